"""How much faster the field is than an earlier commit: ``python -m ... COMMIT [ROUNDS]``.

The commit is checked out beside this one (`git worktree`). Two processes, one for each, play the
same episodes in turn, so that what else the machine does slows both down. The time of a step is the
least process time of all rounds; each ratio is given with its range over the rounds. A first round,
in which kernels are compiled, does not count.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[2]
MODES = ("pose", "candidates")
N_EPISODES = 2
N_ROBOTS, N_RAYS = 2, 64 * 48
"""Of the default environment."""


class StepTimer:
    """A process that runs `_step_times.py` with the code of a checkout."""

    def __init__(self, checkout: Path, mode: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, str(HERE / "_step_times.py"), mode, str(N_EPISODES)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1"},
        )

    def measure(self) -> NDArray[np.float64]:
        """Process times of the steps of one round, and of their fusion (steps, 2), seconds.

        Raises
        ------
        RuntimeError
            If the process ended; it wrote why.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        for line in self._process.stdout:
            if line.startswith("[["):  # PyBullet greets on the same channel
                return np.array(json.loads(line))
        raise RuntimeError("the process that plays episodes ended")

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


def compare(opponent: Path, mode: str, rounds: int) -> str:
    """A line with the times of both checkouts in one mode, and their ratios."""
    timers = [StepTimer(checkout, mode) for checkout in (opponent, ROOT)]
    for timer in timers:
        timer.measure()
    samples = np.array([[timer.measure() for timer in timers] for _ in range(rounds)])
    for timer in timers:
        timer.close()
    (old, old_fusion), (new, new_fusion) = samples.min(axis=0).mean(axis=1) / N_ROBOTS
    by_round = samples.mean(axis=2)
    ratios = by_round[:, 0] / by_round[:, 1]
    (low, low_fusion), (high, high_fusion) = ratios.min(axis=0), ratios.max(axis=0)
    return (
        f"{mode}: {1e3 * old:.2f} -> {1e3 * new:.2f} ms per agent-step, x {old / new:.2f} "
        f"({low:.2f} ... {high:.2f}); sense and fuse {1e-6 * N_RAYS / new_fusion:.2f} M rays/s, "
        f"x {old_fusion / new_fusion:.2f} ({low_fusion:.2f} ... {high_fusion:.2f})"
    )


def main() -> None:
    """Compare with the commit that is named."""
    commit, rounds = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 5
    with tempfile.TemporaryDirectory() as folder:
        checkout = Path(folder) / "opponent"
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--detach", str(checkout), commit], check=True)
        try:
            for mode in MODES:
                print(compare(checkout, mode, rounds), flush=True)
        finally:
            subprocess.run([*git, "remove", "--force", str(checkout)], check=True)


if __name__ == "__main__":
    main()
