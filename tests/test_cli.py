import csv
import errno
import inspect
import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import fields
from types import UnionType
from typing import Union, get_args, get_origin, get_type_hints

import pytest

from coopmap_env import cli
from coopmap_env.cli import environment, main
from coopmap_env.cli.environment import EnvironmentOptions
from coopmap_env.core.files import FileError
from coopmap_env.core.locks import folder_lock
from coopmap_env.core.processes import Interruption, WorkerError
from coopmap_env.envs.arguments import TaskArguments
from coopmap_env.envs.field import FieldArguments
from coopmap_env.envs.planar import PlanarArguments
from coopmap_env.evaluation.saved_run import load_run
from coopmap_env.robots import mount_library
from coopmap_env.simulation import Physics
from coopmap_env.simulation.scenes.field import FIELD_SCENES
from coopmap_env.simulation.scenes.planar import PLANAR_SCENES


def run(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "coopmap_env.cli", *map(str, arguments)],
        capture_output=True,
        text=True,
    )


def test_evaluate_writes_a_row_for_each_policy_and_world_and_a_summary(tmp_path, capsys):
    main([
        "evaluate", "--policies", "rating_function:search=10,raster", "--episodes", "2",
        "--split", "validation", "--seed", "5", "--max-scans", "2", "--out", str(tmp_path),
    ])  # fmt: skip
    rows = list(csv.DictReader((tmp_path / "episodes.csv").read_text().splitlines()))
    assert [(row["policy"], row["seed"]) for row in rows] == [
        ("rating_function:search=10", "5"),
        ("rating_function:search=10", "6"),
        ("raster", "5"),
        ("raster", "6"),
    ]
    wanted = "coverage coverage_auc reward entropy log_loss motion_distance planning_time_ms"
    assert set(wanted.split()) < set(rows[0])
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["env"]["split"] == "validation"
    assert "probability_of_improvement" in summary["policies"]["raster"]["comparison"]
    printed = capsys.readouterr()
    assert "raster" in printed.out
    assert "| rating_function:search=10 | 2 " in (tmp_path / "report.md").read_text()
    assert list(load_run(tmp_path).evaluations) == ["rating_function:search=10", "raster"]
    assert re.fullmatch(rf"done in \d.*; results: {tmp_path}", printed.err.splitlines()[-1])


def test_evaluate_scores_robots_that_are_not_located(tmp_path):
    for module in ("pybullet", "small_gicp"):
        pytest.importorskip(module)
    main([
        "evaluate", "--env", "field", "--policies", "random", "--episodes", "2", "--max-scans", "1",
        "--initialization", "search", "--motion-correction", "fiducials", "--out", str(tmp_path),
    ])  # fmt: skip
    rows = list(csv.DictReader((tmp_path / "episodes.csv").read_text().splitlines()))
    assert all(row["log_loss"] not in ("", "nan") for row in rows)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["env"]["initialization"] == "search"


def test_options_have_the_names_of_scenes_and_mounts():
    assert {
        "planar": tuple(PLANAR_SCENES),
        "field": tuple(FIELD_SCENES),
    } == environment.SCENES
    assert tuple(mount_library.MOUNTS) == environment.MOUNTS


def test_a_urdf_is_a_mount_with_its_joints_and_its_camera(tmp_path):
    urdf = tmp_path / "arm.urdf"
    urdf.write_text("<robot/>")
    options = EnvironmentOptions(env="field", mount=str(urdf), joints=("pan",), camera_link="eye")
    assert options.env_kwargs()["mount"] == {
        "urdf": str(urdf), "joints": ["pan"], "camera_link": "eye", "home": None,
        "root_height": 0.0, "optical_frame": False,
    }  # fmt: skip
    with pytest.raises(ValueError, match=r"arm.urdf needs --joints, .* and --camera-link"):
        EnvironmentOptions(env="field", mount=str(urdf), joints=("pan",)).env_kwargs()


def test_commands_have_an_option_for_each_argument_of_a_task():
    assert issubclass(EnvironmentOptions, TaskArguments)
    task = {field.name for field in fields(TaskArguments)}
    assert set(EnvironmentOptions(env="field").env_kwargs()) == task


def choices_of(hint):
    """Choices of a `Literal`, or types, without None."""
    if get_origin(hint) in (Union, UnionType):
        return set().union(*map(choices_of, get_args(hint))) - {type(None)}
    return set(get_args(hint)) or {hint}


@pytest.mark.parametrize("arguments", [PlanarArguments, FieldArguments])
def test_options_have_the_choices_of_the_environment_arguments(arguments):
    found, expected = get_type_hints(EnvironmentOptions), get_type_hints(arguments)
    others = {"split", "render_mode", "settings", "scene", "mount", "report_shown"}
    others.add("max_cycles")  # PettingZoo's name for max_scans
    numbers = {"n_robots", "max_scans"}  # None is the default
    for name in set(expected) - others - numbers:
        assert choices_of(found[name]) == choices_of(expected[name])
        assert getattr(EnvironmentOptions, name) in (None, getattr(arguments, name))
    assert choices_of(found["physics"]) == choices_of(Physics)
    for name in numbers:
        default = getattr(arguments, name)
        assert EnvironmentOptions().env_kwargs()[name] == default
        text = inspect.getsource(EnvironmentOptions).partition(f" {name}: ")[2].split('"""')[1]
        assert text.endswith(f", {default} by default.")


@pytest.mark.parametrize(
    "command",
    [
        "reproduce",
        "evaluate",
        "localization",
        "bench",
        "compare",
        "train",
        "fit-table",
        "submit",
        "score",
        "report",
        "record",
        "warm-up",
    ],
)
def test_help_shows_examples(command, capsys):
    with pytest.raises(SystemExit) as raised:
        main([command, "--help"])
    assert raised.value.code == 0
    assert f"coopmap {command} --" in capsys.readouterr().out


