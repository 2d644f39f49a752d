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
from coopmap_env.evaluation.metrics.surface import SurfaceJudge
from coopmap_env.evaluation.policy import Policy
from coopmap_env.evaluation.scored_voxels import told_by_scans
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots.reach import FREE_PROBABILITY

Scored = tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]
"""Probability, truth, and which cells are scored."""
POLICY_STREAM = 0xAC7
"""Spawn key of the policies' own random numbers: the same for every policy on a world."""
JUDGE_STREAM = 0x5C0
"""Spawn key of the poses and points by which a surface is judged: the same for every policy."""


@dataclass(frozen=True)
class Extent:
    """How the viewed space lies around the start: the columns of the paper's Table 1."""

    farthest: float
    """Distance of the farthest viewed point from the start, metres."""
    mean_radius: float
    """Mean distance of the viewed cells' centres from the start, metres."""
    sigma: float
    """Standard deviation of these distances, metres."""

    @classmethod
    def of(cls, map_: OccupancyMap, start: NDArray[np.float64]) -> Extent:
        """Measure a map's sampled cells from a start point (D,), metres; 0 if there are none."""
        if not map_.sampled.any():
            return cls(0.0, 0.0, 0.0)
        centers = map_.grid.center(np.argwhere(map_.sampled))
        radii = np.linalg.norm(centers - start, axis=1)
        return cls(float(radii.max()), float(radii.mean()), float(radii.std()))


SURFACE_SCORES = (
    "surface",
    "surface_auc",
    "target",
    "f_score",
    "precision",
    "recall",
    "chamfer",
    "missed",
)
"""Columns that only worlds with a true surface have."""


@dataclass(frozen=True)
class SurfaceTrace:
    """The map against the true surface, in worlds that have one; see `evaluation.surface`."""

    curve: list[float]
    """Curve: covered share of the surface that some reachable pose could see."""
    target: float
    """The same of the target alone, at the end."""
    f_score: float
    precision: float
    recall: float
    chamfer: float
    """Metres."""
    missed: float
    """Share of the truly occupied voxels told of by scans that a mount would enter: P < 0.05."""

    def row(self) -> dict[str, float]:
        """The scores by their column names."""
        return {
            "surface": self.curve[-1],
            "surface_auc": _mean_height(self.curve),
            "target": self.target,
            "f_score": self.f_score,
            "precision": self.precision,
            "recall": self.recall,
            "chamfer": self.chamfer,
            "missed": self.missed,
        }


@dataclass(frozen=True)
class Episode:
    """Measurements of one episode.

    Curves have one value before the first scan and one after each: `max_scans` + 1.
    """

    seed: int
    viewed: list[float]
    """Curve: share of the world's cells that were ever sampled."""
    entropy: list[float]
    """Curve: entropy of the team map, nats."""
    reward: float
    """Sum over steps and robots."""
    motion_cost: float
    """Sum over steps and robots of Eq. 5's distance."""
    log_loss: float
    """Of the sampled cells against the truth, nats; in the field without the parking room, which
    no scan told."""
    brier: float
    """Brier score of the sampled cells."""
    extent: Extent
    """From the middle of the team's start positions."""
    refused: int
    """Actions that were infeasible."""
    contacts: int
    """Cameras that bumped into what the map took as free."""
    planning_ms: float
    """Mean time of a decision of one robot, milliseconds; the only value that is not the same
    again with the same seed."""
    surface: SurfaceTrace | None = None
    """In worlds with a true surface."""

    @property
    def coverage(self) -> float:
        """Share of the world viewed at the end."""
        return self.viewed[-1]

    @property
    def coverage_auc(self) -> float:
        """Area under the viewed share against scans, as a mean over the episode."""
        return _mean_height(self.viewed)

    def row(self) -> dict[str, float]:
        """The scores by their column names."""
        return {
            "seed": self.seed,
            "coverage": self.coverage,
            "coverage_auc": self.coverage_auc,
            "reward": self.reward,
            "entropy": self.entropy[-1],
            "log_loss": self.log_loss,
            "brier": self.brier,
            "motion_cost": self.motion_cost,
            "farthest": self.extent.farthest,
            "mean_radius": self.extent.mean_radius,
            "sigma": self.extent.sigma,
            "refused": self.refused,
            "contacts": self.contacts,
            "planning_ms": self.planning_ms,
            **(self.surface.row() if self.surface else {}),
        }


