"""Speed of the planar environment: steps, ratings, decisions, memory.

The measurements are medians over interleaved rounds, because the machine may be shared. Between
machines, compare the ratio to simple_spread of mpe2 (extra ``bench``), which runs in the same
rounds.
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
from coopmap_env.envs.planar import PlanarEnv, PlanarSettings
from coopmap_env.evaluation import Policy, make_policy, rollout
from coopmap_env.studies.section3.setting import SCANS_EACH
from coopmap_env.studies.speed.common import resident_memory_mb, step_profile

WHOLE_WORLD = replace(PlanarSettings(), reach=300.0)
"""Settings with which planners search all known free space, not only what is near."""


def measure_planar(rounds: int, log: Callable[[str], None]) -> dict[str, Any]:
    """All measurements as JSON values, medians over the rounds."""
    spread = import_optional("mpe2.simple_spread_v3", "bench").parallel_env()
    planar = PlanarEnv(max_scans=SCANS_EACH)
    candidates_env = PlanarEnv(max_scans=SCANS_EACH, action_mode="candidates")
    log("compiling")
    step_rates(planar, 2)
    step_rates(candidates_env, 2)
    names = ("exhaustive", "exhaustive+coordination=sequential", "100")
    policies = {name: make_policy(f"rating_function:search={name}") for name in names}
    long_reach_env = PlanarEnv(split="test", max_scans=SCANS_EACH, settings=WHOLE_WORLD)
    for policy in policies.values():
        decision_ms(long_reach_env, policy, seed=0)
    samples: dict[str, list[float]] = {}

    def add_sample(name: str, value: float) -> None:
        samples.setdefault(name, []).append(value)

    for round_index in range(rounds):
        log(f"round {round_index + 1} of {rounds}")
        for name, env in (
            ("", planar),
            ("candidates_", candidates_env),
            ("simple_spread_", spread),
        ):
            rate, rate_with_resets, rate_with_sampling = step_rates(env, 40)
            add_sample(f"{name}agent_steps_per_s", rate)
            add_sample(f"{name}agent_steps_per_s_with_resets", rate_with_resets)
            add_sample(f"{name}agent_steps_per_s_with_resets_and_sampling", rate_with_sampling)
        for kind in ("", "_with_resets", "_with_resets_and_sampling"):
            name = f"agent_steps_per_s{kind}"
            add_sample(
                f"ratio_to_simple_spread{kind}",
                samples[name][-1] / samples[f"simple_spread_{name}"][-1],
            )
        for size in (1, 100):
            add_sample(f"rating_us_per_pose_batch_{size}", rating_us(long_reach_env, size))
        for search, policy in policies.items():
            add_sample(
                f"decision_ms_{search}", decision_ms(long_reach_env, policy, seed=round_index + 1)
            )
        add_sample("decision_ms_brute_force", brute_force_ms(long_reach_env, seed=round_index + 1))
    figures: dict[str, Any] = {name: statistics.median(values) for name, values in samples.items()}
    figures["resident_memory_mb"] = resident_memory_mb("planar", episodes=5)
    figures["step_profile_us"] = step_profile(planar)
    return figures


def step_rates(env: Any, episodes: int) -> tuple[float, float, float]:
    """Agent-steps per second of random episodes.

    Returns
    -------
    tuple of float
        Of `step` alone; with the resets between episodes; and with the sampling of actions, as
        PettingZoo's own benchmark counts.
    """
    agents = env.possible_agents
    env.reset(seed=0)
    for k, agent in enumerate(agents):
        env.action_space(agent).seed(k)
    step_seconds = reset_seconds = sampling_seconds = 0.0
    count = 0
    clock = time.perf_counter
    for episode in range(episodes):
        start = clock()
        env.reset(seed=episode)
        reset_seconds += clock() - start
        while env.agents:
            start = clock()
            actions = {agent: env.action_space(agent).sample() for agent in env.agents}
            sampled = clock()
            env.step(actions)
            step_seconds += clock() - sampled
            sampling_seconds += sampled - start
            count += len(agents)
    return (
        count / step_seconds,
        count / (step_seconds + reset_seconds),
        count / (step_seconds + reset_seconds + sampling_seconds),
    )


def rating_us(env: PlanarEnv, size: int, n_poses: int = 1000) -> float:
    """Microseconds to rate one random pose (Eq. 9) half-way through an episode.

    One call rates `size` poses, as a decision does.
    """
    _mean_decision_seconds(
        env, make_policy("rating_function:search=100"), seed=0, scans=SCANS_EACH // 2
    )
    belief, rng = env.belief(), np.random.default_rng(0)
    cells = belief.feasible_cells(0).astype(np.int64)
    n = belief.lattice.n_headings
    ids = rng.choice(cells, n_poses) * n + rng.integers(n, size=n_poses)
    start = time.perf_counter()
    for batch in ids.reshape(-1, size):
        belief.rate(0, batch)
    return 1e6 * (time.perf_counter() - start) / n_poses


def decision_ms(env: PlanarEnv, policy: Policy, seed: int) -> float:
    """Milliseconds of one robot's decision, the mean over an episode of 32 scans."""
    return 1e3 * _mean_decision_seconds(env, policy, seed, SCANS_EACH)


def brute_force_ms(env: PlanarEnv, seed: int) -> float:
    """The same for a planner that rates every feasible pose at each decision."""

    class BruteForce:
        """Exhaustive search without a cache."""

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

    return 1e3 * _mean_decision_seconds(env, BruteForce(), seed, SCANS_EACH)


def _mean_decision_seconds(env: PlanarEnv, policy: Policy, seed: int, scans: int) -> float:
    """Play some scans; return the mean time of one robot's decision, seconds."""
    elapsed = sum(step.decision_s for step in islice(rollout(env, policy, seed), scans))
    return elapsed / (scans * len(env.possible_agents))
