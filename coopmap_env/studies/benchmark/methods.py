"""What the comparison of learned policies and planners is made of, as data.

An `Method` is an algorithm: a planner, or a learned policy with its training runs. A `Condition` is
a set of worlds that entries meet. Learned policies are found by entry point, like any other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

EnvArguments = Mapping[str, Any]
"""Of an environment's constructor, as JSON values."""

LEARNED = "learned"
RATING = "rating function"
COVERAGE = "coverage"
FAMILIES = (LEARNED, RATING, "information gain", COVERAGE, "other")
"""Kinds of entries, which share a colour."""
TRAINING_SEEDS = (0, 1, 2)
"""Of the models that are shipped: the runs of one algorithm."""
N_CANDIDATES = 32
"""On offer when the models were trained, and to planners beside them."""
STANDARD_TEAM: EnvArguments = {"n_robots": 2, "max_scans": 16, "split": "test", "reward": "rating"}
"""Two robots of 16 scans each. The reward sums up the planner's own objective, whoever plays."""
POSE_MODE: EnvArguments = {"action_mode": "pose"}
"""Any pose: planners search by themselves."""
REFERENCE = "rating function, m = 100"
"""The paper's planner with its search of 100 random poses, m of the field's default as well."""


def with_n_candidates(n_candidates: int) -> EnvArguments:
    """Arguments of an environment that offers so many candidates."""
    return {"action_mode": "candidates", "n_candidates": n_candidates}


@dataclass(frozen=True)
class Method:
    """One algorithm of a comparison."""

    label: str
    policy_specs: tuple[str, ...]
    """Policies as `make_policy` takes them: one for each training run, one of a planner."""
    arguments: EnvArguments
    """Of the environment, besides those of the condition."""
    family: str
    """One of `FAMILIES`."""
    plotted: bool = False
    """Whether its curves are drawn; the table has all."""

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise ValueError(f"family must be one of {', '.join(FAMILIES)}, got {self.family!r}")
        if not self.policy_specs:
            raise ValueError(f"entry {self.label!r} needs at least one policy")

    @property
    def uses_candidates(self) -> bool:
        """Whether it chooses among poses on offer."""
        return self.arguments.get("action_mode") == "candidates"


@dataclass(frozen=True)
class Condition:
    """A set of worlds, and who meets them."""

    label: str
    """What is special about it."""
    world: str
    """"planar" or "field"."""
    n_worlds: int
    """Worlds of the split, from seed 0 on."""
    arguments: EnvArguments
    """Of the environment, for all entries."""
    methods: tuple[Method, ...]

    def __post_init__(self) -> None:
        if self.n_worlds < 2:
            raise ValueError(f"n_worlds must be at least 2 for an interval, got {self.n_worlds}")
        labels = [method.label for method in self.methods]
        if repeated := {label for label in labels if labels.count(label) > 1}:
            raise ValueError(f"labels must differ, {sorted(repeated)} are there more than once")

    def baseline_for(self, method: Method) -> Method | None:
        """The rating function on as many candidates; else, and for it itself, `REFERENCE`."""
        same = (
            other
            for other in self.methods
            if other.policy_specs == ("rating_function",) and other.arguments == method.arguments
        )
        found = next(same, None) if method.uses_candidates else None
        if found is None or found == method:
            found = next((other for other in self.methods if other.label == REFERENCE), None)
        return None if found == method else found

    def compared_methods(self, method: Method) -> list[Method]:
        """Whom an entry is compared with: baseline, planners that choose as it does, `REFERENCE`.

        Planners on any pose are compared with the baseline only; there are many of them.
        """
        baseline = self.baseline_for(method)
        compared = [baseline] if baseline else []
        for other in self.methods:
            chooses = method.uses_candidates or method.family == LEARNED
            same = chooses and other.arguments == method.arguments
            other_is_compared = (same and other.family != LEARNED) or other.label == REFERENCE
            if other_is_compared and other != method and other not in compared:
                compared.append(other)
        return compared


@dataclass(frozen=True)
class BenchmarkSize:
    """Numbers of worlds."""

    planar: int
    field: int
    generalization_planar: int
    """Of each condition that the policies were not trained for."""
    generalization_field: int


FULL = BenchmarkSize(100, 100, 100, 20)
QUICK = BenchmarkSize(4, 2, 2, 2)


@dataclass(frozen=True)
class BenchmarkPlan:
    """All conditions of the comparison."""

    main: tuple[Condition, ...]
    """At most one of each world."""
    generalization: tuple[Condition, ...]
    """Generalisation: what policies were not trained for, and what they were, to compare with."""


def make_plan(size: BenchmarkSize, worlds: Sequence[str]) -> BenchmarkPlan:
    """The comparison in these worlds, "planar", "field" or both.

    Raises
    ------
    ValueError
        If there is no world, or one is neither of the two.
    """
    if not worlds or (unknown := set(worlds) - {"planar", "field"}):
        named = ", ".join(sorted(unknown)) if worlds else "none"
        raise ValueError(f"worlds must be planar, field or both, got {named}")
    main, generalization = [], []
    if "planar" in worlds:
        main.append(
            Condition("all policies", "planar", size.planar, STANDARD_TEAM, planar_methods())
        )
        generalization += planar_generalization(size.generalization_planar)
    if "field" in worlds:
        main.append(Condition("all policies", "field", size.field, STANDARD_TEAM, field_methods()))
        generalization += field_generalization(size.generalization_field)
    return BenchmarkPlan(tuple(main), tuple(generalization))


def planar_methods() -> tuple[Method, ...]:
    """Everybody in the plane."""
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
    """Everybody in the field."""
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
    """Other teams, worlds and lengths of an episode in the plane."""

    def blocks(**fields: Any) -> EnvArguments:
        return {"scene": {"name": "obstacles", **fields}}

    cases: dict[str, EnvArguments] = {
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
    """Other teams and worlds in the field."""
    cases: dict[str, EnvArguments] = {
        "as trained": {},
        **{team_label(n): {"n_robots": n} for n in (1, 3)},
        "clutter": {"scene": "clutter"},
        "rubble": {"scene": "rubble"},
    }
    return _generalization("field", "field-candidates", cases, n_worlds)


def team_label(n_robots: int) -> str:
    """What a condition with so many robots is called."""
    return f"{n_robots} robot{'s' if n_robots > 1 else ''}"


def learned_method(
    model: str, label: str, arguments: EnvArguments, plotted: bool = False
) -> Method:
    """A shipped model, with all of its training runs."""
    policy_specs = tuple(f"learned:model={model}+seed={seed}" for seed in TRAINING_SEEDS)
    return Method(label, policy_specs, arguments, LEARNED, plotted)


def planner_method(spec: str, arguments: EnvArguments, plotted: bool = False) -> Method:
    """A planner, labelled by what its spec and the candidates on offer say."""
    name, _, options = spec.partition(":")
    words = [name.replace("_", " ")]
    family = words[0] if words[0] in FAMILIES else "other"
    if "n_candidates" in arguments:
        words.append(f"{arguments['n_candidates']} candidates")
    for option in filter(None, options.split("+")):
        value = option.partition("=")[2]
        words.append(f"m = {value}" if value.isdigit() else value)
    return Method(", ".join(words), (spec,), arguments, family, plotted)


def _generalization(
    world: str,
    model: str,
    cases: Mapping[str, EnvArguments],
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
        Condition(label, world, n_worlds, {**STANDARD_TEAM, **case}, methods)
        for label, case in cases.items()
    ]
