"""Paths and names on the pages about the code exist."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = "\n".join(
    (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    for name in ("architecture", "extending")
)
FOLDERS = "coopmap_env|agents|baselines|examples|tests"


def test_paths_exist():
    paths = re.findall(rf"`((?:{FOLDERS})(?:/[\w./]*)?|pyproject\.toml)`", PAGE)
    assert len(paths) > 50
    assert [path for path in paths if not (ROOT / path).exists()] == []


def test_links_lead_to_files():
    links = re.findall(r"\]\(([^)#]+)\)", PAGE)
    assert links
    assert [link for link in links if not (ROOT / "docs" / link).exists()] == []


def test_names_in_parentheses_are_defined_in_the_file_before_them():
    missing = []
    for path, names in re.findall(rf"`((?:{FOLDERS})/[\w./]+\.py)`\s+\(([^)]*`[^)]*)\)", PAGE):
        source = (ROOT / path).read_text(encoding="utf-8")
        for name in re.findall(r"`([\w.]+)`", names):
            last = name.split(".")[-1]
            if not re.search(rf"\b(?:def|class) {last}\b|^{last}\b", source, re.MULTILINE):
                missing.append(f"{path}: {name}")
    assert missing == []
