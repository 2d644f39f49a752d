"""The methods and conditions of the comparison of learned policies and planners, as data.

A `Method` is an algorithm: a planner, or a learned policy with its training runs. A `Condition` is
a set of worlds on which methods are compared, with the `Opponent` of each family and score. Learned
policies are found by entry point, like planners.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

EnvKwargs = Mapping[str, Any]
"""Arguments of an environment's constructor, as JSON values."""

LEARNED = "learned"
CLAIRVOYANT = "clairvoyant"
"""References that know the true world."""
FAMILIES = (
    LEARNED, "rating function", "information gain", "coverage", "frontier", "other", CLAIRVOYANT,
)  # fmt: skip
"""Families of methods; methods of a family share a colour."""
ALL_PLANNERS = "the planners"
"""All families of planners together."""
TRAINING_SEEDS = (0, 1, 2)
"""Training runs of each pretrained policy."""
STANDARD_TEAM: EnvKwargs = {"n_robots": 2, "max_scans": 16, "split": "test", "reward": "rating"}
"""Two robots of 16 scans each. The reward is the planner's own objective, for every method."""
POSE_MODE: EnvKwargs = {"action_mode": "pose"}
"""Actions are any pose; planners search by themselves."""

AREAS = {"planar": ("coverage_auc",), "field": ("surface_coverage_auc", "coverage_auc")}
"""Areas under coverage curves, by environment; the first belongs to the drawn curve."""
REWARD = "reward"
"""The planner's own objective; verdicts are about it and about the areas."""
MOTION = "motion_distance"
"""d of Eq. 5, summed over an episode."""


def verdict_scores(env_name: str) -> tuple[str, ...]:
    """Scores for which opponents are chosen and verdicts given; larger is better for each."""
    return (*AREAS[env_name], REWARD)


def with_n_candidates(n_candidates: int) -> EnvKwargs:
    """Arguments of an environment whose actions are candidates."""
    return {"action_mode": "candidates", "n_candidates": n_candidates}


@dataclass(frozen=True)
class Method:
    """One algorithm of the comparison."""

    label: str
    policy_specs: tuple[str, ...]
    """Specs for `make_policy`: one for each training run; a planner has one. Of a clairvoyant
    reference, its name in `coopmap_env.studies.clairvoyant`."""
    env_kwargs: EnvKwargs
    """Arguments of the environment, in addition to those of the condition."""
    family: str
    """One of `FAMILIES`."""
    plotted: bool = field(default=False, compare=False)
    """Whether its curves are drawn; tables have all methods."""

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise ValueError(f"family must be one of {', '.join(FAMILIES)}, got {self.family!r}")
        if not self.policy_specs:
            raise ValueError(f"method {self.label!r} needs at least one policy")


@dataclass(frozen=True)
class Opponent:
    """The strongest planner of a family by one score, as training worlds have shown it."""

    score: str
    method: Method
    training_mean: float
    """Mean score on the training worlds."""
    training_worlds: int
    """Number of the training worlds."""


@dataclass(frozen=True)
class MotionLine:
    """Planners that are the opponents at equal motion, as training worlds have shown them.

    They are the upper concave hull of score against motion, from the least motion to the best
    score; see `equal_motion`.
    """

    family: str
    """One of `FAMILIES`, or `ALL_PLANNERS`."""
    score: str
    methods: tuple[Method, ...]
    training_worlds: int
    """Number of the training worlds."""


