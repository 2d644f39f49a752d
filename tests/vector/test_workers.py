"""Worker processes: what they are asked, and how they end."""

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
from plain.small_worlds import masked_world
from plain.toy_team import FailingFactory, HookedEnv

from coopmap_baselines import make
from coopmap_env.core.processes import WorkerError
from coopmap_env.vector import WorkerVectorEnv, workers
from coopmap_env.vector.workers import Worker


def with_workers(env_factory, n_envs=2, num_workers=2):
    return contextlib.closing(WorkerVectorEnv(env_factory, n_envs, num_workers=num_workers))


@pytest.fixture(autouse=True)
def no_process_is_left_behind(toys):
    before = set(multiprocessing.active_children())
    yield
    assert set(multiprocessing.active_children()) == before


class Longer(HookedEnv):
    def length(self, factor):
        return factor(self.n_steps)


@pytest.fixture(scope="module")
def toys():
    """Three worlds in two workers, for tests that end none of them; torch is loaded here."""
    pytest.importorskip("torch")

    class Local(Longer):  # defined in a function: cloudpickle takes it, pickle would not
        pass

    with with_workers(lambda: Local(render_mode="rgb_array"), 3) as env:
        yield env


def test_worlds_are_spread_evenly_over_spawned_workers_with_one_thread_and_no_torch(toys):
    processes = toys.get_attr("process_id")
    assert sorted(Counter(processes).values()) == [1, 2]
    assert os.getpid() not in processes
    assert "torch" in sys.modules  # a forked worker would have it
    assert not any(toys.apply(lambda _: "torch" in sys.modules))
    assert set(toys.apply(lambda _: os.environ["OPENBLAS_NUM_THREADS"])) == {"1"}


def test_attributes_methods_options_and_pictures_are_reached_by_world(toys):
    toys.set_attr("n_steps", [5, 9, 7])
    assert toys.get_attr("n_steps") == (5, 9, 7)
    assert toys.apply(getattr, "n_steps", worlds=[2, 0]) == [7, 5]
    toys.set_attr("n_steps", 4)
    assert toys.call("length", lambda n: 2 * n) == (8, 8, 8)
    with pytest.raises(ValueError, match="3 worlds need as many values, got 2"):
        toys.set_attr("n_steps", [1, 2])
    assert [frame.shape for frame in toys.render()] == [(4, 6, 3)] * 3
    toys.set_attr("options", [[], [], []])
    toys.reset(options={"k": 1})
    toys.reset()
    assert toys.get_attr("options") == ([{"k": 1}, None],) * 3
    with pytest.raises(IndexError, match="worlds are 0 to 2, got 3"):
        toys.apply(len, worlds=[3])
    with pytest.raises(RuntimeError, match=r"use apply\(function, worlds=\[0\]\)"):
        toys.world(0)


def test_an_error_that_does_not_unpickle_is_a_runtime_error_of_its_name_and_message(toys):
    class TwoPartError(Exception):
        def __init__(self, what, where):
            super().__init__(f"{what} in {where}")

    def fail():
        raise TwoPartError("leak", "hose 3")

    toys.reset()
    toys.apply(setattr, "on_step", fail, worlds=[2])
    with pytest.raises(RuntimeError, match="TwoPartError: leak in hose 3") as raised:
        toys.step(np.zeros((6, 1)))
    (note,) = raised.value.__notes__
    assert note.startswith("in worker 1:\nTraceback")
    assert "in world 2" in note
    toys.apply(setattr, "on_step", int)


def test_an_unpicklable_value_is_an_error_and_the_worker_continues(toys):
    toys.apply(lambda env: setattr(env, "lock", threading.Lock()))
    with pytest.raises(TypeError, match="lock"):
        toys.get_attr("lock")
    with pytest.raises(TypeError, match="lock"):
        toys.set_attr("lock", threading.Lock())
    assert len(toys.get_attr("n_steps")) == 3


def test_workers_ignore_ctrl_c(toys):
    toys.reset()
    for process in toys.get_attr("process_id"):
        os.kill(process, signal.SIGINT)
    assert (toys.step(np.zeros((6, 1)))[1] == 1).all()


