"""Clutter: tables and shelves full of things, after pybullet_data.

The target is the table in the middle with all that lies on it. Things lie where their boxes find
room; nothing is dropped by physics.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopmap_env.mapping.grid import VoxelGrid
from coopmap_env.simulation.scenes.field.base_poses import DEFAULT_STAND, Stand, draw_bases
from coopmap_env.simulation.scenes.field.layout import Yard
from coopmap_env.simulation.scenes.field.pybullet_assets import (
    RANDOM,
    TOYS,
    Ware,
    random_ware,
    shelf,
    table,
    toy,
)
from coopmap_env.simulation.scenes.field.solid import Solid, turn_about_z
from coopmap_env.simulation.scenes.field.world import (
    CLEARANCE,
    FIELD_GRID,
    FieldWorld,
    check_field_grid,
    ground_of,
)

TARGET = "table"

_TOP = 0.625
_TOP_SIDES = np.array([1.5, 1.0])
_SLOTS = [
    *((x, 0.384, 0.40, 0.40) for x in (-0.21, 0.21)),
    *(
        (x, floor, 0.27, height)
        for floor, height in ((0.814, 0.23), (1.074, 0.20), (1.304, 0.21), (1.544, 0.22))
        for x in (-0.285, 0.0, 0.285)
    ),
]
"""Compartments of a shelf: x of the middle, z of the floor, width and height in metres."""
_ON_SHELVES = 1.5
"""Factor on the size of random objects on shelves, whose compartments are small."""
_TRIES = 20
_FROM, _TO = 1.2, 6.0
_TABLE_RADIUS, _SHELF_RADIUS = 0.91, 0.65
_NO_TURN = np.eye(3)


@dataclass(frozen=True)
class Clutter:
    """Worlds of tables and shelves with things on and around them."""

    grid: VoxelGrid = FIELD_GRID
    on_target: tuple[int, int] = (7, 11)
    """Fewest and most random objects on the table in the middle; some toys come on top."""
    tables: tuple[int, int] = (1, 2)
    """Fewest and most tables around it."""
    shelves: tuple[int, int] = (1, 2)
    """Fewest and most shelves."""
    loose: tuple[int, int] = (3, 6)
    """Fewest and most things on the ground; as many again at most on each table and shelf."""
    enlarged: float = 2.5
    """Factor on the size of the random objects, which are 0.1 m across: about one voxel."""
    stand: Stand = DEFAULT_STAND

    def __post_init__(self) -> None:
        check_field_grid(self.grid)
        for name in ("on_target", "tables", "shelves", "loose"):
            fewest, most = getattr(self, name)
            if not 0 <= fewest <= most:
                raise ValueError(f"{name} must be (fewest, most), not {getattr(self, name)!r}")
        if not 0.0 < self.enlarged < math.inf:
            raise ValueError(f"enlarged must be finite and above 0, not {self.enlarged!r}")

    @property
    def name(self) -> str:
        """What the scene is called in reports."""
        return "clutter"

    def world(
        self, rng: np.random.Generator, n_robots: int, footprint: float = CLEARANCE
    ) -> FieldWorld:
        """Draw the middle table, vehicles about it, then what leaves them room and sight.

        Raises
        ------
        ImportError
            With the pip command, if pybullet_data is not installed.
        """
        target = self._target(rng)
        bases = draw_bases(rng, n_robots, self.stand, footprint, self.grid, target)
        yard = Yard(self.grid, bases, footprint, target)
        for k in range(_number(rng, self.shelves)):
            self._add_shelf(rng, yard, f"shelf_{k}")
        for k in range(_number(rng, self.tables)):
            self._add_table(rng, yard, f"table_{k}")
        for k in range(_number(rng, self.loose)):
            ware, rotation = self._draw(rng), _any_yaw(rng)
            spot = yard.spot(rng, _outline(ware), _FROM, _TO)
            if spot is not None:
                yard.add(ware.put(f"loose_{k}", (*spot, 0.0), rotation, is_target=False))
        solids = (ground_of(self.grid), *target, *yard.in_sight())
        return FieldWorld(self.name, solids, TARGET, self.grid, bases)

    def _target(self, rng: np.random.Generator) -> list[Solid]:
        """Lay the middle table with toys and random objects."""
        target = [table(TARGET, np.zeros(3), _NO_TURN, is_target=True)]
        wares = [toy(name) for name in TOYS if rng.random() < 0.6]
        wares += [self._draw(rng) for _ in range(_number(rng, self.on_target))]
        for k, (ware, spot, rotation) in enumerate(_lay(rng, wares)):
            name = f"{TARGET}_thing_{k}"
            target.append(ware.put(name, (*spot, _TOP), rotation, is_target=True))
        return target

    def _add_table(self, rng: np.random.Generator, yard: Yard, name: str) -> None:
        middle, turned = yard.spot(rng, _TABLE_RADIUS, _FROM, _TO), _any_yaw(rng)
        if middle is None:
            return
        position = np.array([*middle, 0.0])
        below = yard.add(table(name, position, turned, is_target=False))
        wares = [self._draw(rng) for _ in range(_number(rng, self.loose))]
        for k, (ware, spot, rotation) in enumerate(_lay(rng, wares)):
            place = turned @ [*spot, _TOP] + position
            thing = ware.put(f"{name}_thing_{k}", place, turned @ rotation, is_target=False)
            yard.add(thing, below)

    def _add_shelf(self, rng: np.random.Generator, yard: Yard, name: str) -> None:
        middle, turned = yard.spot(rng, _SHELF_RADIUS, _FROM, _TO), _any_yaw(rng)
        if middle is None:
            return
        position = np.array([*middle, 0.0])
        below = yard.add(shelf(name, position, turned))
        slots = rng.permutation(len(_SLOTS))
        for slot in slots[: _number(rng, self.loose)]:
            x, floor, width, height = _SLOTS[slot]
            number, y = RANDOM[rng.integers(len(RANDOM))], rng.uniform(-0.25, 0.25)
            ware = random_ware(number, _ON_SHELVES)
            if ware.size[0] < width and ware.size[2] < height:
                place = turned @ [x, y, floor] + position
                thing = ware.put(f"{name}_thing_{slot}", place, turned, is_target=False)
                yard.add(thing, below)

    def _draw(self, rng: np.random.Generator) -> Ware:
        return random_ware(RANDOM[rng.integers(len(RANDOM))], self.enlarged)


def _lay(
    rng: np.random.Generator, wares: list[Ware]
) -> list[tuple[Ware, NDArray[np.float64], NDArray[np.float64]]]:
    """Lay things on a table: those that found room, with their spot (x, y) and rotation."""
    laid: list[tuple[Ware, NDArray[np.float64], NDArray[np.float64]]] = []
    for ware in wares:
        radius, rotation = _outline(ware), _any_yaw(rng)
        for _ in range(_TRIES):
            spot = (rng.random(2) - 0.5) * np.maximum(_TOP_SIDES - 2 * radius, 0.0)
            if all(math.dist(spot, other) >= radius + _outline(one) for one, other, _ in laid):
                laid.append((ware, spot, rotation))
                break
    return laid


def _outline(ware: Ware) -> float:
    """Radius in metres of the circle about a thing's middle that holds it at any yaw."""
    return 0.5 * math.hypot(ware.size[0], ware.size[1])


def _any_yaw(rng: np.random.Generator) -> NDArray[np.float64]:
    return turn_about_z(rng.uniform(-math.pi, math.pi))


def _number(rng: np.random.Generator, bounds: tuple[int, int]) -> int:
    return int(rng.integers(bounds[0], bounds[1] + 1))
