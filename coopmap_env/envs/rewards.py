"""Rewards: named terms, each a small function of what one robot's look brought.

With teammates looking at the same place at once, the overlap is paid once, to the robot of the
lower number: "rating" leaves the cells that earlier robots are looking at out of a robot's
histogram, "information" and "coverage" count what a scan adds to the scans of earlier robots.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from coopmap_env.mapping import ScanGain


class Look(NamedTuple):
    """What one robot's look brought."""

    new_information: float
    """NI (Eqs. 6-8) of the executed pose on the map before the scans, without the cells that
    earlier robots were looking at; nats."""
    distance: float
    """d of Eq. 5 that the camera moved."""
    motion_cost: float
    """K d**n of Eq. 9, nats."""
    rating: float
    """RF (Eq. 9) of the executed pose, from this NI."""
    gain: ScanGain
    """What the scan brought to the map."""
    contact_cost: float = 0.0
    """What bumping into something costs, as a share of the largest NI; 0 without a contact."""


class Scale(NamedTuple):
    """What the terms are measured against."""

    full_view: float
    """Entropy of all cells that the camera can see, N ln 2, nats."""
    most_information: float
    """The largest NI, ln(n_gray), nats."""
    n_cells: int
    """Cells of the world."""

    @classmethod
    def of(cls, n_visible: int, n_gray: int, n_cells: int) -> Scale:
        """The scale of a camera that sees at most `n_visible` cells of the world's `n_cells`."""
        return cls(n_visible * math.log(2.0), math.log(n_gray), n_cells)


def rating(look: Look, scale: Scale) -> float:
    """Eq. 9 of the executed pose on the map before the scan: what the planner maximises; nats."""
    return look.rating - look.contact_cost * scale.most_information


def information(look: Look, scale: Scale) -> float:
    """Realised drop of map entropy minus the motion cost.

    The drop as a share of a full view's entropy, the cost as a share of the largest NI.
    """
    motion_cost = look.motion_cost / scale.most_information
    return look.gain.entropy_drop / scale.full_view - motion_cost - look.contact_cost


def coverage(look: Look, scale: Scale) -> float:
    """Newly viewed cells as a share of the world."""
    return look.gain.new_cells / scale.n_cells - look.contact_cost


TERMS: dict[str, Callable[[Look, Scale], float]] = {
    "rating": rating,
    "information": information,
    "coverage": coverage,
}


def terms_of(look: Look, scale: Scale) -> dict[str, float]:
    """Every term by its name."""
    return {name: term(look, scale) for name, term in TERMS.items()}
