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


def assert_same_infos(ours, theirs, robots):
    """Compare our infos of teams with those of gymnasium, which are nested by robot."""
    assert ("final_obs" in ours) == ("final_obs" in theirs)
    if "final_obs" in theirs:
        for one, other in zip(ours["final_obs"], theirs["final_obs"], strict=True):
            if other is None:
                assert one is None
            else:
                assert_same(one, other, "final_obs")
        np.testing.assert_array_equal(ours["_final_obs"], theirs["_final_obs"])
        np.testing.assert_array_equal(ours["_final_info"], theirs["_final_info"])
        assert_same_infos(ours["final_info"], theirs["final_info"], robots)
    names = {key for key in ours if not key.startswith("_") and not key.startswith("final_")}
    for index, robot in enumerate(robots):
        assert_same_entries({key: ours[key] for key in names}, ours, theirs["robots"][robot], index)


def assert_same_entries(entries, masks, theirs, index):
    """Entries of one robot, where gymnasium's mask says that there are any."""
    assert set(entries) == {key for key in theirs if not key.startswith("_")}
    for key, values in entries.items():
        mask = theirs[f"_{key}"]
        np.testing.assert_array_equal(masks[f"_{key}"], mask, err_msg=key)
        if isinstance(values, dict):
            own = {name: one for name, one in values.items() if not name.startswith("_")}
            assert_same_entries(own, values, theirs[key], index)
        else:
            found, expected = values[:, index][mask], theirs[key][mask]
            if expected.dtype == object:  # text, and None where a number is not known
                expected = np.array([np.nan if one is None else one for one in expected])
            np.testing.assert_array_equal(found, expected, err_msg=key)


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
