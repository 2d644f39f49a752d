"""Field-v0: stationary vehicles with articulated camera mounts map a worksite in 3-D.

=================  =====================================================================
import             ``from coopmap_env import field_v0`` (extra ``field``)
ids                ``coopmap/Field-v0`` and, with the search for the target and fiducials,
                   ``coopmap/FieldSearch-v0`` (PettingZoo "parallel", and Gymnasium for one
                   controller that moves the whole team)
agents             ``robot_0`` ... , 2 by default
actions            `coopmap_env.envs.field.actions`: ``Box(-1, 1, (n,))``, the mount's
                   joints, or `coopmap_env.envs.actions`: ``Discrete(m)``
observations       `coopmap_env.envs.field.observations`, index by index
rewards            `coopmap_env.envs.rewards`: "rating" (Eq. 9), "information", "coverage"
settings           `FieldSettings`: camera, noise, map, rating function, motion, physics
mounts             `make_mount`: "mast", "husky_panda", "tiago", or a `Mount` of any URDF
scenes             "worksite", "clutter", "rubble", or a YAML file of meshes and URDFs
end                truncation after ``max_scans`` scans of each robot; no termination
=================  =====================================================================

The world frame is that of the target. Vehicles stand around it, know where they stand, and do not
drive; each moves a depth camera on a mount. In a step all mounts move, in the order of their
numbers (or, with stepped physics, all at once); then all cameras look, and their scans are fused
into one probabilistic voxel map.

A motion has to keep clear of every voxel that is not known to be free (P >= 0.05 or never sampled),
along its whole way, of the own vehicle and of the teammates; otherwise the mount stays and
``infos[agent]["rejected_reason"]`` says why. Where the map is wrong, the mount bumps into what is there, is
stopped, and pays `FieldSettings.contact_cost`; where on its links it was touched it does not feel,
so the map learns nothing of it (in the plane it does). Surfaces at a grazing angle, and voxels that
a surface only touches, may be taken as free. The room in which a vehicle was parked is known.

Bodies stand on springs: a mount that swings out leans its vehicle, and the camera does not end
where its encoders say. The map is made from where the robot takes its camera to be, with the
covariance of encoders, calibration and suspension added to that of the range noise
(``motion_correction="kinematic"``, which is fast). With ``"fiducials"``, surfaces that were seen
before and the known target correct the pose of each look, as far as they tell (2.5); ``"exact"``
poses are for upper bounds only. Robots see each other, know each other's shape, and keep it out of
the map.

The common frame is that of the target. A target that looks alike from several sides has several
such frames; the first robot that is located takes the one in which the world is written.

By default robots know where they stand: policies train on mapping alone, and results do not hang on
registration. With ``initialization="search"`` they are parked with any heading (but for those that
a scene's file names), know their mounts
and the target's geometry, and nothing of where they or the others stand (2.2). Each maps in a frame
of its own, in which its base stands in the middle of a grid, and is rewarded for that map; after
each scan it looks for the target in all that it has seen. Once it is located, its looks are moved
into the team's map, which was empty before, and are not paid again. Robots that are both located
know each other as obstacles. A robot that never finds the target leaves nothing in the team's map.

``infos[agent]`` holds ``reward_terms`` (all reward terms), ``rejected_reason`` (why the mount stayed, or ""),
``contact`` (whether it bumped into something) and ``collided_with`` (into what), ``camera_error`` (metres
between where the camera is and where it is taken to be; scoring only, as ``camera_angle_error``,
``base_error`` and ``base_angle_error``, the last two None until it is located), ``located``,
``localization_failure`` (why not, or ""), ``corrected_directions`` (of the camera pose's six, how many
fiducials told better than the prediction) and ``correction_failure`` (why they told nothing, or ""),
``new_information``,
``distance``, ``new_cells``, ``entropy_reduction``, ``scans``, ``observed_fraction``, and ``action_mask`` in
"candidates" mode. After a reset there are only ``scans``, ``observed_fraction`` and the mask.

Version history
---------------
v0: first version.
"""

from coopmap_env.envs.arguments import takes_arguments
from coopmap_env.envs.field import FieldArguments, FieldEnv, FieldSettings, FieldTeamEnv
from coopmap_env.robots import Mount, make_mount, mount_from_urdf

parallel_env = takes_arguments(FieldArguments)(FieldEnv)
team_env = takes_arguments(FieldArguments)(FieldTeamEnv)

__all__ = [
    "FieldArguments",
    "FieldSettings",
    "Mount",
    "make_mount",
    "mount_from_urdf",
    "parallel_env",
    "team_env",
]
