import numpy as np
import pytest
import torch
from gymnasium import spaces
from plain.small_worlds import masked_world, small_world

from coopmap_agents.networks import ObservationFeatures


def batch(space, n=2, seed=0):
    space.seed(seed)
    samples = [space.sample() for _ in range(n)]
    return {
        key: torch.as_tensor(np.stack([sample[key] for sample in samples])).float()
        for key in space.spaces
    }


def test_features_are_the_map_the_vectors_and_the_teammates():
    space = small_world(n_robots=3).observation_space("robot_0")
    features = ObservationFeatures(space, 10, 5)
    assert features.features_dim == features.actor_dim == 10 + 4 + 2 + 2 * 5
    assert features(batch(space)).shape == (2, features.features_dim)


@pytest.mark.parametrize("side", [4, 5, 13, 36, 64])
def test_the_map_may_have_any_side(side):
    space = spaces.Dict({"map": spaces.Box(0, 255, (4, side, side), np.uint8)})
    assert ObservationFeatures(space, 7)(batch(space)).shape == (2, 7)


def test_observations_need_no_map():
    space = spaces.Dict({"pose": spaces.Box(-1, 1, (4,)), "team": spaces.Box(-1, 1, (2, 4))})
    values = batch(space)
    expected = torch.cat([values["pose"], values["team"].reshape(2, 8)], dim=1)
    torch.testing.assert_close(ObservationFeatures(space, 7)(values), expected)


def test_the_order_of_the_entries_does_not_matter():
    # environments give theirs in another order than the roll-out buffer, which sorts them
    space = small_world(n_robots=3).observation_space("robot_0")
    features, values = ObservationFeatures(space, 10), batch(space)
    backwards = dict(reversed(values.items()))
    torch.testing.assert_close(features(values), features(backwards), rtol=0, atol=0)


def test_features_do_not_depend_on_candidates():
    space = masked_world().observation_space("robot_0")
    features, values = ObservationFeatures(space, 10, 5), batch(space)
    assert features.features_dim == 10 + 4 + 2 + 2 * 5
    result = features(values)
    assert result.shape == (2, features.features_dim)
    for key in ("candidates", "action_mask"):
        values[key] = 1 - values[key]
    torch.testing.assert_close(features(values), result, rtol=0, atol=0)


def test_duplicated_teammates_count_once():
    # mean and maximum over teammates: two alike say what one says
    space = small_world(n_robots=2).observation_space("robot_0")
    features, values = ObservationFeatures(space, 10, 5), batch(space)
    twice = values | {"teammates": values["teammates"].repeat(1, 2, 1)}
    torch.testing.assert_close(features(twice), features(values))


def test_features_of_a_single_robot_are_its_map_its_pose_and_what_is_left():
    space = small_world(n_robots=1).observation_space("robot_0")
    assert ObservationFeatures(space, 10, 5).features_dim == 10 + 4 + 2


def test_features_of_missing_teammates_are_zero():
    space = small_world(n_robots=3).observation_space("robot_0")
    features, values = ObservationFeatures(space, 10, 5), batch(space)
    with_teammates = features(values)
    del values["teammates"]
    alone = features(values)
    torch.testing.assert_close(alone[:, :-10], with_teammates[:, :-10], rtol=0, atol=0)
    assert (alone[:, -10:] == 0).all()
    assert (with_teammates[:, -10:] > 0).any()


def test_the_state_comes_last_and_acting_does_not_need_it():
    parts = small_world(n_robots=2).observation_space("robot_0").spaces
    space = spaces.Dict({**parts, "state": spaces.Box(-1.0, 1.0, (30,))})
    features, values = ObservationFeatures(space, 10, 5), batch(space)
    assert (features.actor_dim, features.state_dim) == (10 + 4 + 2 + 2 * 5, 10)
    whole = features(values)
    del values["state"]
    without = features(values)
    torch.testing.assert_close(without[:, :-10], whole[:, :-10], rtol=0, atol=0)
    assert not torch.equal(without, whole)
