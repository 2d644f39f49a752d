"""Playing an episode: the one loop of a policy in an environment."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from coopmap_env.evaluation.policy import Policy

if TYPE_CHECKING:
    from coopmap_env.envs import Belief, Infos, MappingEnv, Observation

POLICY_SPAWN_KEY = 0xAC7
"""Spawn key of the policies' own random numbers: the same for every policy on a world."""


class Step(NamedTuple):
    """One step of an episode."""

    belief: Belief
    """What the policy acted on; the belief after the step is `env.belief()`."""
    observations: Mapping[str, Observation]
    """What the policy acted on, by robot."""
    actions: dict[str, Any]
    """By robot."""
    rewards: Mapping[str, float]
    """By robot, of this step."""
    infos: Infos
    """By robot, after this step."""
    decision_s: float
    """Time that the policy took for all robots, seconds."""
    next_observations: Mapping[str, Observation]
    """What came of it, by robot."""


def policy_rng(seed: int) -> np.random.Generator:
    """The random numbers that policies get on the world of this seed."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(POLICY_SPAWN_KEY,)))


def rollout(
    env: MappingEnv[Any],
    policy: Policy,
    seed: int,
    rng: np.random.Generator | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> Iterator[Step]:
    """Play one episode, a step at a time.

    Environment and policy are reset by the call; each step is played when the iterator is advanced.
    In between, the environment can be asked for anything: its belief, its truth, a picture.

    Parameters
    ----------
    env : MappingEnv
    policy : Policy
    seed : int
        Seed of the world.
    rng : numpy.random.Generator, optional
        The policy's random numbers; by default those of the world, `policy_rng(seed)`.
    clock : callable
        Seconds, by which decisions are timed: `time.process_time` leaves out other processes.

    Raises
    ------
    RuntimeError
        If the policy changes the map of the belief.

    Examples
    --------
    >>> for step in rollout(env, policy, seed=0):
    ...     print(sum(step.rewards.values()), env.belief().map.observed_fraction)
    """
    observations, _ = env.reset(seed=seed)
    policy.reset(policy_rng(seed) if rng is None else rng)
    return _steps(env, policy, observations, clock)


def _steps(
    env: MappingEnv[Any],
    policy: Policy,
    observations: Mapping[str, Observation],
    clock: Callable[[], float],
) -> Iterator[Step]:
    while env.agents:
        fraction = env.belief().map.observed_fraction
        start = clock()
        belief = env.belief()
        actions = policy.act(belief, observations)
        decision_s = clock() - start
        if env.belief().map.observed_fraction != fraction:
            raise RuntimeError(f"{policy!r} changed the map; policies may only read it")
        before = observations
        observations, rewards, _, _, infos = env.step(actions)
        yield Step(belief, before, actions, rewards, infos, decision_s, observations)


def warm_up(env: MappingEnv[Any], *policies: Policy) -> None:
    """Let each policy decide once.

    Compiling and loading are then no part of the measured planning time, and a policy that does not
    fit the environment fails before any episode is played.
    """
    observations, _ = env.reset(seed=0)
    for policy in policies:
        policy.reset(policy_rng(0))
        policy.act(env.belief(), observations)