@dataclass(frozen=True)
class Condition:
    """A set of worlds, and the methods that are compared on them."""

    label: str
    """What distinguishes it from the others."""
    env_name: str
    """"planar" or "field"."""
    n_worlds: int
    """Worlds of the test split, with seeds from 0."""
    env_kwargs: EnvKwargs
    """Arguments of the environment, for all methods."""
    methods: tuple[Method, ...]
    opponents: tuple[Opponent, ...] = ()
    """Their methods are among `methods`."""
    lines: tuple[MotionLine, ...] = ()
    """Opponents at equal motion; their methods are among `methods`."""

    def __post_init__(self) -> None:
        if self.n_worlds < 2:
            raise ValueError(f"n_worlds must be at least 2 for an interval, got {self.n_worlds}")
        labels = [method.label for method in self.methods]
        if repeated := {label for label in labels if labels.count(label) > 1}:
            raise ValueError(f"labels must differ, {sorted(repeated)} occur more than once")
        needed = {opponent.method.label for opponent in self.opponents}
        needed |= {method.label for line in self.lines for method in line.methods}
        if missing := needed - set(labels):
            raise ValueError(f"opponents must be among the methods, {sorted(missing)} are not")

    def opponents_by(self, score: str, env_kwargs: EnvKwargs) -> list[Opponent]:
        """The strongest planner of each family with these actions, the strongest one first."""
        same = [
            opponent
            for opponent in self.opponents
            if opponent.score == score and opponent.method.env_kwargs == env_kwargs
        ]
        return sorted(same, key=lambda opponent: -opponent.training_mean)

    def baseline_for(self, method: Method) -> Method | None:
        """The strongest planner with the same actions, by the area of the drawn curve.

        The same actions are the same candidates, or any pose. None for that planner itself.
        """
        opponents = self.opponents_by(AREAS[self.env_name][0], method.env_kwargs)
        baseline = opponents[0].method if opponents else None
        return None if baseline == method else baseline

    def compared_methods(self, method: Method) -> list[Method]:
        """Methods to compare with, the baseline first.

        A learned method is compared with all planners of the same actions, and with the opponents
        that choose any pose; another method with its baseline only.
        """
        baseline = self.baseline_for(method)
        compared = [baseline] if baseline else []
        if method.family == LEARNED:
            compared += [
                other
                for other in self.methods
                if other.env_kwargs == method.env_kwargs
                and other.family not in (LEARNED, CLAIRVOYANT)
            ]
            compared += [
                opponent.method
                for opponent in self.opponents
                if opponent.method.env_kwargs == POSE_MODE
            ]
        return list(unique_methods(compared))


def unique_methods(methods: Iterable[Method]) -> tuple[Method, ...]:
    """The methods without those whose label occurred before."""
    by_label: dict[str, Method] = {}
    for method in methods:
        by_label.setdefault(method.label, method)
    return tuple(by_label.values())


def learned_method(model: str, label: str, env_kwargs: EnvKwargs, plotted: bool = False) -> Method:
    """A pretrained policy, with all of its training runs."""
    policy_specs = tuple(f"learned:model={model}+seed={seed}" for seed in TRAINING_SEEDS)
    return Method(label, policy_specs, env_kwargs, LEARNED, plotted)


def predicting_method(
    spec: str, label: str, env_kwargs: EnvKwargs, plotted: bool = False
) -> Method:
    """A planner on maps that a pretrained network completes: it is learned, too."""
    return Method(label, (spec,), env_kwargs, LEARNED, plotted)


def clairvoyant_method(name: str) -> Method:
    """A reference that knows the true planar world."""
    return Method(name, (name,), POSE_MODE, CLAIRVOYANT)


def planner_method(spec: str, env_kwargs: EnvKwargs, plotted: bool = False) -> Method:
    """A planner, labelled by its spec and the number of candidates."""
    name, _, options = spec.partition(":")
    words = [name.replace("_", " ")]
    family = words[0] if words[0] in FAMILIES else "other"
    if "n_candidates" in env_kwargs:
        words.append(f"{env_kwargs['n_candidates']} candidates")
    for option in filter(None, options.split("+")):
        key, _, value = option.partition("=")
        if key == "motion_weight":
            words.append(f"motion weight {value}")
        else:
            words.append(f"m = {value}" if value.isdigit() else value)
    return Method(", ".join(words), (spec,), env_kwargs, family, plotted)
