"""Every block of the README and of the site runs: Python as it stands, commands as given.

Sphinx checks links and anchors (`make docs`); what it does not see is tested here.
"""

import importlib.util
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

from coopmap_agents.pretrained import pretrained_path
from coopmap_env.cli import main, parse_command

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for path in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(ROOT.glob("docs/**/*.md"))]
}
FENCE = re.compile(r"(<!-- slow -->\n)?```(python|bash)\n(.*?)```", re.DOTALL)
PYTHON = [
    pytest.param(code, id=f"{page}-{k}", marks=[pytest.mark.slow] if slow else [])
    for page, text in PAGES.items()
    for k, (slow, language, code) in enumerate(FENCE.findall(text))
    if language == "python"
]
SHORTER = ("total_steps=8192", "total_steps=128, n_envs=2, rollout_steps=16, batch_size=32")
"""The training in Python takes half a minute; short roll-outs show that the block runs."""
COMMANDS = [
    line
    for text in PAGES.values()
    for _, language, code in FENCE.findall(text)
    if language == "bash"
    for line in code.splitlines()
]
INDENTED = [
    line.replace("\\\n", "")
    for text in PAGES.values()
    for line in re.findall(r"^    (coopmap (?:.*\\\n)*.*)$", text, re.MULTILINE)
]
"""Commands in blocks that are marked by their indentation only."""


def test_the_first_python_block_runs_as_a_program(tmp_path):
    code = PYTHON[0].values[0]
    assert code in README
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
    exec(compile(code.replace(*SHORTER), "page.md", "exec"), {"__name__": "__main__"})


def test_the_training_that_is_shortened_is_there_once():
    assert sum(code.values[0].count(SHORTER[0]) for code in PYTHON) == 1


def test_pages_have_only_commands_that_are_tested_here():
    kinds = {shlex.split(command)[0] for command in COMMANDS}
    assert kinds == {"pip", "make", "coopmap"}


@pytest.mark.parametrize("command", [c for c in COMMANDS if c.startswith("coopmap evaluate")])
def test_evaluate_command_runs(command, tmp_path, monkeypatch, capsys):
    words = shlex.split(command)
    trained = re.search(r"learned:model=([\w/.]+)", command)
    if trained:  # what the command above it on the page takes minutes to make
        (tmp_path / trained[1]).parent.mkdir(parents=True)
        shutil.copyfile(pretrained_path("planar-candidates"), tmp_path / trained[1])
    monkeypatch.chdir(tmp_path)
    main(words[1:])
    assert "area under curve" in capsys.readouterr().out
    out = tmp_path / words[words.index("--out") + 1]
    assert {path.name for path in out.iterdir()} >= {"episodes.csv", "summary.json"}


@pytest.mark.parametrize(
    "command", sorted({c for c in COMMANDS + INDENTED if c.startswith("coopmap")})
)
def test_every_command_is_understood(command):
    words = shlex.split(command)
    assert type(parse_command(words[1:])).__name__.lower() == words[1].replace("-", "")


@pytest.mark.parametrize("command", sorted({c for c in COMMANDS if c.startswith("make")}))
def test_make_target_exists(command):
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    done = subprocess.run(
        ["make", "--dry-run", *shlex.split(command)[1:]], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "module",
    sorted(
        {
            name
            for text in PAGES.values()
            for name in re.findall(r"python -m (coopmap\w+(?:\.\w+)*)", text)
        }
    ),
)
def test_programs_of_the_pages_exist(module):
    assert importlib.util.find_spec(module) is not None


def test_the_readme_is_short_and_its_first_command_installs_the_core():
    assert len(README.encode()) < 8_000
    assert FENCE.findall(README)[0][2] == "pip install .\n"


def test_the_page_of_installation_has_every_extra():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    rows = re.findall(r"^\|[^|]+\| `(\w+)` \|", PAGES["docs/install.md"], re.MULTILINE)
    extras = {name for name, needed in project["optional-dependencies"].items() if needed}
    assert sorted(rows) == sorted(extras - {"all", "dev"})


def test_extras_in_commands_exist():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    for command in COMMANDS:
        if command.startswith("pip"):
            for names in re.findall(r"\.\[([\w,]+)\]", command):
                assert set(names.split(",")) <= set(extras), command


def test_pictures_and_linked_files_exist():
    """As on the pages of the repository; the site adds those that it makes itself."""
    found = [
        (page, link)
        for page, text in PAGES.items()
        for link in re.findall(r"\]\(([^)#\s]+)[^)\s]*\)", text)
        if not link.startswith("http")
    ]
    assert len(found) > 100
    made = {
        "docs/contributing.md": ROOT,
        "docs/changelog.md": ROOT,
        "docs/security.md": ROOT,
    }  # they include other files
    missing = [
        (page, link)
        for page, link in found
        if not (made.get(page, (ROOT / page).parent) / link).exists()
    ]
    assert missing == []


def test_names_on_the_page_of_the_paper_exist():
    names = re.findall(r"\]\(#(coopmap_\w+(?:\.\w+)+)\)", PAGES["docs/paper.md"])
    assert len(names) > 20
    for name in names:
        package, _, last = name.rpartition(".")
        assert hasattr(import_module(package), last), name
