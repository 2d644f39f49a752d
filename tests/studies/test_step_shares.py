"""How much of a step is compiled code: which calls count, and which of several runs."""

from types import SimpleNamespace

import numpy as np
import pytest
from plain.rollouts import random_actions
from plain.small_worlds import small_world

from coopmap_env.mapping import integration
from coopmap_env.studies.speed import shares
from coopmap_env.studies.speed.shares import Shares, kernel_functions, main, measure_shares


def calls(**seconds):
    """Statistics of calls: own time by the name of the function, in one file."""
    return SimpleNamespace(
        stats={("file.py", 7, name): (1, 1, own, 9.0, {}) for name, own in seconds.items()}
    )


def test_kernels_are_found_by_file_and_name():
    found = kernel_functions()
    assert (integration.__file__, "integrate_scan") in found
    assert (__file__, "calls") not in found


def test_objects_that_warn_when_they_are_looked_at_do_not_matter():
    class Touchy:
        def __getattribute__(self, name):
            raise RuntimeError(name)

    touchy = [Touchy()]
    assert kernel_functions()
    assert len(touchy) == 1


def test_own_times_of_kernels_and_of_libraries_count_each_step_at_its_shortest(monkeypatch):
    kernels = {("file.py", "fuse"), ("file.py", "scan"), ("other.py", "act")}
    monkeypatch.setattr(shares, "kernel_functions", lambda: kernels)
    measured = iter(
        [
            [0.010, 0.030],
            [calls(fuse=0.004, scan=0.001, act=0.5), calls(fuse=0.020, intersect=0.003)],
            [0.012, 0.020],
            [calls(fuse=0.003, scan=0.001), calls(fuse=0.010, intersect=0.002, act=0.1)],
        ]
    )
    monkeypatch.setattr(shares, "_each_step", lambda run, measure: next(measured))
    found = measure_shares(lambda: {}, 2)
    assert found == pytest.approx(Shares(15.0, 7.0, 1.0))
    assert found.python == pytest.approx(7.0)


def test_each_step_of_a_run_is_measured_and_plays_as_before():
    env, shown = small_world(), []

    def run():
        env.reset(seed=0)
        rng = np.random.default_rng(0)
        while env.agents:
            shown.append(env.step(random_actions(env, rng))[1])
        return {}

    run()
    times = shares._each_step(run, shares._timed)
    stats = shares._each_step(run, shares._profiled)
    assert len(times) == len(stats) == env.max_scans
    assert all(seconds >= 0.0 for seconds in times)
    assert all(any(name == "_advance" for _, _, name in one.stats) for one in stats)
    assert shown[: env.max_scans] == shown[env.max_scans : 2 * env.max_scans]
    assert shown[: env.max_scans] == shown[2 * env.max_scans :]


def test_the_command_prints_the_parts_of_a_step(capsys):
    main(["planar_pose", "--runs", "1"])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[-1] for line in lines] == ["step", "kernels", "libraries", "python"]
    assert lines[0].split()[2] == "100.0%"
    with pytest.raises(SystemExit):
        main(["planar_pose", "--runs", "0"])
