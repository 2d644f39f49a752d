"""Speed benchmarks: what is counted as a time, and the comparison with an earlier commit."""

import json
import subprocess
import sys

import numpy as np
import pytest

import coopmap_env
from coopmap_env.cli import main
from coopmap_env.studies.speed import cases, planar, regression
from coopmap_env.studies.speed.cases import CASES, random_episodes
from coopmap_env.studies.speed.measure import Case, Measured, measure, ratio
from coopmap_env.studies.speed.regression import CaseError, NoBaseError, Program, find_base


def recorded(name, runs, log):
    """A case that returns prepared times, and writes its turns into a list."""
    times = iter(runs)

    def run():
        log.append(name)
        return {"step": next(times)}

    return run


def test_an_operation_counts_at_its_shortest_in_a_round_and_over_the_rounds():
    runs = [[5.0, 2.0], [3.0, 9.0], [4.0, 4.0], [4.0, 1.0]]
    found = measure({"a": Case(recorded("a", runs, []), repeats=2)}, rounds=2)["a"]
    np.testing.assert_array_equal(found.minima["step"], [[3.0, 2.0], [4.0, 1.0]])
    np.testing.assert_array_equal(found.shortest("step"), [3.0, 1.0])
    total = found.total("step")
    assert total.seconds == 4.0
    np.testing.assert_array_equal(total.of_rounds, [5.0, 5.0])


def test_cases_take_turns_and_every_second_turn_goes_backwards():
    turns, one = [], [[1.0]] * 9
    measure(
        {
            "a": Case(recorded("a", one, turns), repeats=3),
            "b": Case(recorded("b", one, turns), repeats=1),
            "c": Case(recorded("c", one, turns), repeats=2),
        },
        rounds=1,
    )
    assert turns == ["a", "b", "c", "c", "a", "a"]


def test_a_case_that_does_something_else_each_time_is_refused():
    case = Case(recorded("a", [[1.0], [1.0, 2.0]], []), repeats=2)
    with pytest.raises(
        ValueError, match=r"a must do the same operations in each run, got \{1, 2\}"
    ):
        measure({"a": case}, rounds=1)


def test_a_ratio_has_the_quartiles_of_the_rounds():
    slow = Measured({"step": np.array([[4.0], [6.0], [8.0]]), "reset": np.ones((3, 2))})
    fast = Measured({"step": np.array([[2.0], [2.0], [2.0]]), "reset": np.zeros((3, 2))})
    found = ratio(slow.total("step"), fast.total("step"))
    assert found.estimate == 2.0
    assert found.quartiles == (2.5, 3.5)  # of 2, 3, 4
    assert str(found) == "2.000 (quartiles of the rounds 2.500, 3.500)"
    with_resets = ratio(slow.total("step", "reset"), fast.total("step", "reset"), scale=0.5)
    assert with_resets.estimate == 0.5 * 6.0 / 2.0


class Counting:
    """An environment of three steps that writes down what happens to it."""

    possible_agents = ("a",)

    def __init__(self):
        self.log = []

    def reset(self, seed):
        self.log.append(seed)
        self.agents = ["a"] * 3

    def step(self, actions):
        self.log.append(actions)
        self.agents = self.agents[:-1]


def test_random_episodes_are_the_same_in_each_run():
    env = Counting()
    env.action_space = lambda agent: type("Space", (), {"seed": lambda self, seed: None})()
    run = random_episodes(env, 2, lambda env, rng: {"a": int(rng.integers(1000))})
    first, log = run(), env.log
    assert {kind: len(times) for kind, times in first.items()} == {
        "sampling": 6, "step": 6, "reset": 2,
    }  # fmt: skip
    assert all(time >= 0 for times in first.values() for time in times)
    env.log = []
    run()
    assert env.log == log
    assert len(set(map(str, log))) == 8  # two seeds, six actions


def test_the_cases_of_the_comparison_exist():
    assert set(regression.COMPARED) <= set(CASES)


def git(folder, *arguments):
    author = ["-c", "user.name=a", "-c", "user.email=a@example.org", "-c", "commit.gpgsign=false"]
    command = ["git", *author, *arguments]
    return subprocess.run(
        command, cwd=folder, check=True, capture_output=True, text=True
    ).stdout.strip()


@pytest.fixture
def repository(tmp_path):
    """A history of two commits on main, and one on a branch."""
    folder = tmp_path / "repository"
    folder.mkdir()
    git(folder, "init", "--initial-branch", "main")
    for package in ("coopmap_env", "baselines"):
        (folder / package).mkdir()
        (folder / package / "__init__.py").write_text("VERSION = 'earlier'\n")
    for message in ("one", "two"):
        git(folder, "add", "."), git(folder, "commit", "--allow-empty", "--message", message)
    git(folder, "switch", "--create", "branch")
    git(folder, "commit", "--allow-empty", "--message", "three")
    return folder


def test_the_base_is_the_last_commit_shared_with_main(repository):
    assert find_base(repository) == git(repository, "rev-parse", "main")


def test_the_base_of_main_itself_is_the_commit_before(repository):
    git(repository, "switch", "main")
    assert find_base(repository) == git(repository, "rev-parse", "main^")


def test_the_base_can_be_given(repository):
    assert find_base(repository, "main^") == git(repository, "rev-parse", "main^")
    with pytest.raises(NoBaseError, match="single revision"):
        find_base(repository, "nowhere")


