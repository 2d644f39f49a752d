"""No version with a known hole in what is used here can be installed beside this package.

Public advisories of the direct dependencies were looked at in November 2026.
"""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).parents[1]
FIXED_IN = {
    "jinja2": "3.1.6",  # CVE-2025-27516: a template breaks out of the sandbox
    "pillow": "12.3.0",  # CVE-2026-59197 and others: writes outside of buffers, small bombs
    "pyyaml": "5.4",  # CVE-2020-14343: code in a YAML file
    "ray": "2.55.0",  # CVE-2026-41486: code in a Parquet file; 2.54: CVE-2026-27482
    "setuptools": "78.1.1",  # CVE-2025-47273: an archive writes outside of its folder
    "torch": "2.10.0",  # CVE-2026-24747, CVE-2025-32434: code despite weights_only
    "tqdm": "4.66.3",  # CVE-2024-34062: code in a command line's argument
}
"""First version without the hole, by package."""


def requirements():
    """All requirements of all extras, and those of the build."""
    content = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    texts = [*content["build-system"]["requires"], *content["project"]["dependencies"]]
    for extra in content["project"]["optional-dependencies"].values():
        texts += extra
    return [Requirement(text) for text in texts]


def pins():
    lines = (ROOT / "constraints.txt").read_text("utf-8").splitlines()
    return dict(re.split("==", line) for line in lines if line and not line.startswith("#"))


@pytest.mark.parametrize("name", FIXED_IN)
def test_floors_are_not_below_the_first_version_without_a_known_hole(name):
    floors = [
        Version(part.version)
        for requirement in requirements()
        if requirement.name == name
        for part in requirement.specifier
        if part.operator == ">="
    ]
    assert floors
    assert min(floors) >= Version(FIXED_IN[name])


def test_the_pinned_versions_satisfy_all_floors():
    pinned = pins()
    checked = [one for one in requirements() if one.name in pinned]
    assert len(checked) > 30
    assert [str(one) for one in checked if not one.specifier.contains(pinned[one.name])] == []
