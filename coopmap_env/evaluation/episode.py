"""The measurements of an episode: coverage, entropy, calibration, costs and surface scores."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.linear_algebra import total
from coopmap_env.envs import MappingEnv
from coopmap_env.envs.field import FieldEnv
from coopmap_env.evaluation.metrics import (
    SurfaceEvaluator,
    brier_score,
    log_loss,
    observed_mask,
)
from coopmap_env.evaluation.policy import Policy
from coopmap_env.evaluation.rollout import Step, rollout
from coopmap_env.mapping import FREE_PROBABILITY, OccupancyMap

EvaluatorFor = Callable[[int], SurfaceEvaluator | None]
"""Gives the evaluator of the surface of a seed's world; None if worlds have no true surface."""
SURFACE_SPAWN_KEY = 0x5C0
"""Spawn key of the samples and poses that evaluate a surface: the same for every policy."""
LOG_LOSS_OF_PRIOR, BRIER_SCORE_OF_PRIOR = math.log(2.0), 0.25
"""Scores of p = 1/2 everywhere, which an episode without any scored cell gets."""


@dataclass(frozen=True)
class MappedExtent:
    """Distances of the observed cells from the start: the columns of the paper's Table 1."""

    max_radius: float
    """Largest distance of an observed cell's center from the start, metres."""
    mean_radius: float
    """Mean of these distances, metres."""
    radius_std: float
    """Standard deviation of these distances (the paper's sigma), metres."""

    @classmethod
    def from_map(cls, map_: OccupancyMap, start: NDArray[np.float64]) -> MappedExtent:
        """Measure a map's sampled cells from a start point (D,), metres; 0 if there are none."""
        if not map_.sampled.any():
            return cls(0.0, 0.0, 0.0)
        centers = map_.grid.center(np.argwhere(map_.sampled))
        radii = np.linalg.norm(centers - start, axis=1)
        return cls(float(radii.max()), float(radii.mean()), float(radii.std()))


@dataclass(frozen=True)
class SurfaceResult:
    """The map compared with the true surface; see `coopmap_env.evaluation.metrics`."""

    coverage_curve: list[float]
    """Covered fraction of the visible surface, before the first scan and after each."""
    target_coverage: float
    """Covered fraction of the target's visible surface, at the end."""
    f_score: float
    precision: float
    recall: float
    chamfer: float
    """Metres."""
    chi2_median: float
    """Median of the surface's squared distances in standard deviations; 0.45 is honest."""
    chi2_tail: float
    """Fraction of them beyond 3.84; 0.05 is honest."""
    false_free_fraction: float
    """Fraction of the occupied and observed voxels that a mount would enter, with P < 0.05."""

    def row(self, area_under: Callable[[list[float]], float]) -> dict[str, float]:
        """The scores by their column names; see `Episode.area_under`."""
        curve = self.coverage_curve
        scores = (getattr(self, name) for name in _SCORES_AT_END)
        values = (curve[-1], area_under(curve), *scores)
        return dict(zip(SURFACE_SCORES, values, strict=True))


_SCORES_AT_END = tuple(
    field.name for field in fields(SurfaceResult) if field.name != "coverage_curve"
)
SURFACE_SCORES = ("surface_coverage", "surface_coverage_auc", *_SCORES_AT_END)
"""Columns that only environments with a true surface have."""
SHOWN_SCORES = ("shown", "shown_auc")
"""Columns that only environments have which report what scans truly show: at the end, and the area
under its curve; see `Episode.area_under`."""


