"""The families of planar worlds."""

from __future__ import annotations

from dataclasses import replace

from coopmap_env.envs.planar import PlanarSettings
from coopmap_env.families.family import Family

TEAM = {"n_robots": 2}
CELL = 0.2
"""Metres along the side of a cell of a floor plan."""

PLANAR_FAMILIES = (
    Family(
        "crowded",
        "planar",
        "A small floor that the team could show in two thirds of its scans, if none overlapped.",
        {
            "name": "rooms",
            "shape": [100, 100],
            "room_min": 2.4,
            "room_max": 5.2,
            "corridor": 1.6,
            "halls": 0.5,
            "furniture": 0.4,
        },
        {**TEAM, "max_scans": 29},
        PlanarSettings.for_resolution(CELL),
    ),
    Family(
        "long",
        "planar",
        "A floor of an office building, and 96 scans of each robot.",
        {"name": "rooms"},
        {**TEAM, "max_scans": 96},
        PlanarSettings.for_resolution(CELL),
    ),
    Family(
        "motion-budget",
        "planar",
        "Motions and turns take time on the clock of the team, and it runs out.",
        {"name": "obstacles", "shape": [120, 120], "occupied_fraction": 0.2},
        {**TEAM, "max_scans": 100, "max_time": 240.0},
        PlanarSettings(),
    ),
    Family(
        "narrow",
        "planar",
        "Galleries with side branches and dead ends; a motion reaches eight cells.",
        {"name": "corridors"},
        {**TEAM, "max_scans": 48},
        replace(PlanarSettings.for_resolution(CELL), reach=8 * CELL),
    ),
)
