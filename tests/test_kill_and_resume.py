"""Commands that are killed at any access to a file, and started again, end as undisturbed ones."""

import json
import os
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest

from coopmap_env.core.locks import LOCK_FILE, OWNER_FILE

TESTS = Path(__file__).parent
KILLED = -9
LOCK_FILES = (LOCK_FILE, OWNER_FILE)
EXTRAS = {
    "evaluate": (),
    "record": ("h5py",),
    "compare": ("matplotlib", "jinja2", "torch"),
    "localization": ("pybullet", "small_gicp", "matplotlib", "jinja2"),
    "reproduce": ("matplotlib", "jinja2", "skimage", "rtbdata"),
    "train": ("stable_baselines3", "safetensors"),
    "train with sb3": ("stable_baselines3", "safetensors"),
    "train with rllib": ("stable_baselines3", "safetensors", "ray.rllib"),
}


@pytest.fixture(scope="module")
def play():
    """Plays a command in a folder, killed at an event of a number; see `plain.kill_server`."""
    server = subprocess.Popen(
        [sys.executable, "-m", "plain.kill_server"],
        cwd=TESTS, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(TESTS), *filter(None, sys.path)])},
    )  # fmt: skip

    def request(command, out, event=0):
        server.stdin.write(json.dumps({"command": command, "out": str(out), "event": event}))
        server.stdin.write("\n")
        server.stdin.flush()
        return json.loads(server.stdout.readline())

    yield request
    server.stdin.close()
    server.wait()
    server.stdout.close()


def points(short, long):
    """Decorator of a test with the argument `n_kills`: a short run, and a long one by marker."""
    values = [short, pytest.param(long, marks=pytest.mark.long)]
    return pytest.mark.parametrize("n_kills", values)


def untimed(value):
    """A JSON value without durations."""
    if isinstance(value, dict):
        return {
            key: untimed(item)
            for key, item in value.items()
            if not any(unit in key for unit in ("_ms", "seconds", "command"))
        }
    return [untimed(item) for item in value] if isinstance(value, list) else value


def content(folder):
    """All that a command has written, without durations, by the names of the files.

    A killed process leaves the files of its lock: the next one that writes into the folder removes
    them, and one that finds all results there does not write.
    """
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.suffix == ".json":
            found[name] = json.dumps(untimed(json.loads(path.read_text())))  # NaN equals NaN
        elif path.suffix == ".csv":
            header, *rows = (line.split(",") for line in path.read_text().splitlines())
            kept = [i for i, column in enumerate(header) if "_ms" not in column]
            found[name] = [[row[i] for i in kept] for row in rows]
        elif path.suffix == ".hdf5":
            found[name] = path.read_bytes()
        elif path.suffix == ".safetensors":
            found[name] = weights(path)
        elif path.is_file() and "tensorboard" not in name and path.name not in LOCK_FILES:
            found[name] = ""
    return found


def weights(path):
    from safetensors.numpy import load_file

    return {name: array.tobytes() for name, array in load_file(path).items()}


@pytest.fixture(scope="module")
def undisturbed(play, tmp_path_factory):
    """Number of events and content of an undisturbed command."""
    folders = {}

    def get(command):
        if command not in folders:
            for needed in EXTRAS[command]:
                pytest.importorskip(needed)
            out = tmp_path_factory.mktemp("undisturbed") / "out"
            ended = play(command, out)
            assert ended["status"] == 0, Path(f"{out}.log").read_text()
            folders[command] = ended["events"], content(out)
        return folders[command]

    return get


@points(short=2, long=20)
@pytest.mark.parametrize(
    "command",
    [  # Ray takes half a minute to start
        pytest.param(name, marks=[pytest.mark.long] if "rllib" in name else []) for name in EXTRAS
    ],
)
def test_a_killed_command_that_is_started_again_ends_as_an_undisturbed_one(
    command, n_kills, play, undisturbed, tmp_path
):
    n_events, expected = undisturbed(command)
    rng = np.random.default_rng([zlib.crc32(command.encode()), n_kills])
    out, log = tmp_path / "out", tmp_path / "out.log"
    n_killed = 0
    for event in rng.integers(1, n_events + 1, n_kills):
        status = play(command, out, int(event))["status"]  # and no process is left behind
        assert status in (KILLED, 0), log.read_text()
        n_killed += status == KILLED
        if status == 0:  # it was finished before: the next kill has a new folder
            assert content(out) == expected
            out, log = tmp_path / f"out{n_killed}", tmp_path / f"out{n_killed}.log"
    assert n_killed > 0
    assert play(command, out)["status"] == 0, log.read_text()
    assert content(out) == expected
