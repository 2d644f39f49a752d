"""Learning by imitation: a network does what a planner does, before it learns from rewards.

Any `Policy` can be the teacher. It plays training worlds, and a network is fitted to its decisions
(behaviour cloning); in further rounds the network plays, and the teacher says what it would have
done there (DAgger, Ross et al. 2011)::

    settings, env = PPOSettings(critic_steps=20_000), factory()
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
from coopmap_agents import NEEDS_RL
from gymnasium import spaces

from coopmap_env.evaluation.policy import Policy

try:
    import torch
    from stable_baselines3.common.policies import ActorCriticPolicy
except ImportError as error:
    raise ImportError(NEEDS_RL) from error

from coopmap_agents.pretrained.learned_policy import LearnedPolicy
from coopmap_agents.sb3.vec_env import EnvFactory, stack
from coopmap_agents.settings import ImitationSettings

SAME_POSE = 0.1
"""A pose agrees with the teacher's if no number of the action differs by more, of 2 in all."""
ROWS_AT_ONCE = 1024
"""When held-out decisions are judged; bounds the memory."""


@dataclass(frozen=True)
class ImitationReport:
    """How well a network does as its teacher, on worlds that it was not fitted to."""

    n_learned: int
    """Decisions that it was fitted to."""
    n_held_out: int
    """Decisions that it is judged by here."""
    agreement: float
    """Share of them in which it does the same: takes the same candidate, or a pose that is the
    teacher's within `SAME_POSE`."""
    log_likelihood: float
    """Of the teacher's actions under the model's distribution, mean, nats."""


@dataclass
class Decisions:
    """What a teacher does: n observations, and its actions."""

    observations: dict[str, torch.Tensor]
    """Entries (n, ...) as observed."""
    actions: torch.Tensor
    """Shape (n,) of candidates, (n, k) of poses."""

    def __len__(self) -> int:
        return len(self.actions)

    def __getitem__(self, rows: torch.Tensor | slice) -> Decisions:
        picked = {key: values[rows] for key, values in self.observations.items()}
        return Decisions(picked, self.actions[rows])

    def to(self, device: torch.device) -> Decisions:
        """The same on a device."""
        moved = {key: values.to(device) for key, values in self.observations.items()}
        return Decisions(moved, self.actions.to(device))

    @classmethod
    def together(cls, parts: Iterable[Decisions]) -> Decisions:
        """All decisions in one."""
        parts = list(parts)
        keys = parts[0].observations
        return cls(
            {key: torch.cat([part.observations[key] for part in parts]) for key in keys},
            torch.cat([part.actions for part in parts]),
        )


def clone(
    network: ActorCriticPolicy,
    env_factory: EnvFactory,
    teacher: Policy,
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
    worlds, draws, order = np.random.SeedSequence(seed).spawn(3)
    env = env_factory()
    rng = np.random.default_rng(draws)
    generator = torch.Generator().manual_seed(int(order.generate_state(1)[0]))
    seeds = worlds.generate_state(settings.rounds * settings.episodes).reshape(settings.rounds, -1)
    optimizer = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
    split = settings.episodes - settings.held_out_episodes
    learned: list[Decisions] = []
    held_out: list[Decisions] = []
    try:
        for number, round_seeds in enumerate(seeds.tolist()):
            player = teacher if number == 0 else LearnedPolicy(network)
            played = [watch(env, player, teacher, world, rng) for world in round_seeds]
            learned, held_out = learned + played[:split], held_out + played[split:]
            fit(network, Decisions.together(learned), settings, optimizer, generator)
    finally:
        env.close()
    return judge(network, Decisions.together(held_out), sum(map(len, learned)))


def watch(
    env: Any, player: Policy, teacher: Policy, seed: int, rng: np.random.Generator
) -> Decisions:
    """Let a policy play the world of a seed, and note what the teacher does at each step.

    Returns
    -------
    Decisions
        One for each robot and step.
    """
    observations, _ = env.reset(seed=seed)
    policies = [teacher] if player is teacher else [teacher, player]
    for policy in policies:
        policy.reset(rng)
    rows, actions = [], []
    while env.agents:
        agents, belief = list(env.agents), env.belief()
        said = teacher.act(belief, observations)
        rows += [observations[agent] for agent in agents]
        actions += [said[agent] for agent in agents]
        done = said if player is teacher else player.act(belief, observations)
        observations, *_ = env.step(done)
    stacked = {key: torch.as_tensor(values) for key, values in stack(rows).items()}
    return Decisions(stacked, torch.as_tensor(np.stack(actions)))


def fit(
    network: ActorCriticPolicy,
    decisions: Decisions,
    settings: ImitationSettings,
    optimizer: torch.optim.Optimizer,
    generator: torch.Generator,
) -> None:
    """Raise the likelihood of decisions, `settings.epochs` times through them."""
    network.set_training_mode(True)
    for _ in range(settings.epochs):
        for rows in torch.randperm(len(decisions), generator=generator).split(settings.batch_size):
            batch = decisions[rows].to(network.device)
            _, log_prob, _ = network.evaluate_actions(batch.observations, batch.actions)
            optimizer.zero_grad()
            (-log_prob.mean()).backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), settings.max_gradient_norm)
            optimizer.step()


@torch.no_grad()
def judge(network: ActorCriticPolicy, decisions: Decisions, n_learned: int) -> ImitationReport:
    """Compare what the network does with what the teacher did."""
    network.set_training_mode(False)
    same = likelihood = 0.0
    for start in range(0, len(decisions), ROWS_AT_ONCE):
        batch = decisions[start : start + ROWS_AT_ONCE].to(network.device)
        distribution = network.get_distribution(batch.observations)
        done = distribution.get_actions(deterministic=True)
        likelihood += float(distribution.log_prob(batch.actions).sum())
        if isinstance(network.action_space, spaces.Discrete):
            same += int((done == batch.actions).sum())
        else:
            same += int(((done - batch.actions).abs().amax(dim=1) <= SAME_POSE).sum())
    n = len(decisions)
    return ImitationReport(n_learned, n, same / n, likelihood / n)
