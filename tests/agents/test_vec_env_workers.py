import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from collections import Counter
from functools import partial

import numpy as np
import pytest
from small_worlds import masked_world, small_world
from toy_team import ConstantReward, FailingFactory, HookedEnv

from coopmap_agents.rollouts import workers
from coopmap_agents.rollouts.workers import Worker
from coopmap_agents.sb3 import SharedPolicyVecEnv
from coopmap_env.envs import InvalidActionError


def with_workers(env_factory, n_envs=2, n_workers=2):
    return contextlib.closing(SharedPolicyVecEnv(env_factory, n_envs, n_workers))


@pytest.fixture(autouse=True)
def no_process_is_left_behind():
    yield
    assert multiprocessing.active_children() == []


def played(env, n_steps=9):
    """Everything that an environment returns in some steps of random (even masked) actions."""
    env.action_space.seed(0)
    env.seed(3)
    recorded = {"observations": [env.reset()], "reset_infos": [list(env.reset_infos)]}
    for _ in range(n_steps):
        actions = np.stack([env.action_space.sample() for _ in range(env.num_envs)])
        observations, rewards, dones, infos = env.step(actions)
        recorded["observations"].append(observations)
        recorded["reset_infos"].append(list(env.reset_infos))
        for name, values in (("rewards", rewards), ("dones", dones), ("infos", infos)):
            recorded.setdefault(name, []).append(values)
        if env.has_attr("action_masks"):
            recorded.setdefault("masks", []).append(env.action_masks())
    recorded["observations"].append(env.reset())  # unseeded: the environments' own random numbers
    recorded["types"] = {
        key: values.dtype.str for key, values in recorded["observations"][0].items()
    }
    return recorded


@pytest.mark.parametrize(
    "env_factory", [partial(small_world, n_robots=3), masked_world], ids=["pose", "candidates"]
)
def test_rows_rewards_dones_and_infos_are_the_same_for_any_number_of_workers(env_factory):
    alone = SharedPolicyVecEnv(env_factory, 3)
    expected = played(alone)
    assert [dones.all() for dones in expected["dones"]] == [False, False, False, True] * 2 + [False]
    for n_workers in (1, 2):
        with with_workers(env_factory, 3, n_workers) as env:
            assert env.observation_space == alone.observation_space
            assert env.action_space == alone.action_space
            assert env.robots == alone.robots
            np.testing.assert_equal(played(env), expected)


def test_environments_are_spread_evenly_over_spawned_workers_that_load_no_torch():
    assert "torch" in sys.modules  # a forked worker would have it
    with with_workers(lambda: ConstantReward(n_steps="torch" in sys.modules), 5) as env:
        processes = env.get_attr("process_id")
        assert processes[::2] == processes[1::2]
        assert sorted(Counter(processes[::2]).values()) == [2, 3]
        assert os.getpid() not in processes
        assert env.get_attr("n_steps") == [False] * 10


def test_attributes_methods_options_and_images_are_accessed_by_row_in_workers():
    with with_workers(lambda: ConstantReward(render_mode="rgb_array"), 3) as env:
        env.set_attr("n_steps", 9, indices=[2, 5])
        assert env.get_attr("n_steps") == [5, 5, 9, 9, 9, 9]
        assert env.get_attr("n_steps", indices=[-1, 0]) == [9, 5]
        assert env.has_attr("n_steps")
        assert not env.has_attr("no_such_thing")
        images = env.env_method("render", indices=[5, 0, 4])
        assert images[0] is images[2]
        assert env.get_attr("calls", indices=[0, 2, 4]) == [["render"], [], ["render"]]
        assert env.render().shape == (2 * 4, 2 * 6, 3)
        env.set_options([{"k": row} for row in range(6)])
        env.reset()
        env.reset()
        assert env.get_attr("options", indices=[0, 2, 4]) == [[{"k": k}, None] for k in (0, 2, 4)]
        with pytest.raises(IndexError):
            env.get_attr("n_steps", indices=[6])


def test_classes_defined_in_a_function_reach_workers():
    class Longer(ConstantReward):
        def length(self, factor):
            return factor(self.n_steps)

    with with_workers(lambda: Longer(n_steps=7), 1, 1) as env:
        assert env.env_method("length", lambda n: 2 * n) == [14, 14]


def test_an_invalid_action_is_the_same_error_with_the_worker_s_traceback():
    with with_workers(masked_world) as env:
        env.seed(0)
        first = env.reset()
        with pytest.raises(InvalidActionError, match="robot_1") as caught:
            env.step(np.array([0, 0, 0, 300]))
        (note,) = caught.value.__notes__
        assert note.startswith("in worker 1:\nTraceback")
        assert "team_block.py" in note
        env.seed(0)
        np.testing.assert_equal(env.reset(), first)  # no reply of before is left in a pipe


