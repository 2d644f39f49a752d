"""Speed of the planar environment: steps, ratings, decisions, memory.

See `coopmap_env.studies.speed.measure` for what a time is. Between machines, compare the ratio to
simple_spread of mpe2 (extra ``bench``), which runs in the same rounds.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from coopmap_env.core.extras import import_optional
from coopmap_env.envs.planar import PlanarEnv, PlanarSettings
from coopmap_env.evaluation import Policy, make_policy, policy_rng
from coopmap_env.studies.speed.cases import (
    CASES,
    N_WORLDS,
    SCANS_EACH,
    Run,
    Timings,
    planar_vector,
    random_episodes,
    vector_episodes,
)
from coopmap_env.studies.speed.common import figures_of, resident_memory_mb
from coopmap_env.studies.speed.measure import Case, Measured, measure, ratio

WHOLE_WORLD = replace(PlanarSettings(), reach=300.0)
"""Settings with which planners search all known free space, not only what is near."""
SEARCHES = ("exhaustive", "exhaustive+coordination=sequential", "100")
"""Of the rating function."""
N_RATED_POSES = 1000
SEEDS = (0, 1)
"""Worlds in which decisions are timed."""
RATES = {
    "": ("step",),
    "_with_resets": ("step", "reset"),
    "_with_resets_and_sampling": ("step", "reset", "sampling"),  # as PettingZoo's own benchmark
}

THREAD_WORLDS = (N_WORLDS, 512)
"""Worlds that one or two threads step: to hand them over takes as long as some tens of worlds."""

RIVALS = {
    "": ("planar_pose", 2),
    "candidates_": ("planar_candidates", 2),
    "vector_": ("planar_vector_pose", 2 * N_WORLDS),
    "vector_candidates_": ("planar_vector_candidates", 2 * N_WORLDS),
}
"""Prefix of the figures: the case, and the robots that move in each of its steps."""


def measure_planar(rounds: int, log: Callable[[str], None]) -> dict[str, Any]:
    """All measurements as JSON values."""
    spread = import_optional("mpe2.simple_spread_v3", "bench").parallel_env()
    log("planar: compiling")
    vectors = {
        (n, worlds): planar_vector("pose", worlds, num_threads=n)
        for n in (1, 2)
        for worlds in THREAD_WORLDS
    }
    cases = {
        "planar_pose": Case(CASES["planar_pose"]()),
        "planar_candidates": Case(CASES["planar_candidates"]()),
        "planar_vector_pose": Case(CASES["planar_vector_pose"]()),
        "planar_vector_candidates": Case(CASES["planar_vector_candidates"]()),
        "simple_spread": Case(random_episodes(spread, episodes=8)),
        **{
            f"threads_{n}_{worlds}": Case(vector_episodes(vector, 1, time.perf_counter))
            for (n, worlds), vector in vectors.items()
        },
        **{f"rating_{size}": Case(ratings(size)) for size in (1, 100)},
        **{
            f"decision_ms_{search}": Case(
                decisions(make_policy(f"rating_function:search={search}")), 2
            )
            for search in SEARCHES
        },
        "decision_ms_brute_force": Case(decisions(BruteForce()), repeats=1),
    }
    measure({name: replace(case, repeats=1) for name, case in cases.items()}, rounds=1)
    log(f"planar: {rounds} rounds")
    found = measure(cases, rounds)
    figures: dict[str, Any] = _step_rates(found, len(spread.possible_agents))
    for name, case in found.items():
        if name.startswith("decision"):
            figures[name] = 1e3 * case.total("decision").seconds / (len(SEEDS) * SCANS_EACH * 2)
    for size in (1, 100):
        total = found[f"rating_{size}"].total("rating").seconds
        figures[f"rating_us_per_pose_batch_{size}"] = 1e6 * total / N_RATED_POSES
    figures["resident_memory_mb"] = resident_memory_mb("planar", episodes=5)
    return figures_of(figures)


def _step_rates(found: dict[str, Measured], n_spread: int) -> dict[str, Any]:
    """Agent-steps per second, and how many times those of simple_spread they are."""
    figures: dict[str, Any] = {}
    spread = found["simple_spread"]
    for suffix, kinds in RATES.items():
        n_theirs = n_spread * len(spread.shortest("step"))
        rate = n_theirs / spread.total(*kinds).seconds
        figures[f"simple_spread_agent_steps_per_s{suffix}"] = rate
        for prefix, (name, n_rows) in RIVALS.items():
            case = found[name]
            total, n_ours = case.total(*kinds), n_rows * len(case.shortest("step"))
            figures[f"{prefix}agent_steps_per_s{suffix}"] = n_ours / total.seconds
            figures[f"{prefix}ratio_to_simple_spread{suffix}"] = ratio(
                spread.total(*kinds), total, scale=n_ours / n_theirs
            )
    for worlds in THREAD_WORLDS:
        one, two = (found[f"threads_{n}_{worlds}"].total("step") for n in (1, 2))
        figures[f"vector_wall_time_of_1_thread_over_2_{worlds}_worlds"] = ratio(one, two)
    return figures


def ratings(size: int) -> Run:
    """Rate random poses (Eq. 9) half-way through an episode; one call rates `size` of them."""
    env = PlanarEnv(split="test", max_scans=SCANS_EACH, settings=WHOLE_WORLD)
    policy, seed = make_policy("rating_function:search=100"), SEEDS[0]
    observations, _ = env.reset(seed=seed)
    policy.reset(policy_rng(seed))
    for _ in range(SCANS_EACH // 2):
        observations, *_ = env.step(policy.act(env.belief(), observations))
    belief, rng = env.belief(), np.random.default_rng(0)
    n = belief.lattice.n_headings
    cells = rng.choice(belief.feasible_cells(0), N_RATED_POSES)
    batches = (cells * n + rng.integers(n, size=N_RATED_POSES)).reshape(-1, size)

    def run() -> Timings:
        seconds = []
        for batch in batches:
            start = time.process_time()
            belief.rate(0, batch)
            seconds.append(time.process_time() - start)
        return {"rating": seconds}

    return run


def decisions(policy: Policy) -> Run:
    """Decisions of both robots at every scan of an episode, in each of the worlds `SEEDS`."""
    env = PlanarEnv(split="test", max_scans=SCANS_EACH, settings=WHOLE_WORLD)

    def run() -> Timings:
        seconds = []
        for seed in SEEDS:
            observations, _ = env.reset(seed=seed)
            policy.reset(policy_rng(seed))
            while env.agents:
                start = time.process_time()
                actions = policy.act(env.belief(), observations)
                seconds.append(time.process_time() - start)
                observations, *_ = env.step(actions)
        return {"decision": seconds}

    return run


class BruteForce:
    """Exhaustive search that rates every feasible pose at each decision, without a cache."""

    def reset(self, rng: np.random.Generator) -> None:
        """It has no state."""

    def act(self, belief: Any, observations: Any) -> dict[str, Any]:
        """The pose of the highest rating."""
        actions = {}
        for robot, agent in enumerate(belief.agents):
            ids = belief.feasible_poses(robot)
            rated = belief.rate(robot, ids)
            actions[agent] = belief.action_for(robot, int(ids[np.argmax(rated.rating)]))
        return actions
