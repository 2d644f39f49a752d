"""Episodes of the localization study as jobs: search for the target, and motion correction."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.caches import thread_cache
from coopmap_env.core.linear_algebra import product
from coopmap_env.envs.field import FieldEnv
from coopmap_env.evaluation import (
    EpisodeRecorder,
    Job,
    Result,
    make_policy,
    make_surface_evaluator,
    rollout,
)
from coopmap_env.evaluation.metrics import log_loss
from coopmap_env.geometry import Pose, displacement_between
from coopmap_env.localization import (
    DegenerateGeometryError,
    consistent_subset,
    linear_pose,
    rigid_pose,
)
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots import PoseEstimate, Vehicle
from coopmap_env.sensing import PointCloud, transform_cloud

POSE_KINDS = ("encoders", "kinematic", "estimated", "smoothed", "exact")
"""Kinds of camera poses of one scan; see `RecordedPoses`."""
MIN_POINTS = 50
"""Points that a scan needs for the mean displacement of its points."""
MIN_TRACKED_FIDUCIALS = 6
"""Tracked fiducials that are needed to estimate a pose from their mean points."""


def run_localization_job(job: Job) -> Result:
    """Play the episode of a job of either kind."""
    return run_search_episode(job) if job["kind"] == "search" else run_correction_episode(job)


@thread_cache(maxsize=4)
def _env(split: str, scans: int, scene: str, initialization: str, correction: str) -> FieldEnv:
    return FieldEnv(
        split=split,
        max_scans=scans,
        scene=scene,
        initialization=initialization,
        motion_correction=correction,
    )


def render_search(seed: int, split: str, scans: int, policy: str) -> NDArray[np.uint8]:
    """Pictures of a search, one below the other, (H, W, 3).

    They show the start, the step at which the first robot is located, and the last step: all robots
    are located, or the scans are used up.
    """
    env = FieldEnv(
        split=split, max_scans=scans, render_mode="rgb_array",
        initialization="search", motion_correction="fiducials",
    )  # fmt: skip
    steps = rollout(env, make_policy(policy), seed)
    frames = [env.render()]
    any_located = any(env.belief().located)
    for _ in steps:
        located = env.belief().located
        if all(located):
            break
        if any(located) and not any_located:
            frames.append(env.render())
        any_located = any(located)
    frames.append(env.render())
    env.close()
    return np.concatenate([frame for frame in frames if frame is not None])


def run_search_episode(job: Job) -> Result:
    """Let a team search for the target; record when each robot is located, and its errors.

    A job has "seed", "split", "max_scans", "scene" and "policy".
    """
    env = _env(job["split"], job["max_scans"], job["scene"], "search", "kinematic")
    robots: dict[str, dict[str, Any]] = {}
    times: list[float] = []
    for step in rollout(env, make_policy(job["policy"]), job["seed"]):
        for robot, agent in enumerate(env.possible_agents):
            if step.infos[agent]["located"] and agent not in robots:
                estimate = PoseEstimate(
                    env.belief().vehicles[robot].T_world_base, _covariance(env, robot)
                )
                true = env.truth.base_poses[robot]
                robots[agent] = {
                    "n_scans": step.infos[agent]["n_scans"],
                    **_pose_errors(estimate, true),
                }
        times.extend(env.localizer.registration_times)
        if len(robots) == len(env.possible_agents):
            break
    located = [robots.get(agent) for agent in env.possible_agents]
    return {"robots": located, "registration_ms": [1e3 * t for t in times]}


def _covariance(env: FieldEnv, robot: int) -> NDArray[np.float64]:
    covariance = env.belief().vehicles[robot].base_covariance
    return np.zeros((6, 6)) if covariance is None else covariance


def run_correction_episode(job: Job) -> Result:
    """Play an episode and compare the camera pose of every scan with the true pose.

    A job has "seed", "split", "max_scans", "scene", "policy", "initialization" and
    "motion_correction".
    """
    env = _env(
        job["split"],
        job["max_scans"],
        job["scene"],
        job["initialization"],
        job["motion_correction"],
    )
    scans: list[dict[str, Any]] = []
    recorded = RecordedPoses(env)
    steps = rollout(env, make_policy(job["policy"]), job["seed"])
    recorder = EpisodeRecorder(env, job["seed"])
    for step in steps:
        for robot, agent in enumerate(env.possible_agents):
            if step.infos[agent]["located"]:
                scans.append(_scan_record(env, robot, step.infos[agent]))
                recorded.add(robot)
        recorder.add(step)
    return {
        "episode": asdict(recorder.episode()),
        "scans": [scan | errors for scan, errors in zip(scans, recorded.errors(), strict=True)],
        "same_scans": recorded.map_scores(job["seed"]),
    }


class RecordedPoses:
    """The scans of one episode of located robots, with all kinds of camera poses.

    The poses are those by the encoders ("encoders"), with the predicted deflection of the
    suspension ("kinematic"), as they were fused ("estimated"), as they are known after the last
    scan ("smoothed"), and the true ones ("exact"). Episodes with different camera poses have
    different maps, and so different views. Here the views are the same, and only the poses differ.
    """

    def __init__(self, env: FieldEnv) -> None:
        self._env = env
        self._clouds: list[PointCloud] = []
        self._estimates: list[dict[str, PoseEstimate]] = []

    def add(self, robot: int) -> None:
        """Record a robot's last scan."""
        env, scan = self._env, self._env.last_scans[robot]
        belief = env.belief()
        vehicle, joints, estimated = (
            belief.vehicles[robot], belief.joints[robot], belief.estimates[robot],
        )  # fmt: skip
        self._clouds.append(PointCloud(estimated.pose.inverse().transform(scan.points), scan.hit))
        estimates = {
            name: Vehicle.from_mount(
                vehicle.mount, vehicle.T_world_base, predicts_deflection=name == "kinematic"
            ).camera_estimate(joints)
            for name in ("encoders", "kinematic")
        }
        exact = PoseEstimate(env.diagnostics.true_cameras[robot], np.zeros((6, 6)))
        self._estimates.append(estimates | {"estimated": estimated, "exact": exact})

    def _all_estimates(self) -> list[dict[str, PoseEstimate]]:
        """Of each scan, by kind of pose; without fiducials nothing is smoothed."""
        smoothed = self._env.localizer.revised_estimates()
        if smoothed is None:
            smoothed = [kinds["estimated"] for kinds in self._estimates]
        return [
            kinds | {"smoothed": estimate}
            for kinds, estimate in zip(self._estimates, smoothed, strict=True)
        ]

    def errors(self) -> list[dict[str, dict[str, float]]]:
        """Errors of the camera pose of each scan, by kind of pose."""
        out = []
        for kinds, cloud in zip(self._all_estimates(), self._clouds, strict=True):
            points, true = cloud.points[cloud.hit], kinds.pop("exact").pose
            out.append(
                {
                    name: {
                        **_pose_errors(estimate, true),
                        "point_displacement": _mean_point_displacement(points, estimate.pose, true),
                    }
                    for name, estimate in kinds.items()
                }
            )
        return out

    def map_scores(self, seed: int) -> dict[str, dict[str, float]]:
        """Quality of the map that is fused of all scans, by kind of pose."""
        s, evaluator = self._env.settings, make_surface_evaluator(self._env, seed)
        assert evaluator is not None
        estimates, out = self._all_estimates(), {}
        for name in POSE_KINDS:
            map_ = OccupancyMap(self._env.scene.grid, s.beam, s.log_odds_range)
            for kinds, cloud in zip(estimates, self._clouds, strict=True):
                pose, covariance = kinds[name]
                map_.integrate(transform_cloud(cloud, pose, s.noise, covariance))
            scores = evaluator.scores(map_)
            out[name] = {
                "f_score": scores.f_score,
                "chamfer": scores.chamfer,
                "log_loss": log_loss(map_.probability, self._env.truth.occupied, map_.sampled),
            }
        return out


