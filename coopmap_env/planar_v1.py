"""Planar-v1: a team of planar cameras maps an unknown world.

=================  =====================================================================
import             ``from coopmap_env import planar_v1``
many worlds        `vector_env`: a `gymnasium.vector.VectorEnv`, see `coopmap_env.vector`
in turns           `env` and `raw_env`: PettingZoo "AEC", by its own conversion
id                 ``coopmap/Planar-v1`` (PettingZoo "parallel", and Gymnasium for one
                   controller that moves the whole team)
agents             ``robot_0`` ... , 2 by default
actions            `coopmap_env.envs.planar.actions`: ``Box(-1, 1, (3,))``, or
                   `coopmap_env.envs.actions`: ``Discrete(m)``
observations       `coopmap_env.envs.planar.observations`, index by index
rewards            `coopmap_env.envs.rewards`: "rating" (Eq. 9), "information", "coverage",
                   "shown" (for training: it depends on the true world)
settings           `PlanarSettings`: camera, noise, map, rating function, reach
paper              Sujan and Dubowsky, "Cooperative mapping by robot teams"
end                truncation after ``max_scans`` scans of each robot, or when ``max_time``
                   seconds have passed; no termination
=================  =====================================================================

Every robot is a planar camera at the center of a cell, with one of 16 headings. In a step all
robots move, then all scan; their scans are fused into one probabilistic map, whose cells hold
P(occupied). The first scans are taken in the first step: after a reset only the cells around the
robots are known. Cameras are points: they neither occlude the world for each other nor block each
other.

A robot can move to a cell that is known to be free, along a path through such cells. Noise can make
an obstacle look free. A camera that is sent into it collides and stays, and the map marks the cell
as occupied. In the true world only the goal is tested: a path may lead through an obstacle.

Entries of ``infos[agent]``, numbers, after a reset and after each step:

=====================  =============================================================================
key                    content
=====================  =============================================================================
``reward_rating``,     every reward term, of the step (this and the next seven are 0 after a
``reward_coverage``    reset), ``reward_information`` too; ``reward_shown`` only if it is paid or
                       reported
``rejected_reason``    why the pose was rejected and the camera stayed, a `RejectedReason`; 0 if it
                       was not. `MappingEnv.explain` says it in words
``collided``           whether the camera collided with an obstacle that is mapped as free
``new_information``    NI (Eqs. 6-8) of the executed pose, nats
``distance``           d of Eq. 5 that the camera moved
``new_cells``          cells observed for the first time by this robot's scan
``entropy_reduction``  decrease of the map's entropy by this robot's scan, nats
``n_scans``            scans of each robot so far
``elapsed_time``       seconds on the clock of the team: each step lasts as long as the slowest
                       motion (`PlanarSettings.speed`, `turn_rate`) and the scans (`scan_time`)
``observed_fraction``  observed cells of the team map, as a fraction of all cells of the world; the
                       insides of obstacles count too, so that it does not reach 1
``shown_fraction``     only with ``report_shown=True`` or ``reward="shown"``: cells that were truly
                       shown or known at the start, as a fraction of all; for scoring only
=====================  =============================================================================

The mask of candidates is in the observations only (``action_mask``): engines look there first, and
some take a second one in the infos for an error.

Version history
---------------
v1: Eq. 7 counts cells of a view that are hidden, outside of the map or reserved for a teammate as
known and empty (v0 left them out, so that a known map still paid for them), and Eq. 8a is read
without the distance. K and the number of gray bins, chosen again on training worlds, are 0.005 and
128 (0.2 and 64 in v0). Cells behind a measured surface have probability 0.93 instead of one half,
and P is kept within 0.0001 and 0.9999 instead of 0.001 and 0.999. A cell's surface is the mean of
its points (`coopmap_env.mapping.surface_mean`) instead of Eq. 4. `PlanarSettings.v0` restores v0.

v0: first version.
"""

from coopmap_env.envs import RejectedReason
from coopmap_env.envs.arguments import takes_arguments
from coopmap_env.envs.planar import PlanarArguments, PlanarEnv, PlanarSettings, PlanarTeamEnv
from coopmap_env.envs.turns import in_turns, with_order
from coopmap_env.vector import PlanarVectorEnv

parallel_env = takes_arguments(PlanarArguments)(PlanarEnv)
team_env = takes_arguments(PlanarArguments)(PlanarTeamEnv)
raw_env = takes_arguments(PlanarArguments)(in_turns(PlanarEnv))
env = takes_arguments(PlanarArguments)(with_order(raw_env))
vector_env = PlanarVectorEnv

__all__ = [
    "PlanarArguments",
    "PlanarSettings",
    "RejectedReason",
    "env",
    "parallel_env",
    "raw_env",
    "team_env",
    "vector_env",
]
