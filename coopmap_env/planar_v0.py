"""Planar-v0: a team of cameras maps an unknown planar world.

=================  =====================================================================
import             ``from coopmap_env import planar_v0``
id                 ``coopmap/Planar-v0`` (PettingZoo "parallel", and Gymnasium for one
                   controller that moves the whole team)
agents             ``robot_0`` ... , 2 by default
actions            `coopmap_env.envs.planar.actions`: ``Box(-1, 1, (3,))``, or
                   `coopmap_env.envs.actions`: ``Discrete(m)``
observations       `coopmap_env.envs.planar.observations`, index by index
rewards            `coopmap_env.envs.rewards`: "rating" (Eq. 9), "information", "coverage"
settings           `PlanarSettings`: camera, noise, map, rating function, reach
end                truncation after ``max_scans`` scans of each robot; no termination
=================  =====================================================================

Every robot is a planar camera that stands at a cell centre of the known free space and looks in
one of 16 directions. In a step all robots move, then all look; their scans are fused into one
probabilistic map, whose cells hold P(occupied). The first scans are taken with the first step: a
reset shows only the few cells around the robots. Cameras are points: they neither hide the world
from each other nor stand in each other's way.

Noise can make a wall look free. A camera that is sent there bumps into it and stays, and the map
learns of the cell. Only the goal is asked about: a path may lead through such a cell.

``infos[agent]`` holds ``reward_terms`` (all reward terms), ``rejected_reason`` (why the camera stayed, or ""),
``contact`` (whether it bumped into something that the map took as free),
``new_information``, ``distance``, ``new_cells``, ``entropy_reduction``, ``scans``, ``observed_fraction``, and
``action_mask`` in "candidates" mode. After a reset there are only ``scans``, ``observed_fraction`` and
the mask. ``observed_fraction`` counts every cell of the world, the insides of obstacles too, so it does
not reach one.

Version history
---------------
v0: first version.
"""

from coopmap_env.envs.arguments import takes_arguments
from coopmap_env.envs.planar import PlanarArguments, PlanarEnv, PlanarSettings, PlanarTeamEnv

parallel_env = takes_arguments(PlanarArguments)(PlanarEnv)
team_env = takes_arguments(PlanarArguments)(PlanarTeamEnv)

__all__ = ["PlanarArguments", "PlanarSettings", "parallel_env", "team_env"]
