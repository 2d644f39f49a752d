"""Section 3 of the paper over many worlds: Table 1, Figures 7 and 8, the trends, sensitivity.

The paper's setting is two vision systems that take 32 scans together in a planar world of random
obstacles; its camera and its constants are unstated. Ours are the defaults of `PlanarSettings`
(chosen on training worlds, see `K_SWEEP`), with a reach that spans the world, as the paper searches
"the entire known configuration space". Results are those of test worlds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.planar import PlanarEnv, PlanarSettings
from coopmap_env.evaluation.comparison import BOOTSTRAP_SEED, Evaluation, compare
from coopmap_env.evaluation.policy import make_policy
from coopmap_env.evaluation.rollout import policy_rng
from coopmap_env.evaluation.statistics.bootstrap import Interval, bootstrap_mean
from coopmap_env.mapping import BeamModel
from coopmap_env.studies.recorded import calibration, killian
from coopmap_env.studies.recorded.hit_miss import HitMissModel
from coopmap_env.studies.section3.trends import Trend, all_trends

SCANS_EACH = 16
"""Two robots: 32 scans together."""
SEARCHES = (10, 50, 100, 200, 300, "exhaustive")
"""m of the paper's random search, and all poses."""
RASTER = "raster"
PAPER_TABLE_1 = {
    10: (54.89, 26.74, 11.48),
    50: (47.34, 23.79, 9.91),
    100: (46.69, 23.57, 9.17),
    200: (46.01, 22.81, 9.42),
    300: (36.62, 20.69, 7.85),
    "exhaustive": (34.59, 19.23, 7.52),
}
"""Farthest viewed point, mean radius and sigma as printed, in the paper's units."""
TABLE_1_SCORES = ("max_radius", "mean_radius", "radius_std")
SWEEP_SEARCHES = (10, 100, "exhaustive")
K_SWEEP = (0.1, 0.15, 0.18, 0.2, 0.22, 0.25, 0.3, 0.4)
HOUSE_SCANS_EACH = 48
HOUSE_POLICIES = (
    RASTER, "random", "frontier", "rating_function:search=100", "rating_function:search=exhaustive",
)  # fmt: skip
HOUSE_SEED = 1
"""Seed whose robots start inside the house; others start in the garden."""
FIGURE_7_SCANS_EACH = 200


@dataclass(frozen=True)
class Section3Size:
    """How much is run."""

    worlds: int
    sweep_worlds: int
    k_sweep: tuple[float, ...]
    house_runs: int
    calibration_worlds: int


FULL = Section3Size(200, 60, K_SWEEP, 10, 40)
QUICK = Section3Size(48, 8, (0.1, 0.2, 0.4), 2, 8)


def search_spec(search: int | str) -> str:
    """The policy spec of a search."""
    return f"rating_function:search={search}"


def settings(**rating: Any) -> PlanarSettings:
    """The documented setting of the reproduction; `rating` changes single constants."""
    base = PlanarSettings()
    return replace(base, reach=300.0, rating=replace(base.rating, **rating))


@dataclass(frozen=True)
class EpisodeSnapshot:
    """A true world and a team map of it."""

    truth: NDArray[np.bool_]
    probability: NDArray[np.float64]
    sampled: NDArray[np.bool_]
    paths: list[NDArray[np.float64]]
    """Camera positions of each robot, cells."""
    frame: NDArray[np.uint8]
    """The environment's own last frame, (H, W, 3)."""


@dataclass(frozen=True)
class Section3:
    """All results of the main job."""

    size: Section3Size
    settings: PlanarSettings
    raster: Evaluation
    searches: dict[int | str, Evaluation]
    trends: dict[str, Trend]
    interpretations: dict[str, dict[int | str, Evaluation]]
    """By reading of Eq. 8a."""
    sweep: dict[float, dict[int | str, Evaluation]]
    """By K, on training worlds."""
    figure_7: EpisodeSnapshot
    """200 scans of each robot."""
    episode: EpisodeSnapshot
    """32 scans together, as in Table 1."""
    house: dict[str, Evaluation]
    house_picture: EpisodeSnapshot
    calibration: dict[str, dict[str, Any]]
    killian: killian.KillianResult

    def table_1(self) -> dict[int | str, dict[str, Interval]]:
        """Farthest point, mean radius, sigma and viewed share by search, 95 % intervals."""
        rng = np.random.default_rng(BOOTSTRAP_SEED)
        return {
            search: {
                column: bootstrap_mean(evaluation.table[column], rng)
                for column in (*TABLE_1_SCORES, "coverage")
            }
            for search, evaluation in {RASTER: self.raster, **self.searches}.items()
        }


