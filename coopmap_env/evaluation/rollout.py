"""One episode of one policy, and everything that is measured on it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.field import FieldEnv
from coopmap_env.envs.mapping_env import Infos, MappingEnv
from coopmap_env.evaluation.metrics.calibration import brier_score, log_loss
from coopmap_env.evaluation.metrics.surface import SurfaceEvaluator
from coopmap_env.evaluation.policy import Policy
from coopmap_env.evaluation.scored_voxels import observed_mask
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots.reach import FREE_PROBABILITY

ScoredCells = tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]
"""Probability, truth, and which cells are scored."""
POLICY_SPAWN_KEY = 0xAC7
"""Spawn key of the policies' own random numbers: the same for every policy on a world."""
SURFACE_SPAWN_KEY = 0x5C0
"""Spawn key of the poses and points by which a surface is judged: the same for every policy."""


@dataclass(frozen=True)
class MappedExtent:
    """How the viewed space lies around the start: the columns of the paper's Table 1."""

    max_radius: float
    """Distance of the farthest viewed point from the start, metres."""
    mean_radius: float
    """Mean distance of the viewed cells' centres from the start, metres."""
    radius_std: float
    """Standard deviation of these distances, metres."""

    @classmethod
    def from_map(cls, map_: OccupancyMap, start: NDArray[np.float64]) -> MappedExtent:
        """Measure a map's sampled cells from a start point (D,), metres; 0 if there are none."""
        if not map_.sampled.any():
            return cls(0.0, 0.0, 0.0)
        centers = map_.grid.center(np.argwhere(map_.sampled))
        radii = np.linalg.norm(centers - start, axis=1)
        return cls(float(radii.max()), float(radii.mean()), float(radii.std()))


SURFACE_SCORES = (
    "surface_coverage",
    "surface_coverage_auc",
    "target_coverage",
    "f_score",
    "precision",
    "recall",
    "chamfer",
    "false_free_fraction",
)
"""Columns that only worlds with a true surface have."""


@dataclass(frozen=True)
class SurfaceResult:
    """The map against the true surface, in worlds that have one; see `evaluation.surface`."""

    coverage_curve: list[float]
    """Curve: covered share of the surface that some reachable pose could see."""
    target_coverage: float
    """The same of the target alone, at the end."""
    f_score: float
    precision: float
    recall: float
    chamfer: float
    """Metres."""
    false_free_fraction: float
    """Share of the truly occupied voxels told of by scans that a mount would enter: P < 0.05."""

    def row(self) -> dict[str, float]:
        """The scores by their column names."""
        return {
            "surface_coverage": self.coverage_curve[-1],
            "surface_coverage_auc": _normalized_auc(self.coverage_curve),
            "target_coverage": self.target_coverage,
            "f_score": self.f_score,
            "precision": self.precision,
            "recall": self.recall,
            "chamfer": self.chamfer,
            "false_free_fraction": self.false_free_fraction,
        }


@dataclass(frozen=True)
class Episode:
    """Measurements of one episode.

    Curves have one value before the first scan and one after each: `max_scans` + 1.
    """

    seed: int
    coverage_curve: list[float]
    """Curve: share of the world's cells that were ever sampled."""
    entropy_curve: list[float]
    """Curve: entropy of the team map, nats."""
    reward: float
    """Sum over steps and robots."""
    motion_cost: float
    """Sum over steps and robots of Eq. 5's distance."""
    log_loss: float
    """Of the sampled cells against the truth, nats; in the field without the parking room, which
    no scan told."""
    brier_score: float
    """Brier score of the sampled cells."""
    extent: MappedExtent
    """From the middle of the team's start positions."""
    n_rejected_actions: int
    """Actions that were infeasible."""
    n_collisions: int
    """Cameras that bumped into what the map took as free."""
    planning_time_ms: float
    """Mean time of a decision of one robot, milliseconds; the only value that is not the same
    again with the same seed."""
    surface: SurfaceResult | None = None
    """In worlds with a true surface."""

    @property
    def coverage(self) -> float:
        """Share of the world viewed at the end."""
        return self.coverage_curve[-1]

    @property
    def coverage_auc(self) -> float:
        """Area under the viewed share against scans, as a mean over the episode."""
        return _normalized_auc(self.coverage_curve)

    def row(self) -> dict[str, float]:
        """The scores by their column names."""
        return {
            "seed": self.seed,
            "coverage": self.coverage,
            "coverage_auc": self.coverage_auc,
            "reward": self.reward,
            "entropy": self.entropy_curve[-1],
            "log_loss": self.log_loss,
            "brier_score": self.brier_score,
            "motion_cost": self.motion_cost,
            "max_radius": self.extent.max_radius,
            "mean_radius": self.extent.mean_radius,
            "radius_std": self.extent.radius_std,
            "n_rejected_actions": self.n_rejected_actions,
            "n_collisions": self.n_collisions,
            "planning_time_ms": self.planning_time_ms,
            **(self.surface.row() if self.surface else {}),
        }


