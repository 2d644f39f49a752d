"""Verdicts: what the intervals of differences allow to say, as sentences.

An opponent is named by its policy spec, so that anyone can play it with `coopmap evaluate`.
"""

from __future__ import annotations

from typing import Any

from coopmap_env.evaluation.statistics import Interval
from coopmap_env.evaluation.tables import format_interval
from coopmap_env.studies.benchmark.families import SEARCH_POSES
from coopmap_env.studies.benchmark.methods import (
    ALL_PLANNERS,
    LEARNED,
    POSE_MODE,
    verdict_scores,
)

SCORE_TEXTS = {
    "coverage_auc": ("area under the coverage curve", 100.0, "points"),
    "surface_coverage_auc": ("area under the surface coverage curve", 100.0, "points"),
    "reward": ("reward", 1.0, "nats"),
}
"""Name, factor and unit of the scores in verdicts."""
ENV_LABELS = {"planar": "Planar-v1", "field": "Field-v1"}


def interval_verdict(interval: Interval) -> str:
    """What the interval of a difference says: "higher", "lower" or "no difference found"."""
    if interval.low > 0:
        return "higher"
    return "lower" if interval.high < 0 else "no difference found"


def verdicts(condition: dict[str, Any]) -> list[dict[str, Any]]:
    """Differences of learned policies from the strongest planners, with verdicts.

    For each learned method and score: the strongest planner of each family with the same actions,
    and with any pose (of m = 100); the strongest of all comes first. Training worlds have chosen
    them.

    Parameters
    ----------
    condition : dict
        As `condition_summary` makes it.
    """
    return [
        _verdict(condition, learned, opponent, score, is_strongest=rank == 0)
        for learned, method in condition["methods"].items()
        if method["family"] == LEARNED
        for score in verdict_scores(condition["env_name"])
        for opponents in _opponents(condition, method, score)
        for rank, opponent in enumerate(opponents)
    ]


def _opponents(condition: dict[str, Any], method: dict[str, Any], score: str) -> list[list[str]]:
    """Labels of the opponents with the same actions, and of those with any pose if they differ."""
    kinds = [method["env_kwargs"]]
    if method["env_kwargs"] != POSE_MODE:
        kinds.append(dict(POSE_MODE))
    return [
        [
            opponent["label"]
            for opponent in condition["opponents"]
            if (opponent["score"], opponent["env_kwargs"]) == (score, kind)
        ]
        for kind in kinds
    ]


def _verdict(
    condition: dict[str, Any], learned: str, opponent: str, score: str, is_strongest: bool
) -> dict[str, Any]:
    ours, theirs = condition["methods"][learned], condition["methods"][opponent]
    comparison = ours["comparisons"][opponent]
    difference = comparison["difference"][score]
    return {
        "env_name": condition["env_name"],
        "worlds": condition["worlds"],
        "score": score,
        "learned": learned,
        "planner": opponent,
        "spec": theirs["policies"][0],
        "same_actions": comparison["same_env_kwargs"],
        "is_strongest": is_strongest,
        "difference": difference,
        "runs": comparison["difference_by_run"][score],
        "verdict": interval_verdict(Interval(**difference)),
    }


def verdict_sentence(verdict: dict[str, Any]) -> str:
    """A verdict in words."""
    return _sentence(verdict, f"`{verdict['spec']}` with {actions_text(verdict)}")


def actions_text(verdict: dict[str, Any]) -> str:
    """The opponent's actions. Planners with another number of poses do not compete."""
    return "the same actions" if verdict["same_actions"] else f"any pose (m = {SEARCH_POSES})"


def equal_motion_sentence(verdict: dict[str, Any]) -> str:
    """A verdict at equal motion in words; see `sweep_summary`."""
    where = "at equal motion" if verdict["is_equal"] else "with less motion"
    return _sentence(verdict, f"{verdict['planners']} {where} ({verdict['motion']:.0f})")


def _sentence(verdict: dict[str, Any], opponent: str) -> str:
    name, scale, unit = SCORE_TEXTS[verdict["score"]]
    learned = verdict["learned"]
    if verdict["verdict"] == "no difference found":
        finding = f"no difference found between {learned} and {opponent}"
    else:
        finding = f"{learned} is {verdict['verdict']} than {opponent}"
    difference = format_interval(verdict["difference"], scale, sign="+")
    where = f"{ENV_LABELS[verdict['env_name']]}, {verdict['worlds']} worlds"
    return f"{where}, {name}: {finding}, {difference} {unit} per world."


def headlines(summary: dict[str, Any]) -> list[str]:
    """Sentences about the first learned method of each kind of actions, in each environment.

    By each score: compared with the strongest planner of all families with the same actions, with
    the strongest with any pose, and with all planners of the sweep at equal motion.
    """
    lines = []
    for part in summary["main"]:
        for learned in _first_learned(part):
            for score in verdict_scores(part["env_name"]):
                topic = {"env_name": part["env_name"], "learned": learned, "score": score}
                lines += [
                    verdict_sentence(verdict)
                    for verdict in summary["verdicts"]
                    if topic.items() <= verdict.items() and verdict["is_strongest"]
                ]
                lines += [
                    equal_motion_sentence(verdict)
                    for sweep in summary["sweeps"]
                    for verdict in sweep["equal_motion"]
                    if topic.items() <= verdict.items() and verdict["planners"] == ALL_PLANNERS
                ]
    return lines


def _first_learned(part: dict[str, Any]) -> list[str]:
    """Labels of the first learned methods that choose among candidates, and among any poses."""
    first: dict[str, str] = {}
    for label, method in part["methods"].items():
        if method["family"] == LEARNED:
            first.setdefault(method["env_kwargs"]["action_mode"], label)
    return list(first.values())
