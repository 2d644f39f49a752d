"""Rewards: named terms, each a small function of what one robot's look brought.

With teammates looking at the same place at once, the overlap is paid once, to the robot of the
lower number: "rating" leaves the cells that earlier robots are looking at out of a robot's
histogram, "information" and "coverage" count what a scan adds to the scans of earlier robots.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from coopmap_env.information import RatingFunction
from coopmap_env.mapping import ScanGain


class Look(NamedTuple):
    """What one robot's look brought."""

    new_information: float
    """NI (Eqs. 6-8) of the executed pose on the map before the scans, without the cells that
    earlier robots were looking at; nats."""
    distance: float
    """d of Eq. 5 that the camera moved."""
    rating: float
    """RF (Eq. 9) of the executed pose, from this NI."""
    gain: ScanGain
    """What the scan brought to the map."""


def rating(look: Look, _: RatingFunction, __: int) -> float:
    """Eq. 9 of the executed pose on the map before the scan: what the planner maximises; nats."""
    return look.rating


def information(look: Look, function: RatingFunction, _: int) -> float:
    """Realised drop of map entropy minus the motion cost, both in units of a full view.

    A full view is the entropy of all cells that the camera can see, N ln 2; the motion cost
    K d**n counts against the largest NI, ln(n_gray).
    """
    full_view = function.fan.n_visible * math.log(2.0)
    cost = function.motion_cost(look.distance) / math.log(function.settings.n_gray)
    return look.gain.entropy_drop / full_view - cost


def coverage(look: Look, _: RatingFunction, n_cells: int) -> float:
    """Newly viewed cells as a share of the world."""
    return look.gain.new_cells / n_cells


TERMS: dict[str, Callable[[Look, RatingFunction, int], float]] = {
    "rating": rating,
    "information": information,
    "coverage": coverage,
}


def terms_of(look: Look, function: RatingFunction, n_cells: int) -> dict[str, float]:
    """Every term by its name."""
    return {name: term(look, function, n_cells) for name, term in TERMS.items()}
