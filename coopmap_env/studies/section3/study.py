"""Section 3 of the paper over many worlds: Table 1, Figures 7 and 8, the trends, sensitivity.

In the paper, two vision systems take 32 scans together in a planar world of random obstacles. It
does not state its camera, its world and its constants: the study uses those of `TableConstants`,
which were found on training worlds. Results are those of test worlds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from coopmap_env.core.settings import PositiveInt, Settings, settings_to_dict
from coopmap_env.envs.planar import PlanarEnv, PlanarSettings
from coopmap_env.evaluation import (
    BOOTSTRAP_SEED,
    Evaluation,
    compare,
    make_policy,
    with_efficiencies,
)
from coopmap_env.evaluation.statistics import Interval, bootstrap_mean
from coopmap_env.studies.clairvoyant import play_clairvoyant
from coopmap_env.studies.common.hit_miss import HIT_MISS_LOG_ODDS_RANGE, HitMissModel
from coopmap_env.studies.common.map_scores import MapModel
from coopmap_env.studies.recorded import killian
from coopmap_env.studies.section3 import calibration
from coopmap_env.studies.section3.deviation import deviation_interval
from coopmap_env.studies.section3.setting import (
    RASTER,
    SCANS_EACH,
    SEARCHES,
    TABLE_1_SCORES,
    TableConstants,
    section3_scene,
    section3_settings,
)
from coopmap_env.studies.section3.snapshots import EpisodeSnapshot, record_snapshot
from coopmap_env.studies.section3.trends import Trend, all_trends

RANDOM, CLAIRVOYANT_GREEDY = "random", "clairvoyant, greedy"
"""References beside the paper's searches: any feasible pose, and a policy that knows the world."""
TABLE_1_COLUMNS = (*TABLE_1_SCORES, "coverage", "efficiency")
"""The paper's, the observed fraction, and the fraction of what an upper bound allows."""
SWEEP_SEARCHES = (10, 100, "exhaustive")
K_FACTORS = (0.5, 0.7, 0.85, 1.0, 1.2, 1.4, 2.0)
"""Multiples of the reproduction's K at which its results are shown too."""
READINGS = (
    ("empty", "distance_free"), ("empty", "literal"),
    ("printed", "distance_free"), ("printed", "literal"),
)  # fmt: skip
"""Readings of hidden voxels (Eq. 7) and of Eq. 8a; the first ones are the environment's."""
HOUSE_SCANS_EACH = 48
HOUSE_POLICIES = (
    RASTER, "random", "frontier", "rating_function:search=100", "rating_function:search=exhaustive",
)  # fmt: skip
HOUSE_SEED = 1
"""A seed whose robots start inside the house instead of in the garden."""
FIGURE_7_SCANS_EACH = 200


@dataclass(frozen=True)
class Section3Size(Settings):
    """Numbers of worlds and values that the study runs."""

    worlds: PositiveInt
    """Test worlds of Table 1 and Figure 8."""
    sweep_worlds: PositiveInt
    """Worlds of the sensitivity to K and of the readings of Eqs. 7 and 8a."""
    k_factors: tuple[float, ...]
    """Multiples of K."""
    house_runs: PositiveInt
    """Start poses in the house."""
    calibration_worlds: PositiveInt
    """Test worlds on which the map's calibration is scored."""
    clairvoyant: bool
    """Whether the policy that knows the world plays, too: two seconds for each world."""


FULL = Section3Size(200, 60, K_FACTORS, 10, 40, clairvoyant=True)
QUICK = Section3Size(48, 8, (0.5, 1.0, 2.0), 2, 8, clairvoyant=False)


def search_spec(search: int | str) -> str:
    """The policy spec of a search."""
    return f"rating_function:search={search}"


@dataclass(frozen=True)
class Section3:
    """Results of the study."""

    size: Section3Size
    settings: PlanarSettings
    references: dict[str, Evaluation]
    """A raster scan, random poses, and in the full size a policy that knows the world."""
    searches: dict[int | str, Evaluation]
    trends: dict[str, Trend]
    readings: dict[tuple[str, str], dict[int | str, Evaluation]]
    """By the readings of Eqs. 7 and 8a, then by search; see `READINGS`."""
    sweep: dict[float, dict[int | str, Evaluation]]
    """By K, then by search, on training worlds."""
    figure_7: EpisodeSnapshot
    """200 scans of each robot."""
    episode: EpisodeSnapshot
    """32 scans together, as in Table 1."""
    house: dict[str, Evaluation]
    house_snapshot: EpisodeSnapshot
    calibration: dict[str, dict[str, Any]]
    """By sensor model; see `calibration_scores`."""
    killian: killian.KillianResult

    def table_1(self) -> dict[int | str, dict[str, Interval]]:
        """`TABLE_1_COLUMNS` by search or reference, with 95 % intervals."""
        rng = np.random.default_rng(BOOTSTRAP_SEED)
        rows: dict[int | str, Evaluation] = dict(self.searches)
        rows.update(self.references)
        return {
            search: {
                column: bootstrap_mean(evaluation.table[column], rng) for column in TABLE_1_COLUMNS
            }
            for search, evaluation in rows.items()
        }

    def deviation(self) -> Interval:
        """Mean absolute relative deviation of Table 1 from the paper's 18 numbers."""
        tables = [evaluation.table for evaluation in self.searches.values()]
        scores = np.stack(
            [np.stack([table[column] for column in TABLE_1_SCORES], axis=1) for table in tables],
            axis=1,
        )
        return deviation_interval(scores, np.random.default_rng(BOOTSTRAP_SEED))


