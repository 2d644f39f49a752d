from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import pytest

from coopmap_env.cli.results import command_line, duration, new_results_path

NOW = datetime(2026, 11, 30, 18, 45, 1)


def test_a_default_path_has_the_command_and_the_time_and_never_exists(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first = new_results_path("evaluate", now=NOW)
    assert first == Path("results/evaluate-20261130-184501")
    first.mkdir(parents=True)
    second = new_results_path("evaluate", now=NOW)
    assert second == Path("results/evaluate-20261130-184501-2")
    second.mkdir()
    assert new_results_path("evaluate", now=NOW).name == "evaluate-20261130-184501-3"
    assert new_results_path("replay", ".html", NOW).name == "replay-20261130-184501.html"
    assert new_results_path("replay").name.startswith("replay-2")


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.04, "0.0 s"),
        (9.94, "9.9 s"),
        (9.96, "10 s"),
        (59.4, "59 s"),
        (59.6, "1 min 0 s"),
        (200, "3 min 20 s"),
        (3660, "1 h 1 min"),
    ],
)
def test_durations_are_short(seconds, text):
    assert duration(seconds) == text


@dataclass
class Options:
    out: Path = Path("results")
    n_robots: int | None = None
    joints: tuple[str, ...] = ()
    fast: bool = False
    shown: bool = True


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (Options(), "coopmap play"),
        (Options(Path("of one")), "coopmap play --out 'of one'"),
        (
            Options(n_robots=3, joints=("pan", "tilt")),
            "coopmap play --n-robots 3 --joints pan tilt",
        ),
        (Options(fast=True, shown=False), "coopmap play --fast --no-shown"),
    ],
)
def test_a_command_line_has_the_options_that_differ_from_the_defaults(options, line):
    assert command_line("play", options) == line
