"""What the comparison of learned policies and planners is made of, as data.

An `Entry` is an algorithm: a planner, or a learned policy with its training runs. A `Condition` is
a set of worlds that entries meet. Learned policies are found by entry point, like any other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

Arguments = Mapping[str, Any]
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
TEAM: Arguments = {"n_robots": 2, "max_scans": 16, "split": "test", "reward": "rating"}
"""Two robots of 16 scans each. The reward sums up the planner's own objective, whoever plays."""
POSES: Arguments = {"action_mode": "pose"}
"""Any pose: planners search by themselves."""
REFERENCE = "rating function, m = 100"
"""The paper's planner with its search of 100 random poses, m of the field's default as well."""


def among(n_candidates: int) -> Arguments:
    """Arguments of an environment that offers so many candidates."""
    return {"action_mode": "candidates", "n_candidates": n_candidates}


@dataclass(frozen=True)
class Entry:
    """One algorithm of a comparison."""

    label: str
    specs: tuple[str, ...]
    """Policies as `make_policy` takes them: one for each training run, one of a planner."""
    arguments: Arguments
    """Of the environment, besides those of the condition."""
    family: str
    """One of `FAMILIES`."""
    pictured: bool = False
    """Whether its curves are drawn; the table has all."""

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise ValueError(f"family must be one of {', '.join(FAMILIES)}, got {self.family!r}")
        if not self.specs:
            raise ValueError(f"entry {self.label!r} needs at least one policy")

    @property
    def chooses_candidates(self) -> bool:
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
    arguments: Arguments
    """Of the environment, for all entries."""
    entries: tuple[Entry, ...]

    def __post_init__(self) -> None:
        if self.n_worlds < 2:
            raise ValueError(f"n_worlds must be at least 2 for an interval, got {self.n_worlds}")
        labels = [entry.label for entry in self.entries]
        if twice := {label for label in labels if labels.count(label) > 1}:
            raise ValueError(f"labels must differ, {sorted(twice)} are there more than once")

    def baseline_of(self, entry: Entry) -> Entry | None:
        """The rating function on as many candidates; else, and for it itself, `REFERENCE`."""
        same = (
            other
            for other in self.entries
            if other.specs == ("rating_function",) and other.arguments == entry.arguments
        )
        found = next(same, None) if entry.chooses_candidates else None
        if found is None or found == entry:
            found = next((other for other in self.entries if other.label == REFERENCE), None)
        return None if found == entry else found

    def rivals_of(self, entry: Entry) -> list[Entry]:
        """Whom an entry is compared with: baseline, planners that choose as it does, `REFERENCE`.

        Planners on any pose are compared with the baseline only; there are many of them.
        """
        baseline = self.baseline_of(entry)
        rivals = [baseline] if baseline else []
        for other in self.entries:
            chooses = entry.chooses_candidates or entry.family == LEARNED
            same = chooses and other.arguments == entry.arguments
            rival = (same and other.family != LEARNED) or other.label == REFERENCE
            if rival and other != entry and other not in rivals:
                rivals.append(other)
        return rivals


@dataclass(frozen=True)
class PolicySize:
    """Numbers of worlds."""

    planar: int
    field: int
    elsewhere_planar: int
    """Of each condition that the policies were not trained for."""
    elsewhere_field: int


FULL = PolicySize(100, 100, 100, 20)
QUICK = PolicySize(4, 2, 2, 2)


@dataclass(frozen=True)
class Plan:
    """All conditions of the comparison."""

    main: tuple[Condition, ...]
    """At most one of each world."""
    elsewhere: tuple[Condition, ...]
    """Generalisation: what policies were not trained for, and what they were, to compare with."""


def plan(size: PolicySize, worlds: Sequence[str]) -> Plan:
    """The comparison in these worlds, "planar", "field" or both.

    Raises
    ------
    ValueError
        If there is no world, or one is neither of the two.
    """
    if not worlds or (unknown := set(worlds) - {"planar", "field"}):
        named = ", ".join(sorted(unknown)) if worlds else "none"
        raise ValueError(f"worlds must be planar, field or both, got {named}")
    main, elsewhere = [], []
    if "planar" in worlds:
        main.append(Condition("all policies", "planar", size.planar, TEAM, planar_entries()))
        elsewhere += planar_elsewhere(size.elsewhere_planar)
    if "field" in worlds:
        main.append(Condition("all policies", "field", size.field, TEAM, field_entries()))
        elsewhere += field_elsewhere(size.elsewhere_field)
    return Plan(tuple(main), tuple(elsewhere))


