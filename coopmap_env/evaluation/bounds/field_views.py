"""What field cameras view in a true world, from the poses of a finite set for each robot.

What counts are voxels (`FieldViews.from_env`) or the samples of the visible surface, by which maps
are scored (`FieldViews.of_surface`).

Joints are continuous, so what is bounded here is what poses of the set show: by default of the grid
of the joint space, which exhaustive search and the raster scan choose from, and home. The cameras
are where joints without encoder errors and the true suspension put them. All poses count as
possible from the first scan on, and no robot hides anything from a camera: both only add to what
can be shown.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.arguments import check_count
from coopmap_env.core.kernels import borrowing_kernel, kernel
from coopmap_env.core.limits import check_bytes
from coopmap_env.envs.field import FieldEnv
from coopmap_env.evaluation.bounds._active_views import score_views
from coopmap_env.evaluation.bounds.certificate import PoseSets, ViewScores
from coopmap_env.evaluation.metrics import SampleVoxels, SurfaceEvaluator
from coopmap_env.geometry import Pose, RigidTransform
from coopmap_env.robots import Vehicle
from coopmap_env.simulation.depth import CameraRays, DepthRenderer
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
    """Flat indices (n_cells,) of the voxels that count: cell c is voxel ``voxels[c]``, or a sample
    of the surface in that voxel."""
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
        cameras = _CameraSet.from_env(env, n_scans, joints)
        known = env.diagnostics.initial_free_mask.ravel()
        counted = env.truth.occupied.ravel() if surfaces_only else np.ones_like(known)
        sets = _list_views(env, _trace(env, cameras.poses), counted & ~known)
        counts = counted & known
        counts[sets.cells] = True
        numbers = np.cumsum(counts, dtype=np.int32) - 1
        return cameras.views(
            np.flatnonzero(counts), known[counts], PoseSets(sets.start, numbers[sets.cells])
        )

    @classmethod
    def of_surface(
        cls,
        env: FieldEnv,
        evaluator: SurfaceEvaluator,
        n_scans: int | None = None,
        joints: Sequence[NDArray[np.float64]] | None = None,
    ) -> FieldViews:
        """Those of the visible surface: what counts are all samples that an evaluator scores.

        A pose covers the samples with a truly occupied voxel that it shows within one voxel of
        their own, as a map does (`SurfaceEvaluator.coverage`) that has exactly these voxels. The
        robot's own body hides from it what is behind it; teammates hide nothing but by what does
        not move of them.

        Parameters
        ----------
        env, n_scans, joints
            As of `from_env`.
        evaluator : SurfaceEvaluator
            Of the environment's world.

        Raises
        ------
        ValueError
            See `from_env`; or if the evaluator is of a world with another grid.
        """
        cameras = _CameraSet.from_env(env, n_scans, joints)
        samples, grid = evaluator.sample_voxels, env.truth.grid
        if samples.grid != grid:
            raise ValueError(f"the samples lie in {samples.grid}, the world in {grid}")
        simulator = env.diagnostics.simulator
        traced = (
            one
            for robot, own in enumerate(cameras.joints)
            for one in simulator.views_from(robot, own)
        )
        sets = _list_samples(_list_views(env, traced, env.truth.occupied.ravel()), samples)
        voxels = np.repeat(samples.cells, samples.counts)
        return cameras.views(voxels, np.zeros(len(voxels), dtype=np.bool_), sets)

    @cached_property
    def digest(self) -> str:
        """See `Views`."""
        sha = hashlib.sha256(f"field views of {self.n_scans} scans".encode())
        for array in (self.voxels, self.known, *self.sets, self.earliest, *self.joints):
            sha.update(f"{array.dtype.str} {array.shape} ".encode() + array.tobytes())
        return sha.hexdigest()

    def best(self, weights: NDArray[np.int64]) -> ViewScores:
        """See `Views`."""
        scores = np.empty(len(self.blocks), dtype=np.int64)
        score_views(*self.sets, weights, scores)
        return ViewScores(scores, np.arange(len(scores)))

    def choose(self, n_scans: int, n_exchanges: int) -> NDArray[np.int64]:
        """See `Views`; the greedy choice, in which views are exchanged for the best beside it."""
        chosen = np.full((n_scans, len(self.joints)), -1)
        first = np.cumsum([0, *map(len, self.joints)])
        n_sweeps = -(-n_exchanges // (n_scans * first[-1]))
        _choose_sets(*self.sets, first, len(self.known), n_sweeps, chosen)
        return chosen

    def can_take(self, choice: NDArray[np.int64]) -> bool:
        """See `Views`."""
        if choice.min(initial=0) < 0 or choice.max(initial=0) >= len(self.blocks):
            return False
        scans = np.arange(1, len(choice) + 1)[:, None]
        return bool((self.earliest[np.arange(len(self.joints)), choice] <= scans).all())

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


class _CameraSet(NamedTuple):
    """The camera poses of a set of mount poses for each robot."""

    n_scans: int
    joints: tuple[NDArray[np.float64], ...]
    poses: list[Pose]
    """Of all robots, one after another."""
    blocks: NDArray[np.int64]

    @classmethod
    def from_env(
        cls, env: FieldEnv, n_scans: int | None, joints: Sequence[NDArray[np.float64]] | None
    ) -> _CameraSet:
        """See `FieldViews.from_env`."""
        if not isinstance(env, FieldEnv):
            raise ValueError(f"field views need a field environment, got {env}")
        if env.last_scans:
            raise ValueError("the environment has been stepped: reset it")
        n_scans = check_count("n_scans", env.max_scans if n_scans is None else n_scans)
        spaces = env.belief().joint_spaces
        if joints is None:
            homes = [np.array(mount.home) for mount in env.mounts]
            joints = [np.vstack([home, s.grid()]) for home, s in zip(homes, spaces, strict=True)]
        if len(joints) != len(spaces):
            raise ValueError(
                f"one set of poses for each of {len(spaces)} robots is needed, got {len(joints)}"
            )
        bases = env.truth.base_poses
        vehicles = [
            Vehicle.from_mount(mount, base, mount.suspension is not None)
            for mount, base in zip(env.diagnostics.simulator.mounts, bases, strict=True)
        ]
        checked = tuple(map(_check_joints, vehicles, joints))
        poses = [
            Pose(t, R)
            for vehicle, own in zip(vehicles, checked, strict=True)
            for R, t in zip(*vehicle.camera_poses(own), strict=True)
        ]
        blocks = [
            replace(space, max_grid_poses=BLOCKS_OF_A_ROBOT).grid_index(own) + k * BLOCKS_OF_A_ROBOT
            for k, (space, own) in enumerate(zip(spaces, checked, strict=True))
        ]
        return cls(n_scans, checked, poses, np.concatenate(blocks))

    def views(
        self, voxels: NDArray[np.int64], known: NDArray[np.bool_], sets: PoseSets
    ) -> FieldViews:
        """What these cameras view."""
        robots = np.repeat(np.arange(len(self.joints)), [len(own) for own in self.joints])
        is_own = robots == np.arange(len(self.joints))[:, None]
        earliest = np.where(is_own, 1, self.n_scans + 1)
        return FieldViews(self.n_scans, voxels, known, sets, self.joints, earliest, self.blocks)


def _check_joints(vehicle: Vehicle, joints: NDArray[np.float64]) -> NDArray[np.float64]:
    """Poses (k, n) of a vehicle."""
    poses = vehicle.chain.check_limits(joints)
    if poses.ndim != 2 or not len(poses):
        raise ValueError(f"a set of poses must be (k, n) with at least one, got {poses.shape}")
    return poses


def _trace(env: FieldEnv, poses: Sequence[Pose]) -> Iterator[tuple[Pose, NDArray[np.float64]]]:
    """Camera poses and the distances along their rays, without any robot."""
    renderer = DepthRenderer(env.truth.triangles)
    rays = CameraRays.from_directions(env.settings.camera.directions)
    for pose in poses:
        yield pose, renderer.trace(rays, pose.arrays, NO_BODIES, NO_BODY)


def _list_views(
    env: FieldEnv,
    traced: Iterator[tuple[Pose, NDArray[np.float64]]],
    counted: NDArray[np.bool_],
) -> PoseSets:
    """The counted voxels, by flat index, that each of some traced camera poses shows."""
    camera, true_grid = env.settings.camera, env.truth.grid
    mask, start, views = np.zeros(true_grid.n_cells, dtype=np.uint8), [0], []
    grid, near, far = tuple(true_grid.geometry), float(camera.near), float(camera.far)
    for pose, distances in traced:
        mask[:] = 0
        mark_depth_image(grid, tuple(pose.arrays), camera.directions, distances, near, far, mask)
        views.append(np.flatnonzero(mask.view(np.bool_) & counted).astype(np.int32))
        start.append(start[-1] + len(views[-1]))
        check_bytes(2 * 4 * start[-1], "the list of what field poses show (fewer poses take less)")
    return PoseSets(np.array(start), np.concatenate(views))


def _list_samples(shown: PoseSets, samples: SampleVoxels) -> PoseSets:
    """The samples that each pose covers, from the voxels that it shows."""
    counts = np.zeros(samples.grid.n_cells + 1, dtype=np.int64)
    counts[samples.cells + 1] = samples.counts
    first = np.cumsum(counts)
    start, shape = np.zeros(len(shown.start), dtype=np.int64), samples.grid.shape_3d
    list_samples_beside(*shown, shape, first, start, np.empty(0, np.int32))
    check_bytes(4 * start[-1], "the list of what field poses cover (fewer poses take less)")
    covered = np.empty(start[-1], dtype=np.int32)
    list_samples_beside(*shown, shape, first, start, covered)
    return PoseSets(start, covered)


@kernel
def list_samples_beside(
    start: NDArray[np.int64],
    voxels: NDArray[np.int32],
    shape: tuple[int, int, int],
    first: NDArray[np.int64],
    samples_start: NDArray[np.int64],
    samples: NDArray[np.int32],
) -> None:
    """Write the samples in the voxels of each pose, and in the 26 around each of them.

    The samples of voxel v are first[v] to first[v + 1]. Without room in `samples` only
    `samples_start` (k + 1,) is written, which says how much is needed.
    """
    nx, ny, nz = shape
    seen = np.full(nx * ny * nz, -1, np.int32)
    n, has_room = 0, len(samples) > 0
    for pose in range(len(start) - 1):
        for entry in range(start[pose], start[pose + 1]):
            x, rest = voxels[entry] // (ny * nz), voxels[entry] % (ny * nz)
            y, z = rest // nz, rest % nz
            for i in range(max(x - 1, 0), min(x + 2, nx)):
                for j in range(max(y - 1, 0), min(y + 2, ny)):
                    row = (i * ny + j) * nz
                    for v in range(row + max(z - 1, 0), row + min(z + 2, nz)):
                        if seen[v] == pose:
                            continue
                        seen[v] = pose
                        for sample in range(first[v], first[v + 1]):
                            if has_room:
                                samples[n] = sample
                            n += 1
        samples_start[pose + 1] = n


@kernel
def _choose_sets(
    start: NDArray[np.int64],
    cells: NDArray[np.int32],
    first: NDArray[np.int64],
    n_cells: int,
    n_sweeps: int,
    chosen: NDArray[np.int64],
) -> None:
    """Write poses (n_scans, n_robots): those of robot r are first[r] to first[r + 1].

    Each is the one that adds most to the others, which are none at first. It ends early if nothing
    changes any more.
    """
    times = np.zeros(n_cells, dtype=np.int32)
    for _ in range(1 + n_sweeps):
        is_changed = False
        for scan in range(chosen.shape[0]):
            for robot in range(chosen.shape[1]):
                before = int(chosen[scan, robot])
                if before >= 0:
                    for entry in range(start[before], start[before + 1]):
                        times[cells[entry]] -= 1
                best, most = before, -1
                if before >= 0:
                    most = _count_new(start, cells, before, times)
                for pose in range(first[robot], first[robot + 1]):
                    count = _count_new(start, cells, pose, times)
                    if count > most:
                        best, most = pose, count
                is_changed |= best != before
                chosen[scan, robot] = best
                for entry in range(start[best], start[best + 1]):
                    times[cells[entry]] += 1
        if not is_changed:
            break


@borrowing_kernel
def _count_new(
    start: NDArray[np.int64], cells: NDArray[np.int32], pose: int, times: NDArray[np.int32]
) -> int:
    """Cells that a pose shows and no other does."""
    count = 0
    for entry in range(start[pose], start[pose + 1]):
        count += times[np.uint64(cells[np.uint64(entry)])] == 0
    return count
