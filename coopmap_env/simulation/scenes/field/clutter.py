"""Clutter: tables and shelves full of objects, after pybullet_data.

The target is the table in the middle with all that lies on it. Objects lie where there is room
for their boxes; nothing is dropped by physics.
"""

import math
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.linear_algebra import length, product
from coopmap_env.core.settings import Bounds, Settings
from coopmap_env.geometry import Z_AXIS, rotation_about_axis
from coopmap_env.mapping import VoxelGrid
from coopmap_env.simulation.scenes.field._layout import SceneLayout
from coopmap_env.simulation.scenes.field._pybullet_assets import (
    NAMED_ASSETS,
    RANDOM_ASSETS,
    PyBulletAsset,
    load_asset,
    load_random_asset,
    shelf,
    table,
)
from coopmap_env.simulation.scenes.field.base_poses import (
    DEFAULT_PLACEMENT,
    BasePlacement,
    sample_base_poses,
)
from coopmap_env.simulation.scenes.field.solid import Solid
from coopmap_env.simulation.scenes.field.world import (
    BASE_CLEARANCE,
    FIELD_GRID,
    CountRange,
    FieldWorld,
    check_counts,
    check_field_grid,
    make_ground,
)

TARGET = "table"

_TABLE_HEIGHT = 0.625
_TABLE_SIZE = np.array([1.5, 1.0])


class Compartment(NamedTuple):
    """A compartment of a shelf, metres in the frame of the shelf."""

    x: float
    """X of its middle."""
    floor: float
    """z of its floor."""
    width: float
    height: float


_COMPARTMENTS = [
    *(Compartment(x, 0.384, 0.40, 0.40) for x in (-0.21, 0.21)),
    *(
        Compartment(x, floor, 0.27, height)
        for floor, height in ((0.814, 0.23), (1.074, 0.20), (1.304, 0.21), (1.544, 0.22))
        for x in (-0.285, 0.0, 0.285)
    ),
]
_SHELF_OBJECT_SCALE = 1.5
"""Factor on the size of random objects on shelves, whose compartments are small."""
_MAX_TRIES = 20
_MIN_DISTANCE, _MAX_DISTANCE = 1.2, 6.0
_TABLE_RADIUS, _SHELF_RADIUS = 0.91, 0.65
_IDENTITY = np.eye(3)