def test_an_error_that_does_not_unpickle_is_a_runtime_error_of_its_name_and_message():
    class TwoPartError(Exception):
        def __init__(self, what, where):
            super().__init__(f"{what} in {where}")

    def fail():
        raise TwoPartError("leak", "hose 3")

    with with_workers(lambda: HookedEnv(on_step=fail), 1, 1) as env:
        env.reset()
        with pytest.raises(RuntimeError, match="TwoPartError: leak in hose 3"):
            env.step(np.zeros((2, 1)))


def test_an_unpicklable_value_is_an_error_and_the_worker_continues():
    def lock():
        return ConstantReward(truncates=threading.Lock())

    with with_workers(lock, 1, 1) as env:
        assert env.has_attr("truncates")
        with pytest.raises(TypeError, match="lock"):
            env.get_attr("truncates")
        with pytest.raises(TypeError, match="lock"):
            env.set_attr("truncates", threading.Lock())
        assert env.get_attr("n_steps") == [5, 5]


@pytest.mark.parametrize("when", ["idle", "in a step"])
def test_a_killed_worker_is_an_error_with_its_exit_code(when):
    with with_workers(HookedEnv) as env:
        env.reset()
        if when == "idle":
            os.kill(env.get_attr("process_id", indices=2)[0], signal.SIGKILL)
        else:
            env.set_attr("on_step", lambda: os.kill(os.getpid(), signal.SIGKILL), indices=2)
        with pytest.raises(RuntimeError, match="worker 1 has ended, with exit code -9"):
            env.step(np.zeros((4, 1)))
        assert env.get_attr("n_steps", indices=0) == [5]
        with pytest.raises(RuntimeError, match="worker 1 has ended"):
            env.reset()


def test_close_closes_every_environment_and_ends_the_workers_once(tmp_path):
    def leaves_a_file():
        return HookedEnv(on_close=lambda: (tmp_path / f"{os.getpid()}.txt").open("a").write("."))

    env = SharedPolicyVecEnv(leaves_a_file, 3, workers=2)
    env.close()
    env.close()
    assert sorted(path.read_text() for path in tmp_path.iterdir()) == [".", ".."]
    assert multiprocessing.active_children() == []
    with pytest.raises(RuntimeError, match="closed"):
        env.step(np.zeros((6, 1)))


def test_a_worker_that_does_not_end_is_killed(monkeypatch):
    monkeypatch.setattr(workers, "SHUTDOWN_TIMEOUT", 0.2)
    env = SharedPolicyVecEnv(lambda: HookedEnv(on_close=lambda: threading.Event().wait()), 1, 1)
    env.close()
    assert multiprocessing.active_children() == []


@pytest.mark.parametrize(("n_workers", "n_envs"), [(0, 2), (1, 2), (2, 3)])
def test_a_factory_that_raises_leaves_neither_processes_nor_open_environments(
    n_workers, n_envs, tmp_path
):
    with pytest.raises(OSError, match="no second environment"):
        SharedPolicyVecEnv(FailingFactory(tmp_path), n_envs, n_workers)
    assert multiprocessing.active_children() == []
    assert len(list(tmp_path.iterdir())) == max(n_workers, 1)


def test_workers_ignore_ctrl_c():
    with with_workers(ConstantReward) as env:
        env.reset()
        for process in env.get_attr("process_id")[::2]:
            os.kill(process, signal.SIGINT)
        _, rewards, _, _ = env.step(np.zeros((4, 1)))
        assert (rewards == 1).all()


@pytest.mark.parametrize("close", [lambda: None, lambda: threading.Event().wait()])
def test_ctrl_c_in_the_main_process_ends_the_workers_whatever_they_do(close, monkeypatch):
    def interrupted(worker):
        signal.raise_signal(signal.SIGINT)  # as Ctrl-C does while the main process waits

    monkeypatch.setattr(workers, "SHUTDOWN_TIMEOUT", None)  # for ever
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with with_workers(partial(HookedEnv, on_close=close)) as env:
            env.reset()
            monkeypatch.setattr(Worker, "reply", interrupted)
            with pytest.raises(KeyboardInterrupt):
                env.step(np.zeros((4, 1)))
            assert multiprocessing.active_children() == []
            with pytest.raises(RuntimeError, match="closed"):
                env.reset()
    finally:
        signal.signal(signal.SIGINT, before)


def test_an_unread_reply_is_discarded_and_none_is_read_twice():
    with with_workers(ConstantReward) as env:
        with pytest.raises(RuntimeError, match=r"call step_async\(\)"):
            env.step_wait()
        env.seed(0)
        first = env.reset()
        env.step_async(np.zeros((4, 1)))
        env.seed(0)
        np.testing.assert_equal(env.reset(), first)


@pytest.mark.parametrize("number", [-1, 3])
def test_workers_are_none_or_at_most_one_for_each_environment(number):
    with pytest.raises(ValueError, match=rf"workers must be 0 to n_envs \(2\), got {number}"):
        SharedPolicyVecEnv(ConstantReward, 2, number)
