"""Speed of the field environment: steps, scans, ratings, localization, memory.

The reference of a scan is PyBullet's `rayTestBatch` followed by OctoMap's `insertPointCloud` (extra
``octomap``) at the same camera pose. Everything runs on one core; see
`coopmap_env.studies.speed.measure` for what a time is.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np

from coopmap_env import field_v1
from coopmap_env.core.extras import import_optional
from coopmap_env.envs.field import FieldEnv, FieldSettings
from coopmap_env.evaluation import make_policy, rollout
from coopmap_env.mapping import OccupancyMap
from coopmap_env.sensing import Scan, transform_cloud
from coopmap_env.simulation.depth import DepthRenderer, simulate_point_cloud
from coopmap_env.simulation.physics import BulletWorld
from coopmap_env.studies.field.octomap_comparison import fuse_octomap
from coopmap_env.studies.speed.cases import (
    CASES,
    SCANS_EACH,
    Run,
    Timings,
    feasible_actions,
    field_candidates,
    random_episodes,
    vector_episodes,
)
from coopmap_env.studies.speed.common import figures_of, resident_memory_mb
from coopmap_env.studies.speed.measure import Case, measure, ratio

N_SCAN_POSES = 20
"""Camera poses at which a scan is timed."""
N_CANDIDATES = 300
"""Poses that are rated at once."""
WORKER_WORLDS = 8
"""Worlds that one or two workers step. With a single world each, every step would take as
long as the slower one of two worlds."""
SEARCH_SCANS = 16
"""Length of the episode in which localization is timed."""

STEPPED = ("kinematic", "stepped", "candidates")
"""Cases whose steps are counted."""


def measure_field(rounds: int, log: Callable[[str], None]) -> dict[str, Any]:
    """All measurements as JSON values."""
    import_optional("pyoctomap", "octomap")
    log("field: compiling")
    vectors = {
        n: field_v1.vector_env(
            WORKER_WORLDS, num_workers=n, autoreset_mode="Disabled", action_mode="candidates",
            max_scans=SCANS_EACH,
        )
        for n in (1, 2)
    }  # fmt: skip
    stepped = FieldEnv(max_scans=SCANS_EACH, settings=replace(FieldSettings(), physics="stepped"))
    cases = {
        "kinematic": Case(CASES["field"]()),
        "stepped": Case(random_episodes(stepped, 1, feasible_actions)),
        "candidates": Case(field_candidates()),
        **{
            f"workers_{n}": Case(vector_episodes(env, 1, time.perf_counter), repeats=2)
            for n, env in vectors.items()
        },
        "scans": Case(scans()),
        "ratings": Case(ratings()),
        "localization": Case(localization(), repeats=2),
    }
    measure({name: replace(case, repeats=1) for name, case in cases.items()}, rounds=1)
    log(f"field: {rounds} rounds")
    found = measure(cases, rounds)
    figures: dict[str, Any] = {
        f"agent_steps_per_s_{name}": 2 * len(found[name].shortest("step")) / total.seconds
        for name, total in ((name, found[name].total("step")) for name in STEPPED)
    }
    figures["vector_wall_time_of_1_worker_over_2"] = ratio(
        found["workers_1"].total("step"), found["workers_2"].total("step")
    )
    n_rays = FieldSettings().camera.width * FieldSettings().camera.height
    figures["scan_rays_per_s"] = n_rays / float(np.mean(found["scans"].shortest("scan")))
    for kind in ("scan", "scan_reference"):
        figures[f"{kind}_ms"] = 1e3 * float(np.mean(found["scans"].shortest(kind)))
    figures["scan_speedup"] = ratio(
        found["scans"].total("scan_reference"), found["scans"].total("scan")
    )
    for kind in ("rating_300", "rating_300_without_prescreen"):
        figures[f"{kind}_ms"] = 1e3 * float(np.mean(found["ratings"].shortest(kind)))
    for kind in ("correction", "registration"):
        shortest = 1e3 * found["localization"].shortest(kind)
        figures[f"{kind}_ms"] = float(np.median(shortest))
        figures[f"{kind}_max_ms"] = float(shortest.max())
    figures["resident_memory_mb"] = resident_memory_mb("field", episodes=3)
    stepped.close()
    for vector in vectors.values():
        vector.close()
    return figures_of(figures)


def scans() -> Run:
    """Simulate and fuse depth images, ``scan``, and ``scan_reference`` at the same poses."""
    env = FieldEnv()
    env.reset(seed=0)
    world, s, belief = env.truth, env.settings, env.belief()
    renderer = DepthRenderer(world.triangles)
    physics = BulletWorld(world.solids, env.mounts, world.base_poses)
    poses = belief.random_poses(0, N_SCAN_POSES, np.random.default_rng(0))
    estimates = [belief.vehicles[0].camera_estimate(q) for q in poses]

    def run() -> Timings:
        map_ = OccupancyMap(world.grid, s.beam, s.log_odds_range)
        rng = np.random.default_rng(0)
        timings: Timings = {"scan": [], "scan_reference": []}
        for estimate in estimates:
            pose = estimate.pose
            start = time.process_time()
            distances = renderer.distances(pose.rotation, pose.translation, s.camera.directions)
            cloud = simulate_point_cloud(distances, s.camera, s.noise, rng)
            scan = transform_cloud(cloud, pose, s.noise, estimate.covariance)
            map_.integrate(scan)
            timings["scan"].append(time.process_time() - start)
            timings["scan_reference"].append(
                reference_scan_seconds(physics, scan, s.camera.far, world.grid)
            )
        return timings

    return run


def reference_scan_seconds(physics: BulletWorld, scan: Scan, far: float, grid: Any) -> float:
    """Seconds of `rayTestBatch` with the same beams and one `insertPointCloud` of the scan."""
    rays = scan.points - scan.origin
    ends = scan.origin + far * rays / np.linalg.norm(rays, axis=1, keepdims=True)
    start = time.process_time()
    physics.client.cast_rays(np.broadcast_to(scan.origin, ends.shape), ends)
    seconds = time.process_time() - start
    _, fused = fuse_octomap([scan], grid)
    return seconds + fused


def ratings() -> Run:
    """Rate 300 candidates half-way through an episode.

    First as a decision does it (all on a coarse map, then the best 30 exactly), then all exactly.
    """
    env, policy = FieldEnv(), make_policy("rating_function:search=50")
    for _ in islice(rollout(env, policy, seed=0), env.max_scans // 2):
        pass
    belief = env.belief()
    poses = belief.random_poses(0, N_CANDIDATES, np.random.default_rng(0))

    def run() -> Timings:
        start = time.process_time()
        short = belief.planning.prescreen(
            belief, poses, lambda rough, some: rough.rate(0, some).rating
        )
        belief.rate(0, short)
        prescreened = time.process_time()
        belief.rate(0, poses)
        return {
            "rating_300": [prescreened - start],
            "rating_300_without_prescreen": [time.process_time() - prescreened],
        }

    return run


def localization() -> Run:
    """Motion corrections and registrations of the target in a search episode."""
    env = FieldEnv(initialization="search", motion_correction="fiducials", max_scans=SEARCH_SCANS)
    policy = make_policy("rating_function:search=50")

    def run() -> Timings:
        timings: Timings = {"correction": [], "registration": []}
        for _ in rollout(env, policy, seed=1):
            timings["registration"] += env.localizer.registration_times
            if all(env.belief().located):
                timings["correction"] += env.localizer.correction_times
        return timings

    return run
