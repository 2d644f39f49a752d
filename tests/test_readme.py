"""Every block of the README runs: Python as it stands, commands through the command line.

The Python blocks of the other pages run too.
"""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from coopmap_agents.pretrained import pretrained_path
from coopmap_env.cli import main, parse_command

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = {
    name: (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    for name in (
        "vector_environments",
        "bounds",
        "leaderboard",
        "families",
        "map_prediction",
        "predicted_maps",
        "what_was_tried",
    )
}
FENCE = re.compile(r"(<!-- slow -->\n)?```(python|bash)\n(.*?)```", re.DOTALL)
BLOCKS = FENCE.findall(TEXT)
PYTHON = [
    pytest.param(code, id=f"{page}{k}", marks=[pytest.mark.slow] if slow else [])
    for page, blocks in (
        ("block", BLOCKS),
        *((name, FENCE.findall(text)) for name, text in PAGES.items()),
    )
    for k, (slow, language, code) in enumerate(blocks)
    if language == "python"
]
SHORTER = ("total_steps=8192", "total_steps=128, n_envs=2, rollout_steps=16, batch_size=32")
"""The training in the README takes half a minute; short roll-outs show that the block runs."""
COMMANDS = [
    line for _, language, code in BLOCKS if language == "bash" for line in code.splitlines()
]


def test_the_first_python_block_runs_as_a_program(tmp_path):
    code = PYTHON[0].values[0]
    done = subprocess.run(
        [sys.executable, "-W", "error::DeprecationWarning:coopmap_env", "-c", code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("code", PYTHON[1:])
def test_python_block_runs(code, tmp_path, monkeypatch):
    """In this process: each interpreter more would import everything and load all kernels."""
    monkeypatch.chdir(tmp_path)
    exec(compile(code.replace(*SHORTER), "README.md", "exec"), {"__name__": "__main__"})


def test_the_training_of_the_readme_is_the_one_that_is_shortened():
    assert sum(code.values[0].count(SHORTER[0]) for code in PYTHON) == 1


def test_the_readme_has_only_commands_that_are_tested_here():
    kinds = {shlex.split(command)[0] for command in COMMANDS}
    assert kinds == {"pip", "make", "coopmap"}


@pytest.mark.parametrize("command", [c for c in COMMANDS if c.startswith("coopmap evaluate")])
def test_evaluate_command_runs(command, tmp_path, monkeypatch, capsys):
    words = shlex.split(command)
    trained = re.search(r"learned:model=([\w/.]+)", command)
    if trained:  # what the command above it in the README takes minutes to make
        (tmp_path / trained[1]).parent.mkdir(parents=True)
        shutil.copyfile(pretrained_path("planar-candidates"), tmp_path / trained[1])
    monkeypatch.chdir(tmp_path)
    main(words[1:])
    assert "area under curve" in capsys.readouterr().out
    out = tmp_path / words[words.index("--out") + 1]
    assert {path.name for path in out.iterdir()} >= {"episodes.csv", "summary.json"}


@pytest.mark.parametrize("command", [c for c in COMMANDS if c.startswith("coopmap")])
def test_every_command_is_understood(command):
    words = shlex.split(command)
    assert type(parse_command(words[1:])).__name__.lower() == words[1]


@pytest.mark.parametrize("command", [c for c in COMMANDS if c.startswith("make")])
def test_make_target_exists(command):
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    done = subprocess.run(
        ["make", "--dry-run", *shlex.split(command)[1:]], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def test_extras_named_in_the_readme_exist():
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = "maps|render|report|cli|data|rl|ray|notebooks|bench|field|mounts|paths|octomap|replay"
    named = set(re.findall(rf"`({extras})`", TEXT))
    assert named <= set(project["optional-dependencies"])
    assert 'pip install ".[all]"' in TEXT


def test_pictures_and_linked_files_exist():
    paths = [path for path in re.findall(r"\]\((.*?)\)", TEXT) if not path.startswith("http")]
    assert len(paths) > 10
    for text in PAGES.values():
        paths += [f"docs/{path}" for path in re.findall(r"\]\((.*?)\)", text)]
    for page in (ROOT / "docs" / "families").glob("*.md"):
        paths += [
            f"docs/families/{path}"
            for path in re.findall(r"\]\((.*?)\)", page.read_text(encoding="utf-8"))
        ]
    for path in paths:
        assert (ROOT / path.split("#")[0]).exists(), path
