"""Observations are views of one memory, and how long they last."""

import numpy as np
import pytest
from plain.small_worlds import masked_world, small_world
from plain.toy_team import ConstantReward

from coopmap_env.vector import WorkerVectorEnv


def stepped(env):
    env.action_space.seed(0)
    return env.step(env.action_space.sample())[0]


def test_arrays_are_written_in_place():
    env = WorkerVectorEnv(small_world, 2)
    first, _ = env.reset(seed=0)
    kept = {key: values.copy() for key, values in first.items()}
    second = stepped(env)
    for key, values in second.items():
        assert np.shares_memory(values, first[key])
    assert (first["map"] != kept["map"]).any()


def test_with_two_buffers_the_arrays_of_a_step_last_until_the_one_after_the_next():
    env = WorkerVectorEnv(small_world, 2, double_buffer=True)
    first, _ = env.reset(seed=0)
    kept = {key: values.copy() for key, values in first.items()}
    second = stepped(env)
    for key, values in first.items():
        np.testing.assert_array_equal(values, kept[key])
        assert not np.shares_memory(values, second[key])
    third = stepped(env)
    assert all(np.shares_memory(third[key], first[key]) for key in first)


def test_with_two_buffers_worlds_outside_of_a_mask_keep_what_they_show():
    env = WorkerVectorEnv(
        small_world, 2, rows="teams", autoreset_mode="Disabled", double_buffer=True
    )
    env.reset(seed=0)
    shown = {key: values.copy() for key, values in stepped(env).items()}
    observations, infos = env.reset(seed=5, options={"reset_mask": np.array([False, True])})
    for key, values in observations.items():
        np.testing.assert_array_equal(values[0], shown[key][0])
    assert (observations["map"][1] != shown["map"][1]).any()
    np.testing.assert_array_equal(infos["_n_scans"], [False, True])


@pytest.mark.parametrize("workers", [0, 1])
def test_torch_and_dlpack_share_the_memory(workers):
    torch = pytest.importorskip("torch")
    env = WorkerVectorEnv(masked_world, 2, num_workers=workers)
    observations, _ = env.reset(seed=0)
    tensors = {key: torch.from_numpy(values) for key, values in observations.items()}
    others = {key: torch.from_dlpack(values) for key, values in observations.items()}
    for key, values in stepped(env).items():
        np.testing.assert_array_equal(tensors[key].numpy(), values)
        np.testing.assert_array_equal(others[key].numpy(), values)
    env.close()


def test_the_memory_is_checked_before_it_is_taken(monkeypatch):
    monkeypatch.setenv("COOPMAP_MAX_BYTES", "1000")
    with pytest.raises(ValueError, match=r"the memory of a vector environment .* bytes"):
        WorkerVectorEnv(ConstantReward, 20)
