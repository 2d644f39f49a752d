"""Every example runs as it stands, in an empty folder."""

import runpy
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))
NEEDS = {
    "field_episode": ("pybullet", "embreex", "pyoctomap"),
    "custom_scene": ("pybullet", "embreex", "yaml"),
    "custom_mount": ("pybullet", "embreex"),
    "train_policy": ("stable_baselines3",),
    "vector_ppo": ("stable_baselines3", "safetensors"),
    "planar_episode": ("PIL",),
    "torchrl_ppo": ("torchrl",),
    "skrl_ippo": ("skrl",),
    "maskable_ppo": ("sb3_contrib",),
    "benchmarl_mappo": ("benchmarl",),
}
"""Modules of the extras that an example uses."""
ARGUMENTS = {
    "vector_ppo": ["--steps", "1"],
    "benchmarl_mappo": ["--frames", "64", "--frames-per-batch", "64", "--worlds", "1"],
}
"""For examples that take minutes without any."""


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs_without_a_warning(path, tmp_path, monkeypatch, capsys):
    for module in NEEDS.get(path.stem, ()):
        pytest.importorskip(module)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(path), *ARGUMENTS.get(path.stem, ())])
    runpy.run_path(str(path), run_name="__main__")
    assert capsys.readouterr().out


def test_every_example_says_what_it_shows():
    assert len(EXAMPLES) >= 5
    for path in EXAMPLES:
        assert path.read_text(encoding="utf-8").startswith('"""'), path.name
