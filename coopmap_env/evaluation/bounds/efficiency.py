"""Efficiency: what a policy shows, as a fraction of what the upper bound allows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.evaluation.episode import Episode, area_under


class Efficiency(NamedTuple):
    """(shown - start) / (bound - start), of the same episode."""

    end: float
    area: float
    """Of the areas under both curves."""


def scans_in_time(n_scans: int, max_time: float | None, scan_time: float) -> int:
    """Most scans of each robot that an episode can have.

    Each step lasts `scan_time` seconds or longer. One more begins while time is left. Times are
    summed as the environment does: ten times 0.1 is less than 1.
    """
    if max_time is None:
        return n_scans
    return int(np.count_nonzero(_earliest_times(n_scans, scan_time)[:-1] < max_time))


def _earliest_times(n_scans: int, scan_time: float) -> NDArray[np.float64]:
    """Seconds before the first scan and after each (n_scans + 1,), if robots stand still."""
    return np.cumsum([0.0, *[scan_time] * n_scans])


def efficiency(
    episode: Episode, bounds: NDArray[np.int64], n_cells: int, scan_time: float
) -> Efficiency:
    """Efficiency of an episode in a world with these bounds.

    Where time ends episodes, areas are over time. The scan s of a robot ends at s * scan_time
    seconds at the earliest, so a bound of what s scans show is one of what is shown then. What an
    episode shows between two scans, on the straight line from one to the other, is below the line
    through the bounds, too: there it is later than the same fraction of the way between the same
    bounds, which only rise.

    Parameters
    ----------
    episode : Episode
        With what was truly shown (``report_shown=True``).
    bounds : ndarray, shape (n + 1,)
        Most cells that can be shown before the first scan and after each, of as many scans as the
        episode can have (`scans_in_time`).
    n_cells : int
        Cells of the world.
    scan_time : float
        Seconds that a scan takes.

    Raises
    ------
    ValueError
        If the episode has no curve of what was shown, there are fewer bounds than it has values, it
        shows more than they allow, or they allow nothing beyond the start.
    """
    shown, most = episode.shown_curve, bounds / n_cells
    if shown is None:
        raise ValueError("an episode has an efficiency with report_shown=True only")
    if len(shown) > len(most):
        raise ValueError(f"{len(shown) - 1} scans need as many bounds, got {len(most) - 1}")
    start = shown[0]
    if (np.array(shown) > most[: len(shown)] + 1e-9).any() or not most[-1] > start:
        raise ValueError(f"the bounds {most} do not belong to an episode that shows {shown}")
    times = _earliest_times(len(most) - 1, scan_time)
    allowed = area_under(most.tolist(), times.tolist(), episode.max_time)
    own = area_under(shown, episode.elapsed_curve, episode.max_time)
    return Efficiency(
        float((shown[-1] - start) / (most[-1] - start)), float((own - start) / (allowed - start))
    )
