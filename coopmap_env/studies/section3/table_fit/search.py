"""The search itself, by Optuna (extra ``tuning``); it can be interrupted and continued."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from coopmap_env.core.extras import import_optional
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


def open_search(folder: Path, seed: int = 0) -> Any:
    """The Optuna study of a folder; a new one, with the constants so far as its first trial.

    Raises
    ------
    ImportError
        With the pip command, if Optuna is not installed.
    """
    optuna = import_optional("optuna", "tuning")
    backends = import_optional("optuna.storages.journal", "tuning")
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    folder.mkdir(parents=True, exist_ok=True)
    journal = backends.JournalFileBackend(str(folder / "trials.journal"))
    study = optuna.create_study(
        study_name="table 1",
        storage=optuna.storages.JournalStorage(journal),
        sampler=optuna.samplers.TPESampler(
            multivariate=True, n_startup_trials=N_STARTUP_TRIALS, seed=seed
        ),
        pruner=optuna.pruners.PercentilePruner(
            KEPT_PERCENTILE, n_startup_trials=N_STARTUP_TRIALS, n_min_trials=10
        ),
        load_if_exists=True,
    )
    if not study.get_trials(deepcopy=False):
        study.enqueue_trial(point_of(TableConstants()))
    return study


def run_search(
    study: Any,
    n_trials: int,
    seeds: Sequence[int],
    base: PlanarSettings | None = None,
    log: Callable[[str], None] = lambda text: None,
) -> None:
    """Play trials until the study has `n_trials`; it can be interrupted at any time.

    Parameters
    ----------
    study : optuna.Study
        Of `open_search`.
    n_trials : int
        Those of the study before included.
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

    done = count_trials(study)
    if done < n_trials:
        study.optimize(objective, n_trials=n_trials - done)


def count_trials(study: Any) -> int:
    """Trials that have ended, complete or not."""
    optuna = import_optional("optuna", "tuning")
    return len(study.get_trials(deepcopy=False, states=_finished(optuna)))


def ranked_points(study: Any) -> list[tuple[float, Point]]:
    """Value and point of all complete trials, the best first."""
    complete = [t for t in study.get_trials(deepcopy=False) if t.state.name == "COMPLETE"]
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


def _finished(optuna: Any) -> tuple[Any, ...]:
    states = optuna.trial.TrialState
    return states.COMPLETE, states.PRUNED, states.FAIL
