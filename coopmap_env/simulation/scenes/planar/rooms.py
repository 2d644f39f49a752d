"""Rooms and corridors: a floor of an office building with doors and furniture.

The floor is split recursively (`floor_plan.split_floor`); each part becomes a room or a corridor,
doors join them, and furniture stands in the rooms. Every free cell can be reached from every
other one by construction:

- the parts are joined by a spanning tree of openings (`floor_plan.choose_doors`);
- pieces of furniture keep a gap to each other, to the wall opposite and to doors, so one can
  always walk around each of them.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import kernel
from coopmap_env.core.limits import check_cells
from coopmap_env.core.settings import Bounds, Positive, Settings, UnitInterval
from coopmap_env.simulation.scenes.planar._floor_plan import (
    FloorPlanSizes,
    choose_doors,
    split_floor,
)
from coopmap_env.simulation.scenes.planar.world import CellSide, CellsPerSide, PlanarWorld

FurnitureSide = Annotated[float, Bounds(above=0, largest=1_000)]


@dataclass(frozen=True)
class Rooms(Settings):
    """Worlds of rooms along corridors, inside an outer wall. Lengths are rounded to cells."""

    shape: tuple[CellsPerSide, CellsPerSide] = (200, 200)
    """Cells along x and y, the same as in the obstacle worlds."""
    resolution: CellSide = 0.2
    """Side of a cell in metres: a wall is one cell, a door five; 40 m x 40 m in all."""
    origin: tuple[float, float] = (0.0, 0.0)
    """Lower corner of cell (0, 0) in metres."""
    wall: Positive = 0.2
    """Thickness of each wall in metres: that of a light brick wall."""
    corridor: Positive = 2.0
    """Width of corridors in metres: two robots pass."""
    door: Positive = 1.0
    """Width of doors in metres: one robot passes."""
    room_min: Positive = 3.0
    """Shortest side of a room in metres: a small office."""
    room_max: Positive = 8.0
    """Longest side of a room in metres: a longer one is split, so it must hold two small ones."""
    corridor_from: Positive = 12.0
    """A part is split by a corridor if both of its sides exceed this many metres: a row of rooms
    on each side of the corridor."""
    extra_doors: UnitInterval = 0.15
    """Chance of an opening beyond those needed to reach each room: makes loops."""
    furniture: Annotated[float, Bounds(at_least=0, largest=100)] = 0.2
    """Pieces of furniture tried per square metre of room; those that fit are placed."""
    furniture_sides: tuple[FurnitureSide, FurnitureSide] = (0.4, 2.0)
    """Shortest and longest side of a piece in metres: a stool to a table."""
    aisle: FurnitureSide = 0.8
    """Free space in metres in front of doors and between pieces: one robot passes."""
    halls: UnitInterval = 0.0
    """Chance that a part of the floor that is larger than a room stays whole: a hall."""
    hall_max: Positive = 10.0
    """Longest side of a hall in metres; its sides exceed `room_max`. Used if there are halls."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_cells(self.shape, f"Rooms.shape {self.shape}")
        sizes = self._sizes_in_cells
        if sizes.door > min(sizes.room_min, sizes.corridor):
            raise ValueError(
                f"Rooms.door must fit into the smallest room and corridor, not {self.door!r} m "
                f"(room_min {self.room_min!r} m, corridor {self.corridor!r} m)"
            )
        if sizes.room_max < 2 * sizes.room_min + sizes.wall:
            raise ValueError(
                "Rooms.room_max must hold two rooms and a wall "
                f"({2 * self.room_min + self.wall!r} m), not {self.room_max!r} m"
            )
        if min(self.shape) < sizes.room_min + 2 * sizes.wall:
            raise ValueError(
                f"Rooms.shape must hold a room of {self.room_min!r} m inside its walls "
                f"at {self.resolution!r} m per cell, not {self.shape}"
            )
        if self.halls > 0.0 and not self.hall_max > self.room_max:
            raise ValueError(
                f"Rooms.hall_max must exceed room_max ({self.room_max!r} m) where there are halls, "
                f"not {self.hall_max!r} m"
            )
        if not self.furniture_sides[0] <= self.furniture_sides[1]:
            raise ValueError(f"Rooms.furniture_sides must ascend, not {self.furniture_sides!r}")

    @property
    def name(self) -> str:
        """What the scene is called in reports."""
        return "rooms"

    def world(self, rng: np.random.Generator) -> PlanarWorld:
        """Split the floor, open doors, place furniture."""
        sizes = self._sizes_in_cells
        parts = split_floor(rng, self.shape, sizes)
        doors = choose_doors(rng, parts, sizes, self.extra_doors)
        occupied = np.ones(self.shape, dtype=np.bool_)
        for free in [*parts, *doors]:
            occupied[free.slices] = False
        aisle = self._cells(self.aisle)
        reserved = np.zeros(self.shape, dtype=np.bool_)
        for door in doors:
            reserved[door.expanded(aisle).slices] = True
        rooms = [(room.x, room.y, room.n_x, room.n_y) for room in parts if not room.is_corridor]
        pieces = self._random_furniture(rng, np.array(rooms).reshape(-1, 4))
        place_furniture(occupied, reserved, pieces, aisle)
        return PlanarWorld(occupied, self.resolution, self.origin, self.name)

    @property
    def _sizes_in_cells(self) -> FloorPlanSizes:
        return FloorPlanSizes(
            wall=self._cells(self.wall),
            corridor=self._cells(self.corridor),
            door=self._cells(self.door),
            room_min=self._cells(self.room_min),
            room_max=self._cells(self.room_max),
            corridor_from=self._cells(self.corridor_from),
            hall_max=self._cells(self.hall_max),
            halls=self.halls,
        )

    def _cells(self, metres: float) -> int:
        return max(1, round(metres / self.resolution))

    def _random_furniture(
        self, rng: np.random.Generator, rooms: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Draw the pieces to try, room by room, each with an aisle to the walls opposite.

        Both the rooms (n, 4) and the pieces (k, 4) are rectangles [x, y, n_x, n_y] of cells.
        """
        tries = rng.poisson(self.furniture * self.resolution**2 * rooms[:, 2] * rooms[:, 3])
        room = np.repeat(rooms, tries, axis=0)
        drawn = rng.random((len(room), 4))
        shortest, longest = self.furniture_sides
        sides = (shortest + (longest - shortest) * drawn[:, :2]) / self.resolution
        cells = np.maximum(1, np.rint(sides)).astype(np.int64)
        start, fits = _positions(drawn[:, 2:], room[:, 2:] - cells, self._cells(self.aisle))
        return np.hstack([room[:, :2] + start, cells])[fits.all(axis=1)]


def _positions(
    drawn: NDArray[np.float64], spare: NDArray[np.int64], aisle: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Where pieces start along a side of their rooms that is `spare` cells longer, if they fit.

    One time in three at the lower wall, one in three at the upper, else an aisle from both.
    """
    places = spare - 2 * aisle + 1
    between = aisle + ((3 * drawn - 2) * places).astype(np.int64)
    start = np.where(drawn < 1 / 3, 0, np.where(drawn < 2 / 3, spare, between))
    return start, np.where(drawn < 2 / 3, spare >= aisle, places > 0)


@kernel
def place_furniture(
    occupied: NDArray[np.bool_],
    reserved: NDArray[np.bool_],
    pieces: NDArray[np.int64],
    aisle: int,
) -> None:
    """Occupy each piece that covers no reserved cell, and reserve an aisle around it.

    Parameters
    ----------
    occupied, reserved : (nx, ny) bool arrays
        Changed in place.
    pieces : (k, 4) int array
        Rectangles [x, y, n_x, n_y] of cells, inside the world.
    aisle : int
        Cells around a piece that no later one may take.
    """
    for k in range(len(pieces)):
        x, y = pieces[k, 0], pieces[k, 1]
        end_x, end_y = x + pieces[k, 2], y + pieces[k, 3]
        if reserved[x:end_x, y:end_y].any():
            continue
        occupied[x:end_x, y:end_y] = True
        reserved[max(x - aisle, 0) : end_x + aisle, max(y - aisle, 0) : end_y + aisle] = True
