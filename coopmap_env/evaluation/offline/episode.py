"""One recorded episode: what a team saw, did and got, as arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.linear_algebra import total
from coopmap_env.envs import Belief, MappingEnv, Observation
from coopmap_env.envs.team import team_info, team_observation
from coopmap_env.evaluation.policy import Policy
from coopmap_env.evaluation.rollout import rollout

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class RecordedEpisode:
    """An episode of T steps in the world of a seed, as the environment of one controller shows it.

    Entries are those of `TeamEnv`: the robots' ones, concatenated.
    """

    seed: int
    observations: Arrays
    """Each entry (T + 1, ...): before the first step and after each."""
    actions: NDArray[Any]
    """(T, k), of the type of the action space."""
    rewards: NDArray[np.float64]
    """(T,), sums over the robots."""
    terminations: NDArray[np.bool_]
    """(T,), all false: episodes are truncated, and the world goes on."""
    truncations: NDArray[np.bool_]
    """(T,), the last one is true."""
    infos: Arrays
    """Each entry (T + 1, n_robots), with all reward terms of each robot."""

    def __len__(self) -> int:
        """Number of steps."""
        return len(self.rewards)


class _InActionSpace:
    """A policy whose actions are rounded to the types of the action spaces before they are taken.

    So what is recorded is what was done, to the bit.
    """

    def __init__(self, policy: Policy, env: MappingEnv[Any]) -> None:
        self._policy = policy
        self._types = {agent: space.dtype for agent, space in env.action_spaces.items()}

    def reset(self, rng: np.random.Generator) -> None:
        self._policy.reset(rng)

    def act(self, belief: Belief, observations: Mapping[str, Observation]) -> dict[str, Any]:
        actions = self._policy.act(belief, observations)
        return {
            agent: np.asarray(action).astype(self._types[agent], casting="same_kind")
            for agent, action in actions.items()
        }


def record_episode(env: MappingEnv[Any], policy: Policy, seed: int) -> RecordedEpisode:
    """Play an episode and keep it.

    Parameters
    ----------
    env : MappingEnv
    policy : Policy
    seed : int
        Seed of the world; it gives the policy's random numbers too.
    """
    observations, infos = env.reset(seed=seed)
    seen, reported = [team_observation(observations)], [team_info(infos, env.info_types)]
    actions, rewards = [], []
    for step in rollout(env, _InActionSpace(policy, env), seed):
        actions.append(np.hstack([step.actions[agent] for agent in env.possible_agents]))
        rewards.append(total(step.rewards.values()))
        seen.append(team_observation(step.next_observations))
        reported.append(team_info(step.infos, env.info_types))
    n_steps = len(rewards)
    return RecordedEpisode(
        seed,
        _stack(seen),
        np.array(actions),
        np.array(rewards, np.float64),
        np.zeros(n_steps, np.bool_),
        np.arange(n_steps) == n_steps - 1,
        _stack(reported),
    )


def _stack(entries: list[Arrays]) -> Arrays:
    return {key: np.array([one[key] for one in entries]) for key in entries[0]}
