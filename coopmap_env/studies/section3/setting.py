"""Section 3 of the paper: its searches, its printed table, and the camera, world and weights.

The paper does not state its camera, its obstacles and its constants. `TableConstants` are those
with which our Table 1 is nearest to the printed one, of those that searches on training worlds
tried: `table_fit/record.json` says what was played, and `coopmap fit-table` searches further.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Any

from coopmap_env.core.settings import Bounds, NonNegative, Positive, Settings
from coopmap_env.envs.planar import PlanarSettings
from coopmap_env.simulation.scenes.planar import Obstacles

SCANS_EACH = 16
"""Two robots: 32 scans together."""
SEARCHES = (10, 50, 100, 200, 300, "exhaustive")
"""m of the paper's random search, and the search over all poses."""
RASTER = "raster"
PAPER_TABLE_1 = {
    10: (54.89, 26.74, 11.48),
    50: (47.34, 23.79, 9.91),
    100: (46.69, 23.57, 9.17),
    200: (46.01, 22.81, 9.42),
    300: (36.62, 20.69, 7.85),
    "exhaustive": (34.59, 19.23, 7.52),
}
"""Farthest observed point, mean radius and sigma as printed, in the paper's units."""
TABLE_1_SCORES = ("max_radius", "mean_radius", "radius_std")
"""Columns of an evaluation's table that correspond to the paper's."""
PAPER_OBSERVED = 0.09
"""Observed fraction after 32 scans: where the curves of the paper's Figure 8 end."""

BEAM_GAP = 0.5
"""Cells between two beams at the end of the view: no cell falls between them."""
MAX_BEAMS = 64
"""Beams of a camera whose views are rated in one pass; a wider view has larger gaps."""


@dataclass(frozen=True)
class TableConstants(Settings):
    """What the paper leaves open. Lengths are in cells, the unit of its distances.

    Raises
    ------
    ValueError
        If a value is outside of its range.
    """

    field_of_view: Annotated[float, Bounds(above=0, at_most=180)] = 22.0
    """Degrees."""
    depth_of_field: Positive = 21.6
    """Cells."""
    K: NonNegative = 0.204
    """Weight of the motion (Eq. 9), nats per unit of d**n."""
    exponent: Annotated[float, Bounds(at_least=0, at_most=4)] = 0.919
    """n of Eq. 9."""
    heading_length: NonNegative = 4.5
    """Cells of motion that cost as much as one radian: the root of a heading's weight in Eq. 5."""
    n_gray_bins: Annotated[int, Bounds(at_least=2, at_most=256)] = 10
    """Bins over the gray levels (Eq. 7)."""
    n_headings: Annotated[int, Bounds(at_least=3, at_most=256)] = 42
    """Headings of the configuration space."""
    side: Annotated[int, Bounds(at_least=40, at_most=400)] = 145
    """Cells along each side of the world."""
    occupied_fraction: Annotated[float, Bounds(at_least=0, at_most=0.5)] = 0.138
    block_side: Positive = 6.2
    """Shortest side of an obstacle, cells."""
    block_ratio: Annotated[float, Bounds(at_least=1)] = 2.23
    """Longest side of an obstacle over the shortest."""
    start_distance: Positive = 30.5
    """Cells: the second robot starts no further than this from the first."""

    @property
    def n_beams(self) -> int:
        """Beams of the camera."""
        arc = math.radians(self.field_of_view) * self.depth_of_field
        return min(MAX_BEAMS, max(2, math.ceil(arc / BEAM_GAP)))


def section3_settings(
    constants: TableConstants | None = None, base: PlanarSettings | None = None, **rating: Any
) -> PlanarSettings:
    """Settings of the reproduction.

    The reach spans the world, because the paper searches "the entire known configuration space".

    Parameters
    ----------
    constants : TableConstants, optional
    base : PlanarSettings, optional
        Has what is not among the constants, such as the readings of Eqs. 7 and 8a.
    **rating
        Replaces single constants of the rating function.
    """
    c, base = constants or TableConstants(), base or PlanarSettings()
    weights = {
        "K": c.K,
        "exponent": c.exponent,
        "alpha_heading": c.heading_length**2,
        "n_gray_bins": c.n_gray_bins,
    }
    return replace(
        base,
        camera=replace(
            base.camera,
            field_of_view=math.radians(c.field_of_view),
            depth_of_field=c.depth_of_field,
            n_beams=c.n_beams,
        ),
        rating=replace(base.rating, **{**weights, **rating}),
        n_headings=c.n_headings,
        reach=2.0 * c.side,
        max_start_distance=c.start_distance,
    )


def section3_scene(constants: TableConstants | None = None) -> Obstacles:
    """The scene of the reproduction."""
    c = constants or TableConstants()
    return Obstacles(
        shape=(c.side, c.side),
        occupied_fraction=c.occupied_fraction,
        side_min=c.block_side,
        side_max=c.block_side * c.block_ratio,
    )
