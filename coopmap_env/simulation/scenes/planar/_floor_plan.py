"""How a floor is split into rooms and corridors, and where the doors between them go.

Lengths are integers, in cells. Between two neighbouring parts lies one wall; a door is a piece
of it.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class CellRectangle:
    """A rectangle of cells: its lower corner (x, y) and its size (n_x, n_y)."""

    x: int
    y: int
    n_x: int
    n_y: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Index of these cells in an (nx, ny) array."""
        return slice(self.x, self.x + self.n_x), slice(self.y, self.y + self.n_y)

    def expanded(self, n: int) -> "CellRectangle":
        """The rectangle with `n` cells more on each side, cut off at index 0."""
        x, y = max(0, self.x - n), max(0, self.y - n)
        return CellRectangle(x, y, self.x + self.n_x + n - x, self.y + self.n_y + n - y)


@dataclass(frozen=True)
class FloorPart(CellRectangle):
    """A room or a corridor."""

    is_corridor: bool = False


@dataclass(frozen=True)
class Door(CellRectangle):
    """An opening in the wall between the parts `first` and `second` (indices)."""

    first: int = 0
    second: int = 0


@dataclass(frozen=True)
class FloorPlanSizes:
    """Lengths of a floor plan in cells, and the chance of halls; see `rooms.Rooms`."""

    wall: int
    corridor: int
    door: int
    room_min: int
    room_max: int
    corridor_from: int
    hall_max: int = 0
    halls: float = 0.0


def split_floor(
    rng: np.random.Generator, shape: tuple[int, int], sizes: FloorPlanSizes
) -> list[FloorPart]:
    """Split the floor inside the outer wall until each part is a corridor or a room.

    Parameters
    ----------
    rng : numpy.random.Generator
        Chooses where to cut.
    shape : (int, int)
        Cells of the floor with its outer wall.
    sizes : FloorPlanSizes
        ``room_max`` holds two smallest rooms and a wall.

    Returns
    -------
    list of FloorPart
        Disjoint, with walls in between.
    """
    wall = sizes.wall
    floor = FloorPart(wall, wall, shape[0] - 2 * wall, shape[1] - 2 * wall)
    return list(_split(rng, floor, sizes))


def _split(rng: np.random.Generator, part: FloorPart, sizes: FloorPlanSizes) -> Iterator[FloorPart]:
    """Cut across the longer side: with a corridor while the part is large, then with a wall."""
    longer, shorter = max(part.n_x, part.n_y), min(part.n_x, part.n_y)
    gap_of_corridor = sizes.corridor + 2 * sizes.wall
    if shorter > sizes.corridor_from and longer >= 2 * sizes.room_min + gap_of_corridor:
        gap, spread = gap_of_corridor, 0.3  # corridors run near the middle
    elif longer > sizes.room_max and not _is_hall(rng, longer, shorter, sizes):
        gap, spread = sizes.wall, 1.0
    else:
        yield part
        return
    spare = longer - gap - 2 * sizes.room_min
    fraction = 0.5 + spread * (rng.random() - 0.5)
    cut = sizes.room_min + int(fraction * (spare + 1))
    lower, upper = _sub_part(part, 0, cut), _sub_part(part, cut + gap, longer)
    yield from _split(rng, lower, sizes)
    if gap == gap_of_corridor:
        start = cut + sizes.wall
        yield _sub_part(part, start, start + sizes.corridor, is_corridor=True)
    yield from _split(rng, upper, sizes)


def _is_hall(rng: np.random.Generator, longer: int, shorter: int, sizes: FloorPlanSizes) -> bool:
    """Whether a part of these sides stays whole; nothing is drawn on a floor without halls."""
    is_fit = shorter > sizes.room_max and longer <= sizes.hall_max
    return is_fit and sizes.halls > 0.0 and rng.random() < sizes.halls


def _sub_part(part: FloorPart, start: int, stop: int, *, is_corridor: bool = False) -> FloorPart:
    """The cells from `start` to `stop` along the longer side of a part."""
    if part.n_x >= part.n_y:
        return FloorPart(part.x + start, part.y, stop - start, part.n_y, is_corridor)
    return FloorPart(part.x, part.y + start, part.n_x, stop - start, is_corridor)


def choose_doors(
    rng: np.random.Generator, parts: list[FloorPart], sizes: FloorPlanSizes, extra: float
) -> list[Door]:
    """Join all parts by a spanning tree of openings, and some more by chance.

    Corridors open into each other over their full width. The tree prefers doors between a room
    and a corridor over doors between rooms; among equals chance decides. A tree exists: by
    induction over the cuts, the parts on either side are joined, and at the end of the cut the
    first two parts face each other over at least the smallest room or corridor, where a door fits.
    """
    walls = sorted(
        (2 - parts[a].is_corridor - parts[b].is_corridor + rng.random(), a, b, opening)
        for a, b, opening in _shared_walls(parts, sizes)
    )
    group = list(range(len(parts)))
    doors = []
    for cost, a, b, (along_x, start, stop, at) in walls:
        needed = group[a] != group[b]
        if not needed and rng.random() >= extra:
            continue
        if needed:
            old, new = group[b], group[a]
            group = [new if label == old else label for label in group]
        width = stop - start if cost < 1 else sizes.door
        start += int(rng.random() * (stop - start - width + 1))
        if along_x:
            doors.append(Door(start, at, width, sizes.wall, a, b))
        else:
            doors.append(Door(at, start, sizes.wall, width, a, b))
    return doors


def _shared_walls(
    parts: list[FloorPart], sizes: FloorPlanSizes
) -> Iterator[tuple[int, int, tuple[bool, int, int, int]]]:
    """Find pairs of parts with one wall between them that is wide enough for a door.

    Yields the two indices and the wall: whether it runs along x, from where to where, and its
    lower edge on the other axis.
    """
    lower = np.array([(part.x, part.y) for part in parts])
    upper = lower + [(part.n_x, part.n_y) for part in parts]
    start = np.maximum(lower[:, None], lower)
    stop = np.minimum(upper[:, None], upper)
    for across in (0, 1):
        along = 1 - across
        facing = upper[:, None, across] + sizes.wall == lower[None, :, across]
        wide = stop[:, :, along] - start[:, :, along] >= sizes.door
        for a, b in np.argwhere(facing & wide).tolist():
            wall = (along == 0, int(start[a, b, along]), int(stop[a, b, along]))
            yield a, b, (*wall, int(upper[a, across]))
