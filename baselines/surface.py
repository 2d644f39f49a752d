"""New surface: the pose that is expected to show most of the surface that is still unknown."""

from __future__ import annotations

from coopmap_baselines.lookahead import LookaheadPolicy, TeamCoordination
from coopmap_baselines.planner import Search
from coopmap_env.envs import Belief, Foresight
from coopmap_env.information import near_surface_weights


class SurfacePolicy(LookaheadPolicy):
    """The look-ahead planner that counts expected surface, in the field.

    Never-sampled voxels near the known surface count most, as surfaces go on: `coverage` and
    `lookahead` count all alike, and most of them are air.

    Parameters are those of `LookaheadPolicy`, with other defaults. Of motion weights from 0 to
    0.0004, 0.0002 covered most on training worlds, with less motion than `coverage`.

    Raises
    ------
    ValueError
        If an option is not one of its choices; in `act`, if the map is planar.
    """

    def __init__(
        self,
        horizon: int = 1,
        width: int = 16,
        search: Search = 100,
        samples: int = 150,
        coordination: TeamCoordination = "sequential",
        discount: float = 0.5,
        motion_weight: float = 2e-4,
    ) -> None:
        super().__init__(horizon, width, search, samples, coordination, discount, motion_weight)

    def foresight(self, belief: Belief) -> Foresight:
        """The map, with how much each unknown voxel counts as surface."""
        return belief.planning.foresight(belief, near_surface_weights(belief.map))