def run_section3(
    store: Path, size: Section3Size, workers: int, log: Callable[[str], None], progress: bool = True
) -> Section3:
    """Run the study.

    Parameters
    ----------
    store : Path
        Folder of finished episodes, which are not run again.
    size : Section3Size
    workers : int
        Processes; the results do not depend on it.
    log : callable
        Receives a line of progress.
    progress : bool
        Show progress bars.
    """
    scene = section3_scene()
    scene_fields = {"name": scene.name, **settings_to_dict(scene)}
    standard = {"max_scans": SCANS_EACH, "split": "test", "scene": scene_fields}

    def evaluate_policies(
        policies: list[str], n_worlds: int, settings: PlanarSettings | None, **env_kwargs: Any
    ) -> dict[str, Evaluation]:
        env_kwargs = {**standard, **env_kwargs}
        return compare(policies, range(n_worlds), env_kwargs, store, settings, workers, progress)

    def evaluate_searches(searches: tuple[int | str, ...], *args: Any, **env: Any) -> Any:
        evaluations = evaluate_policies([search_spec(search) for search in searches], *args, **env)
        return dict(zip(searches, evaluations.values(), strict=True))

    log(f"Table 1 and Figure 8: {size.worlds} test worlds, {len(SEARCHES) + 1} searches")
    searches = evaluate_searches(SEARCHES, size.worlds, section3_settings())
    references = evaluate_policies([RASTER, RANDOM], size.worlds, section3_settings())
    if size.clairvoyant:
        references[CLAIRVOYANT_GREEDY] = play_clairvoyant(
            CLAIRVOYANT_GREEDY, range(size.worlds), standard, store, section3_settings(), workers,
            progress,
        )  # fmt: skip
    log("upper bounds of its worlds")
    bounded = with_efficiencies(
        {**searches, **references}, range(size.worlds), standard, store / "bounds",
        section3_settings(), workers, progress,
    )  # fmt: skip
    searches = {search: bounded[search] for search in searches}
    references = {name: bounded[name] for name in references}
    log("the readings of Eqs. 7 and 8a")
    readings = {
        (hidden, interpretation): evaluate_searches(
            SWEEP_SEARCHES,
            size.sweep_worlds,
            section3_settings(hidden=hidden, interpretation=interpretation),
        )
        for hidden, interpretation in READINGS
    }
    log("sensitivity to K, on training worlds")
    sweep = {
        round(factor * TableConstants().K, 3): evaluate_searches(
            SWEEP_SEARCHES,
            size.sweep_worlds,
            section3_settings(K=factor * TableConstants().K),
            split="train",
        )
        for factor in size.k_factors
    }
    log("Figure 7: one world, 400 scans")
    world_kwargs: dict[str, Any] = {"settings": section3_settings(), "scene": scene}
    figure_7 = record_snapshot(FIGURE_7_SCANS_EACH, **world_kwargs)
    log("the real floor plan")
    house_kwargs = {"scene": "house", "max_scans": HOUSE_SCANS_EACH}
    house = evaluate_policies(list(HOUSE_POLICIES), size.house_runs, None, **house_kwargs)
    house_snapshot = record_snapshot(HOUSE_SCANS_EACH, seed=HOUSE_SEED, scene="house")
    log("calibration of the map, on test worlds")
    calibration_scores = compare_calibration(size.calibration_worlds)
    log("3,873 real laser scans")
    return Section3(
        size=size,
        settings=section3_settings(),
        references=references,
        searches=searches,
        trends=all_trends(references[RASTER], searches),
        readings=readings,
        sweep=sweep,
        figure_7=figure_7,
        episode=record_snapshot(SCANS_EACH, **world_kwargs),
        house=house,
        house_snapshot=house_snapshot,
        calibration=calibration_scores,
        killian=killian.run_killian(progress=progress),
    )


def compare_calibration(n_worlds: int) -> dict[str, dict[str, Any]]:
    """Scores of the Gaussian beam map, of that of v0, and of the constant hit/miss map.

    All fuse the same scans.
    """
    env = PlanarEnv(split="test", max_scans=SCANS_EACH)
    worlds = list(calibration.record_scans(env, make_policy(search_spec(100)), range(n_worlds)))
    grid, v0 = env.belief().map.grid, PlanarSettings.v0()
    models = {
        "gaussian_beam": MapModel(env.settings.beam, env.settings.log_odds_range),
        "gaussian_beam_v0": MapModel(v0.beam, v0.log_odds_range),
        "hit_miss": MapModel(HitMissModel(), HIT_MISS_LOG_ODDS_RANGE),
    }
    scores = calibration.compare_models(worlds, grid, models)
    for name in ("gaussian_beam", "gaussian_beam_v0"):
        scores[name]["surface"] = calibration.surface_consistency(worlds, grid, models[name])
    return scores