@dataclass(frozen=True)
class Clutter(Settings):
    """Worlds of tables and shelves with objects on and around them."""

    grid: VoxelGrid = FIELD_GRID
    target_objects: CountRange = (7, 11)
    """Fewest and most random objects on the table in the middle; named ones are added to them."""
    tables: CountRange = (1, 2)
    """Fewest and most tables around it."""
    shelves: CountRange = (1, 2)
    """Fewest and most shelves."""
    loose_objects: CountRange = (3, 6)
    """Fewest and most objects on the ground; at most as many more on each table and shelf."""
    object_scale: Annotated[float, Bounds(above=0, smallest=0.01, largest=100)] = 2.5
    """Factor on the size of the random objects, which are 0.1 m across: about one voxel."""
    base_placement: BasePlacement = DEFAULT_PLACEMENT

    def __post_init__(self) -> None:
        super().__post_init__()
        check_field_grid(self.grid)
        check_counts(self, "target_objects", "tables", "shelves", "loose_objects")

    @property
    def name(self) -> str:
        """What the scene is called in reports."""
        return "clutter"

    def world(
        self, rng: np.random.Generator, n_robots: int, footprint: float = BASE_CLEARANCE
    ) -> FieldWorld:
        """Draw the middle table, base poses around it, then what leaves them room and a view.

        Raises
        ------
        ImportError
            With the pip command, if pybullet_data is not installed.
        """
        target = self._target(rng)
        bases = sample_base_poses(rng, n_robots, self.base_placement, footprint, self.grid, target)
        layout = SceneLayout(self.grid, bases, footprint, target)
        for k in range(_sample_count(rng, self.shelves)):
            self._add_shelf(rng, layout, f"shelf_{k}")
        for k in range(_sample_count(rng, self.tables)):
            self._add_table(rng, layout, f"table_{k}")
        for k in range(_sample_count(rng, self.loose_objects)):
            asset, rotation = self._random_asset(rng), _random_yaw(rng)
            center = layout.sample_free_disc(rng, _disc_radius(asset), _MIN_DISTANCE, _MAX_DISTANCE)
            if center is not None:
                layout.add(asset.to_solid(f"loose_{k}", (*center, 0.0), rotation, is_target=False))
        solids = (make_ground(self.grid), *target, *layout.remove_occluders())
        return FieldWorld(self.name, solids, TARGET, self.grid, bases)

    def _target(self, rng: np.random.Generator) -> list[Solid]:
        """The middle table with named and random objects on it."""
        target = [table(TARGET, np.zeros(3), _IDENTITY, is_target=True)]
        assets = [load_asset(name) for name in NAMED_ASSETS if rng.random() < 0.6]
        assets += [self._random_asset(rng) for _ in range(_sample_count(rng, self.target_objects))]
        for k, (asset, center, rotation) in enumerate(_arrange(rng, assets)):
            name = f"{TARGET}_thing_{k}"
            target.append(asset.to_solid(name, (*center, _TABLE_HEIGHT), rotation, is_target=True))
        return target

    def _add_table(self, rng: np.random.Generator, layout: SceneLayout, name: str) -> None:
        middle = layout.sample_free_disc(rng, _TABLE_RADIUS, _MIN_DISTANCE, _MAX_DISTANCE)
        support_rotation = _random_yaw(rng)
        if middle is None:
            return
        position = np.array([*middle, 0.0])
        support = layout.add(table(name, position, support_rotation, is_target=False))
        assets = [self._random_asset(rng) for _ in range(_sample_count(rng, self.loose_objects))]
        for k, (asset, center, rotation) in enumerate(_arrange(rng, assets)):
            world_position = product(support_rotation, [*center, _TABLE_HEIGHT]) + position
            world_rotation = product(support_rotation, rotation)
            solid = asset.to_solid(
                f"{name}_thing_{k}", world_position, world_rotation, is_target=False
            )
            layout.add(solid, support)

    def _add_shelf(self, rng: np.random.Generator, layout: SceneLayout, name: str) -> None:
        middle = layout.sample_free_disc(rng, _SHELF_RADIUS, _MIN_DISTANCE, _MAX_DISTANCE)
        support_rotation = _random_yaw(rng)
        if middle is None:
            return
        position = np.array([*middle, 0.0])
        support = layout.add(shelf(name, position, support_rotation))
        slots = rng.permutation(len(_COMPARTMENTS))
        for slot in slots[: _sample_count(rng, self.loose_objects)]:
            x, floor, width, height = _COMPARTMENTS[slot]
            number, y = RANDOM_ASSETS[rng.integers(len(RANDOM_ASSETS))], rng.uniform(-0.25, 0.25)
            asset = load_random_asset(number, _SHELF_OBJECT_SCALE)
            if asset.size[0] < width and asset.size[2] < height:
                world_position = product(support_rotation, [x, y, floor]) + position
                solid = asset.to_solid(
                    f"{name}_thing_{slot}", world_position, support_rotation, is_target=False
                )
                layout.add(solid, support)

    def _random_asset(self, rng: np.random.Generator) -> PyBulletAsset:
        return load_random_asset(RANDOM_ASSETS[rng.integers(len(RANDOM_ASSETS))], self.object_scale)


def _arrange(
    rng: np.random.Generator, assets: list[PyBulletAsset]
) -> list[tuple[PyBulletAsset, NDArray[np.float64], NDArray[np.float64]]]:
    """Lay assets on a table: those with room, their positions (x, y) and rotations."""
    placed: list[tuple[PyBulletAsset, NDArray[np.float64], NDArray[np.float64]]] = []
    for asset in assets:
        radius, rotation = _disc_radius(asset), _random_yaw(rng)
        for _ in range(_MAX_TRIES):
            center = (rng.random(2) - 0.5) * np.maximum(_TABLE_SIZE - 2 * radius, 0.0)
            if all(
                math.dist(center, other) >= radius + _disc_radius(one) for one, other, _ in placed
            ):
                placed.append((asset, center, rotation))
                break
    return placed


def _disc_radius(asset: PyBulletAsset) -> float:
    """Radius in metres of the disc around an asset's middle that contains it at any yaw."""
    return 0.5 * length(asset.size[:2])


def _random_yaw(rng: np.random.Generator) -> NDArray[np.float64]:
    return rotation_about_axis(Z_AXIS, rng.uniform(-math.pi, math.pi))


def _sample_count(rng: np.random.Generator, bounds: tuple[int, int]) -> int:
    return int(rng.integers(bounds[0], bounds[1] + 1))
