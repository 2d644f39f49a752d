"""Vector environments the slow way: gymnasium's own loop, and single environments by hand."""

import numpy as np
from gymnasium.vector import SyncVectorEnv


def assert_same(ours, theirs, where=""):
    """Equal dicts of arrays, to the last bit."""
    assert ours.keys() == theirs.keys(), where
    for key, values in theirs.items():
        np.testing.assert_array_equal(ours[key], values, err_msg=f"{where} {key}")


def gymnasium_loop(make_team, n_worlds, mode):
    """Gymnasium's vector environment of the team's."""
    return SyncVectorEnv([make_team] * n_worlds, autoreset_mode=mode)


def assert_same_infos(ours, theirs):
    """Compare our infos of teams with those of gymnasium."""
    assert ours.keys() == theirs.keys()
    for key, values in theirs.items():
        if key == "final_obs":
            for one, other in zip(ours[key], values, strict=True):
                assert (one is None) == (other is None)
                assert_same(one or {}, other or {}, key)
        elif key == "final_info":
            assert_same_infos(ours[key], values)
        else:
            mask = theirs.get(f"_{key}", np.full(len(values), True))
            np.testing.assert_array_equal(ours[key][mask], values[mask], err_msg=key)
            assert ours[key].dtype == values.dtype, key


class SingleTeams:
    """Parallel environments stepped by hand, as rows of robots; resets in the same step."""

    def __init__(self, make, n_worlds):
        self.envs = [make() for _ in range(n_worlds)]

    def reset(self, seeds):
        return self._stack(
            [env.reset(seed=seed) for env, seed in zip(self.envs, seeds, strict=True)]
        )

    def step(self, actions):
        """Observations, rewards, ends, last observations of ended rows, infos by row."""
        by_world = np.split(actions, len(self.envs))
        rewards, ends, last, results = [], [], [], []
        for env, own in zip(self.envs, by_world, strict=True):
            robots = env.possible_agents
            observations, paid, _, truncated, infos = env.step(dict(zip(robots, own, strict=True)))
            rewards += [paid[robot] for robot in robots]
            ends += [truncated[robot] for robot in robots]
            last += [observations[robot] for robot in robots]
            results.append((observations, infos) if env.agents else env.reset())
        observations, infos = self._stack(results)
        return observations, rewards, ends, last, infos

    def close(self):
        for env in self.envs:
            env.close()

    def _stack(self, results):
        rows = [
            o[robot]
            for env, (o, _) in zip(self.envs, results, strict=True)
            for robot in env.possible_agents
        ]
        infos = [
            i[robot]
            for env, (_, i) in zip(self.envs, results, strict=True)
            for robot in env.possible_agents
        ]
        return {key: np.stack([row[key] for row in rows]) for key in rows[0]}, infos
