"""Speed of this version relative to an earlier commit, in a clone of the repository.

``python -m coopmap_env.studies.speed.regression [COMMIT] [--cases ...]``: the earlier version runs
in a process of its own, from the files of its commit, in turns with this one; see
`coopmap_env.studies.speed.measure`. Without a commit it is the last commit that this branch
shares with `main`, or the one before if that is the present one. The result is printed and decides
nothing: where there is no such commit, as in a shallow clone, a line says so. With other cases and
with a commit whose kernels take minutes to compile::

    python -m coopmap_env.studies.speed.regression COMMIT --cases field --longest-run 600
"""

from __future__ import annotations

import argparse
import io
import json
import os
import shutil
import subprocess
import sys
import tarfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Timer

import coopmap_env
from coopmap_env.cli.errors import errors_as_lines
from coopmap_env.studies.speed import cases
from coopmap_env.studies.speed.cases import CASES, Timings
from coopmap_env.studies.speed.measure import Case, measure, ratio

COMPARED = ("planar_pose", "planar_candidates")
"""Of `cases.CASES`; the whole comparison should take half a minute."""
MAIN_BRANCHES = ("origin/main", "main", "origin/master", "master")
ROUNDS = 5
PACKAGES = {"coopmap_env": "coopmap_env", "coopmap_baselines": "baselines"}
"""Folders of a commit by the names under which they install."""
LONGEST_RUN_S = 30
"""An earlier version that needs longer, to compile what has changed since, is not compared."""


class NoBaseError(Exception):
    """There is nothing to compare with, and why."""


class CaseError(Exception):
    """A program does not run a case, and why."""


class Program:
    """`cases.py` as a process, with this version of the package or with that in a folder.

    Parameters
    ----------
    folder : Path or None
        With the packages of the version; None for this one.
    longest_run : float
        Seconds after which a run is given up.
    """

    def __init__(self, folder: Path | None, longest_run: float = LONGEST_RUN_S) -> None:
        self._longest_run = longest_run
        paths = [str(folder)] if folder else []
        paths += filter(None, [os.environ.get("PYTHONPATH")])
        self._process = subprocess.Popen(
            [sys.executable, "-P", cases.__file__],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths), "OMP_NUM_THREADS": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )

    def __enter__(self) -> Program:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.communicate()

    def run(self, name: str) -> Timings:
        """Run a case once.

        Raises
        ------
        CaseError
            If it fails, or takes too long.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        timer = Timer(self._longest_run, self._process.kill)
        timer.start()
        try:
            self._process.stdin.write(f"{name}\n")
            self._process.stdin.flush()
            # PyBullet greets on the same channel
            line = next((own for own in self._process.stdout if own.startswith("{")), "")
        except BrokenPipeError:
            line = ""
        finally:
            timer.cancel()
        if not line:
            raise CaseError(f"a process has ended, or needed more than {self._longest_run} s")
        answer = json.loads(line)
        if "error" in answer:
            raise CaseError(answer["error"])
        timings: Timings = answer["timings"]
        return timings


def main() -> None:
    """Print a line for each case."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("commit", nargs="?")
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(COMPARED))
    parser.add_argument("--longest-run", type=float, default=LONGEST_RUN_S, help="seconds")
    options = parser.parse_args()
    try:
        base = find_base(Path.cwd(), options.commit)
        with TemporaryDirectory() as folder:
            extract(Path.cwd(), base, Path(folder))
            report = compare(Path(folder), options.cases, ROUNDS, options.longest_run)
    except NoBaseError as reason:
        print(f"speed is not compared: {reason}")
        return
    print(f"time of a step, this version over {base[:9]} (processor time, below 1 is faster):")
    for line in report:
        print(f"  {line}")


def find_base(repository: Path, given: str | None = None) -> str:
    """The commit to compare with.

    Raises
    ------
    NoBaseError
        If there is no repository, or the history does not go back to such a commit.
    """
    head = _git(repository, "rev-parse", "HEAD").decode().strip()
    if given is not None:
        return _git(repository, "rev-parse", "--verify", f"{given}^{{commit}}").decode().strip()
    for branch in MAIN_BRANCHES:
        try:
            base = _git(repository, "merge-base", "HEAD", branch).decode().strip()
        except NoBaseError:
            continue
        is_head = base == head
        return (
            _git(repository, "rev-parse", "--verify", "HEAD^").decode().strip() if is_head else base
        )
    raise NoBaseError(f"none of {', '.join(MAIN_BRANCHES)} shares a known commit with this one")


def extract(repository: Path, commit: str, folder: Path) -> None:
    """Write the packages of a commit into a folder, with the compiled kernels of this version.

    Kernels are found by their code, so that only those that have changed are compiled.
    """
    top = Path(_git(repository, "rev-parse", "--show-toplevel").decode().strip())
    archive = _git(top, "archive", commit, *PACKAGES.values())
    with tarfile.open(fileobj=io.BytesIO(archive)) as files:
        files.extractall(folder, filter="data")
    ours = Path(coopmap_env.__file__).parent
    for path in ours.rglob("__pycache__/*.nbc"):
        copy = folder / "coopmap_env" / path.relative_to(ours)
        if copy.parents[1].exists():
            copy.parent.mkdir(exist_ok=True)
            shutil.copyfile(path, copy)
    for name, source in PACKAGES.items():
        if name != source:
            (folder / source).rename(folder / name)


def compare(
    folder: Path, names: Sequence[str], rounds: int, longest_run: float = LONGEST_RUN_S
) -> list[str]:
    """A line for each case: the ratio of the times of this version and of the one in a folder."""
    lines = []
    with Program(None, longest_run) as present, Program(folder, longest_run) as earlier:
        played: dict[str, Case] = {}
        for name in names:
            try:
                for program in (present, earlier):
                    program.run(name)  # compiles
            except CaseError as reason:
                lines.append(f"{name}: not compared, {reason}")
            else:
                played[f"present {name}"] = Case(partial(present.run, name))
                played[f"earlier {name}"] = Case(partial(earlier.run, name))
        try:
            found = measure(played, rounds) if played else {}
        except (CaseError, ValueError) as reason:
            return [*lines, f"not compared, {reason}"]
    for name in names:
        if f"present {name}" in found:
            present_time, earlier_time = (
                found[f"{label} {name}"].total("step") for label in ("present", "earlier")
            )
            lines.append(f"{name}: {ratio(present_time, earlier_time)}")
    return lines


def _git(repository: Path, *arguments: str) -> bytes:
    try:
        done = subprocess.run(["git", *arguments], cwd=repository, capture_output=True, check=True)
    except FileNotFoundError:
        raise NoBaseError("git is not installed") from None
    except subprocess.CalledProcessError as error:
        lines = error.stderr.decode(errors="replace").strip().splitlines()
        raise NoBaseError(lines[-1] if lines else f"git {arguments[0]} failed") from None
    return done.stdout


if __name__ == "__main__":
    with errors_as_lines("regression"):
        main()
