"""Teams so simple that everything about them is known by hand."""

import os
from typing import ClassVar

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv


class ConstantReward(ParallelEnv):
    """Reward 1 a step, whatever the robots do, and an end after `n_steps`.

    A robot observes [its number, the fraction of the episode that is over, the episode's number].
    Without a clock the fraction is 0 throughout: the end cannot be predicted.
    """

    metadata: ClassVar = {"name": "constant_reward"}
    info_types: ClassVar = {"episode_number": float, "step": int}

    def __init__(self, n_steps=5, truncates=True, n_robots=2, clock=True, render_mode=None):
        self.n_steps = n_steps
        self.truncates = truncates
        self.clock = clock
        self.render_mode = render_mode
        self.possible_agents = [f"robot_{i}" for i in range(n_robots)]
        self.agents = []
        self.rng = np.random.default_rng()
        self.options = []
        self.calls = []
        self.process_id = os.getpid()

    def observation_space(self, agent):
        return spaces.Dict({"pose": spaces.Box(-1.0, 1.0, (3,), np.float32)})

    def action_space(self, agent):
        return spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, seed=None, options=None):
        if seed is not None:
            self.rng = np.random.default_rng(seed)
        self.options.append(options)
        self.step_number = 0
        self.episode = self.rng.random()
        self.agents = list(self.possible_agents)
        return self.observe(), self.infos()

    def step(self, actions):
        self.calls.append(actions)
        self.step_number += 1
        over = self.step_number == self.n_steps
        names = self.possible_agents
        observations = self.observe()
        if over:
            self.agents = []
        return (
            observations,
            dict.fromkeys(names, 1.0),
            dict.fromkeys(names, over and not self.truncates),
            dict.fromkeys(names, over and self.truncates),
            self.infos(),
        )

    def infos(self):
        own = {"episode_number": self.episode, "step": self.step_number}
        return {agent: dict(own) for agent in self.possible_agents}

    def observe(self):
        fraction = self.step_number / self.n_steps if self.clock else 0.0
        return {
            agent: {"pose": np.array([i, fraction, self.episode], dtype=np.float32)}
            for i, agent in enumerate(self.possible_agents)
        }

    def render(self):
        self.calls.append("render")
        return np.full((4, 6, 3), 7, dtype=np.uint8)

    def close(self):
        self.calls.append("close")


class HookedEnv(ConstantReward):
    """The same, with functions that are called in `step` and `close`."""

    def __init__(self, on_step=lambda: None, on_close=lambda: None, **arguments):
        super().__init__(**arguments)
        self.on_step = on_step
        self.on_close = on_close

    def step(self, actions):
        self.on_step()
        return super().step(actions)

    def close(self):
        self.on_close()


class StatefulEnv(ConstantReward):
    """Its state is [the fraction of the episode that is over, the episode's number]."""

    state_space: ClassVar = spaces.Box(0.0, 1.0, (2,), np.float32)

    def state(self):
        return np.array([self.step_number / self.n_steps, self.episode], dtype=np.float32)


class FailingFactory:
    """A factory of one environment, which leaves a file when it is closed."""

    def __init__(self, folder):
        self.folder = folder
        self.n_made = 0

    def __call__(self):
        self.n_made += 1
        if self.n_made == 2:
            raise OSError("there is no second environment")
        return HookedEnv(on_close=lambda: (self.folder / str(os.getpid())).touch())


class ConstantChoice(ConstantReward):
    """The same, choosing among `m` candidates, of which a random number is unmasked."""

    def __init__(self, m=6, **arguments):
        super().__init__(**arguments)
        self.m = m

    def observation_space(self, agent):
        candidates = spaces.Box(-10.0, 10.0, (self.m, 3), np.float32)
        mask = spaces.Box(0, 1, (self.m,), np.int8)
        own = super().observation_space(agent).spaces
        return spaces.Dict({**own, "candidates": candidates, "action_mask": mask})

    def action_space(self, agent):
        return spaces.Discrete(self.m)

    def observe(self):
        observations = super().observe()
        for own in observations.values():
            mask = np.arange(self.m) < self.rng.integers(1, self.m + 1)
            features = self.rng.uniform(-1, 1, (self.m, 3)) * mask[:, None]
            own.update(candidates=features.astype(np.float32), action_mask=mask.astype(np.int8))
        return observations
