"""Field-v1: stationary vehicles with articulated camera mounts map a worksite in 3-D.

=================  =====================================================================
import             ``from coopmap_env import field_v1`` (extra ``field``)
many worlds        `vector_env`: a `gymnasium.vector.VectorEnv`, see `coopmap_env.vector`
in turns           `env` and `raw_env`: PettingZoo "AEC", by its own conversion
ids                ``coopmap/Field-v1`` and, with the search for the target and fiducials,
                   ``coopmap/FieldSearch-v1`` (PettingZoo "parallel", and Gymnasium for one
                   controller that moves the whole team)
agents             ``robot_0`` ... , 2 by default
actions            `coopmap_env.envs.field.actions`: ``Box(-1, 1, (n,))``, the mount's
                   joints, or `coopmap_env.envs.actions`: ``Discrete(m)``
observations       `coopmap_env.envs.field.observations`, index by index
rewards            `coopmap_env.envs.rewards`: "rating" (Eq. 9), "information", "coverage",
                   "shown" (for training: it depends on the true world)
settings           `FieldSettings`: camera, noise, map, rating function, motion, physics
mounts             `make_mount`: "mast", "husky_panda", "tiago", or a `Mount` of any URDF
scenes             "worksite", "clutter", "rubble", "occluded", or a YAML file of meshes and URDFs
paper              Sujan and Dubowsky, "Cooperative mapping by robot teams"
end                truncation after ``max_scans`` scans of each robot, or when ``max_time``
                   seconds have passed; no termination
=================  =====================================================================

The world frame is that of the target. Vehicles are parked around it and do not drive; each moves a
depth camera on a mount. In a step all mounts move, in the order of their indices (or, with stepped
physics, all at once). Then all cameras scan, and their scans are fused into one probabilistic voxel
map.

A motion must keep clear of the own vehicle, of teammates and of every voxel that is not known to be
free (P >= 0.05 or never sampled), along its whole path. Otherwise the mount stays, and
``infos[agent]["rejected_reason"]`` is why, a `RejectedReason`. Where the map is wrong, the mount
collides, is stopped, and pays `FieldSettings.collision_cost`. It has no touch sensors, so the map
learns nothing of the collision (the planar environment marks the cell). Surfaces seen at a grazing
angle, and voxels that a surface only touches, may be mapped as free. The space in which a vehicle
was parked is known.

Vehicles stand on springs: a mount that reaches out tilts its vehicle, so that the true camera pose
differs from that of the encoders. The map is made with the robot's estimate of the camera pose,
whose covariance adds to that of the range noise. Robots predict the tilt from the masses and the
stiffness of their mount's description (``motion_correction="kinematic"``); the true stiffness
differs from that by up to a fifth, at random for each episode and vehicle. ``"encoders"`` leaves
the tilt out, with a larger covariance. With ``"fiducials"``, surfaces observed before and the known
target correct the pose of each scan in the directions that they constrain (Section 2.5 of the
paper), and the stiffness is estimated. ``"exact"`` poses are for upper bounds only. Robots know
each other's shape, and points on robots are removed from their scans.

A symmetric target has several equivalent frames. The first robot that is located takes the one in
which the world is written.

By default robots know their base poses: policies train on mapping alone, and results do not depend
on registration. With ``initialization="search"`` they are parked with any heading (except for poses
that a scene file fixes). They know their mounts and the geometry of the target, but not where they
or the others stand (Section 2.2). Each robot maps in a frame of its own, with its base in the
middle of the grid, and is rewarded for that map. After each scan it searches for the target in all
of its scans. Once it is located, its scans are transferred to the team's map, which was empty
before, and are not rewarded again. Located robots know each other as obstacles. A robot that never
finds the target contributes nothing to the team's map.

Entries of ``infos[agent]``, numbers, after a reset and after each step:

========================  ==========================================================================
key                       content
========================  ==========================================================================
``reward_rating``,        every reward term, of the step (this and the next seven are 0 after a
``reward_information``,   reset); ``reward_shown`` only if it is paid or reported
``reward_coverage``
``rejected_reason``       why the pose was rejected and the mount stayed, a `RejectedReason`; 0 if
                          it was not. `MappingEnv.explain` says it in words, with names and figures
``collided``              whether the mount collided; `MappingEnv.explain` says with what
``new_information``       NI (Eqs. 6-8) of the executed pose, nats
``distance``              d of Eq. 5 that the joints moved
``new_cells``             voxels observed for the first time by this robot's scan
``entropy_reduction``     decrease of the map's entropy by this robot's scan, nats
``n_scans``               scans of each robot so far
``elapsed_time``          seconds on the clock of the team: each step lasts as long as the slowest
                          motion, by the speeds in the URDFs, and the scans
                          (`FieldSettings.scan_time`)
``observed_fraction``     observed voxels of the team map, as a fraction of the grid
``located``               whether the robot knows its base pose
``localization_failure``  why it is not located, a `LocalizationFailure`; 0 if it is
``corrected_directions``  number of the camera pose's six directions in which fiducials are more
                          precise than kinematics
``correction_failure``    why fiducials corrected nothing, a `CorrectionFailure`; 0 otherwise
``camera_error``          metres between the true and the estimated camera; for scoring only
``camera_angle_error``    radians, likewise
``base_error``            metres, of the base; infinite until it is located; for scoring only
``base_angle_error``      radians, likewise
``shown_fraction``        only with ``report_shown=True`` or ``reward="shown"``: voxels that were
                          truly shown or known at the start, as a fraction of the grid; for
                          scoring only. Scans of robots that are not located count, and the space
                          around all true bases
========================  ==========================================================================

The mask of candidates is in the observations only (``action_mask``): engines look there first, and
some take a second one in the infos for an error.

Version history
---------------
v1: Eq. 7 counts voxels of a view that are hidden, outside of the map or reserved for a teammate as
known and empty (v0 left them out, so that a known map still paid for them), and Eq. 8a is read
without the distance. K, chosen again on training worlds, is 0.2 (0.1 in v0). Camera poses contain
the predicted deflection of the suspension, and the true stiffness differs from the described one.
Voxels behind a measured surface have probability 0.97 instead of one half, and a beam that passes
lowers P to 0.01 instead of 0.02. A voxel's surface is the mean of its points
(`coopmap_env.mapping.surface_mean`) instead of Eq. 4. `FieldSettings.v0` restores v0, with
``motion_correction="encoders"`` where v0 had ``"kinematic"``.

v0: first version.
"""

