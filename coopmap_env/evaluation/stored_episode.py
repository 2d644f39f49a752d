"""Whether a stored episode can be used; one that cannot is played again."""

from __future__ import annotations

from typing import Any

import numpy as np

from coopmap_env.core.json_types import has_type
from coopmap_env.evaluation.episode import Episode


def is_episode(
    result: Any,
    n_scans: int | None = None,
    with_surface: bool | None = None,
    with_shown: bool | None = None,
) -> bool:
    """Whether a stored result has the form and the ranges of an episode of this version.

    Parameters
    ----------
    result : object
        From a JSON file.
    n_scans : int, optional
        Most scans of each robot: curves have one value more, or fewer where the time ran out.
    with_surface : bool, optional
        Whether it has to have scores of a true surface, or must have none.
    with_shown : bool, optional
        Likewise the curve of what scans truly showed.
    """
    if not has_type(result, Episode):
        return False
    surface = result.get("surface")
    if with_surface not in (None, surface is not None):
        return False
    if with_shown not in (None, result.get("shown_curve") is not None):
        return False
    fractions = [result["coverage_curve"], *([surface["coverage_curve"]] if surface else [])]
    if result.get("shown_curve") is not None:
        fractions.append(result["shown_curve"])
    curves = [result["entropy_curve"], result["elapsed_curve"], *fractions]
    n_values, max_time = len(curves[0]), result["max_time"]
    if n_values < 2 or any(len(curve) != n_values for curve in curves):
        return False
    ended_by_time = max_time is not None and result["elapsed_curve"][-1] >= max_time > 0
    fewest = 2 if ended_by_time else (n_scans or 1) + 1
    if n_scans is not None and not fewest <= n_values <= n_scans + 1:
        return False
    counts = [result["n_rejected_actions"], result["n_collisions"], result["planning_time_ms"]]
    # scores of a surface may be undefined
    numbers = [value for value in result.values() if isinstance(value, int | float)]
    return bool(
        np.isfinite(np.hstack([*curves, numbers, list(result["extent"].values())])).all()
        and all(0 <= value <= 1 for curve in fractions for value in curve)
        and min(result["entropy_curve"]) >= 0
        and result["elapsed_curve"][0] == 0
        and (np.diff(result["elapsed_curve"]) >= 0).all()
        and min(counts) >= 0
        and result["seed"] >= 0
    )
