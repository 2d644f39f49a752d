"""A folder of results has one owner at a time."""

import os
import re
import signal
import subprocess
import sys

import pytest

from coopmap_env.cli import main
from coopmap_env.core.locks import FolderInUseError, folder_lock

OWN_AND_DIE = """
import os, signal, sys
from pathlib import Path
from coopmap_env.core.locks import folder_lock
folder = Path(sys.argv[1])
with folder_lock(folder):
    (folder / f".episode.{'0a' * 16}.tmp.json").touch()  # it dies while it writes
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_an_owned_folder_is_refused_with_its_owner_and_free_afterwards(tmp_path):
    with folder_lock(tmp_path):
        with pytest.raises(FolderInUseError, match=rf"{tmp_path} is in use by .*this process"):
            folder_lock(tmp_path).__enter__()
        with folder_lock(tmp_path / "inside"):
            pass
    with folder_lock(tmp_path):
        pass
    assert list(tmp_path.iterdir()) == []


def test_another_process_is_told_the_process_machine_and_time_of_the_owner(tmp_path):
    command = [sys.executable, "-c", OWN_AND_DIE, str(tmp_path)]
    with folder_lock(tmp_path):
        other = subprocess.run(command, capture_output=True, text=True)
    message = other.stderr.splitlines()[-1]
    time = r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\+00:00"
    assert re.search(rf"in use by process {os.getpid()} on '.+', since '{time}': wait", message)


def test_a_killed_owner_leaves_a_folder_that_can_be_owned_and_is_tidied(tmp_path):
    owner = subprocess.run([sys.executable, "-c", OWN_AND_DIE, str(tmp_path)])
    assert owner.returncode == -signal.SIGKILL
    assert len(list(tmp_path.iterdir())) == 3  # the lock, the owner, and what it was writing
    with folder_lock(tmp_path):
        pass
    assert list(tmp_path.iterdir()) == []


def test_an_owner_without_a_record_is_another_process(tmp_path):
    with folder_lock(tmp_path):
        for content in (b"\xff", b"[]", b'{"process": [1]}', b""):
            (tmp_path / ".coopmap.owner").write_bytes(content)
            with pytest.raises(FolderInUseError, match="in use by another process: wait"):
                folder_lock(tmp_path).__enter__()


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").touch()
    for folder in (tmp_path / "file", tmp_path / "file" / "folder"):
        with pytest.raises(OSError, match=rf"{folder} cannot be used as a folder of results"):
            folder_lock(folder).__enter__()


def test_other_files_with_similar_names_stay(tmp_path):
    names = [".notes.tmp", "a.tmp.json", f".a.{'g' * 32}.tmp.json", f"a.{'0' * 32}.tmp.json"]
    for name in names:
        (tmp_path / name).touch()
    with folder_lock(tmp_path):
        pass
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names)


@pytest.mark.parametrize("command", ["evaluate", "compare", "localization", "reproduce", "train"])
def test_every_command_refuses_a_folder_that_is_in_use(command, tmp_path):
    if command != "evaluate":
        pytest.importorskip("torch" if command == "train" else "jinja2")
    with folder_lock(tmp_path):
        with pytest.raises(SystemExit, match=rf"^coopmap: {tmp_path} is in use by"):
            main([command, "--out", str(tmp_path)])
        assert len(list(tmp_path.iterdir())) == 2
