"""A team that scans a small world, corrects its poses, and maps its scans."""

from typing import NamedTuple

import numpy as np

from coopmap_env.geometry import displacement_between
from coopmap_env.localization import PoseCorrector, TargetModel
from coopmap_env.mapping import BeamModel, OccupancyMap
from coopmap_env.robots import Vehicle, filter_robot_points, make_mount
from coopmap_env.sensing import DepthCamera, RangeNoise, transform_cloud

CAMERA, NOISE = DepthCamera(), RangeNoise()


class CorrectedScan(NamedTuple):
    """Result of one scan, and its errors (6,): displacements to the true pose."""

    correction: object
    error: np.ndarray
    """Of the corrected pose."""
    kinematic_error: np.ndarray
    """Of the pose from the encoders alone."""
    kinematic: object
    """`Vehicle.camera_estimate` of the reading."""
    true: object
    """T_world_camera."""

    @property
    def nees(self):
        return self.error @ np.linalg.solve(self.correction.estimate.covariance, self.error)


class CorrectionTeam:
    """Vehicles with masts in a world; `targets` are the names of the known solids."""

    def __init__(self, world, targets=(), seed=0, **settings):
        # imported here: tests that use this are skipped without the extra
        from coopmap_env.simulation import FieldSimulator

        self._simulator, self.simulator = FieldSimulator, None
        self.seed, self.rng = seed, np.random.default_rng([seed, 1])
        self.mounts = [make_mount("mast")] * world.n_robots
        self.vehicles = tuple(
            Vehicle.from_mount(mount, base)
            for mount, base in zip(self.mounts, world.base_poses, strict=True)
        )
        self.readings = [np.array(mount.home) for mount in self.mounts]
        known = [s.triangles for s in world.solids if s.name in targets]
        model = TargetModel(np.concatenate(known)) if known else None
        self.correction = PoseCorrector(self.vehicles, CAMERA, NOISE, model, **settings)
        self.map = OccupancyMap(world.grid, BeamModel(0.02, 0.998, "partial"))
        self.change_world(world)

    def change_world(self, world):
        """Change the world; encoders keep their offsets."""
        if self.simulator is not None:
            self.simulator.close()
        self.simulator = self._simulator(
            world, self.mounts, CAMERA, NOISE, "kinematic", np.random.default_rng([self.seed, 0])
        )
        if any(
            not np.array_equal(q, m.home) for q, m in zip(self.readings, self.mounts, strict=True)
        ):
            self.simulator.move(self.readings, self.rng)

    def scan(self, reading, robot=0):
        targets = [None] * len(self.mounts)
        targets[robot] = np.asarray(reading, dtype=float)
        self.readings[robot] = self.simulator.move(targets, self.rng)[robot].measured_configuration
        reading = self.readings[robot]
        kinematic = self.vehicles[robot].camera_estimate(reading)
        cloud = self.simulator.scan(robot, self.rng)
        balls = [v.spheres(q) for v, q in zip(self.vehicles, self.readings, strict=True)]
        clean = filter_robot_points(
            cloud, kinematic.pose, np.concatenate([at for at, _ in balls]),
            np.concatenate([radii + 0.03 for _, radii in balls]), NOISE, kinematic.covariance,
        )  # fmt: skip
        correction = self.correction.correct(robot, reading, clean, self.map)
        pose, covariance = correction.estimate
        self.map.integrate(transform_cloud(clean, pose, NOISE, covariance))
        true = self.simulator.true_camera_pose(robot)
        return CorrectedScan(
            correction, displacement_between(pose, true),
            displacement_between(kinematic.pose, true), kinematic, true,
        )  # fmt: skip


def readings_aimed_at(vehicle, point, n, rng, off_axis=0.2):
    """N readings (n, joints) with the camera towards a point, away from its own mast."""
    chain, found = vehicle.chain, []
    margin = 0.05 * (chain.upper - chain.lower)
    while len(found) < n:
        q = rng.uniform(chain.lower + margin, chain.upper - margin, (2000, chain.n_joints))
        R, t = vehicle.camera_poses(q)
        ray = point - t
        ray /= np.linalg.norm(ray, axis=1)[:, None]
        ahead = np.einsum("ki,ki->k", R[:, :, 0], ray) > np.cos(off_axis)
        out = np.einsum("ki,ki->k", R[:, :2, 0], (t - vehicle.T_world_base.translation)[:, :2])
        found += list(q[ahead & (out > 0.1) & (R[:, 2, 2] > 0.8) & (t[:, 2] > 0.7)])
    return np.array(found[:n])