def _scan_record(env: FieldEnv, robot: int, info: dict[str, Any]) -> dict[str, Any]:
    """What a scan saw, and what its correction found."""
    true = env.diagnostics.true_cameras[robot]
    correction = env.localizer.corrections[robot]
    out: dict[str, Any] = {
        "corrected_directions": info["corrected_directions"],
        "correction_failure": "" if correction is None else correction.reason,
        "n_hits": int(env.last_scans[robot].hit.sum()),
        "noise_floor": _encoder_noise_error(env, robot),
    }
    if correction is not None:
        out["correction_ms"] = 1e3 * env.localizer.correction_times[robot]
        out["n_fiducials"] = int(correction.matches.inlier_mask.sum())
        out["n_outliers"] = int((~correction.matches.inlier_mask).sum())
        out["mean_points"] = _errors_from_mean_points(*correction.tracked_fiducials, true)
    return out


def _encoder_noise_error(env: FieldEnv, robot: int) -> float:
    """Position error, metres, of one draw of the encoders' noise alone: no estimator knows it.

    Fiducials do, where they are in view.
    """
    belief = env.belief()
    vehicle, joints = belief.vehicles[robot], belief.joints[robot]
    draw = np.random.default_rng(joints.view(np.uint64)).standard_normal(len(joints))
    noise = draw * vehicle.mount.encoder_noise
    return float(np.linalg.norm(product(vehicle.joint_jacobian(joints)[:3], noise)))


def _pose_errors(estimate: PoseEstimate, true: Pose) -> dict[str, float]:
    """Position error (m), angle error (rad) and normalised estimation error squared (NEES)."""
    error = displacement_between(estimate.pose, true)
    covariance = estimate.covariance
    is_exact = not covariance.any()
    return {
        "position": float(np.linalg.norm(error[:3])),
        "angle": float(np.linalg.norm(error[3:])),
        "nees": math.nan if is_exact else float(error @ np.linalg.solve(covariance, error)),
    }


def _mean_point_displacement(points: NDArray[np.float64], pose: Pose, true: Pose) -> float:
    """Mean displacement of a scan's points by its pose error, metres; NaN for too few points."""
    if len(points) < MIN_POINTS:
        return math.nan
    return float(np.linalg.norm(pose.transform(points) - true.transform(points), axis=1).mean())


def _errors_from_mean_points(
    base: NDArray[np.float64], measured_points: NDArray[np.float64], true: Pose
) -> dict[str, Any] | None:
    """Errors of poses that are estimated from the regions' mean points; None if too few."""
    if len(base) < MIN_TRACKED_FIDUCIALS:
        return None
    # the mean of a region lies anywhere in its ball of some centimetres
    kept = consistent_subset(base, measured_points, np.full(len(base), 0.05))
    out = {}
    try:
        poses = {
            "linear": linear_pose(base, measured_points),
            "rigid": rigid_pose(base[kept], measured_points[kept]),
        }
    except DegenerateGeometryError:
        return None
    for name, pose in poses.items():
        error = displacement_between(pose, true)
        out[name] = {
            "position": float(np.linalg.norm(error[:3])),
            "angle": float(np.linalg.norm(error[3:])),
        }
    return out
