"""Policies and references on the same worlds of a family."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from coopmap_env.evaluation import Evaluation, compare, with_world_bounds
from coopmap_env.evaluation.bounds import WorldBound, bound_worlds
from coopmap_env.families import Family
from coopmap_env.studies.clairvoyant import CLAIRVOYANT, play_clairvoyant
from coopmap_env.studies.families.field_references import SurfaceBounds, play_field_references


class Entry(NamedTuple):
    """A policy that is played."""

    spec: str
    kind: str
    """"random", "one step", "look-ahead", "learned" or "clairvoyant"."""
    action_mode: str = "pose"
    n_candidates: int | None = None
    """By default that of the environment."""
    is_for_time: bool = False
    """Whether it is played only where time ends episodes."""
    only: str | None = None
    """The kind of environment, "planar" or "field", if it is played only there."""

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """How it acts, as arguments of the environment."""
        arguments: dict[str, Any] = {"action_mode": self.action_mode}
        if self.n_candidates is not None:
            arguments["n_candidates"] = self.n_candidates
        return arguments


PLAYED_POLICIES = {
    "random": Entry("random", "random"),
    "rating function, m = 100": Entry("rating_function:search=100", "one step"),
    "rating function, m = 100, sequential": Entry(
        "rating_function:search=100+coordination=sequential", "one step"
    ),
    "coverage, m = 300, sequential": Entry(
        "coverage:search=300+coordination=sequential", "one step"
    ),
    "expected coverage, m = 300, sequential": Entry("lookahead:horizon=1", "one step"),
    "expected coverage, m = 1000, sequential": Entry(
        "lookahead:horizon=1+search=1000", "one step", only="planar"
    ),
    "expected coverage, weighing motion": Entry(
        "lookahead:horizon=1+motion_weight=0.015", "one step", is_for_time=True
    ),
    "expected coverage, m = 1000, weighing motion": Entry(
        "lookahead:horizon=1+motion_weight=0.015+search=1000",
        "one step",
        is_for_time=True,
        only="planar",
    ),
    "frontier, sequential": Entry("frontier:coordination=sequential", "look-ahead"),
    "allocation": Entry("allocation", "look-ahead"),
    "tour": Entry("tour", "look-ahead"),
    "look-ahead": Entry("lookahead", "look-ahead"),
    "look-ahead, m = 1000": Entry("lookahead:search=1000", "look-ahead", only="planar"),
    "look-ahead, joint": Entry("lookahead:coordination=joint", "look-ahead"),
    "look-ahead, weighing motion": Entry(
        "lookahead:motion_weight=0.02", "look-ahead", is_for_time=True
    ),
    "predicted map, m = 1000": Entry("predictive", "learned", only="planar"),
    "predicted map, look-ahead, m = 1000": Entry("predictive:horizon=2", "learned", only="planar"),
    "predicted map, short look-ahead, m = 300": Entry(
        "predictive:horizon=2+search=300+samples=75+width=8", "learned", only="planar"
    ),
    "predicted map, m = 1000, weighing motion": Entry(
        "predictive:motion_weight=0.015", "learned", is_for_time=True, only="planar"
    ),
    "predicted map, look-ahead, m = 1000, weighing motion": Entry(
        "predictive:horizon=2+motion_weight=0.02", "learned", is_for_time=True, only="planar"
    ),
    "surface, m = 100": Entry("surface", "one step", only="field"),
    "predicted surface, m = 100": Entry("predictive_surface", "learned", only="field"),
    "learned, 32 candidates": Entry("learned", "learned", "candidates"),
    "learned, 300 candidates": Entry("learned", "learned", "candidates", 300),
}
"""Policies by their names in the table. One-step planners value the next view alone; those that go
to a frontier or along a tour look further than that. The motion weights were chosen on training
worlds of `motion-budget`, the short look-ahead on validation worlds of `long` so that a decision
takes no longer than that of the look-ahead with 1,000 poses."""


class Played(NamedTuple):
    """What was played on the same worlds."""

    evaluations: dict[str, Evaluation]
    """By name; with efficiencies where the family is planar."""
    kinds: dict[str, str]
    n_worlds: int
    shown_bounds: tuple[WorldBound, ...] = ()
    """Of the worlds, where the family is planar."""
    n_cells: int = 0
    """Of a planar world."""
    surface_bounds: SurfaceBounds | None = None
    """Of the covered surface, where the family is a field one and references are played."""


def play_family(
    family: Family,
    split: str,
    seeds: Sequence[int],
    folder: Path,
    workers: int = 1,
    names: Sequence[str] | None = None,
) -> Played:
    """Play policies and references on some worlds of a family; resumable.

    Parameters
    ----------
    family : Family
    split : {"train", "validation", "test"}
    seeds : sequence of int
    folder : Path
        Keeps episodes and certificates.
    workers : int
        Episodes at a time; decision times depend on it.
    names : sequence of str, optional
        Keys of `PLAYED_POLICIES` and `CLAIRVOYANT`; by default all that are installed and fit the
        family.

    Raises
    ------
    ValueError
        If a name is none of these, or is of a policy for the other kind of environment.
    """
    is_planar = family.env_name == "planar"
    chosen = list(names or [*_usual_policies(family), *CLAIRVOYANT])
    _check_names(family, chosen)
    evaluations: dict[str, Evaluation] = {}
    entries = {n: PLAYED_POLICIES[n] for n in chosen if n in PLAYED_POLICIES}
    modes = dict.fromkeys((entry.action_mode, entry.n_candidates) for entry in entries.values())
    for mode in modes:
        own = {n: e for n, e in entries.items() if (e.action_mode, e.n_candidates) == mode}
        acting = next(iter(own.values())).env_kwargs
        arguments = {**family.env_kwargs, "split": split, **acting}
        found = compare(
            [entry.spec for entry in own.values()], seeds, arguments, folder / "episodes",
            family.settings, workers, env_name=family.env_name,
        )  # fmt: skip
        evaluations |= {name: found[entry.spec] for name, entry in own.items()}
    references, bounds = [name for name in chosen if name in CLAIRVOYANT], None
    if is_planar:
        arguments = {**family.env_kwargs, "split": split}
        for name in references:
            evaluations[name] = play_clairvoyant(
                name, seeds, arguments, folder / "clairvoyant", family.settings, workers
            )
    elif references:
        found, bounds = play_field_references(
            family, split, seeds, folder / "references", workers, references
        )
        evaluations |= found
    kinds = {n: PLAYED_POLICIES[n].kind if n in PLAYED_POLICIES else "clairvoyant" for n in chosen}
    ordered = {name: evaluations[name] for name in chosen}
    played = Played(ordered, kinds, len(seeds), surface_bounds=bounds)
    return _with_bounds(family, split, seeds, folder, workers, played) if is_planar else played


def _check_names(family: Family, names: Sequence[str]) -> None:
    for name in names:
        entry = PLAYED_POLICIES.get(name)
        if entry is None and name not in CLAIRVOYANT:
            choices = "; ".join([*PLAYED_POLICIES, *CLAIRVOYANT])
            raise ValueError(f"unknown policy {name!r}; choose from {choices}")
        if entry is not None and entry.only not in (None, family.env_name):
            raise ValueError(
                f"{name!r} is for {entry.only} families, and {family.name!r} is a "
                f"{family.env_name} one"
            )


def _usual_policies(family: Family) -> list[str]:
    """Names in the table that fit a family; the learned ones are missing without the extra rl."""
    can_learn = all(find_spec(name) for name in ("torch", "stable_baselines3", "safetensors"))
    has_time = "max_time" in family.budget
    return [
        name
        for name, entry in PLAYED_POLICIES.items()
        if (can_learn or entry.kind != "learned")
        and (has_time or not entry.is_for_time)
        and entry.only in (None, family.env_name)
    ]


def _with_bounds(
    family: Family, split: str, seeds: Sequence[int], folder: Path, workers: int, played: Played
) -> Played:
    """The same with efficiencies."""
    arguments = {**family.env_kwargs, "split": split}
    bounds = bound_worlds(seeds, arguments, folder / "bounds", family.settings, workers)
    with closing(family.make(split)) as env:
        env.reset(seed=seeds[0])
        evaluations = with_world_bounds(played.evaluations, bounds, env)
        n_cells = env.belief().map.grid.n_cells
    return played._replace(evaluations=evaluations, shown_bounds=tuple(bounds), n_cells=n_cells)
