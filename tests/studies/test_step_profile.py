"""The sampling profile of a step: which line is counted, and what the table says."""

import signal
from types import SimpleNamespace

import pytest

from coopmap_env import planar_v1
from coopmap_env.envs.planar.worlds import PlanarWorlds
from coopmap_env.studies.speed import profile
from coopmap_env.studies.speed.profile import (
    ROOT,
    Line,
    Samples,
    innermost_line,
    sampled_lines,
    table,
)

pytestmark = pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="needs a timer")
NEVER = 1e6
"""Seconds: the timer does not go off in a test."""


def test_lines_of_a_step_get_the_time_since_the_last_look(monkeypatch):
    env = planar_v1.parallel_env()
    env.reset(seed=0)
    step_worlds, now = PlanarWorlds.step, [0.0]

    def looked_at(self, *arguments):
        now[0] += 3.0
        signal.raise_signal(signal.SIGPROF)  # as the timer does
        return step_worlds(self, *arguments)

    before = signal.getsignal(signal.SIGPROF)
    monkeypatch.setattr(PlanarWorlds, "step", looked_at)
    with sampled_lines(NEVER, lambda: now[0]) as samples:
        now[0] = 40.0
        signal.raise_signal(signal.SIGPROF)  # outside of a step: this time counts for nothing
        assert samples.n_looks == 0
        env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    assert signal.getsignal(signal.SIGPROF) == before
    assert signal.getitimer(signal.ITIMER_PROF) == (0.0, 0.0)
    ((line, seconds),) = samples.seconds.items()
    assert (line.module, seconds, samples.n_looks) == ("envs/planar/env", 3.0, 1)
    assert line.text.startswith("worlds.step(")


def frame(path, name, line, back):
    code = SimpleNamespace(co_filename=str(path), co_name=name)
    return SimpleNamespace(f_code=code, f_lineno=line, f_back=back)


def test_the_line_of_the_project_counts_for_those_of_libraries():
    run = frame(ROOT / "studies/speed/cases.py", "run", 3, None)
    step = frame(ROOT / "envs/mapping_env.py", "step", 7, run)
    inner = frame(ROOT / "mapping/grid.py", "cells", 9, step)
    library = frame("/elsewhere/numpy/core.py", "dot", 1, inner)
    assert innermost_line(library) == Line(str(ROOT / "mapping/grid.py"), 9)
    assert innermost_line(run) is None
    assert innermost_line(frame(ROOT / "mapping/grid.py", "cells", 9, run)) is None
    assert innermost_line(None) is None


def test_the_table_by_hand():
    grid, env = ROOT / "mapping/grid.py", ROOT / "envs/mapping_env.py"
    seconds = {Line(str(grid), 1): 0.6, Line(str(grid), 2): 0.2, Line(str(env), 1): 0.2}
    lines = table(Samples(seconds, 10), step_ms=5.0, n_lines=2).splitlines()
    assert lines[0] == "10 looks; 5.000 ms a step"
    assert lines[3] == "   4.000  80.0%  mapping/grid"
    assert lines[4] == "   1.000  20.0%  envs/mapping_env"
    first = grid.read_text().splitlines()[0]
    assert lines[7] == f"   3.000  60.0%  mapping/grid:1  {first}"
    assert len(lines) == 9


def test_steps_that_were_never_looked_at_give_no_table():
    with pytest.raises(SystemExit, match="more runs"):
        table(Samples(), step_ms=5.0, n_lines=2)


def test_the_command_profiles_a_case(monkeypatch, capsys):
    def run():
        if callable(signal.getsignal(signal.SIGPROF)):  # not in the first run, which compiles
            signal.raise_signal(signal.SIGPROF)
        return {"step": [0.001, 0.003]}

    line = Line(str(ROOT / "mapping/grid.py"), 1)
    monkeypatch.setitem(profile.CASES, "planar_pose", lambda: run)
    monkeypatch.setattr(profile, "innermost_line", lambda _: line)
    profile.main(["planar_pose", "--runs", "3"])
    printed = capsys.readouterr().out
    assert "3 looks; 2.000 ms a step" in printed
    assert "mapping/grid:1" in printed
    with pytest.raises(SystemExit):
        profile.main(["planar_pose", "--runs", "0"])
    assert "--runs must be at least 1, got 0" in capsys.readouterr().err
