"""Episodes of the localization study, as jobs: the search for the target, and corrected motions."""

from __future__ import annotations

import math
from dataclasses import asdict
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.field import FieldEnv
from coopmap_env.envs.mapping_env import Infos
from coopmap_env.evaluation.jobs import Job, Result
from coopmap_env.evaluation.metrics.calibration import log_loss
from coopmap_env.evaluation.policy import make_policy
from coopmap_env.evaluation.rollout import make_surface_evaluator, policy_rng, run_episode
from coopmap_env.geometry import Pose, displacement_between
from coopmap_env.localization import (
    DegenerateGeometryError,
    consistent_subset,
    linear_pose,
    rigid_pose,
)
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots import PoseEstimate
from coopmap_env.sensing import PointCloud, transform_cloud

MIN_POINTS = 50
"""Points of a look that the displacement of what was seen is averaged over."""
MIN_TRACKED_FIDUCIALS = 6
"""Fiducials of the map that were found in an image, to identify a pose from their mean points."""


def run_localization_job(job: Job) -> Result:
    """Play the episode of a job of either kind."""
    return run_search_episode(job) if job["kind"] == "search" else run_correction_episode(job)


@lru_cache(maxsize=4)
def _env(split: str, scans: int, scene: str, initialization: str, correction: str) -> FieldEnv:
    return FieldEnv(
        split=split,
        max_scans=scans,
        scene=scene,
        initialization=initialization,  # type: ignore[arg-type]
        motion_correction=correction,  # type: ignore[arg-type]
    )


def render_search(seed: int, split: str, scans: int, policy: str) -> NDArray[np.uint8]:
    """Pictures of a search, one below the other.

    At the start, when the first robot is located, and when all are or the last look was made.
    """
    env = FieldEnv(
        split=split, max_scans=scans, render_mode="rgb_array",
        initialization="search", motion_correction="fiducials",
    )  # fmt: skip
    chosen = make_policy(policy)
    observations, _ = env.reset(seed=seed)
    chosen.reset(policy_rng(seed))
    frames = [env.render()]
    while env.agents and not all(env.belief().located):
        before = any(env.belief().located)
        observations, *_ = env.step(chosen.act(env.belief(), observations))
        if any(env.belief().located) and not before and not all(env.belief().located):
            frames.append(env.render())
    frames.append(env.render())
    env.close()
    return np.concatenate([frame for frame in frames if frame is not None])


def run_search_episode(job: Job) -> Result:
    """Let a team look for the target; when and how well each of its robots found it.

    A job names its "seed", "split", "scans" of each robot, "scene" and "policy".
    """
    env = _env(job["split"], job["max_scans"], job["scene"], "search", "kinematic")
    policy = make_policy(job["policy"])
    observations, _ = env.reset(seed=job["seed"])
    policy.reset(policy_rng(job["seed"]))
    robots: dict[str, dict[str, Any]] = {}
    times: list[float] = []
    while env.agents:
        actions = policy.act(env.belief(), observations)
        observations, _, _, _, infos = env.step(actions)
        for robot, agent in enumerate(env.possible_agents):
            if infos[agent]["located"] and agent not in robots:
                estimate = PoseEstimate(
                    env.belief().vehicles[robot].T_world_base, _covariance(env, robot)
                )
                true = env.truth.base_poses[robot]
                robots[agent] = {"n_scans": infos[agent]["scans"], **_pose_errors(estimate, true)}
        times.extend(env.localizer.registration_times)
        if len(robots) == len(env.possible_agents):
            break
    found = [robots.get(agent) for agent in env.possible_agents]
    return {"robots": found, "registration_ms": [1e3 * t for t in times]}


def _covariance(env: FieldEnv, robot: int) -> NDArray[np.float64]:
    covariance = env.belief().vehicles[robot].base_covariance
    return np.zeros((6, 6)) if covariance is None else covariance


def run_correction_episode(job: Job) -> Result:
    """Play an episode and hold every look's pose against the truth.

    A job names its "seed", "split", "scans" of each robot, "scene", "policy", "initialization" and
    "motion_correction".
    """
    env = _env(
        job["split"],
        job["max_scans"],
        job["scene"],
        job["initialization"],
        job["motion_correction"],
    )
    policy = make_policy(job["policy"])
    scans: list[dict[str, Any]] = []
    ablation = PoseAblation(env)

    def record_scans(infos: Infos) -> None:
        for robot, agent in enumerate(env.possible_agents):
            if infos[agent]["located"]:
                scans.append(_scan_record(env, robot, infos[agent]))
                ablation.add(robot)

    episode = run_episode(env, policy, job["seed"], record_scans)
    return {"episode": asdict(episode), "scans": scans, "same_scans": ablation.scores(job["seed"])}


