"""Sentences on the goals of motion correction, made from intervals."""

from __future__ import annotations

from typing import Any

from coopmap_env.evaluation.tables import format_interval

ALL_SCANS_RATIO = 3.5
"""Goal: how many times smaller than the encoders' the median position error is, over all scans."""
CORRECTED_SCANS_RATIO = 5.0
"""The same over scans that fiducials correct."""
GAP_CLOSED = 0.5
"""Goal: part of the difference between the maps by encoders and by exact poses that is closed."""
KINDS = {"estimated": "fiducials, when fused", "smoothed": "fiducials, by all scans"}
SCORES = {"f_score": "F-score", "chamfer": "Chamfer distance", "log_loss": "log-loss"}


def verdicts(correction: dict[str, Any], same_scans: dict[str, Any]) -> list[str]:
    """One sentence for each goal and kind of estimate.

    Parameters
    ----------
    correction : dict
        See `correction_summary`.
    same_scans : dict
        See `same_scans_summary`.
    """
    sentences = []
    for kind, name in KINDS.items():
        for part, title, goal in (
            ("all_scans", "all scans", ALL_SCANS_RATIO),
            ("corrected_scans", "scans with fiducials", CORRECTED_SCANS_RATIO),
        ):
            ratio = correction[part]["position"][kind]["error_ratio"]
            sentences.append(
                f"{name}: over {title}, the median position error is {format_interval(ratio)} "
                f"times smaller than the encoders'; {at_least(ratio, goal)}."
            )
        change = correction["all_scans"]["position"][kind]["p95_minus_kinematic"]
        sentences.append(
            f"{name}: the 95th percentile of the position error is that of the prediction "
            f"{format_interval(change, 1e3, sign='+')} mm; {is_not_worse(change)}."
        )
        for score, title in SCORES.items():
            closed = same_scans["gap_closed"][kind][score]
            sentences.append(
                f"{name}: of the difference in {title} between encoders and exact poses "
                f"{format_interval(closed)} is closed; {at_least(closed, GAP_CLOSED)}."
            )
    return sentences


def at_least(interval: dict[str, float], goal: float) -> str:
    """Whether a value reaches a goal, by its 95 % interval."""
    if interval["low"] >= goal:
        return f"the goal of {goal:g} is reached"
    if interval["high"] < goal:
        return f"the goal of {goal:g} is missed"
    return f"the interval does not decide whether it is {goal:g}"


def is_not_worse(change: dict[str, float]) -> str:
    """Whether an error has not grown, by the 95 % interval of its change."""
    if change["high"] <= 0.0:
        return "it is smaller"
    if change["low"] > 0.0:
        return "it is larger"
    return "no difference is shown"
