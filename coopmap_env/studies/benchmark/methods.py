"""The methods and conditions of the comparison of learned policies and planners, as data.

A `Method` is an algorithm: a planner, or a learned policy with its training runs. A `Condition` is
a set of worlds on which methods are compared. Learned policies are found by entry point, like
planners.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from coopmap_env.core.settings import PositiveInt, Settings

EnvKwargs = Mapping[str, Any]
"""Arguments of an environment's constructor, as JSON values."""

LEARNED = "learned"
RATING = "rating function"
COVERAGE = "coverage"
FAMILIES = (LEARNED, RATING, "information gain", COVERAGE, "other")
"""Families of methods; methods of a family share a colour."""
TRAINING_SEEDS = (0, 1, 2)
"""Training runs of each pretrained policy."""
N_CANDIDATES = 32
"""Number of candidates with which the policies were trained, and of the planners beside them."""
STANDARD_TEAM: EnvKwargs = {"n_robots": 2, "max_scans": 16, "split": "test", "reward": "rating"}
"""Two robots of 16 scans each. The reward is the planner's own objective, for every method."""
POSE_MODE: EnvKwargs = {"action_mode": "pose"}
"""Actions are any pose; planners search by themselves."""
REFERENCE = "rating function, m = 100"
"""The paper's planner with a search over 100 random poses."""


def with_n_candidates(n_candidates: int) -> EnvKwargs:
    """Arguments of an environment whose actions are candidates."""
    return {"action_mode": "candidates", "n_candidates": n_candidates}


@dataclass(frozen=True)
class Method:
    """One algorithm of the comparison."""

    label: str
    policy_specs: tuple[str, ...]
    """Specs for `make_policy`: one for each training run; a planner has one."""
    env_kwargs: EnvKwargs
    """Arguments of the environment, in addition to those of the condition."""
    family: str
    """One of `FAMILIES`."""
    plotted: bool = False
    """Whether its curves are drawn; tables have all methods."""

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise ValueError(f"family must be one of {', '.join(FAMILIES)}, got {self.family!r}")
        if not self.policy_specs:
            raise ValueError(f"method {self.label!r} needs at least one policy")

    @property
    def uses_candidates(self) -> bool:
        """Whether its actions are candidates."""
        return self.env_kwargs.get("action_mode") == "candidates"


@dataclass(frozen=True)
class Condition:
    """A set of worlds, and the methods that are compared on them."""

    label: str
    """What distinguishes it from the others."""
    env_name: str
    """"planar" or "field"."""
    n_worlds: int
    """Worlds of the split, with seeds from 0."""
    env_kwargs: EnvKwargs
    """Arguments of the environment, for all methods."""
    methods: tuple[Method, ...]

    def __post_init__(self) -> None:
        if self.n_worlds < 2:
            raise ValueError(f"n_worlds must be at least 2 for an interval, got {self.n_worlds}")
        labels = [method.label for method in self.methods]
        if repeated := {label for label in labels if labels.count(label) > 1}:
            raise ValueError(f"labels must differ, {sorted(repeated)} occur more than once")

    def baseline_for(self, method: Method) -> Method | None:
        """The rating function on the same candidates if there is one, otherwise `REFERENCE`."""
        same = (
            other
            for other in self.methods
            if other.policy_specs == ("rating_function",) and other.env_kwargs == method.env_kwargs
        )
        baseline = next(same, None) if method.uses_candidates else None
        if baseline is None or baseline == method:
            baseline = next((other for other in self.methods if other.label == REFERENCE), None)
        return None if baseline == method else baseline

    def compared_methods(self, method: Method) -> list[Method]:
        """Methods to compare with: baseline, planners with the same actions, and `REFERENCE`.

        Planners with any pose are compared with the baseline only, because there are many.
        """
        baseline = self.baseline_for(method)
        compared = [baseline] if baseline else []
        for other in self.methods:
            chooses = method.uses_candidates or method.family == LEARNED
            same = chooses and other.env_kwargs == method.env_kwargs
            other_is_compared = (same and other.family != LEARNED) or other.label == REFERENCE
            if other_is_compared and other != method and other not in compared:
                compared.append(other)
        return compared