class PoseAblation:
    """The same looks fused by the encoders alone, as they were taken to be, and by the truth.

    Policies look elsewhere with another map. Here the views are those of one episode, so that
    nothing but the camera poses differs.
    """

    def __init__(self, env: FieldEnv) -> None:
        self._env = env
        s = env.settings
        self._maps = {
            name: OccupancyMap(env.scene.grid, s.beam, s.log_odds_range)
            for name in ("kinematic", "estimated", "exact")
        }

    def add(self, robot: int) -> None:
        """Fuse a robot's last look into each map."""
        env, scan = self._env, self._env.scans[robot]
        belief = env.belief()
        estimated = belief.estimates[robot]
        cloud = PointCloud(estimated.pose.inverse().transform(scan.points), scan.hit)
        estimates = {
            "kinematic": belief.vehicles[robot].camera_estimate(belief.joints[robot]),
            "estimated": estimated,
            "exact": PoseEstimate(env.true_cameras[robot], np.zeros((6, 6))),
        }
        for name, (pose, covariance) in estimates.items():
            self._maps[name].integrate(transform_cloud(cloud, pose, env.settings.noise, covariance))

    def scores(self, seed: int) -> dict[str, dict[str, float]]:
        """Map quality by each kind of pose."""
        evaluator = make_surface_evaluator(self._env, seed)
        assert evaluator is not None
        out = {}
        for name, map_ in self._maps.items():
            scores = evaluator.scores(map_)
            out[name] = {
                "f_score": scores.f_score,
                "chamfer": scores.chamfer,
                "log_loss": log_loss(map_.probability, self._env.truth.occupied, map_.sampled),
            }
        return out


def _scan_record(env: FieldEnv, robot: int, info: dict[str, Any]) -> dict[str, Any]:
    """One look's errors: by the encoders alone, and as it was fused."""
    belief, true = env.belief(), env.true_cameras[robot]
    estimated = belief.estimates[robot]
    kinematic = belief.vehicles[robot].camera_estimate(belief.joints[robot])
    scan = env.scans[robot]
    measured_points = estimated.pose.inverse().transform(scan.points[scan.hit])
    out: dict[str, Any] = {
        "corrected_directions": info["corrected_directions"],
        "correction_failure": info["correction_failure"],
        "n_hits": len(measured_points),
        "kinematic": {
            **_pose_errors(kinematic, true),
            "point_displacement": _mean_point_displacement(measured_points, kinematic.pose, true),
        },
        "estimated": {
            **_pose_errors(estimated, true),
            "point_displacement": _mean_point_displacement(measured_points, estimated.pose, true),
        },
    }
    correction = env.localizer.corrections[robot]
    if correction is not None:
        out["correction_ms"] = 1e3 * env.localizer.correction_times[robot]
        out["n_fiducials"] = int(correction.matches.inlier_mask.sum())
        out["n_outliers"] = int((~correction.matches.inlier_mask).sum())
        out["mean_points"] = _errors_from_mean_points(*correction.tracked_fiducials, true)
    return out


def _pose_errors(estimate: PoseEstimate, true: Pose) -> dict[str, float]:
    """Position (m) and angle (rad) of an error, and its square in units of what is claimed."""
    error = displacement_between(estimate.pose, true)
    covariance = estimate.covariance
    is_exact = not covariance.any()
    return {
        "position": float(np.linalg.norm(error[:3])),
        "angle": float(np.linalg.norm(error[3:])),
        "nees": math.nan if is_exact else float(error @ np.linalg.solve(covariance, error)),
    }


def _mean_point_displacement(points: NDArray[np.float64], pose: Pose, true: Pose) -> float:
    """Mean displacement in metres of what a look saw, by the error of its pose; NaN for little."""
    if len(points) < MIN_POINTS:
        return math.nan
    return float(np.linalg.norm(pose.transform(points) - true.transform(points), axis=1).mean())


def _errors_from_mean_points(
    base: NDArray[np.float64], measured_points: NDArray[np.float64], true: Pose
) -> dict[str, Any] | None:
    """Errors of poses that are identified from the regions' mean points; None if too few."""
    if len(base) < MIN_TRACKED_FIDUCIALS:
        return None
    # a region's mean lies anywhere in its ball, which is some centimetres
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
