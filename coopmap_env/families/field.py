"""The families of field worlds."""

from __future__ import annotations

from coopmap_env.envs.field import FieldSettings
from coopmap_env.families.family import Family

TEAM = {"n_robots": 2}
MAST = {"mount": "mast"}

FIELD_FAMILIES = (
    Family(
        "occluded",
        "field",
        "Screens hide the target, and the robots stand on one side of it.",
        {"name": "occluded"},
        {**TEAM, "max_scans": 6},
        FieldSettings(),
        MAST,
    ),
    Family(
        "time",
        "field",
        "Joints have their speeds, scans take time, and the clock of the team runs out.",
        {"name": "worksite"},
        {**TEAM, "max_scans": 100, "max_time": 20.0},
        FieldSettings(),
        MAST,
    ),
)