def _normalized_auc(curve: list[float]) -> float:
    """Area under a curve over its scans, as a mean."""
    return float(np.trapezoid(curve)) / (len(curve) - 1)


def policy_rng(seed: int) -> np.random.Generator:
    """The random numbers that policies get on the world of this seed."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(POLICY_SPAWN_KEY,)))


def warm_up(env: MappingEnv[Any], policy: Policy) -> None:
    """Take one decision unmeasured, so that compiling and loading are no planning time."""
    observations, _ = env.reset(seed=0)
    policy.reset(policy_rng(0))
    policy.act(env.belief(), observations)


def run_episode(
    env: MappingEnv[Any],
    policy: Policy,
    seed: int,
    on_step: Callable[[Infos], None] = lambda infos: None,
) -> Episode:
    """Play one episode and measure it; the environment holds the final map afterwards.

    `on_step` is called after each step, for what else a study wants to know of it.
    """
    observations, _ = env.reset(seed=seed)
    policy.reset(policy_rng(seed))
    map_ = env.belief().map
    evaluator = make_surface_evaluator(env, seed)
    start, initial_free_mask = _initial_state(env)
    coverage_curve, entropy_curve = [map_.observed_fraction], [map_.entropy]
    surface = [evaluator.coverage(map_)] if evaluator else []
    reward = motion_cost = planning_s = 0.0
    n_rejected_actions = n_collisions = n_decisions = 0
    while env.agents:
        before = time.perf_counter()
        actions = policy.act(env.belief(), observations)
        planning_s += time.perf_counter() - before
        if map_.observed_fraction != coverage_curve[-1]:
            raise RuntimeError(f"{policy!r} changed the map, which is to be looked at only")
        n_decisions += len(actions)
        observations, rewards, _, _, infos = env.step(actions)
        on_step(infos)
        reward += sum(rewards.values())
        motion_cost += sum(info["distance"] for info in infos.values())
        n_rejected_actions += sum(bool(info["rejected_reason"]) for info in infos.values())
        n_collisions += sum(info["contact"] for info in infos.values())
        coverage_curve.append(map_.observed_fraction)
        entropy_curve.append(map_.entropy)
        if evaluator:
            surface.append(evaluator.coverage(map_))
    scored: ScoredCells = (
        map_.probability,
        env.truth.occupied,
        observed_mask(map_.sampled, initial_free_mask & map_.sampled),
    )
    return Episode(
        seed=seed,
        coverage_curve=coverage_curve,
        entropy_curve=entropy_curve,
        reward=reward,
        motion_cost=motion_cost,
        log_loss=_value_or(log_loss(*scored), math.log(2.0)),
        brier_score=_value_or(brier_score(*scored), 0.25),
        extent=MappedExtent.from_map(map_, start),
        n_rejected_actions=n_rejected_actions,
        n_collisions=n_collisions,
        planning_time_ms=1e3 * planning_s / max(n_decisions, 1),
        surface=_surface_result(evaluator, surface, map_, scored) if evaluator else None,
    )


def _initial_state(env: MappingEnv[Any]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Middle of the cameras at the start (D,), and cells that are known without any scan.

    In the field by the truth: robots may not know yet where they stand.
    """
    if isinstance(env, FieldEnv):
        middle = np.mean([camera.translation for camera in env.true_cameras], axis=0)
        return middle, env.initial_free_mask
    return env.belief().positions.mean(axis=0), np.zeros_like(env.belief().map.sampled)


def _value_or(value: float, unknown: float) -> float:
    """A score, or that of a map that knows nothing where there is nothing to score."""
    return unknown if math.isnan(value) else value


def make_surface_evaluator(env: MappingEnv[Any], seed: int) -> SurfaceEvaluator | None:
    """What scores maps of the environment's world against its surface; None in the plane."""
    if not isinstance(env, FieldEnv):
        return None
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(SURFACE_SPAWN_KEY,)))
    return SurfaceEvaluator(env.truth, env.true_vehicles, env.settings.camera, rng)


def _surface_result(
    evaluator: SurfaceEvaluator, curve: list[float], map_: OccupancyMap, scored: ScoredCells
) -> SurfaceResult:
    scores = evaluator.scores(map_)
    probability, occupied, observed = scored
    occupied_probability = probability[occupied & observed]
    return SurfaceResult(
        curve,
        scores.target_coverage,
        scores.f_score,
        scores.precision,
        scores.recall,
        scores.chamfer,
        float((occupied_probability < FREE_PROBABILITY).mean())
        if len(occupied_probability)
        else 0.0,
    )


def episode_from_dict(values: dict[str, Any]) -> Episode:
    """The episode that `dataclasses.asdict` turned into JSON values."""
    surface = values.get("surface")
    parts = {
        "extent": MappedExtent(**values["extent"]),
        "surface": None if surface is None else SurfaceResult(**surface),
    }
    return Episode(**{**values, **parts})