@dataclass(frozen=True)
class Episode:
    """Measurements of one episode.

    Curves have one value before the first scan and one after each: `max_scans` + 1, or fewer where
    the time ran out.
    """

    seed: int
    coverage_curve: list[float]
    """Fraction of the world's cells that were ever sampled."""
    elapsed_curve: list[float]
    """Seconds on the clock of the team."""
    max_time: float | None
    """Of the environment: seconds after which an episode ends, if time ends it."""
    entropy_curve: list[float]
    """Entropy of the team map, nats."""
    reward: float
    """Sum over steps and robots."""
    motion_distance: float
    """Sum over steps and robots of Eq. 5's distance."""
    log_loss: float
    """Of the observed cells, nats. In the field environment without the initial free space, which
    no scan has observed; see `observed_mask`."""
    log_loss_free: float
    """Of those of the same cells that are truly free, nats. How many of each kind there are depends
    on where a policy looked; these two do not mix them."""
    log_loss_occupied: float
    """Of those that are truly occupied, nats."""
    brier_score: float
    """Of the same cells."""
    extent: MappedExtent
    """Measured from the mean of the robots' start positions."""
    n_rejected_actions: int
    """Infeasible actions; the robot stayed."""
    n_collisions: int
    """Motions that ended at an obstacle which the map called free."""
    planning_time_ms: float
    """Mean time of a decision of one robot, milliseconds. The only value that differs between runs
    with the same seed."""
    surface: SurfaceResult | None = None
    """In environments with a true surface."""
    shown_curve: list[float] | None = None
    """Fraction of the world's cells that scans truly showed or that were known, in environments
    with ``report_shown=True``."""

    @property
    def coverage(self) -> float:
        """Observed fraction of the world at the end."""
        return self.coverage_curve[-1]

    @property
    def coverage_auc(self) -> float:
        """Area under the coverage curve; see `area_under`."""
        return self.area_under(self.coverage_curve)

    def area_under(self, curve: list[float]) -> float:
        """Area under one of the curves; see `area_under`."""
        return area_under(curve, self.elapsed_curve, self.max_time)

    def row(self) -> dict[str, float]:
        """The scores by their column names."""
        return {
            "seed": self.seed,
            "coverage": self.coverage,
            "coverage_auc": self.coverage_auc,
            "reward": self.reward,
            "entropy": self.entropy_curve[-1],
            "log_loss": self.log_loss,
            "log_loss_free": self.log_loss_free,
            "log_loss_occupied": self.log_loss_occupied,
            "brier_score": self.brier_score,
            "motion_distance": self.motion_distance,
            "max_radius": self.extent.max_radius,
            "mean_radius": self.extent.mean_radius,
            "radius_std": self.extent.radius_std,
            "n_scans": len(self.coverage_curve) - 1,
            "elapsed_time": self.elapsed_curve[-1],
            "n_rejected_actions": self.n_rejected_actions,
            "n_collisions": self.n_collisions,
            "planning_time_ms": self.planning_time_ms,
            **(self.surface.row(self.area_under) if self.surface else {}),
            **self._shown_row(),
        }

    def _shown_row(self) -> dict[str, float]:
        """Scores of what was truly shown, where it is known."""
        curve = self.shown_curve
        if curve is None:
            return {}
        return dict(zip(SHOWN_SCORES, (curve[-1], self.area_under(curve)), strict=True))


def area_under(curve: list[float], elapsed: list[float], max_time: float | None) -> float:
    """Area under a curve over its scans, divided by their number.

    With `max_time` over the time from 0 to there, divided by it: straight from scan to scan, and
    level after the last. `elapsed` are the seconds of the values.
    """
    if max_time is None:
        return float(np.trapezoid(curve)) / (len(curve) - 1)
    n = sum(time < max_time for time in elapsed)  # times only rise
    times, values = [*elapsed[:n], max_time], [*curve[:n], np.interp(max_time, elapsed, curve)]
    return float(np.trapezoid(values, times)) / max_time