def planar_entries() -> tuple[Entry, ...]:
    """Everybody in the plane."""
    model = "planar-candidates"
    offered = among(N_CANDIDATES)
    return (
        learned(model, f"learned, {N_CANDIDATES} candidates", offered, pictured=True),
        learned(
            "planar-candidates-rating",
            f"learned on the rating, {N_CANDIDATES} candidates",
            offered,
            pictured=True,
        ),
        planner("rating_function", offered, pictured=True),
        planner("rating_function:coordination=sequential", offered),
        planner("information_gain", offered, pictured=True),
        planner("coverage", offered, pictured=True),
        *(
            entry
            for m in (100, 300)
            for entry in (
                learned(model, f"learned, {m} candidates", among(m)),
                planner("rating_function", among(m)),
                planner("coverage", among(m)),
            )
        ),
        learned("planar-pose", "learned, poses", POSES, pictured=True),
        *(
            planner(f"rating_function:search={m}", POSES, pictured=m == 100)
            for m in (10, 50, 100, 200, 300, "exhaustive")
        ),
        planner("rating_function:search=100+coordination=sequential", POSES),
        planner("information_gain:search=100", POSES),
        planner("coverage:search=100", POSES),
        planner("frontier", POSES, pictured=True),
        planner("raster", POSES),
        planner("random", POSES, pictured=True),
    )


def field_entries() -> tuple[Entry, ...]:
    """Everybody in the field."""
    offered = among(N_CANDIDATES)
    return (
        learned("field-candidates", f"learned, {N_CANDIDATES} candidates", offered, pictured=True),
        planner("rating_function", offered, pictured=True),
        planner("information_gain", offered, pictured=True),
        planner("coverage", offered, pictured=True),
        planner("rating_function:search=100", POSES, pictured=True),
        planner("rating_function:search=300", POSES),
        planner("rating_function:search=100+coordination=sequential", POSES),
        planner("coverage:search=100", POSES),
        planner("frontier", POSES, pictured=True),
        planner("raster", POSES),
        planner("random", POSES, pictured=True),
    )


def planar_elsewhere(n_worlds: int) -> list[Condition]:
    """Other teams, worlds and lengths of an episode in the plane."""

    def blocks(**fields: Any) -> Arguments:
        return {"scene": {"name": "obstacles", **fields}}

    cases: dict[str, Arguments] = {
        "as trained": {},
        **{team_of(n): {"n_robots": n} for n in (1, 3, 4, 5)},
        "150 x 150 cells": blocks(shape=[150, 150]),
        "half the obstacles": blocks(occupied_share=0.06),
        "twice the obstacles": blocks(occupied_share=0.24),
        "rooms": {"scene": "rooms"},
        "a real house": {"scene": "house"},
        "32 scans each": {"max_scans": 32},
    }
    poses = (
        learned("planar-pose", "learned, poses", POSES),
        planner("rating_function:search=100", POSES),
    )
    return _elsewhere("planar", "planar-candidates", cases, n_worlds, poses)


def field_elsewhere(n_worlds: int) -> list[Condition]:
    """Other teams and worlds in the field."""
    cases: dict[str, Arguments] = {
        "as trained": {},
        **{team_of(n): {"n_robots": n} for n in (1, 3)},
        "clutter": {"scene": "clutter"},
        "rubble": {"scene": "rubble"},
    }
    return _elsewhere("field", "field-candidates", cases, n_worlds)


def team_of(n_robots: int) -> str:
    """What a condition with so many robots is called."""
    return f"{n_robots} robot{'s' if n_robots > 1 else ''}"


def learned(model: str, label: str, arguments: Arguments, pictured: bool = False) -> Entry:
    """A shipped model, with all of its training runs."""
    specs = tuple(f"learned:model={model}+seed={seed}" for seed in TRAINING_SEEDS)
    return Entry(label, specs, arguments, LEARNED, pictured)


def planner(spec: str, arguments: Arguments, pictured: bool = False) -> Entry:
    """A planner, labelled by what its spec and the candidates on offer say."""
    name, _, options = spec.partition(":")
    words = [name.replace("_", " ")]
    family = words[0] if words[0] in FAMILIES else "other"
    if "n_candidates" in arguments:
        words.append(f"{arguments['n_candidates']} candidates")
    for option in filter(None, options.split("+")):
        value = option.partition("=")[2]
        words.append(f"m = {value}" if value.isdigit() else value)
    return Entry(", ".join(words), (spec,), arguments, family, pictured)


def _elsewhere(
    world: str,
    model: str,
    cases: Mapping[str, Arguments],
    n_worlds: int,
    others: tuple[Entry, ...] = (),
) -> list[Condition]:
    offered = among(N_CANDIDATES)
    entries = (
        learned(model, f"learned, {N_CANDIDATES} candidates", offered),
        planner("rating_function", offered),
        planner("coverage", offered),
        *others,
    )
    return [
        Condition(label, world, n_worlds, {**TEAM, **case}, entries)
        for label, case in cases.items()
    ]