def test_a_world_is_the_environment_itself_where_there_are_no_workers():
    with with_workers(masked_world, 2, 0) as env:
        env.reset(seed=3)
        other = masked_world()
        other.reset(seed=4)
        np.testing.assert_array_equal(
            env.world(1).belief().map.probability, other.belief().map.probability
        )


def teach(env, policy, seed):
    env.teacher = policy
    policy.reset(np.random.default_rng(seed))


def ask(env):
    actions = env.teacher.act(env.belief(), {})
    return [int(actions[robot]) for robot in env.possible_agents]


def test_planners_decide_in_the_workers():
    labels = []
    for num_workers in (0, 2):
        with with_workers(masked_world, 2, num_workers) as env:
            env.reset(seed=0)
            for world in range(2):
                env.apply(teach, make("random"), world, worlds=[world])
            own = []
            for _ in range(3):
                actions = np.array(env.apply(ask)).ravel()
                own.append(actions)
                env.step(actions)
            labels.append(np.array(own))
    np.testing.assert_array_equal(*labels)


@pytest.mark.parametrize("when", ["idle", "in a step"])
def test_a_killed_worker_is_an_error_with_its_exit_code_and_worlds(when):
    with with_workers(HookedEnv) as env:
        env.reset()
        if when == "idle":
            os.kill(env.get_attr("process_id")[1], signal.SIGKILL)
        else:
            kills = partial(os.kill, env.get_attr("process_id")[1], signal.SIGKILL)
            env.apply(setattr, "on_step", kills, worlds=[1])
        message = "worker 1, of worlds 1 to 1, has ended, with exit code -9"
        with pytest.raises(WorkerError, match=message):
            env.step(np.zeros((4, 1)))
        assert env.apply(getattr, "n_steps", worlds=[0]) == [5]
        with pytest.raises(WorkerError, match="worker 1"):
            env.reset()


def test_close_closes_every_environment_and_ends_the_workers_once(tmp_path):
    def leave_a_dot():
        with (tmp_path / f"{os.getpid()}.txt").open("a") as file:
            file.write(".")

    def leaves_a_file():
        return HookedEnv(on_close=leave_a_dot)

    env = WorkerVectorEnv(leaves_a_file, 3, num_workers=2)
    env.close()
    env.close()
    (tmp_path / f"{os.getpid()}.txt").unlink()  # of the environment that was asked for its spaces
    assert sorted(path.read_text() for path in tmp_path.iterdir()) == [".", ".."]


def test_a_worker_that_does_not_end_is_killed(monkeypatch):
    monkeypatch.setattr(workers, "SHUTDOWN_TIMEOUT", 0.2)
    main_process = os.getpid()

    def waits():
        if os.getpid() != main_process:
            threading.Event().wait()

    env = WorkerVectorEnv(lambda: HookedEnv(on_close=waits), 1, num_workers=1)
    env.close()


@pytest.mark.parametrize(("num_workers", "n_envs"), [(0, 2), (1, 2)])
def test_a_factory_that_raises_leaves_neither_processes_nor_open_environments(
    num_workers, n_envs, tmp_path
):
    with pytest.raises(OSError, match="no second environment"):
        WorkerVectorEnv(FailingFactory(tmp_path), n_envs, num_workers=num_workers)
    assert len(list(tmp_path.iterdir())) == 1


def test_ctrl_c_in_the_main_process_ends_the_workers_whatever_they_do(monkeypatch):
    def interrupted(worker):
        signal.raise_signal(signal.SIGINT)  # as Ctrl-C does while the main process waits

    main_process = os.getpid()

    def waits():
        if os.getpid() != main_process:
            threading.Event().wait()

    monkeypatch.setattr(workers, "SHUTDOWN_TIMEOUT", None)  # for ever
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with with_workers(lambda: HookedEnv(on_close=waits), 1, 1) as env:
            env.reset()
            monkeypatch.setattr(Worker, "reply", interrupted)
            with pytest.raises(KeyboardInterrupt):
                env.step(np.zeros((2, 1)))
            with pytest.raises(RuntimeError, match="closed"):
                env.reset()
    finally:
        signal.signal(signal.SIGINT, before)
