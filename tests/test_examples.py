"""Every example runs as it stands, in an empty folder."""

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))
NEEDS = {
    "field_episode": ("pybullet", "embreex", "pyoctomap"),
    "custom_scene": ("pybullet", "embreex", "yaml"),
    "custom_mount": ("pybullet", "embreex"),
    "train_policy": ("stable_baselines3",),
    "planar_episode": ("PIL",),
}
"""Modules of the extras that an example uses."""


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs_without_warnings_of_this_library(path, tmp_path):
    for module in NEEDS.get(path.stem, ()):
        pytest.importorskip(module)
    done = subprocess.run(
        [sys.executable, "-W", "error::DeprecationWarning:coopmap_env", str(path)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout


def test_every_example_says_what_it_shows():
    assert len(EXAMPLES) >= 5
    for path in EXAMPLES:
        assert path.read_text(encoding="utf-8").startswith('"""'), path.name