class EpisodeRecorder:
    """Measures an episode while it is played.

    Parameters
    ----------
    env : MappingEnv
        Reset to the world of the seed; `rollout` does so.
    seed : int
        Seed of the world.
    evaluator_for : callable, optional
        Gives the evaluator of the surface from the seed, such as one that remembers it; by default
        `make_surface_evaluator`, a quarter of the time of an episode.

    Examples
    --------
    >>> steps = rollout(env, policy, seed)
    >>> recorder = EpisodeRecorder(env, seed)
    >>> for step in steps:
    ...     recorder.add(step)
    >>> episode = recorder.episode()
    """

    def __init__(
        self, env: MappingEnv[Any], seed: int, evaluator_for: EvaluatorFor | None = None
    ) -> None:
        self._env, self._seed = env, seed
        evaluator_for = evaluator_for or partial(make_surface_evaluator, env)
        self._evaluator = evaluator_for(seed)
        self._start, self._initial_free_mask = _initial_state(env)
        self._coverage: list[float] = []
        self._elapsed = [0.0]
        self._entropy: list[float] = []
        self._surface_coverage: list[float] = []
        self._shown: list[float] = []
        self._reward = self._motion_distance = self._planning_s = 0.0
        self._n_rejected_actions = self._n_collisions = self._n_decisions = 0
        self._add_map()

    def add(self, step: Step) -> None:
        """Measure a step; called right after it."""
        self._planning_s += step.decision_s
        self._n_decisions += len(step.actions)
        infos = step.infos.values()
        self._elapsed.append(next(iter(infos))["elapsed_time"])
        self._reward += total(step.rewards.values())
        self._motion_distance += total(info["distance"] for info in infos)
        self._n_rejected_actions += sum(bool(info["rejected_reason"]) for info in infos)
        self._n_collisions += sum(info["collided"] for info in infos)
        self._add_map()

    def _add_map(self) -> None:
        map_ = self._env.belief().map
        self._coverage.append(map_.observed_fraction)
        self._entropy.append(map_.entropy)
        if self._evaluator:
            self._surface_coverage.append(self._evaluator.coverage(map_))
        if self._env.reports_shown:
            self._shown.append(float(self._env.shown_mask.mean()))

    def episode(self) -> Episode:
        """The measurements; called after the last step."""
        map_ = self._env.belief().map
        probability, occupied = map_.probability, self._env.truth.occupied
        observed = observed_mask(map_.sampled, self._initial_free_mask & map_.sampled)
        return Episode(
            seed=self._seed,
            coverage_curve=self._coverage,
            elapsed_curve=self._elapsed,
            max_time=self._env.max_time,
            entropy_curve=self._entropy,
            reward=self._reward,
            motion_distance=self._motion_distance,
            log_loss=_log_loss(probability, occupied, observed),
            log_loss_free=_log_loss(probability, occupied, observed & ~occupied),
            log_loss_occupied=_log_loss(probability, occupied, observed & occupied),
            brier_score=_value_or(
                brier_score(probability, occupied, observed), BRIER_SCORE_OF_PRIOR
            ),
            extent=MappedExtent.from_map(map_, self._start),
            n_rejected_actions=self._n_rejected_actions,
            n_collisions=self._n_collisions,
            planning_time_ms=1e3 * self._planning_s / max(self._n_decisions, 1),
            surface=self._surface_result(map_, probability[occupied & observed]),
            shown_curve=self._shown or None,
        )

    def _surface_result(
        self, map_: OccupancyMap, occupied_probability: NDArray[np.float64]
    ) -> SurfaceResult | None:
        if self._evaluator is None:
            return None
        scores = self._evaluator.scores(map_)
        false_free = occupied_probability < FREE_PROBABILITY
        return SurfaceResult(
            coverage_curve=self._surface_coverage,
            target_coverage=scores.target_coverage,
            f_score=scores.f_score,
            precision=scores.precision,
            recall=scores.recall,
            chamfer=scores.chamfer,
            chi2_median=scores.chi2_median,
            chi2_tail=scores.chi2_tail,
            false_free_fraction=float(false_free.mean()) if len(false_free) else 0.0,
        )


def run_episode(
    env: MappingEnv[Any], policy: Policy, seed: int, evaluator_for: EvaluatorFor | None = None
) -> Episode:
    """Play one episode and measure it; the environment holds the final map afterwards.

    `evaluator_for` is as of `EpisodeRecorder`.
    """
    steps = rollout(env, policy, seed)
    recorder = EpisodeRecorder(env, seed, evaluator_for)
    for step in steps:
        recorder.add(step)
    return recorder.episode()


def episode_from_dict(values: dict[str, Any]) -> Episode:
    """The episode that `dataclasses.asdict` turned into JSON values."""
    surface = values.get("surface")
    parts = {
        "extent": MappedExtent(**values["extent"]),
        "surface": None if surface is None else SurfaceResult(**surface),
    }
    return Episode(**{**values, **parts})


def make_surface_evaluator(env: MappingEnv[Any], seed: int) -> SurfaceEvaluator | None:
    """Evaluator of maps of the environment's world; None in the planar environment."""
    if not isinstance(env, FieldEnv):
        return None
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(SURFACE_SPAWN_KEY,)))
    return SurfaceEvaluator(env.truth, env.diagnostics.true_vehicles, env.settings.camera, rng)


def _initial_state(env: MappingEnv[Any]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Mean start position of the cameras (D,), and the cells that are known without any scan.

    The field environment gives the true positions: its robots may not be located yet.
    """
    if isinstance(env, FieldEnv):
        middle = np.mean([camera.translation for camera in env.diagnostics.true_cameras], axis=0)
        return middle, env.diagnostics.initial_free_mask
    return env.belief().positions.mean(axis=0), np.zeros_like(env.belief().map.sampled)


def _log_loss(
    probability: NDArray[np.float64], occupied: NDArray[np.bool_], cells: NDArray[np.bool_]
) -> float:
    """Of some cells, nats; that of the prior if there are none."""
    return _value_or(log_loss(probability, occupied, cells), LOG_LOSS_OF_PRIOR)


def _value_or(value: float, default: float) -> float:
    """The value, or the default where it is NaN."""
    return default if math.isnan(value) else value
