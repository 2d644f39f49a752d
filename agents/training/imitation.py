"""Imitation: a network learns to decide as a planner, before it learns from rewards.

Any `Policy` can be the expert. It plays training worlds, and the network is fitted to its decisions
(behaviour cloning). In further rounds the network plays, and the expert gives the labels: what it
would have done (DAgger, Ross et al. 2011)::

    settings, env = PPOSettings(critic_warmup_steps=20_000), factory()
    network = make_network(
        env.observation_space("robot_0"), env.action_space("robot_0"), settings
    )
    expert = make("rating_function")
    report = behavior_clone(network, factory, expert, ImitationSettings(), seed=0)
    model = train(factory, settings, seed=0, warm_start=network)
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy

from coopmap_agents.config import ImitationSettings
from coopmap_agents.networks import stack
from coopmap_agents.pretrained import LearnedPolicy
from coopmap_env.envs import Belief, Observation
from coopmap_env.evaluation import Policy, rollout
from coopmap_env.vector import EnvFactory

POSE_TOLERANCE = 0.1
"""Two poses agree if no entry of the action, of range 2, differs by more; for the report only."""
EVALUATION_BATCH_SIZE = 1024
"""Held-out decisions evaluated at a time; bounds the memory."""


@dataclass(frozen=True)
class ImitationReport:
    """Agreement of a network with its expert, on worlds that it was not fitted to."""

    n_train: int
    """Number of decisions that it was fitted to."""
    n_held_out: int
    """Number of held-out decisions, of which the following are means."""
    agreement: float
    """Fraction of equal actions: the same candidate, or the same pose within `POSE_TOLERANCE`."""
    log_likelihood: float
    """Log-likelihood of the expert's actions under the network's distribution, nats."""


@dataclass
class Demonstrations:
    """Observations and the actions of an expert, n of each."""

    observations: dict[str, torch.Tensor]
    """Entries of shape (n, ...)."""
    actions: torch.Tensor
    """Shape (n,) of candidates, (n, k) of poses with k entries."""

    def __len__(self) -> int:
        return len(self.actions)

    def __getitem__(self, rows: torch.Tensor | slice) -> Demonstrations:
        picked = {key: values[rows] for key, values in self.observations.items()}
        return Demonstrations(picked, self.actions[rows])

    def to(self, device: torch.device) -> Demonstrations:
        """Copy on a device."""
        on_device = {key: values.to(device) for key, values in self.observations.items()}
        return Demonstrations(on_device, self.actions.to(device))

    @classmethod
    def concatenate(cls, parts: Iterable[Demonstrations]) -> Demonstrations:
        """All demonstrations in one, in order."""
        parts = list(parts)
        keys = parts[0].observations
        return cls(
            {key: torch.cat([part.observations[key] for part in parts]) for key in keys},
            torch.cat([part.actions for part in parts]),
        )


def behavior_clone(
    network: ActorCriticPolicy,
    env_factory: EnvFactory,
    expert: Policy,
    settings: ImitationSettings,
    seed: int,
) -> ImitationReport:
    """Fit a network to an expert's decisions, in place; the critic learns nothing.

    The loss is the negative log-likelihood of the expert's actions: cross-entropy among candidates;
    for poses that of a Gaussian, which fits its standard deviation too.

    Parameters
    ----------
    network : ActorCriticPolicy
        From `make_network`, or the ``policy`` of a model.
    env_factory : callable
        Makes a parallel environment of the training split; called once.
    expert : Policy
        For example a planner. Its actions must be in the action space of the environment.
    settings : ImitationSettings
    seed : int
        Seed of the worlds, of the expert and of the order of the decisions. The result depends on
        it and on the initial weights only.
    """
    world_seeds, policy_draws, order = np.random.SeedSequence(seed).spawn(3)
    env = env_factory()
    rng = np.random.default_rng(policy_draws)
    generator = torch.Generator().manual_seed(int(order.generate_state(1)[0]))
    seeds = world_seeds.generate_state(settings.rounds * settings.episodes).reshape(
        settings.rounds, -1
    )
    optimizer = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
    split = settings.episodes - settings.n_held_out_episodes
    train_set: list[Demonstrations] = []
    validation_set: list[Demonstrations] = []
    try:
        for number, round_seeds in enumerate(seeds.tolist()):
            behavior_policy = expert if number == 0 else LearnedPolicy(network)
            played = [
                collect_demonstrations(env, behavior_policy, expert, world, rng)
                for world in round_seeds
            ]
            train_set, validation_set = train_set + played[:split], validation_set + played[split:]
            fit(network, Demonstrations.concatenate(train_set), settings, optimizer, generator)
    finally:
        env.close()
    return evaluate_agreement(
        network, Demonstrations.concatenate(validation_set), sum(map(len, train_set))
    )


def collect_demonstrations(
    env: Any, behavior_policy: Policy, expert: Policy, seed: int, rng: np.random.Generator
) -> Demonstrations:
    """Let a policy play the world of a seed; the expert gives the action of each step as label.

    Returns
    -------
    Demonstrations
        One for each robot and step.
    """
    labelled = _LabelledPolicy(behavior_policy, expert)
    for _ in rollout(env, labelled, seed, rng):
        pass
    stacked = {key: torch.as_tensor(values) for key, values in stack(labelled.rows).items()}
    return Demonstrations(stacked, torch.as_tensor(np.stack(labelled.actions)))


class _LabelledPolicy:
    """Acts as one policy; records observations with the actions of an expert."""

    def __init__(self, behavior_policy: Policy, expert: Policy) -> None:
        self._behavior_policy, self._expert = behavior_policy, expert
        self.rows: list[Observation] = []
        self.actions: list[Any] = []

    def reset(self, rng: np.random.Generator) -> None:
        """Both policies draw from one generator, the expert first."""
        self._expert.reset(rng)
        if self._behavior_policy is not self._expert:
            self._behavior_policy.reset(rng)

    def act(self, belief: Belief, observations: Mapping[str, Observation]) -> dict[str, Any]:
        """The actions of the policy; those of the expert are recorded."""
        expert_actions = self._expert.act(belief, observations)
        self.rows += [observations[agent] for agent in belief.agents]
        self.actions += [expert_actions[agent] for agent in belief.agents]
        if self._behavior_policy is self._expert:
            return expert_actions
        return self._behavior_policy.act(belief, observations)


def fit(
    network: ActorCriticPolicy,
    demonstrations: Demonstrations,
    settings: ImitationSettings,
    optimizer: torch.optim.Optimizer,
    generator: torch.Generator,
) -> None:
    """Maximise the likelihood of the demonstrations, for `settings.epochs` passes."""
    network.set_training_mode(True)
    for _ in range(settings.epochs):
        for rows in torch.randperm(len(demonstrations), generator=generator).split(
            settings.batch_size
        ):
            batch = demonstrations[rows].to(network.device)
            _, log_prob, _ = network.evaluate_actions(batch.observations, batch.actions)
            optimizer.zero_grad()
            (-log_prob.mean()).backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), settings.max_gradient_norm)
            optimizer.step()


@torch.no_grad()
def evaluate_agreement(
    network: ActorCriticPolicy, demonstrations: Demonstrations, n_train: int
) -> ImitationReport:
    """Compare the actions of a network with held-out demonstrations."""
    network.set_training_mode(False)
    n_agreeing = likelihood = 0.0
    for start in range(0, len(demonstrations), EVALUATION_BATCH_SIZE):
        batch = demonstrations[start : start + EVALUATION_BATCH_SIZE].to(network.device)
        distribution = network.get_distribution(batch.observations)
        actions_taken = distribution.get_actions(deterministic=True)
        likelihood += float(distribution.log_prob(batch.actions).sum())
        if isinstance(network.action_space, spaces.Discrete):
            n_agreeing += int((actions_taken == batch.actions).sum())
        else:
            n_agreeing += int(
                ((actions_taken - batch.actions).abs().amax(dim=1) <= POSE_TOLERANCE).sum()
            )
    n = len(demonstrations)
    return ImitationReport(n_train, n, n_agreeing / n, likelihood / n)
