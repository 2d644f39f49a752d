"""The plan of the comparison: which methods play under which conditions, on how many worlds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from coopmap_env.core.settings import PositiveInt, Settings
from coopmap_env.studies.benchmark.families import (
    COORDINATIONS,
    MOTION_WEIGHTS,
    SEARCHING,
    planner_spec,
    sweep_specs,
)
from coopmap_env.studies.benchmark.methods import (
    AREAS,
    LEARNED,
    POSE_MODE,
    STANDARD_TEAM,
    Condition,
    EnvKwargs,
    Method,
    clairvoyant_method,
    learned_method,
    planner_method,
    predicting_method,
    unique_methods,
    with_n_candidates,
)
from coopmap_env.studies.benchmark.tuned_planners import (
    TunedCase,
    find_case,
    read_record,
    record_notes,
)

N_CANDIDATES = 32
"""Number of candidates with which the policies were trained, and of the planners beside them."""
CANDIDATE_MODE = with_n_candidates(N_CANDIDATES)


@dataclass(frozen=True)
class BenchmarkSize(Settings):
    """Numbers of worlds."""

    planar: PositiveInt
    """Worlds of the main condition in the planar environment."""
    field: PositiveInt
    """Worlds of the main condition in the field environment."""
    sweep_planar: PositiveInt
    """Worlds on which every planner of the sweep plays."""
    sweep_field: PositiveInt
    generalization_planar: PositiveInt
    """Worlds of each condition that differs from the training."""
    generalization_field: PositiveInt

    def at_most(self, n_worlds: int) -> BenchmarkSize:
        """The same size with at most this many worlds for each condition."""
        return BenchmarkSize(**{name: min(n, n_worlds) for name, n in asdict(self).items()})


FULL = BenchmarkSize(
    planar=100,
    field=50,
    sweep_planar=100,
    sweep_field=20,
    generalization_planar=50,
    generalization_field=20,
)
"""About an hour on two cores."""
QUICK = BenchmarkSize(
    planar=4,
    field=2,
    sweep_planar=4,
    sweep_field=2,
    generalization_planar=2,
    generalization_field=2,
)


@dataclass(frozen=True)
class BenchmarkPlan:
    """All conditions of the comparison."""

    main: tuple[Condition, ...]
    """At most one of each environment."""
    sweeps: tuple[Condition, ...] = ()
    """The same worlds with all motion weights of all families, to compare at equal motion."""
    generalization: tuple[Condition, ...] = ()
    """Conditions that differ from the training, and the training condition for comparison."""
    notes: tuple[str, ...] = ()
    """What readers of the results have to know about the opponents; see `record_notes`."""


def make_plan(
    size: BenchmarkSize, env_names: Sequence[str], tuned: tuple[TunedCase, ...] | None = None
) -> BenchmarkPlan:
    """Conditions of the comparison.

    Parameters
    ----------
    size : BenchmarkSize
    env_names : sequence of {"planar", "field"}
    tuned : tuple of TunedCase, optional
        Decides which planners are the opponents; by default the record of the repository.

    Raises
    ------
    ValueError
        If there is no environment, or one is neither of the two.
    """
    if not env_names or (unknown := set(env_names) - {"planar", "field"}):
        named = ", ".join(sorted(unknown)) if env_names else "none"
        raise ValueError(f"environments must be planar, field or both, got {named}")
    cases = read_record() if tuned is None else tuned
    main, sweeps, generalization = [], [], []
    if "planar" in env_names:
        main.append(main_condition("planar", size.planar, PLANAR_METHODS, cases))
        sweeps.append(sweep_condition("planar", size.sweep_planar, PLANAR_METHODS, cases))
        generalization += planar_generalization(size.generalization_planar, cases)
    if "field" in env_names:
        main.append(main_condition("field", size.field, FIELD_METHODS, cases))
        sweeps.append(sweep_condition("field", size.sweep_field, FIELD_METHODS, cases))
        generalization += field_generalization(size.generalization_field, cases)
    notes = record_notes([case for case in cases if case.env_name in env_names])
    return BenchmarkPlan(tuple(main), tuple(sweeps), tuple(generalization), tuple(notes))


PREDICTED_MAP, PREDICTED_SURFACE = (
    predicting_method(f"{spec}:search=100", f"{label}, m = 100", POSE_MODE, plotted=True)
    for spec, label in (
        ("predictive", "predicted map"),
        ("predictive_surface", "predicted surface"),
    )
)
"""They choose among as many poses as the planners beside them."""
PLANAR_CANDIDATES, FIELD_CANDIDATES = (
    learned_method(
        f"{name}-candidates", f"learned, {N_CANDIDATES} candidates", CANDIDATE_MODE, plotted=True
    )
    for name in ("planar", "field")
)
PLANAR_POSES = learned_method("planar-pose", "learned, poses", POSE_MODE, plotted=True)
PLANAR_METHODS = (
    PREDICTED_MAP,
    predicting_method("predictive", f"predicted map, {N_CANDIDATES} candidates", CANDIDATE_MODE),
    PLANAR_CANDIDATES,
    learned_method(
        "planar-candidates-rating",
        f"learned on the rating, {N_CANDIDATES} candidates",
        CANDIDATE_MODE,
        plotted=True,
    ),
    *(
        learned_method("planar-candidates", f"learned, {m} candidates", with_n_candidates(m))
        for m in (100, 300)
    ),
    PLANAR_POSES,
    planner_method("rating_function", CANDIDATE_MODE, plotted=True),
    *(planner_method("rating_function", with_n_candidates(m)) for m in (100, 300)),
    *(
        planner_method(f"rating_function:search={m}", POSE_MODE)
        for m in (10, 50, 100, 200, 300, "exhaustive")
    ),
    planner_method("lookahead:horizon=1+search=100", POSE_MODE),
    planner_method("raster", POSE_MODE),
    planner_method("random", POSE_MODE, plotted=True),
    clairvoyant_method("clairvoyant, greedy"),
)
"""Methods of the main condition, besides the tuned planners."""
FIELD_METHODS = (
    PREDICTED_SURFACE,
    predicting_method(
        "predictive_surface", f"predicted surface, {N_CANDIDATES} candidates", CANDIDATE_MODE
    ),
    FIELD_CANDIDATES,
    planner_method("rating_function", CANDIDATE_MODE, plotted=True),
    planner_method("rating_function:search=100", POSE_MODE),
    planner_method("rating_function:search=300", POSE_MODE),
    planner_method("surface:search=100", POSE_MODE),
    planner_method("raster", POSE_MODE),
    planner_method("random", POSE_MODE, plotted=True),
)


def main_condition(
    env_name: str, n_worlds: int, methods: Sequence[Method], cases: Sequence[TunedCase]
) -> Condition:
    """All methods, with the opponents and with the planners that do not pay for motion."""
    found = [
        case
        for env_kwargs in _different_actions(methods)
        if (case := find_case(cases, env_name, env_kwargs))
    ]
    opponents = tuple(opponent for case in found for opponent in case.opponents())
    drawn = (
        replace(opponent.method, plotted=True)
        for opponent in opponents
        if opponent.score == AREAS[env_name][0] and opponent.method.env_kwargs == CANDIDATE_MODE
    )
    others = (opponent.method for opponent in opponents)
    free = (
        planner_method(planner_spec(family, 0, coordination), CANDIDATE_MODE)
        for family in SEARCHING
        for coordination in COORDINATIONS
    )
    return Condition(
        "all policies",
        env_name,
        n_worlds,
        STANDARD_TEAM,
        unique_methods((*methods, *drawn, *others, *free)),
        opponents,
    )


def sweep_condition(
    env_name: str, n_worlds: int, methods: Sequence[Method], cases: Sequence[TunedCase]
) -> Condition:
    """The learned policies that choose among candidates, and all planners of all families."""
    case = find_case(cases, env_name, CANDIDATE_MODE)
    lines = case.lines() if case else ()
    chosen = (method for line in lines for method in line.methods)
    planners = (
        planner_method(spec, CANDIDATE_MODE)
        for family in MOTION_WEIGHTS[env_name]
        for spec in sweep_specs(family, env_name)
    )
    learned = (
        method
        for method in methods
        if method.family == LEARNED and method.env_kwargs == CANDIDATE_MODE
    )
    return Condition(
        "price of motion",
        env_name,
        n_worlds,
        STANDARD_TEAM,
        unique_methods((*learned, *planners, *chosen)),
        lines=lines,
    )


def _different_actions(methods: Sequence[Method]) -> list[EnvKwargs]:
    actions: list[EnvKwargs] = []
    for method in methods:
        if method.env_kwargs not in actions:
            actions.append(method.env_kwargs)
    return actions


def planar_generalization(n_worlds: int, cases: Sequence[TunedCase]) -> list[Condition]:
    """Other teams, scenes and episode lengths in the planar environment."""

    def blocks(**fields: Any) -> EnvKwargs:
        return {"scene": {"name": "obstacles", **fields}}

    conditions: dict[str, EnvKwargs] = {
        "as trained": {},
        **{team_label(n): {"n_robots": n} for n in (1, 3, 4, 5)},
        "150 x 150 cells": blocks(shape=[150, 150]),
        "half the obstacles": blocks(occupied_fraction=0.06),
        "twice the obstacles": blocks(occupied_fraction=0.24),
        "rooms": {"scene": "rooms"},
        "a real house": {"scene": "house"},
        "32 scans each": {"max_scans": 32},
    }
    learned = (PREDICTED_MAP, PLANAR_CANDIDATES, PLANAR_POSES)
    return _generalization("planar", learned, conditions, n_worlds, cases)


def field_generalization(n_worlds: int, cases: Sequence[TunedCase]) -> list[Condition]:
    """Other teams and scenes in the field environment."""
    conditions: dict[str, EnvKwargs] = {
        "as trained": {},
        **{team_label(n): {"n_robots": n} for n in (1, 3)},
        "clutter": {"scene": "clutter"},
        "rubble": {"scene": "rubble"},
    }
    learned = (PREDICTED_SURFACE, FIELD_CANDIDATES)
    return _generalization("field", learned, conditions, n_worlds, cases)


def team_label(n_robots: int) -> str:
    """Label of a condition with this number of robots."""
    return f"{n_robots} robot{'s' if n_robots > 1 else ''}"


def _generalization(
    env_name: str,
    learned: Sequence[Method],
    conditions: Mapping[str, EnvKwargs],
    n_worlds: int,
    cases: Sequence[TunedCase],
) -> list[Condition]:
    """The planners are those that are strongest under the condition of the training."""
    opponents = tuple(
        opponent
        for env_kwargs in _different_actions(learned)
        if (case := find_case(cases, env_name, env_kwargs))
        for opponent in case.opponents()
        if opponent.score == AREAS[env_name][0]
    )
    methods = (*learned, planner_method("rating_function", CANDIDATE_MODE))
    return [
        Condition(
            label,
            env_name,
            n_worlds,
            {**STANDARD_TEAM, **changes},
            unique_methods((*methods, *(opponent.method for opponent in opponents))),
            opponents,
        )
        for label, changes in conditions.items()
    ]
