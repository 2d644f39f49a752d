"""Speed of the field environment: steps, scans, ratings, localization, memory.

The reference of a scan is PyBullet's `rayTestBatch` followed by OctoMap's `insertPointCloud` (extra
``octomap``) at the same camera pose. Everything runs on one core.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np

from coopmap_env.core.extras import import_optional
from coopmap_env.envs.field import FieldEnv, FieldSettings
from coopmap_env.evaluation import make_policy, rollout
from coopmap_env.mapping import OccupancyMap
from coopmap_env.sensing import Scan, transform_cloud
from coopmap_env.simulation.depth import DepthRenderer, simulate_point_cloud
from coopmap_env.simulation.physics import BulletWorld
from coopmap_env.studies.field.octomap_comparison import fuse_octomap
from coopmap_env.studies.speed.common import resident_memory_mb, step_profile

N_SCAN_POSES = 20
"""Camera poses per round at which a scan is measured."""
N_CANDIDATES = 300
"""Poses that are rated at once."""
N_EPISODES = 4
"""Random episodes per round, of each kind of physics."""


def measure_field(rounds: int, log: Callable[[str], None]) -> dict[str, Any]:
    """All measurements as JSON values: process times, medians over interleaved rounds."""
    import_optional("pyoctomap", "octomap")
    settings = FieldSettings()
    envs = {
        physics: FieldEnv(settings=replace(settings, physics=physics))
        for physics in ("kinematic", "stepped")
    }
    samples: dict[str, list[float]] = {}
    log("field: compiling")
    for env in envs.values():
        agent_steps_per_second(env, 1)
    for round_index in range(rounds):
        log(f"field: round {round_index + 1} of {rounds}")
        measured = {
            f"agent_steps_per_s_{name}": agent_steps_per_second(env, N_EPISODES)
            for name, env in envs.items()
        }
        measured |= scan_ms(envs["kinematic"])
        measured |= rating_ms(envs["kinematic"])
        measured |= localization_ms()
        for name, value in measured.items():
            samples.setdefault(name, []).append(value)
    figures: dict[str, Any] = {name: statistics.median(v) for name, v in samples.items()}
    figures["scan_speedup"] = figures["scan_reference_ms"] / figures["scan_ms"]
    figures["resident_memory_mb"] = resident_memory_mb("field", episodes=3)
    figures["step_profile_us"] = step_profile(envs["kinematic"], steps=32)
    for env in envs.values():
        env.close()
    return {
        name: round(value, 4) if isinstance(value, float) else value
        for name, value in figures.items()
    }


def agent_steps_per_second(env: FieldEnv, episodes: int) -> float:
    """Agent-steps per second of `step` with random feasible poses, so that every robot moves."""
    rng = np.random.default_rng(0)
    elapsed, count = 0.0, 0
    for seed in range(episodes):
        env.reset(seed=seed)
        while env.agents:
            belief = env.belief()
            actions = {
                agent: belief.action_for(robot, belief.random_poses(robot, 1, rng)[0])
                for robot, agent in enumerate(env.agents)
            }
            start = time.process_time()
            env.step(actions)
            elapsed += time.process_time() - start
            count += len(actions)
    return count / elapsed


def scan_ms(env: FieldEnv) -> dict[str, float]:
    """Milliseconds to simulate and fuse one depth image, and the same of the reference."""
    env.reset(seed=0)
    world, s, rng = env.truth, env.settings, np.random.default_rng(0)
    renderer = DepthRenderer(world.triangles)
    map_ = OccupancyMap(world.grid, s.beam, s.log_odds_range)
    physics = BulletWorld(world.solids, env.mounts, world.base_poses)
    belief = env.belief()
    ours, theirs = [], []
    for q in belief.random_poses(0, N_SCAN_POSES, rng):
        estimate = belief.vehicles[0].camera_estimate(q)
        pose = estimate.pose
        start = time.process_time()
        distances = renderer.distances(pose.rotation, pose.translation, s.camera.directions)
        cloud = simulate_point_cloud(distances, s.camera, s.noise, rng)
        scan = transform_cloud(cloud, pose, s.noise, estimate.covariance)
        map_.integrate(scan)
        ours.append(time.process_time() - start)
        theirs.append(reference_scan_seconds(physics, scan, s.camera.far, world.grid))
    physics.close()
    return {
        "scan_ms": 1e3 * statistics.median(ours),
        "scan_reference_ms": 1e3 * statistics.median(theirs),
    }


def reference_scan_seconds(physics: BulletWorld, scan: Scan, far: float, grid: Any) -> float:
    """Seconds of `rayTestBatch` with the same beams and one `insertPointCloud` of the scan."""
    rays = scan.points - scan.origin
    ends = scan.origin + far * rays / np.linalg.norm(rays, axis=1, keepdims=True)
    start = time.process_time()
    physics.client.cast_rays(np.broadcast_to(scan.origin, ends.shape), ends)
    seconds = time.process_time() - start
    _, fused = fuse_octomap([scan], grid)
    return seconds + fused


def rating_ms(env: FieldEnv) -> dict[str, float]:
    """Milliseconds to rate 300 candidates half-way through an episode.

    First as a decision does it (all on a coarse map, then the best 30 exactly), then all exactly.
    """
    policy = make_policy("rating_function:search=50")
    for _ in islice(rollout(env, policy, seed=0), env.max_scans // 2):
        pass
    belief = env.belief()
    poses = belief.random_poses(0, N_CANDIDATES, np.random.default_rng(0))
    start = time.process_time()
    short = belief.planning.prescreen(belief, poses, lambda rough, some: rough.rate(0, some).rating)
    belief.rate(0, short)
    prescreened = time.process_time()
    belief.rate(0, poses)
    return {
        "rating_300_ms": 1e3 * (prescreened - start),
        "rating_300_without_prescreen_ms": 1e3 * (time.process_time() - prescreened),
    }


def localization_ms() -> dict[str, float]:
    """Milliseconds of a motion correction and of a registration, over a search episode."""
    env = FieldEnv(initialization="search", motion_correction="fiducials")
    policy = make_policy("rating_function:search=50")
    corrections: list[float] = []
    registrations: list[float] = []
    for seed in range(2):  # the first one loads compiled code
        steps = rollout(env, policy, seed)
        corrections.clear()
        registrations.clear()
        for _ in steps:
            registrations += env.localizer.registration_times
            if all(env.belief().located):
                corrections += env.localizer.correction_times
    env.close()
    return {
        "correction_ms": 1e3 * statistics.median(corrections),
        "correction_max_ms": 1e3 * max(corrections),
        "registration_ms": 1e3 * statistics.median(registrations),
        "registration_max_ms": 1e3 * max(registrations),
    }