@dataclass(frozen=True)
class BenchmarkSize(Settings):
    """Numbers of worlds."""

    planar: PositiveInt
    """Worlds of the main condition in the planar environment."""
    field: PositiveInt
    """Worlds of the main condition in the field environment."""
    generalization_planar: PositiveInt
    """Worlds of each condition that differs from the training."""
    generalization_field: PositiveInt


FULL = BenchmarkSize(100, 100, 100, 20)
QUICK = BenchmarkSize(4, 2, 2, 2)


@dataclass(frozen=True)
class BenchmarkPlan:
    """All conditions of the comparison."""

    main: tuple[Condition, ...]
    """At most one of each environment."""
    generalization: tuple[Condition, ...]
    """Conditions that differ from the training, and the training condition for comparison."""


def make_plan(size: BenchmarkSize, env_names: Sequence[str]) -> BenchmarkPlan:
    """Conditions of the comparison in these environments, "planar", "field" or both.

    Raises
    ------
    ValueError
        If there is no environment, or one is neither of the two.
    """
    if not env_names or (unknown := set(env_names) - {"planar", "field"}):
        named = ", ".join(sorted(unknown)) if env_names else "none"
        raise ValueError(f"environments must be planar, field or both, got {named}")
    main, generalization = [], []
    if "planar" in env_names:
        main.append(
            Condition("all policies", "planar", size.planar, STANDARD_TEAM, planar_methods())
        )
        generalization += planar_generalization(size.generalization_planar)
    if "field" in env_names:
        main.append(Condition("all policies", "field", size.field, STANDARD_TEAM, field_methods()))
        generalization += field_generalization(size.generalization_field)
    return BenchmarkPlan(tuple(main), tuple(generalization))


def planar_methods() -> tuple[Method, ...]:
    """Methods of the main condition in the planar environment."""
    model = "planar-candidates"
    candidate_mode = with_n_candidates(N_CANDIDATES)
    return (
        learned_method(model, f"learned, {N_CANDIDATES} candidates", candidate_mode, plotted=True),
        learned_method(
            "planar-candidates-rating",
            f"learned on the rating, {N_CANDIDATES} candidates",
            candidate_mode,
            plotted=True,
        ),
        planner_method("rating_function", candidate_mode, plotted=True),
        planner_method("rating_function:coordination=sequential", candidate_mode),
        planner_method("information_gain", candidate_mode, plotted=True),
        planner_method("coverage", candidate_mode, plotted=True),
        *(
            method
            for m in (100, 300)
            for method in (
                learned_method(model, f"learned, {m} candidates", with_n_candidates(m)),
                planner_method("rating_function", with_n_candidates(m)),
                planner_method("coverage", with_n_candidates(m)),
            )
        ),
        learned_method("planar-pose", "learned, poses", POSE_MODE, plotted=True),
        *(
            planner_method(f"rating_function:search={m}", POSE_MODE, plotted=m == 100)
            for m in (10, 50, 100, 200, 300, "exhaustive")
        ),
        planner_method("rating_function:search=100+coordination=sequential", POSE_MODE),
        planner_method("information_gain:search=100", POSE_MODE),
        planner_method("coverage:search=100", POSE_MODE),
        planner_method("frontier", POSE_MODE, plotted=True),
        planner_method("raster", POSE_MODE),
        planner_method("random", POSE_MODE, plotted=True),
    )


