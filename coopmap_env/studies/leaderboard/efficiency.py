"""How much of what any policy can show a policy has shown.

The efficiency of an episode is (shown - start) / (bound - start), with the cells that were known at
the start, and an upper bound of those that any policy shows (`coopmap_env.evaluation.bounds`): once
at the end, and once with the areas under both curves (`Episode.area_under`).

Where time ends episodes, a step lasts at least as long as a scan. So scan s cannot be done before
the time c_s, at which s scans without any motion end. Two things follow:

- The last step begins before ``max_time``, at c_(s-1) or later: at most as many scans are done at
  the end as there are s with c_(s-1) < max_time, which is max_time / scan_time, rounded up. The
  bound of so many scans is that at the end.
- The curve over time through the points (c_s, bound_s), straight in between and level after the
  last, is nowhere below the curve of an episode through the points (e_s, shown_s). Proof: let
  t = e_s + u (e_(s+1) - e_s) with u from 0 to 1. The episode has at most
  bound_s + u (bound_(s+1) - bound_s) there, which is the value of our curve at
  c_s + u (c_(s+1) - c_s). That is no later than t, as e_s >= c_s, and both steps last at least a
  scan; and our curve does not fall. So its area is a bound of the areas.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs import MappingEnv
from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation import Episode
from coopmap_env.evaluation.bounds import PlanarViews, bound_shown, load_bound, save_bound


class Efficiency(NamedTuple):
    """Of one episode."""

    end: float
    """At its end."""
    area: float
    """Of the area under its curve."""


def has_bound(env: MappingEnv[Any]) -> bool:
    """Whether bounds of the worlds of an environment are known."""
    return isinstance(env, PlanarEnv)


def most_scans(max_scans: int, max_time: float | None, scan_time: float) -> int:
    """Most scans of each robot in an episode; see the module."""
    if max_time is None:
        return max_scans
    return int(np.count_nonzero(_clock(max_scans, scan_time)[:-1] < max_time))


def _clock(n_scans: int, scan_time: float) -> NDArray[np.float64]:
    """Earliest time (n_scans + 1,) at which so many scans are done.

    A sum like that of the environment, so that rounding does not make it later than that.
    """
    return np.concatenate([[0.0], np.cumsum(np.full(n_scans, scan_time))])


def world_bounds(env: PlanarEnv, path: Path) -> NDArray[np.int64]:
    """Most cells that can be shown in the world of an environment after each scan (n + 1,).

    For n of `most_scans`. The bound is read from a file and checked, or searched and written.

    Parameters
    ----------
    env : PlanarEnv
        After a reset, before the first step.
    path : Path

    Raises
    ------
    BoundFileError
        If the file is broken, belongs to something else, or is wrong.
    """
    n_scans = most_scans(env.max_scans, env.max_time, env.settings.scan_time)
    views = PlanarViews.from_env(env, n_scans)
    if path.exists():
        return load_bound(path, views).bounds
    found = bound_shown(views, n_scans)
    save_bound(path, found, views)
    return found.bounds


def efficiency(episode: Episode, bounds: NDArray[np.float64], scan_time: float) -> Efficiency:
    """Efficiency of an episode.

    Parameters
    ----------
    episode : Episode
        With a `shown_curve`.
    bounds : ndarray, shape (n + 1,)
        Most that can be shown, as a fraction of all cells, after each of `most_scans` scans.
    scan_time : float
        Seconds.

    Raises
    ------
    ValueError
        If the episode has no curve of what was shown, or more scans than the bound, or if the
        bound is not above the start.
    """
    curve = episode.shown_curve
    if curve is None or len(curve) > len(bounds):
        raise ValueError(
            f"an efficiency needs a curve of what was shown with at most {len(bounds)} values"
        )
    start = curve[0]
    if not bounds[-1] > start:
        raise ValueError(f"the bound {bounds[-1]} must be above the start {start}")
    area = _area(bounds, episode.max_time, scan_time)
    return Efficiency(
        float((curve[-1] - start) / (bounds[-1] - start)),
        float((episode.area_under(curve) - start) / (area - start)),
    )


def _area(bounds: NDArray[np.float64], max_time: float | None, scan_time: float) -> float:
    """Area under the bound as `Episode.area_under` has it, with each scan as early as it can be."""
    if max_time is None:
        return float(np.trapezoid(bounds)) / (len(bounds) - 1)
    clock = _clock(len(bounds) - 1, scan_time)
    inside = clock < max_time
    times = np.append(clock[inside], max_time)
    values = np.append(bounds[inside], np.interp(max_time, clock, bounds))
    return float(np.trapezoid(values, times)) / max_time
