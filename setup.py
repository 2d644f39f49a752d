"""Finds the packages; all else is in `pyproject.toml`.

Setuptools' own discovery cannot rename the folders `agents` and `baselines`.
"""

from setuptools import find_packages, setup

FOLDERS = {
    "coopmap": "coopmap",
    "coopmap_env": "coopmap_env",
    "baselines": "coopmap_baselines",
    "agents": "coopmap_agents",
}

setup(
    packages=[
        ".".join(filter(None, (name, package)))
        for folder, name in FOLDERS.items()
        for package in ("", *find_packages(folder))
    ]
)
