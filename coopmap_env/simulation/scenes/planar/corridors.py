"""Corridors: narrow galleries as in a mine or under a plant, with dead ends, chambers and loops.

The places of an irregular lattice are joined by a random spanning tree of corridors
(`_gallery_plan`). Some dead ends are joined to a neighbour, which makes loops. Corridors bend on
their way from place to place, each has its own width, and some places widen into chambers.

Every free cell can be reached from every other one by construction: the tree joins all places, and
the cells that the middle line of a corridor crosses are a free path. Their middles lie at most
0.71 cells from the line, and a corridor reaches at least one cell to either side.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.limits import check_cells
from coopmap_env.core.settings import Bounds, Settings, UnitInterval
from coopmap_env.simulation.scenes.planar._digging import Blocks, boxes, dig, strips
from coopmap_env.simulation.scenes.planar._gallery_plan import (
    Bands,
    Join,
    cut_bands,
    grow_tree,
    join_dead_ends,
)
from coopmap_env.simulation.scenes.planar.world import CellSide, CellsPerSide, PlanarWorld

Length = Annotated[float, Bounds(above=0, largest=1e12)]

_CHAMBER_CORNERS, _ROUND = 1.6, 1.4
"""Where the corners of chambers, and of the ends of corridors, are cut; see `boxes`."""


@dataclass(frozen=True)
class Corridors(Settings):
    """Worlds of narrow corridors in solid rock."""

    shape: tuple[CellsPerSide, CellsPerSide] = (160, 160)
    """Cells along x and y."""
    resolution: CellSide = 0.2
    """Side of a cell in metres, as in `Rooms`; 32 m x 32 m in all."""
    origin: tuple[float, float] = (0.0, 0.0)
    """Lower corner of cell (0, 0) in metres."""
    corridor: tuple[Length, Length] = (0.8, 1.6)
    """Narrowest and widest corridor in metres: one robot passes, two robots pass."""
    pitch: Length = 3.6
    """Mean distance in metres between neighbouring places; rounded to cells."""
    wall: Length = 0.6
    """Thickness of the thinnest wall in metres, also around the world; rounded to cells."""
    wander: UnitInterval = 1.0
    """How far places and bends stray from the middle between the walls: at 0 the corridors are
    straight, at 1 only the thinnest walls stop them."""
    dead_ends: UnitInterval = 0.6
    """Chance that a dead end stays one; the others are joined to a neighbour, which makes loops."""
    chambers: UnitInterval = 0.3
    """Chance that a place widens into a chamber."""
    chamber_sides: tuple[Length, Length] = (1.8, 3.6)
    """Shortest and longest side of a chamber in metres; where the walls leave less, it is less."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_cells(self.shape, f"Corridors.shape {self.shape}")
        for field in ("corridor", "chamber_sides"):
            shortest, longest = getattr(self, field)
            if not shortest <= longest:
                raise ValueError(f"Corridors.{field} must ascend, not {(shortest, longest)!r}")
        if not self.corridor[0] >= 2 * self.resolution:
            raise ValueError(
                "Corridors.corridor must be at least two cells wide "
                f"({2 * self.resolution!r} m), not {self.corridor!r} m"
            )
        if not self._pitch >= self._thinnest_band + self._wall:
            raise ValueError(
                "Corridors.pitch must hold the widest corridor and a wall "
                f"({self.corridor[1] + self.wall!r} m), not {self.pitch!r} m"
            )
        if not min(self._n_places) >= 2:
            raise ValueError(
                f"Corridors.shape must hold 2 x 2 places every {self.pitch!r} m "
                f"at {self.resolution!r} m per cell, not {self.shape}"
            )

    @property
    def name(self) -> str:
        """What the scene is called in reports."""
        return "corridors"

    def world(self, rng: np.random.Generator) -> PlanarWorld:
        """Choose places and what is joined, dig chambers and corridors."""
        columns, rows = (
            cut_bands(rng, side, n, self._thinnest_band, self._wall)
            for side, n in zip(self.shape, self._n_places, strict=True)
        )
        joins = grow_tree(rng, self._n_places)
        joins += join_dead_ends(rng, joins, self._n_places, self.dead_ends)
        low, high = (
            np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1)
            for ends in zip(columns, rows, strict=True)
        )
        centers, chambers = self._random_places(rng, Bands(low, high))
        corridors = self._random_corridors(rng, Bands(low, high), centers, joins)
        occupied = ~dig(self.shape, [chambers, *corridors])
        return PlanarWorld(occupied, self.resolution, self.origin, self.name)

    def _random_places(
        self, rng: np.random.Generator, bands: Bands
    ) -> tuple[NDArray[np.float64], Blocks]:
        """Draw the centers of all places (columns, rows, 2) and the chambers of some."""
        is_chamber = rng.random(self._n_places) < self.chambers
        shortest, longest = self.chamber_sides
        sides = shortest + (longest - shortest) * rng.random(bands.starts.shape)
        sides = np.maximum(sides * is_chamber[:, :, None], self.corridor[1]) / self.resolution
        half_sides = np.minimum(sides, bands.stops - bands.starts) / 2
        centers = self._wander(rng.random(half_sides.shape), bands, half_sides)
        return centers, boxes(centers[is_chamber], half_sides[is_chamber], _CHAMBER_CORNERS)

    def _random_corridors(
        self,
        rng: np.random.Generator,
        bands: Bands,
        centers: NDArray[np.float64],
        joins: list[Join],
    ) -> list[Blocks]:
        """Draw a width and a bend halfway for each corridor.

        Along its column or row a corridor bends in the middle, across it anywhere between the
        straight line and where a place might be.
        """
        first, second = np.array(joins).transpose(1, 2, 0)
        starts, ends = centers[*first], centers[*second]
        narrowest, widest = self.corridor
        widths = narrowest + (widest - narrowest) * rng.random(len(joins))
        half_widths = widths / self.resolution / 2
        bends = (starts + ends) / 2
        own_bands = Bands(bands.starts[*first], bands.stops[*first])
        drawn = rng.random((len(joins), 1))
        strayed = (bends + self._wander(drawn, own_bands, half_widths[:, None])) / 2
        bends = np.where((first == second).T, strayed, bends)
        squares = np.stack([half_widths, half_widths], axis=-1)
        return [
            strips(starts, bends, half_widths),
            strips(bends, ends, half_widths),
            *(boxes(points, squares, _ROUND) for points in (starts, bends, ends)),
        ]

    def _wander(
        self, drawn: NDArray[np.float64], bands: Bands, margin: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Place something in each band, `margin` cells or more inside, by numbers in [0, 1)."""
        room = bands.stops - bands.starts - 2 * margin
        return (bands.starts + bands.stops) / 2 + self.wander * (drawn - 0.5) * room

    @property
    def _n_places(self) -> tuple[int, int]:
        """Columns and rows."""
        n_x, n_y = ((side - self._wall) // self._pitch for side in self.shape)
        return n_x, n_y

    @property
    def _thinnest_band(self) -> int:
        return math.ceil(self.corridor[1] / self.resolution)

    @property
    def _pitch(self) -> int:
        return round(self.pitch / self.resolution)

    @property
    def _wall(self) -> int:
        return max(1, round(self.wall / self.resolution))
