"""The coordinates of the search: two of them are chosen so that fewer combinations are useless."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, NamedTuple

from coopmap_env.studies.section3.setting import SCANS_EACH, TableConstants

Point = dict[str, float]
"""A value for each of `RANGES`."""


class Range(NamedTuple):
    """Values that are searched."""

    low: float
    high: float
    log: bool = False
    integer: bool = False


RANGES = {
    "field_of_view": Range(12.0, 64.0, log=True),
    "depth_of_field": Range(12.0, 26.0),
    "views": Range(0.08, 0.24, log=True),
    "cost_of_5": Range(0.5, 2.5, log=True),
    "exponent": Range(0.4, 1.4),
    "heading_length": Range(0.0, 10.0),
    "n_gray_bins": Range(4, 64, log=True, integer=True),
    "n_headings": Range(12, 48, log=True, integer=True),
    "occupied_fraction": Range(0.03, 0.2),
    "block_side": Range(2.0, 8.0),
    "block_ratio": Range(1.0, 4.0),
    "start_distance": Range(5.0, 40.0),
}
"""What is searched: fields of `TableConstants`, but "views", the area of all views in empty space
over that of the world, which gives its side; and "cost_of_5", the cost of a motion by 5 cells in
nats, which gives K."""


def constants_at(point: Mapping[str, float]) -> TableConstants:
    """The constants of a point."""
    values: dict[str, Any] = dict(point)
    views = _area_of_views(values["field_of_view"], values["depth_of_field"])
    side = round(math.sqrt(views / values.pop("views")))
    K = values.pop("cost_of_5") / 5.0 ** values["exponent"]
    return TableConstants(side=side, K=K, **values)


def point_of(constants: TableConstants) -> Point:
    """The point of some constants: the inverse of `constants_at`."""
    point = asdict(constants)
    views = _area_of_views(constants.field_of_view, constants.depth_of_field)
    point["views"] = views / point.pop("side") ** 2
    point["cost_of_5"] = point.pop("K") * 5.0**constants.exponent
    return point


def _area_of_views(field_of_view: float, depth_of_field: float) -> float:
    """Area of all views of both robots in empty space, cells."""
    return SCANS_EACH * math.radians(field_of_view) * depth_of_field**2