def field_methods() -> tuple[Method, ...]:
    """Methods of the main condition in the field environment."""
    candidate_mode = with_n_candidates(N_CANDIDATES)
    return (
        learned_method(
            "field-candidates", f"learned, {N_CANDIDATES} candidates", candidate_mode, plotted=True
        ),
        planner_method("rating_function", candidate_mode, plotted=True),
        planner_method("information_gain", candidate_mode, plotted=True),
        planner_method("coverage", candidate_mode, plotted=True),
        planner_method("rating_function:search=100", POSE_MODE, plotted=True),
        planner_method("rating_function:search=300", POSE_MODE),
        planner_method("rating_function:search=100+coordination=sequential", POSE_MODE),
        planner_method("coverage:search=100", POSE_MODE),
        planner_method("frontier", POSE_MODE, plotted=True),
        planner_method("raster", POSE_MODE),
        planner_method("random", POSE_MODE, plotted=True),
    )


def planar_generalization(n_worlds: int) -> list[Condition]:
    """Other teams, scenes and episode lengths in the planar environment."""

    def blocks(**fields: Any) -> EnvKwargs:
        return {"scene": {"name": "obstacles", **fields}}

    cases: dict[str, EnvKwargs] = {
        "as trained": {},
        **{team_label(n): {"n_robots": n} for n in (1, 3, 4, 5)},
        "150 x 150 cells": blocks(shape=[150, 150]),
        "half the obstacles": blocks(occupied_fraction=0.06),
        "twice the obstacles": blocks(occupied_fraction=0.24),
        "rooms": {"scene": "rooms"},
        "a real house": {"scene": "house"},
        "32 scans each": {"max_scans": 32},
    }
    poses = (
        learned_method("planar-pose", "learned, poses", POSE_MODE),
        planner_method("rating_function:search=100", POSE_MODE),
    )
    return _generalization("planar", "planar-candidates", cases, n_worlds, poses)


def field_generalization(n_worlds: int) -> list[Condition]:
    """Other teams and scenes in the field environment."""
    cases: dict[str, EnvKwargs] = {
        "as trained": {},
        **{team_label(n): {"n_robots": n} for n in (1, 3)},
        "clutter": {"scene": "clutter"},
        "rubble": {"scene": "rubble"},
    }
    return _generalization("field", "field-candidates", cases, n_worlds)


def team_label(n_robots: int) -> str:
    """Label of a condition with this number of robots."""
    return f"{n_robots} robot{'s' if n_robots > 1 else ''}"


def learned_method(model: str, label: str, env_kwargs: EnvKwargs, plotted: bool = False) -> Method:
    """A pretrained policy, with all of its training runs."""
    policy_specs = tuple(f"learned:model={model}+seed={seed}" for seed in TRAINING_SEEDS)
    return Method(label, policy_specs, env_kwargs, LEARNED, plotted)


def planner_method(spec: str, env_kwargs: EnvKwargs, plotted: bool = False) -> Method:
    """A planner, labelled by its spec and the number of candidates."""
    name, _, options = spec.partition(":")
    words = [name.replace("_", " ")]
    family = words[0] if words[0] in FAMILIES else "other"
    if "n_candidates" in env_kwargs:
        words.append(f"{env_kwargs['n_candidates']} candidates")
    for option in filter(None, options.split("+")):
        value = option.partition("=")[2]
        words.append(f"m = {value}" if value.isdigit() else value)
    return Method(", ".join(words), (spec,), env_kwargs, family, plotted)


def _generalization(
    env_name: str,
    model: str,
    cases: Mapping[str, EnvKwargs],
    n_worlds: int,
    others: tuple[Method, ...] = (),
) -> list[Condition]:
    candidate_mode = with_n_candidates(N_CANDIDATES)
    methods = (
        learned_method(model, f"learned, {N_CANDIDATES} candidates", candidate_mode),
        planner_method("rating_function", candidate_mode),
        planner_method("coverage", candidate_mode),
        *others,
    )
    return [
        Condition(label, env_name, n_worlds, {**STANDARD_TEAM, **case}, methods)
        for label, case in cases.items()
    ]