def test_without_a_shared_commit_a_line_says_so_and_nothing_fails(
    repository, tmp_path, monkeypatch, capsys
):
    shallow = tmp_path / "shallow"
    git(tmp_path, "clone", "--depth", "1", "--branch", "main", f"file://{repository}", "shallow")
    empty = tmp_path / "empty"
    empty.mkdir()
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["regression"])
    for folder in (shallow, empty):
        monkeypatch.chdir(folder)
        regression.main()
        assert capsys.readouterr().out.startswith("speed is not compared: ")
    monkeypatch.setenv("PATH", "")
    with pytest.raises(NoBaseError, match="git is not installed"):
        find_base(repository)


def test_the_packages_of_a_commit_are_importable_with_the_compiled_kernels_of_this_version(
    repository, tmp_path, monkeypatch
):
    (repository / "coopmap_env" / "__init__.py").write_text("VERSION = 'present'\n")
    cache = repository / "coopmap_env" / "__pycache__"
    cache.mkdir()
    (cache / "a.nbc").write_text("compiled")
    ours = repository / "coopmap_env" / "__init__.py"
    monkeypatch.setattr(coopmap_env, "__file__", str(ours))
    folder = tmp_path / "extracted"
    folder.mkdir()
    regression.extract(repository, "main", folder)
    assert (folder / "coopmap_env" / "__init__.py").read_text() == "VERSION = 'earlier'\n"
    assert (folder / "coopmap_env" / "__pycache__" / "a.nbc").read_text() == "compiled"
    assert (folder / "coopmap_baselines" / "__init__.py").exists()


PROGRAM = """
import os, sys
for line in sys.stdin:
    name = line.strip()
    if name == "ends":
        sys.exit()
    if name == "fails":
        print('{"error": "AttributeError: vector"}', flush=True)
    else:
        from coopmap_env import SECONDS
        print('{"timings": {"step": [%s, %s]}}' % (SECONDS, SECONDS), flush=True)
"""


@pytest.fixture
def versions(tmp_path, monkeypatch):
    """Two versions of a package in which a step takes two seconds, and half a second before."""
    for version, seconds in (("present", 2.0), ("earlier", 0.5)):
        package = tmp_path / version / "coopmap_env"
        package.mkdir(parents=True)
        (package / "__init__.py").write_text(f"SECONDS = {seconds}\n")
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    monkeypatch.setattr(cases, "__file__", str(program))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "present"))
    return tmp_path


def test_the_comparison_prints_the_ratio_of_this_version_to_the_earlier_one(versions):
    lines = regression.compare(versions / "earlier", ("steps", "fails"), rounds=2)
    assert sorted(lines) == [
        "fails: not compared, AttributeError: vector",
        "steps: 4.000 (quartiles of the rounds 4.000, 4.000)",
    ]


def test_a_version_that_ends_is_reported(versions):
    assert regression.compare(versions / "earlier", ("ends",), rounds=1) == [
        f"ends: not compared, a process has ended, or needed more than {regression.LONGEST_RUN_S} s"
    ]


def test_the_served_cases_answer_by_lines_with_an_error_where_one_is_missing():
    with Program(None) as program:
        with pytest.raises(CaseError, match="KeyError: 'nobody'"):
            program.run("nobody")
        timings = program.run("planar_pose")
    assert {kind: len(times) for kind, times in timings.items()} == {
        "sampling": 8 * 16, "step": 8 * 16, "reset": 8,
    }  # fmt: skip


@pytest.mark.slow
def test_bench_writes_ratios_and_times(tmp_path, monkeypatch):
    for needed in ("mpe2", "psutil"):
        pytest.importorskip(needed)
    monkeypatch.setattr(planar, "SEEDS", (0,))
    monkeypatch.setattr(planar, "THREAD_WORLDS", (4,))
    main(["bench", "--env", "planar", "--out", str(tmp_path / "bench.json"), "--rounds", "2"])
    figures = json.loads((tmp_path / "bench.json").read_text())
    low, high = figures["quartiles_over_rounds"]["ratio_to_simple_spread"]
    assert 0 < low <= high
    assert figures["ratio_to_simple_spread"] == pytest.approx(
        figures["agent_steps_per_s"] / figures["simple_spread_agent_steps_per_s"], rel=1e-3
    )
    for case in ("candidates", "vector", "vector_candidates"):
        assert (
            figures[f"{case}_agent_steps_per_s"] > figures[f"{case}_agent_steps_per_s_with_resets"]
        )
    assert figures["vector_wall_time_of_1_thread_over_2_4_worlds"] > 0
    assert figures["resident_memory_mb"] > 0
    assert {*figures} > {"decision_ms_brute_force", "decision_ms_exhaustive"}


@pytest.mark.slow
def test_the_field_is_measured_too(monkeypatch):
    for needed in ("pybullet", "small_gicp", "pyoctomap", "psutil"):
        pytest.importorskip(needed)
    from coopmap_env.studies.speed import field

    monkeypatch.setattr(field, "SEARCH_SCANS", 4)
    monkeypatch.setattr(field, "WORKER_WORLDS", 2)
    monkeypatch.setattr(field, "N_SCAN_POSES", 3)
    monkeypatch.setattr(field, "N_CANDIDATES", 60)
    figures = field.measure_field(1, print)
    assert figures["quartiles_over_rounds"].keys() == {
        "scan_speedup",
        "vector_wall_time_of_1_worker_over_2",
    }
    for name in (
        "agent_steps_per_s_kinematic",
        "agent_steps_per_s_stepped",
        "rating_300_ms",
        "correction_ms",
        "registration_ms",
    ):
        assert figures[name] > 0, name