def _mean_height(curve: list[float]) -> float:
    """Area under a curve over its scans, as a mean."""
    return float(np.trapezoid(curve)) / (len(curve) - 1)


def policy_rng(seed: int) -> np.random.Generator:
    """The random numbers that policies get on the world of this seed."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(POLICY_STREAM,)))


def warm_up(env: MappingEnv[Any], policy: Policy) -> None:
    """Take one decision unmeasured, so that compiling and loading are no planning time."""
    observations, _ = env.reset(seed=0)
    policy.reset(policy_rng(0))
    policy.act(env.belief(), observations)


def run_episode(
    env: MappingEnv[Any],
    policy: Policy,
    seed: int,
    watch: Callable[[Infos], None] = lambda infos: None,
) -> Episode:
    """Play one episode and measure it; the environment holds the final map afterwards.

    `watch` is called after each step, for what else a study wants to know of it.
    """
    observations, _ = env.reset(seed=seed)
    policy.reset(policy_rng(seed))
    map_ = env.belief().map
    judge = judge_of(env, seed)
    start, known = _start_of(env)
    viewed, entropy = [map_.observed_fraction], [map_.entropy]
    surface = [judge.coverage(map_)] if judge else []
    reward = distance = planning = 0.0
    refused = contacts = decisions = 0
    while env.agents:
        before = time.perf_counter()
        actions = policy.act(env.belief(), observations)
        planning += time.perf_counter() - before
        if map_.observed_fraction != viewed[-1]:
            raise RuntimeError(f"{policy!r} changed the map, which is to be looked at only")
        decisions += len(actions)
        observations, rewards, _, _, infos = env.step(actions)
        watch(infos)
        reward += sum(rewards.values())
        distance += sum(info["distance"] for info in infos.values())
        refused += sum(bool(info["rejected_reason"]) for info in infos.values())
        contacts += sum(info["contact"] for info in infos.values())
        viewed.append(map_.observed_fraction)
        entropy.append(map_.entropy)
        if judge:
            surface.append(judge.coverage(map_))
    scored: Scored = (
        map_.probability,
        env.truth.occupied,
        told_by_scans(map_.sampled, known & map_.sampled),
    )
    return Episode(
        seed=seed,
        viewed=viewed,
        entropy=entropy,
        reward=reward,
        motion_cost=distance,
        log_loss=_or(log_loss(*scored), math.log(2.0)),
        brier=_or(brier_score(*scored), 0.25),
        extent=Extent.of(map_, start),
        refused=refused,
        contacts=contacts,
        planning_ms=1e3 * planning / max(decisions, 1),
        surface=_trace(judge, surface, map_, scored) if judge else None,
    )


def _start_of(env: MappingEnv[Any]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Middle of the cameras at the start (D,), and cells that are known without any scan.

    In the field by the truth: robots may not know yet where they stand.
    """
    if isinstance(env, FieldEnv):
        middle = np.mean([camera.translation for camera in env.true_cameras], axis=0)
        return middle, env.initial_free_mask
    return env.belief().positions.mean(axis=0), np.zeros_like(env.belief().map.sampled)


def _or(value: float, unknown: float) -> float:
    """A score, or that of a map that knows nothing where there is nothing to score."""
    return unknown if math.isnan(value) else value


def judge_of(env: MappingEnv[Any], seed: int) -> SurfaceJudge | None:
    """What scores maps of the environment's world against its surface; None in the plane."""
    if not isinstance(env, FieldEnv):
        return None
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(JUDGE_STREAM,)))
    return SurfaceJudge(env.truth, env.true_vehicles, env.settings.camera, rng)


def _trace(
    judge: SurfaceJudge, curve: list[float], map_: OccupancyMap, scored: Scored
) -> SurfaceTrace:
    scores = judge.scores(map_)
    probability, occupied, told = scored
    there = probability[occupied & told]
    return SurfaceTrace(
        curve,
        scores.target_coverage,
        scores.f_score,
        scores.precision,
        scores.recall,
        scores.chamfer,
        float((there < FREE_PROBABILITY).mean()) if len(there) else 0.0,
    )


def episode_from_dict(values: dict[str, Any]) -> Episode:
    """The episode that `dataclasses.asdict` turned into JSON values."""
    surface = values.get("surface")
    parts = {
        "extent": Extent(**values["extent"]),
        "surface": None if surface is None else SurfaceTrace(**surface),
    }
    return Episode(**{**values, **parts})
