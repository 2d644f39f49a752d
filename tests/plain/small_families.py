"""Families of worlds in which an episode takes a few milliseconds."""

from plain.small_worlds import SETTINGS

from coopmap_env.envs import registration
from coopmap_env.envs.field import FieldSettings
from coopmap_env.families import FAMILIES, Family, worlds
from coopmap_env.families.freeze import hashes_of

SCENE = {"name": "obstacles", "shape": [24, 24], "side_min": 2.0, "side_max": 6.0}
SMALL_FAMILIES = (
    Family("tiny", "planar", "Tiny worlds.", SCENE, {"n_robots": 2, "max_scans": 4}, SETTINGS),
    Family(
        "hasty",
        "planar",
        "Tiny worlds with a clock.",
        SCENE,
        {"n_robots": 2, "max_scans": 30, "max_time": 14.0},
        SETTINGS,
    ),
)
SHORT_FIELD = Family(
    "short", "field", "Few scans.", {"name": "worksite"}, {"n_robots": 1, "max_scans": 2},
    FieldSettings(),
)  # fmt: skip
"""Its worlds take longer to make."""
N_FROZEN = 4


def with_small_families(monkeypatch, small_families=SMALL_FAMILIES):
    """Let the registry of families have these, and their first test worlds be frozen."""
    frozen = {}
    for family in small_families:
        monkeypatch.setitem(FAMILIES, family.name, family)
        monkeypatch.setitem(registration.FAMILIES, family.name, family.env_name.capitalize())
        frozen[family.name] = hashes_of(family, {"test": N_FROZEN})
    monkeypatch.setattr(worlds, "frozen_hashes", frozen.__getitem__)
