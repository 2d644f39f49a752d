"""Learning by imitation: a network does what a planner does, before it learns from rewards.

Any `Policy` can be the teacher. It plays training worlds, and a network is fitted to its decisions
(behaviour cloning); in further rounds the network plays, and the teacher says what it would have
done there (DAgger, Ross et al. 2011)::

    settings, env = PPOSettings(critic_warmup_steps=20_000), factory()
    network = make_network(
        env.observation_space("robot_0"), env.action_space("robot_0"), settings
    )
    report = clone(network, factory, make("rating_function"), ImitationSettings(), seed=0)
    model = train(factory, settings, seed=0, warm_start=network)
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from coopmap_agents import RL_EXTRA_HINT
from gymnasium import spaces

from coopmap_env.evaluation.policy import Policy

try:
    import torch
    from stable_baselines3.common.policies import ActorCriticPolicy
except ImportError as error:
    raise ImportError(RL_EXTRA_HINT) from error

from coopmap_agents.pretrained.learned_policy import LearnedPolicy
from coopmap_agents.sb3.vec_env import EnvFactory, stack
from coopmap_agents.settings import ImitationSettings

POSE_TOLERANCE = 0.1
"""A pose agrees with the teacher's if no number of the action differs by more, of 2 in all."""
EVALUATION_BATCH_SIZE = 1024
"""When held-out decisions are judged; bounds the memory."""


@dataclass(frozen=True)
class ImitationReport:
    """How well a network does as its teacher, on worlds that it was not fitted to."""

    n_train: int
    """Decisions that it was fitted to."""
    n_held_out: int
    """Decisions that it is judged by here."""
    agreement: float
    """Share of them in which it does the same: takes the same candidate, or a pose that is the
    teacher's within `POSE_TOLERANCE`."""
    log_likelihood: float
    """Of the teacher's actions under the model's distribution, mean, nats."""


@dataclass
class Demonstrations:
    """What a teacher does: n observations, and its actions."""

    observations: dict[str, torch.Tensor]
    """Entries (n, ...) as observed."""
    actions: torch.Tensor
    """Shape (n,) of candidates, (n, k) of poses."""

    def __len__(self) -> int:
        return len(self.actions)

    def __getitem__(self, rows: torch.Tensor | slice) -> Demonstrations:
        picked = {key: values[rows] for key, values in self.observations.items()}
        return Demonstrations(picked, self.actions[rows])

    def to(self, device: torch.device) -> Demonstrations:
        """The same on a device."""
        on_device = {key: values.to(device) for key, values in self.observations.items()}
        return Demonstrations(on_device, self.actions.to(device))

    @classmethod
    def concatenate(cls, parts: Iterable[Demonstrations]) -> Demonstrations:
        """All decisions in one."""
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
    """Fit a network to a teacher's decisions, in place; its critic learns nothing.

    The loss is minus the log-likelihood of the teacher's actions: cross-entropy among candidates,
    that of a Gaussian for poses, whose spread becomes that of the deviations.

    Parameters
    ----------
    network : ActorCriticPolicy
        Of `make_network`, or the ``policy`` of a model.
    env_factory : callable
        Makes a new parallel environment of the training split; one is made.
    teacher : Policy
        Whose actions fit the environment, such as a planner, which chooses among the candidates on
        offer where there are some.
    settings : ImitationSettings
    seed : int
        Decides the worlds, what the teacher draws, and the order of the decisions. With the
        network's weights it decides the result.
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
    """Let a policy play the world of a seed, and note what the teacher does at each step.

    Returns
    -------
    Decisions
        One for each robot and step.
    """
    observations, _ = env.reset(seed=seed)
    policies = [expert] if behavior_policy is expert else [expert, behavior_policy]
    for policy in policies:
        policy.reset(rng)
    rows, actions = [], []
    while env.agents:
        agents, belief = list(env.agents), env.belief()
        expert_actions = expert.act(belief, observations)
        rows += [observations[agent] for agent in agents]
        actions += [expert_actions[agent] for agent in agents]
        actions_taken = (
            expert_actions
            if behavior_policy is expert
            else behavior_policy.act(belief, observations)
        )
        observations, *_ = env.step(actions_taken)
    stacked = {key: torch.as_tensor(values) for key, values in stack(rows).items()}
    return Demonstrations(stacked, torch.as_tensor(np.stack(actions)))


def fit(
    network: ActorCriticPolicy,
    demonstrations: Demonstrations,
    settings: ImitationSettings,
    optimizer: torch.optim.Optimizer,
    generator: torch.Generator,
) -> None:
    """Raise the likelihood of decisions, `settings.epochs` times through them."""
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
    """Compare what the network does with what the teacher did."""
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
