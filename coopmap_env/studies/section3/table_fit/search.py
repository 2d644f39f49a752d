"""The search itself, by Optuna (extra ``tuning``); it can be interrupted and continued.

Each trial draws its point from a generator of its own, seeded by the number of trials that ended
before it. An interrupted trial does not count and is drawn again: after interruptions, a search has
the same trials as without, beside the failed ones that the journal keeps.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from coopmap_env.core.extras import import_optional
from coopmap_env.core.settings import settings_to_dict
from coopmap_env.core.version import __version__
from coopmap_env.envs.planar import PlanarSettings
from coopmap_env.studies.section3.setting import TableConstants
from coopmap_env.studies.section3.table_fit.episodes import Columns, mean_columns, play_all
from coopmap_env.studies.section3.table_fit.objective import Fit
from coopmap_env.studies.section3.table_fit.points import (
    RANGES,
    Point,
    constants_at,
    point_of,
)

BATCH = 4
"""Training worlds after which a trial is compared with the others, and ended if it is behind."""
N_STARTUP_TRIALS = 12
"""Trials at random, before the sampler takes the others into account."""
KEPT_PERCENTILE = 40.0
"""A trial goes on while it is among this part of the trials that came as far."""


SETUP = "setup"
"""Attribute of the study: what all its trials have in common, see `describe_setup`."""


def describe_setup(seeds: Sequence[int], base: PlanarSettings) -> dict[str, Any]:
    """What the trials of a study must have in common to be ranked together, as JSON values."""
    setup = {
        "version": __version__,
        "seeds": f"{seeds[0]} to {seeds[-1]}",
        "base": settings_to_dict(base),
        "searched": RANGES,
    }
    values: dict[str, Any] = json.loads(json.dumps(setup))
    return values


def open_search(folder: Path, setup: Mapping[str, Any], seed: int = 0) -> Any:
    """The Optuna study of a folder, or a new one.

    Parameters
    ----------
    folder : Path
    setup : mapping
        Of `describe_setup`; a new study keeps it.
    seed : int
        Of a new search.

    Raises
    ------
    ImportError
        With the pip command, if Optuna is not installed.
    ValueError
        If the folder has trials of another setup.
    """
    optuna = import_optional("optuna", "tuning")
    backends = import_optional("optuna.storages.journal", "tuning")
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    folder.mkdir(parents=True, exist_ok=True)
    journal = folder / "trials.journal"
    study = optuna.create_study(
        study_name="table 1",
        storage=optuna.storages.JournalStorage(backends.JournalFileBackend(str(journal))),
        pruner=optuna.pruners.PercentilePruner(
            KEPT_PERCENTILE, n_startup_trials=N_STARTUP_TRIALS, n_min_trials=10
        ),
        load_if_exists=True,
    )
    if not study.user_attrs and not study.get_trials(deepcopy=False):
        study.set_user_attr("seed", seed)
        study.set_user_attr(SETUP, dict(setup))
    if SETUP not in study.user_attrs:
        raise ValueError(
            f"{journal} does not say with which settings and version its trials were played: "
            "choose another --out"
        )
    differences = _differences(study.user_attrs[SETUP], setup)
    if differences:
        raise ValueError(
            f"{journal} has trials of another search: {'; '.join(differences)}. Choose another "
            "--out, or continue with the settings and the version of that search"
        )
    return study


def run_search(
    study: Any,
    n_trials: int,
    seeds: Sequence[int],
    base: PlanarSettings | None = None,
    log: Callable[[str], None] = lambda text: None,
) -> None:
    """Play trials until the study has `n_trials`; it can be interrupted at any time.

    The first trial has the constants so far.

    Parameters
    ----------
    study : optuna.Study
        Of `open_search`.
    n_trials : int
        Those of the study before included, but for interrupted ones.
    seeds : sequence of int
        Of the training worlds.
    base : PlanarSettings, optional
        Has what is not among the constants.
    log : callable
        Receives a line for each finished trial.
    """
    optuna = import_optional("optuna", "tuning")

    def objective(trial: Any) -> float:
        def compare_with_others(n: int, columns: dict[str, Columns]) -> None:
            if n % BATCH == 0:
                trial.report(float(Fit.from_means(mean_columns(columns["center"])).value), n)
                if n < len(seeds) and trial.should_prune():
                    raise optuna.TrialPruned

        point = _suggest_point(trial)
        columns = play_all(constants_at(point), seeds, base, compare_with_others)
        fits = {start: Fit.from_means(mean_columns(one)) for start, one in columns.items()}
        for start, fit in fits.items():
            trial.set_user_attr(start, fit.as_dict())
        fit = fits["center"]
        log(f"trial {trial.number}: {fit.value:.4f}, deviation {fit.deviation:.4f}")
        return float(fit.value)

    while (done := count_trials(study)) < n_trials:
        if done == 0 and not _has_state(study, optuna.trial.TrialState.WAITING):
            study.enqueue_trial(point_of(TableConstants()))
        study.sampler = optuna.samplers.TPESampler(
            multivariate=True, n_startup_trials=N_STARTUP_TRIALS, seed=_trial_seed(study, done)
        )
        study.optimize(objective, n_trials=1)


def count_trials(study: Any) -> int:
    """Trials that were played to the end or ended because they were behind, not failed ones."""
    states = import_optional("optuna", "tuning").trial.TrialState
    return len(study.get_trials(deepcopy=False, states=(states.COMPLETE, states.PRUNED)))


def ranked_points(study: Any) -> list[tuple[float, Point]]:
    """Value and point of all complete trials, the best first.

    Raises
    ------
    ValueError
        If there is none.
    """
    complete = [t for t in study.get_trials(deepcopy=False) if t.state.name == "COMPLETE"]
    if not complete:
        raise ValueError("no trial of the search was played to its end: play more trials")
    complete.sort(key=lambda trial: trial.value)
    return [(trial.value, dict(trial.params)) for trial in complete]


def least_value(study: Any, start: str) -> float:
    """Least value of a trial if distances are measured from this one of `episodes.STARTS`."""
    complete = [t for t in study.get_trials(deepcopy=False) if t.state.name == "COMPLETE"]
    return min(float(Fit(**trial.user_attrs[start]).value) for trial in complete)


def importances(study: Any) -> Mapping[str, float]:
    """How much each constant decides whether a trial is among the best (PED-ANOVA)."""
    optuna = import_optional("optuna", "tuning")
    evaluator = optuna.importance.PedAnovaImportanceEvaluator()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of few trials, which then count as equal
        values: Mapping[str, float] = optuna.importance.get_param_importances(
            study, evaluator=evaluator
        )
    return values


def _suggest_point(trial: Any) -> Point:
    return {
        name: trial.suggest_int(name, low, high, log=log)
        if integer
        else trial.suggest_float(name, low, high, log=log)
        for name, (low, high, log, integer) in RANGES.items()
    }


def _has_state(study: Any, state: Any) -> bool:
    return bool(study.get_trials(deepcopy=False, states=(state,)))


def _trial_seed(study: Any, n_ended: int) -> int:
    """Seed of the sampler of the trial after `n_ended` ones, below 2**32."""
    sequence = np.random.SeedSequence((study.user_attrs["seed"], n_ended))
    return int(sequence.generate_state(1)[0])


def _differences(kept: Any, wanted: Any, name: str = "") -> list[str]:
    """The values of two setups that differ, each as "name is A there and B here"."""
    if isinstance(kept, Mapping) and isinstance(wanted, Mapping):
        names = sorted({*kept, *wanted})
        return [
            line
            for key in names
            for line in _differences(kept.get(key), wanted.get(key), f"{name}.{key}".lstrip("."))
        ]
    return [] if kept == wanted else [f"{name} is {kept} there and {wanted} here"]