def run(
    store: Path, size: Section3Size, workers: int, log: Callable[[str], None], progress: bool = True
) -> Section3:
    """Run everything; finished episodes are kept in `store` and not run again."""

    def evaluate_policies(
        policies: list[str], n: int, chosen: PlanarSettings | None, **env: Any
    ) -> dict[str, Evaluation]:
        arguments = {"max_scans": SCANS_EACH, "split": "test", **env}
        return compare(policies, range(n), arguments, store, chosen, workers, progress)

    def evaluate_searches(searches: tuple[int | str, ...], *args: Any, **env: Any) -> Any:
        found = evaluate_policies([search_spec(search) for search in searches], *args, **env)
        return dict(zip(searches, found.values(), strict=True))

    log(f"Table 1 and Figure 8: {size.worlds} test worlds, {len(SEARCHES) + 1} searches")
    searches = evaluate_searches(SEARCHES, size.worlds, settings())
    raster = evaluate_policies([RASTER], size.worlds, settings())[RASTER]
    log("the two readings of Eq. 8a")
    interpretations = {
        interpretation: evaluate_searches(
            SWEEP_SEARCHES, size.sweep_worlds, settings(interpretation=interpretation)
        )
        for interpretation in ("literal", "distance_free")
    }
    log("sensitivity to K, on training worlds")
    sweep = {
        K: evaluate_searches(SWEEP_SEARCHES, size.sweep_worlds, settings(K=K), split="train")
        for K in size.k_sweep
    }
    log("Figure 7: one world, 400 scans")
    figure_7 = record_snapshot(FIGURE_7_SCANS_EACH, settings=settings())
    log("the real floor plan")
    house_env = {"scene": "house", "max_scans": HOUSE_SCANS_EACH}
    house = evaluate_policies(list(HOUSE_POLICIES), size.house_runs, None, **house_env)
    house_picture = record_snapshot(HOUSE_SCANS_EACH, seed=HOUSE_SEED, scene="house")
    log("calibration of the map, on test worlds")
    calibrated = compare_calibration(size.calibration_worlds)
    log("3,873 real laser scans")
    return Section3(
        size=size,
        settings=settings(),
        raster=raster,
        searches=searches,
        trends=all_trends(raster, searches),
        interpretations=interpretations,
        sweep=sweep,
        figure_7=figure_7,
        episode=record_snapshot(SCANS_EACH, settings=settings()),
        house=house,
        house_picture=house_picture,
        calibration=calibrated,
        killian=killian.run(progress=progress),
    )


def record_snapshot(max_scans: int, seed: int = 0, **arguments: Any) -> EpisodeSnapshot:
    """Play one episode of the rating function (m = 100) and keep what a figure needs."""
    env = PlanarEnv(split="test", max_scans=max_scans, render_mode="rgb_array", **arguments)
    chosen = make_policy(search_spec(100))
    observations, _ = env.reset(seed=seed)
    chosen.reset(policy_rng(seed))
    grid = env.belief().map.grid
    paths = [[grid.to_cell_units(pose)] for pose in env.belief().poses[:, :2]]
    while env.agents:
        observations, *_ = env.step(chosen.act(env.belief(), observations))
        for path, pose in zip(paths, env.belief().poses[:, :2], strict=True):
            path.append(grid.to_cell_units(pose))
    map_, frame = env.belief().map, env.render()
    assert frame is not None
    return EpisodeSnapshot(
        env.truth.occupied,
        map_.probability,
        map_.sampled,
        [np.array(path) for path in paths],
        frame,
    )


def compare_calibration(n_worlds: int) -> dict[str, dict[str, Any]]:
    """Scores of the Gaussian beam map and of the constant hit/miss map, on the same scans."""
    env = PlanarEnv(split="test", max_scans=SCANS_EACH)
    worlds = list(calibration.record_scans(env, make_policy(search_spec(100)), range(n_worlds)))
    models: dict[str, BeamModel | HitMissModel] = {
        "gaussian_beam": env.settings.beam,
        "hit_miss": HitMissModel(),
    }
    return {
        name: calibration.calibration_scores(calibration.pool_cells(worlds, env, model))
        for name, model in models.items()
    }
