"""What field cameras view in a true world, from the poses of a finite set for each robot.

Joints are continuous, so what is bounded here is what poses of the set show: by default of the grid
of the joint space, which exhaustive search and the raster scan choose from, and home. The cameras
are where joints without encoder errors and the true suspension put them. All poses count as
possible from the first scan on, and no robot hides anything from a camera: both only add to what
can be shown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.arguments import check_count
from coopmap_env.core.kernels import kernel
from coopmap_env.core.limits import check_bytes
from coopmap_env.envs.field import FieldEnv
from coopmap_env.evaluation.bounds.certificate import PoseSets, ViewScores
from coopmap_env.geometry import Pose, RigidTransform
from coopmap_env.robots import Vehicle
from coopmap_env.sensing import DepthCamera
from coopmap_env.simulation.depth import CameraRays, DepthRenderer
from coopmap_env.simulation.scenes.field import FieldWorld
from coopmap_env.simulation.shown_cells import mark_depth_image

BLOCKS_OF_A_ROBOT = 250
"""Parts of the joint space, at most, whose poses count as near to each other."""
NO_BODIES = RigidTransform(np.empty((0, 3, 3)), np.empty((0, 3)))
NO_BODY = np.zeros(0, dtype=np.bool_)


@dataclass(frozen=True, eq=False)
class FieldViews:
    """Views in a field world; see `Views`. A pose is its number among those of all robots.

    Each pose is a place of its own, at which one robot can be.
    """

    n_scans: int
    voxels: NDArray[np.int64]
    """Flat indices (n_cells,) of the voxels that count: cell c is voxel ``voxels[c]``."""
    known: NDArray[np.bool_]
    sets: PoseSets
    """What each pose (k,) shows of these, those that are known left out."""
    joints: tuple[NDArray[np.float64], ...]
    """Poses (k_r, n) of each robot, one robot after another."""
    earliest: NDArray[np.int64]
    blocks: NDArray[np.int64]

    @classmethod
    def from_env(
        cls,
        env: FieldEnv,
        n_scans: int | None = None,
        joints: Sequence[NDArray[np.float64]] | None = None,
        surfaces_only: bool = False,
    ) -> FieldViews:
        """Those of an environment after a reset, before the first step.

        Parameters
        ----------
        env : FieldEnv
        n_scans : int, optional
            Scans of each robot, by default those of an episode.
        joints : sequence of ndarray, each (k, n), optional
            The set of poses of each robot, by default home and the grid of its joint space.
        surfaces_only : bool
            Whether only voxels count that are truly occupied.

        Raises
        ------
        ValueError
            If it is no field environment, robots have scanned already, there is no scan, there is
            not one set of poses for each robot with at least one pose inside of the joint limits,
            or the views take too much memory.
        """
        if not isinstance(env, FieldEnv):
            raise ValueError(f"field views need a field environment, got {env}")
        belief, world = env.belief(), env.truth
        if env.last_scans:
            raise ValueError("the environment has been stepped: reset it")
        n_scans = check_count("n_scans", env.max_scans if n_scans is None else n_scans)
        spaces = belief.joint_spaces
        if joints is None:
            homes = [np.array(mount.home) for mount in env.mounts]
            joints = [np.vstack([home, s.grid()]) for home, s in zip(homes, spaces, strict=True)]
        if len(joints) != len(spaces):
            raise ValueError(
                f"one set of poses for each of {len(spaces)} robots is needed, got {len(joints)}"
            )
        vehicles = [
            Vehicle.from_mount(mount, base, mount.suspension is not None)
            for mount, base in zip(env.diagnostics.simulator.mounts, world.base_poses, strict=True)
        ]
        checked = tuple(map(_check_joints, vehicles, joints))
        cameras = [
            Pose(t, R)
            for vehicle, own in zip(vehicles, checked, strict=True)
            for R, t in zip(*vehicle.camera_poses(own), strict=True)
        ]
        known = env.diagnostics.initial_free_mask.ravel()
        counted = world.occupied.ravel() if surfaces_only else np.ones_like(known)
        sets = _list_views(world, env.settings.camera, cameras, counted & ~known)
        counts = counted & known
        counts[sets.cells] = True
        robots = np.repeat(np.arange(len(checked)), [len(own) for own in checked])
        blocks = [
            replace(space, max_grid_poses=BLOCKS_OF_A_ROBOT).grid_index(own)
            for space, own in zip(spaces, checked, strict=True)
        ]
        return cls(
            n_scans,
            np.flatnonzero(counts),
            known[counts],
            PoseSets(sets.start, (np.cumsum(counts, dtype=np.int32) - 1)[sets.cells]),
            checked,
            np.where(robots == np.arange(len(checked))[:, None], 1, n_scans + 1),
            np.concatenate(blocks) + robots * BLOCKS_OF_A_ROBOT,
        )

    def best(
        self, weights: NDArray[np.int64], places: NDArray[np.int64] | None = None
    ) -> ViewScores:
        """See `Views`."""
        poses = np.arange(len(self.blocks)) if places is None else places
        scores = np.empty(len(poses), dtype=np.int64)
        _score_sets(*self.sets, poses, weights, scores)
        return ViewScores(scores, poses)

    def pose_sets(self, poses: NDArray[np.int64]) -> PoseSets:
        """See `Views`."""
        start, cells = self.sets
        own = [cells[start[pose] : start[pose + 1]] for pose in poses]
        return PoseSets(
            np.cumsum([0, *map(len, own)]), np.concatenate([np.empty(0, np.int32), *own])
        )

    def place_of(self, poses: NDArray[np.int64]) -> NDArray[np.int64]:
        """See `Views`."""
        return poses


def _check_joints(vehicle: Vehicle, joints: NDArray[np.float64]) -> NDArray[np.float64]:
    """Poses (k, n) of a vehicle."""
    poses = vehicle.chain.check_limits(joints)
    if poses.ndim != 2 or not len(poses):
        raise ValueError(f"a set of poses must be (k, n) with at least one, got {poses.shape}")
    return poses


def _list_views(
    world: FieldWorld, camera: DepthCamera, poses: Sequence[Pose], counted: NDArray[np.bool_]
) -> PoseSets:
    """The counted voxels that each camera pose shows, by flat index: no robot is in the way."""
    renderer, rays = DepthRenderer(world.triangles), CameraRays.from_directions(camera.directions)
    mask, start, views = np.zeros(world.grid.n_cells, dtype=np.uint8), [0], []
    grid, near, far = tuple(world.grid.geometry), float(camera.near), float(camera.far)
    for pose in poses:
        distances = renderer.trace(rays, pose.arrays, NO_BODIES, NO_BODY)
        mask[:] = 0
        mark_depth_image(grid, tuple(pose.arrays), rays.directions, distances, near, far, mask)
        views.append(np.flatnonzero(mask.view(np.bool_) & counted).astype(np.int32))
        start.append(start[-1] + len(views[-1]))
        check_bytes(2 * 4 * start[-1], "the list of what field poses show (fewer poses take less)")
    return PoseSets(np.array(start), np.concatenate(views))


@kernel
def _score_sets(
    start: NDArray[np.int64],
    cells: NDArray[np.int32],
    poses: NDArray[np.int64],
    weights: NDArray[np.int64],
    scores: NDArray[np.int64],
) -> None:
    """Write the sum of the weights of what each of some poses (k,) shows."""
    for k in range(len(poses)):
        total = 0
        for entry in range(start[poses[k]], start[poses[k] + 1]):
            total += weights[np.uint64(cells[np.uint64(entry)])]
        scores[k] = total
