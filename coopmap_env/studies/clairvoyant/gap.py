"""How far a policy is from the upper bound, and what each part of that gap needs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray


class Gap(NamedTuple):
    """Fractions of what the bound allows beyond the start; together they are 1. Arrays (n,)."""

    efficiency: NDArray[np.float64]
    """What the policy shows."""
    search: NDArray[np.float64]
    """What the best planner without the truth shows beyond it: a better search would do."""
    knowledge: NDArray[np.float64]
    """What a clairvoyant policy shows beyond that planner: one must know, or predict, the world."""
    information: NDArray[np.float64]
    """What the bound allows beyond that. Robots go only where scans have shown the way, which the
    bound leaves out; and it may be loose."""


def split_gap(
    start: ArrayLike,
    bound: ArrayLike,
    clairvoyant: ArrayLike,
    planner: ArrayLike,
    policy: ArrayLike,
) -> Gap:
    """Split the gap between a policy and the bound, world by world.

    Parameters
    ----------
    start, bound, clairvoyant, planner, policy : array_like (n,)
        Cells in each world: known at the start, allowed by the upper bound, shown by a policy that
        knows the truth, by the best planner that does not, and by the policy itself. Or areas under
        the curves of these over the scans.

    Raises
    ------
    ValueError
        If the bound of a world is not above its start.

    Examples
    --------
    >>> split_gap(100, 1100, 1000, 900, 600)
    Gap(efficiency=0.5, search=0.3, knowledge=0.1, information=0.1)
    """
    values = [np.asarray(one, dtype=np.float64) for one in (start, bound, clairvoyant, planner)]
    known, most, seeing, best = values
    own = np.asarray(policy, dtype=np.float64)
    if not np.all(most > known):
        raise ValueError(f"each bound must be above its start, got {most} and {known}")
    room = most - known
    return Gap(
        (own - known) / room, (best - own) / room, (seeing - best) / room, (most - seeing) / room
    )
