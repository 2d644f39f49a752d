import sys
import tomllib
from pathlib import Path

import pytest

from coopmap_env.core import extras
from coopmap_env.core.extras import EXTRAS, missing_extras, require_extras

ROOT = Path(__file__).parents[2]


@pytest.fixture
def some_missing(monkeypatch):
    monkeypatch.setattr(extras, "_is_installed", lambda name: name not in ("matplotlib", "ompl"))


def test_extras_are_those_of_the_project():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    declared = set(project["optional-dependencies"])
    assert declared - {"cli", "docs", "notebooks", "all", "dev"} == set(EXTRAS)


def test_missing_modules_are_found_without_importing_them(some_missing):
    assert missing_extras(["report", "maps", "paths", "report"]) == {
        "report": ["matplotlib"],
        "paths": ["ompl"],
    }


def test_all_missing_extras_are_named_at_once(some_missing):
    with pytest.raises(ImportError) as raised:
        require_extras(["report", "maps", "paths"])
    assert str(raised.value) == (
        "matplotlib, ompl are needed here and are not installed: "
        "pip install 'coopmap[report,paths]'"
    )
    with pytest.raises(ImportError, match="ompl is needed here and is not installed"):
        require_extras(["paths"])
    require_extras(["maps"])


def test_what_has_no_wheels_for_this_python_is_said(monkeypatch):
    monkeypatch.setattr(extras, "_is_installed", lambda name: name != "pybullet")
    monkeypatch.setattr(sys, "version_info", (3, 12, 1))
    with pytest.raises(ImportError, match=r"\[field\]' \(pybullet has no wheels from Python 3\.12"):
        require_extras(["field"])
    monkeypatch.setattr(sys, "version_info", (3, 11, 9))
    with pytest.raises(ImportError, match=r"\[field\]'$"):
        require_extras(["field"])


def test_a_hidden_module_is_missing(monkeypatch):
    def find(name):
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(extras, "find_spec", find)
    assert missing_extras(["paths"]) == {"paths": ["ompl"]}
