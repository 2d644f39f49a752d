"""New surface: the pose that is expected to show most of the surface that is still unknown."""

from __future__ import annotations

from typing import Any

from coopmap_baselines.lookahead import LookaheadPolicy
from coopmap_baselines.planner import Search
from coopmap_env.envs import Belief, Foresight
from coopmap_env.information import near_surface_chances


class SurfacePolicy(LookaheadPolicy):
    """The look-ahead planner that counts expected surface, in the field.

    Never-sampled voxels near the known surface count most, as surfaces go on: `coverage` and
    `lookahead` count all alike, and most of them are air.

    Parameters
    ----------
    horizon : int
        See `LookaheadPolicy`.
    search : int or "exhaustive"
        Number of random poses, of which the first view is one.
    motion_weight : float
        Gain, as a fraction of a full view, that is worth one unit of d (Eq. 5).
    **options
        The others of `LookaheadPolicy`.

    Raises
    ------
    ValueError
        If an option is not one of its choices; in `act`, if the map is planar.
    """

    def __init__(
        self,
        horizon: int = 1,
        search: Search = 100,
        motion_weight: float = 2e-4,
        **options: Any,
    ) -> None:
        super().__init__(horizon, search=search, motion_weight=motion_weight, **options)

    def foresight(self, belief: Belief) -> Foresight:
        """The map with the probability that each unknown voxel is surface."""
        return belief.planning.foresight(belief, near_surface_chances(belief.map))
