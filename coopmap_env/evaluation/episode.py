"""One episode of one policy, and everything that is measured on it."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation.policy import Policy
from coopmap_env.mapping import OccupancyMap
from coopmap_env.mapping.quality import brier_score, log_loss

POLICY_STREAM = 0xAC7
"""Spawn key of the policies' own random numbers: the same for every policy on a world."""


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
        """Measure a map's sampled cells from a start point (2,), metres."""
        centers = map_.grid.center(np.argwhere(map_.sampled))
        radii = np.linalg.norm(centers - start, axis=1)
        return cls(float(radii.max()), float(radii.mean()), float(radii.std()))


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
    """Of the sampled cells against the truth, nats."""
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

    @property
    def coverage(self) -> float:
        """Share of the world viewed at the end."""
        return self.viewed[-1]

    @property
    def coverage_auc(self) -> float:
        """Area under the viewed share against scans, as a mean over the episode."""
        return float(np.trapezoid(self.viewed)) / (len(self.viewed) - 1)

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
        }


def policy_rng(seed: int) -> np.random.Generator:
    """The random numbers that policies get on the world of this seed."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(POLICY_STREAM,)))


def warm_up(env: PlanarEnv, policy: Policy) -> None:
    """Take one decision unmeasured, so that compiling and loading are no planning time."""
    observations, _ = env.reset(seed=0)
    policy.reset(policy_rng(0))
    policy.act(env.belief(), observations)


def run_episode(env: PlanarEnv, policy: Policy, seed: int) -> Episode:
    """Play one episode and measure it; the environment holds the final map afterwards."""
    observations, _ = env.reset(seed=seed)
    policy.reset(policy_rng(seed))
    belief = env.belief()
    start = belief.poses[:, :2].mean(axis=0)
    viewed, entropy = [belief.map.viewed_share], [belief.map.entropy]
    reward = distance = planning = 0.0
    refused = contacts = decisions = 0
    while env.agents:
        before = time.perf_counter()
        actions = policy.act(env.belief(), observations)
        planning += time.perf_counter() - before
        if belief.map.viewed_share != viewed[-1]:
            raise RuntimeError(f"{policy!r} changed the map, which is to be looked at only")
        decisions += len(actions)
        observations, rewards, _, _, infos = env.step(actions)
        reward += sum(rewards.values())
        distance += sum(info["distance"] for info in infos.values())
        refused += sum(bool(info["refused"]) for info in infos.values())
        contacts += sum(info["contact"] for info in infos.values())
        viewed.append(belief.map.viewed_share)
        entropy.append(belief.map.entropy)
    scored = (belief.map.probability, env.truth.occupied, belief.map.sampled)
    return Episode(
        seed=seed,
        viewed=viewed,
        entropy=entropy,
        reward=reward,
        motion_cost=distance,
        log_loss=log_loss(*scored),
        brier=brier_score(*scored),
        extent=Extent.of(belief.map, start),
        refused=refused,
        contacts=contacts,
        planning_ms=1e3 * planning / max(decisions, 1),
    )


def episode_from_dict(values: dict[str, Any]) -> Episode:
    """The episode that `dataclasses.asdict` turned into JSON values."""
    return Episode(**{**values, "extent": Extent(**values["extent"])})