def test_the_program_prints_its_help():
    done = run("evaluate", "--help")
    assert done.returncode == 0
    assert "coopmap evaluate --" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--policies", "nobody"], "unknown policy 'nobody'"),
        (["--episodes", "0"], "--episodes must be at least 1, got 0"),
        (["--episodes", str(10**20)], f"--episodes must be at most 1,000,000, got {10**20}"),
        (["--scene", "missing.yaml"], "missing.yaml"),
        (["--scene", "moon"], "'moon'"),
        (["--n-robots", "0"], "n_robots must be an integer >= 1, got 0"),
        (["--seed", "-3"], "seed"),
        (["--workers", "0"], "workers must be at least 1"),
        (["--policies", ","], "names no policy"),
        (["--policies", "raster,raste"], "unknown policy 'raste'; did you mean 'raster'?"),
        (["--policies", "raster:search=5"], "raster has no argument 'search'; it takes none"),
        (["--family", "crowd"], "unknown family 'crowd'; did you mean 'crowded'?"),
        (["--mount", "mast"], "--mount belongs to --env field"),
        (["--physics", "stepped"], "--physics belongs to --env field"),
        (["--motion-correction", "exact"], "--motion-correction belongs to --env field"),
        (["--env", "field", "--mount", "mast,crane"], "unknown mount 'crane'"),
        (["--env", "field", "--mount", "arm.urdf"], "--mount arm.urdf: there is no such file"),
        (["--env", "field", "--mount", __file__ + ".urdf"], "there is no such file"),
        (["--env", "field", "--joints", "pan"], "--joints belongs to --mount FILE.urdf"),
        (["--env", "field", "--camera-link", "eye"], "--camera-link belongs to --mount FILE.urdf"),
        (["--env", "field", "--mount", "mast,mast,mast"], "one for each of 2 robots, got 3"),
    ],
)
def test_bad_input_gives_one_clear_line_and_a_failure(arguments, message, tmp_path):
    with pytest.raises(SystemExit) as raised:
        main(["evaluate", "--out", str(tmp_path), "--max-scans", "1", *arguments])
    text = str(raised.value)
    assert message in text
    assert text.startswith("coopmap: ")
    assert "\n" not in text


def test_a_failure_exits_with_status_one(tmp_path):
    done = run("evaluate", "--policies", "nobody", "--out", tmp_path)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr


def run_command_that_raises(error, monkeypatch):
    """Exit status or message of a command."""

    class Command:
        def run(self):
            raise error

    monkeypatch.setattr(cli, "parse_command", lambda arguments: Command())
    with pytest.raises(SystemExit) as raised:
        main([])
    return raised.value.code


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (WorkerError("a worker\nwas killed"), "coopmap: a worker was killed"),
        (
            MemoryError("Unable to allocate 7 GiB"),
            "coopmap: Unable to allocate 7 GiB: memory is short; use fewer workers",
        ),
        (MemoryError(), "coopmap: MemoryError: memory is short; use fewer workers"),
        (
            RuntimeError("DefaultCPUAllocator: can't allocate memory"),
            "coopmap: DefaultCPUAllocator: can't allocate memory: memory is short; "
            "use fewer workers",
        ),
        (
            OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "e.json"),
            "coopmap: [Errno 28] No space left on device: 'e.json'",
        ),
        (FileError("a.yaml: expected YAML"), "coopmap: a.yaml: expected YAML"),
    ],
)
def test_a_failure_of_the_machine_or_of_a_file_is_one_line(error, message, monkeypatch):
    assert run_command_that_raises(error, monkeypatch) == message


@pytest.mark.parametrize(
    ("error", "status"),
    [(KeyboardInterrupt(), 130), (Interruption(signal.SIGTERM), 143), (Interruption(1), 129)],
)
def test_an_interrupted_command_says_so_and_exits_as_shells_expect(
    error, status, monkeypatch, capsys
):
    assert run_command_that_raises(error, monkeypatch) == status
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "interrupted; finished results are kept, and the same command resumes the run"


def test_a_fault_of_ours_keeps_its_traceback(monkeypatch):
    with pytest.raises(RuntimeError, match="a fault"):
        run_command_that_raises(RuntimeError("a fault"), monkeypatch)


def test_a_full_disk_is_one_line_and_the_folder_is_free_again(tmp_path, monkeypatch):
    def write(path, content):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    monkeypatch.setattr("coopmap_env.evaluation.jobs.write_atomically", write)
    with pytest.raises(SystemExit, match=r"^coopmap: \[Errno 28\] No space left on device: "):
        main([
            "evaluate", "--policies", "random", "--episodes", "1", "--max-scans", "1",
            "--out", str(tmp_path),
        ])  # fmt: skip
    with folder_lock(tmp_path), folder_lock(tmp_path / "episodes"):
        pass


def test_output_that_nobody_reads_ends_the_command_without_a_traceback():
    code = """
import sys
from coopmap_env import cli

class Command:
    def run(self):
        sys.stdin.read()
        print("line", flush=True)

cli.parse_command = lambda arguments: Command()
cli.main([])
"""
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    process.stdout.close()
    process.stdin.close()
    assert process.stderr.read() == ""
    process.stderr.close()
    assert process.wait() == 1


def test_unknown_options_are_rejected(tmp_path, capsys):
    with pytest.raises(SystemExit) as raised:
        main(["evaluate", "--colour", "red", "--out", str(tmp_path)])
    assert raised.value.code == 2
    assert "--colour" in capsys.readouterr().err