from functools import partial
from typing import Any

from gymnasium.vector import AutoresetMode

from coopmap_env.envs import RejectedReason
from coopmap_env.envs.arguments import takes_arguments
from coopmap_env.envs.field import FieldArguments, FieldEnv, FieldSettings, FieldTeamEnv
from coopmap_env.envs.turns import in_turns, with_order
from coopmap_env.localization import CorrectionFailure, LocalizationFailure
from coopmap_env.robots import Mount, make_mount, mount_from_urdf
from coopmap_env.vector import RowName, WorkerVectorEnv

parallel_env = takes_arguments(FieldArguments)(FieldEnv)
team_env = takes_arguments(FieldArguments)(FieldTeamEnv)
raw_env = takes_arguments(FieldArguments)(in_turns(FieldEnv))
env = takes_arguments(FieldArguments)(with_order(raw_env))


def vector_env(
    n_envs: int,
    *,
    rows: RowName = "agents",
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    double_buffer: bool = False,
    with_state: bool = False,
    num_workers: int = 0,
    **arguments: Any,
) -> WorkerVectorEnv:
    """Many worlds in one call; see `coopmap_env.vector` and `WorkerVectorEnv`.

    Parameters
    ----------
    n_envs : int
        Number of worlds.
    rows, autoreset_mode, double_buffer, with_state, num_workers
        See `WorkerVectorEnv`.
    **arguments
        `FieldArguments`.
    """
    return WorkerVectorEnv(
        partial(FieldEnv, **arguments),
        n_envs,
        rows=rows,
        autoreset_mode=autoreset_mode,
        double_buffer=double_buffer,
        with_state=with_state,
        num_workers=num_workers,
    )


__all__ = [
    "CorrectionFailure",
    "FieldArguments",
    "FieldSettings",
    "LocalizationFailure",
    "Mount",
    "RejectedReason",
    "env",
    "make_mount",
    "mount_from_urdf",
    "parallel_env",
    "raw_env",
    "team_env",
    "vector_env",
]
