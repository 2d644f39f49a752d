"""An environment that checks the actions of its robots."""

from pettingzoo.utils import BaseParallelWrapper


class Strict(BaseParallelWrapper):
    """Fails if an action is out of its space or masked."""

    def __init__(self, env):
        super().__init__(env)
        self.masks = {}

    def reset(self, seed=None, options=None):
        observations, infos = super().reset(seed, options)
        self.masks = {agent: own.get("action_mask") for agent, own in observations.items()}
        return observations, infos

    def step(self, actions):
        for agent, action in actions.items():
            assert self.action_space(agent).contains(action)
            assert self.masks[agent] is None or self.masks[agent][action] == 1
        result = super().step(actions)
        self.masks = {agent: own.get("action_mask") for agent, own in result[0].items()}
        return result
