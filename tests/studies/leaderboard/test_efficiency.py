"""Efficiencies by hand, and bounds over time that no episode exceeds."""

from dataclasses import replace

import numpy as np
import pytest
from plain.rollouts import random_actions
from plain.small_families import with_small_families
from plain.small_worlds import SETTINGS, small_world

from coopmap_env.evaluation import Episode, MappedExtent, run_episode
from coopmap_env.evaluation.bounds import BoundFileError, PlanarViews, bound_shown
from coopmap_env.studies.leaderboard import efficiency as module
from coopmap_env.studies.leaderboard.efficiency import (
    efficiency,
    has_bound,
    most_scans,
    world_bounds,
)
from coopmap_env.studies.leaderboard.play import submit
from coopmap_env.studies.leaderboard.score import score_file


def episode(shown, elapsed=None, max_time=None):
    n = len(shown)
    return Episode(
        seed=0,
        coverage_curve=[0.0] * n,
        elapsed_curve=list(elapsed or range(n)),
        max_time=max_time,
        entropy_curve=[0.0] * n,
        reward=0.0,
        motion_distance=0.0,
        log_loss=0.0,
        log_loss_free=0.0,
        log_loss_occupied=0.0,
        brier_score=0.0,
        extent=MappedExtent(0.0, 0.0, 0.0),
        n_rejected_actions=0,
        n_collisions=0,
        planning_time_ms=0.0,
        shown_curve=shown,
    )


def test_efficiency_over_scans_by_hand():
    found = efficiency(episode([0.1, 0.2, 0.4]), np.array([0.1, 0.5, 0.7]), 2.0)
    assert found.end == pytest.approx(0.3 / 0.6)
    # areas beyond the start: (0 + 0.1)/2 + (0.1 + 0.3)/2 and (0 + 0.4)/2 + (0.4 + 0.6)/2
    assert found.area == pytest.approx(0.25 / 0.7)


def test_efficiency_over_time_by_hand():
    # scans of 2 s: none before 2 s; the second scan of the bound at 4 s, then level to 5 s
    bounds = np.array([0.0, 0.4, 0.6, 0.7])
    found = efficiency(episode([0.0, 0.2, 0.3], [0.0, 3.0, 6.0], 5.0), bounds, 2.0)
    assert found.end == pytest.approx(0.3 / 0.7)
    own = 3.0 * 0.1 + 2.0 * (0.2 + (0.2 + 0.1 * 2.0 / 3.0)) / 2.0
    most = 2.0 * 0.2 + 2.0 * 0.5 + 1.0 * (0.6 + 0.65) / 2.0
    assert found.area == pytest.approx(own / most)


def test_scans_that_take_no_time_are_all_possible_at_once():
    assert most_scans(7, 5.0, 0.0) == 7
    found = efficiency(episode([0.0, 0.4], [0.0, 4.0], 4.0), np.array([0.0, 0.5, 0.8]), 0.0)
    assert found == (pytest.approx(0.4 / 0.8), pytest.approx(0.2 / 0.8))


@pytest.mark.parametrize(
    ("arguments", "n"),
    [
        ((9, None, 2.0), 9),
        ((9, 100.0, 2.0), 9),
        ((9, 6.0, 2.0), 3),
        ((9, 6.5, 2.0), 4),
        ((9, 0.5, 2.0), 1),
        ((20, 1.0, 0.1), 11),  # ten times 0.1 is less than 1 in doubles: one more begins
    ],
)
def test_the_most_scans_are_those_that_begin_in_time(arguments, n):
    assert most_scans(*arguments) == n


def test_an_efficiency_needs_a_curve_and_a_bound_above_the_start():
    with pytest.raises(ValueError, match="a curve of what was shown with at most 3 values"):
        efficiency(replace(episode([0.0, 0.1]), shown_curve=None), np.zeros(3), 2.0)
    with pytest.raises(ValueError, match="with at most 2 values"):
        efficiency(episode([0.0, 0.1, 0.2]), np.array([0.0, 0.5]), 2.0)
    with pytest.raises(ValueError, match=r"the bound 0\.1 must be above the start 0\.1"):
        efficiency(episode([0.1, 0.1]), np.array([0.1, 0.1]), 2.0)


class RandomPolicy:
    """Random actions, half of them feasible."""

    def __init__(self, env):
        self.env = env

    def reset(self, rng):
        self.rng = rng

    def act(self, belief, observations):
        return random_actions(self.env, self.rng)


@pytest.mark.parametrize("speed", [1.0, 1e6])
@pytest.mark.parametrize("scan_time", [0.0, 0.3, 2.0])
def test_no_episode_is_above_the_bound_over_time(scan_time, speed):
    settings = replace(SETTINGS, scan_time=scan_time, speed=speed, turn_rate=speed)
    env = small_world(settings=settings, max_scans=12, max_time=3.1, report_shown=True)
    policy = RandomPolicy(env)
    for seed in range(3):
        env.reset(seed=seed)
        n_scans = most_scans(12, 3.1, scan_time)
        views = PlanarViews.from_env(env, n_scans)
        bounds = bound_shown(views, n_scans).bounds / env.belief().map.grid.n_cells
        played = run_episode(env, policy, seed)
        assert len(played.shown_curve) <= n_scans + 1
        times = np.linspace(0.0, 3.1, 200)
        own = np.interp(times, played.elapsed_curve, played.shown_curve)
        clock = scan_time * np.arange(n_scans + 1)
        assert (own <= np.interp(times, clock, bounds) + 1e-12).all() or scan_time == 0.0
        assert 0.0 <= efficiency(played, bounds, scan_time).end <= 1.0
        assert 0.0 <= efficiency(played, bounds, scan_time).area <= 1.0


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    options = {"action_mode": "pose", "n_candidates": 32}
    with pytest.MonkeyPatch.context() as patch:
        with_small_families(patch)
        for family in ("tiny", "hasty"):
            submit(family, "frontier", 2, options, folder / f"{family}.json", progress=False)
        yield {family: folder / f"{family}.json" for family in ("tiny", "hasty")}


def stop(*arguments):
    raise AssertionError("a bound was searched again")


@pytest.mark.parametrize("family", ["tiny", "hasty"])
def test_scores_have_efficiencies_and_bounds_are_kept(family, files, tmp_path, monkeypatch):
    bounds = tmp_path / "bounds"
    scored = score_file(files[family], bounds=bounds, progress=False)
    kept = sorted(bounds.iterdir())
    hashes = {episode["world_hash"] for episode in scored.submission["episodes"]}
    assert {path.stem.rpartition("_")[2] for path in kept} == hashes
    for name in ("efficiency", "efficiency_auc"):
        assert 0.1 < scored.scores[name].low <= scored.scores[name].high < 1.0
    monkeypatch.setattr(module, "bound_shown", stop)
    assert score_file(files[family], bounds=bounds, progress=False).scores == scored.scores


def test_a_bound_that_is_wrong_is_no_fault_of_the_submission(files, tmp_path):
    bounds = tmp_path / "bounds"
    score_file(files["tiny"], bounds=bounds, progress=False)
    first, second = sorted(bounds.iterdir())
    first.write_bytes(second.read_bytes())
    with pytest.raises(BoundFileError, match=f"{first.name} belongs to another world"):
        score_file(files["tiny"], bounds=bounds, progress=False)


def test_planar_worlds_have_bounds_of_so_many_scans(tmp_path):
    env = small_world(max_scans=5)
    env.reset(seed=0)
    assert has_bound(env)
    bounds = world_bounds(env, tmp_path / "bound.npz")
    assert len(bounds) == 6
    assert (np.diff(bounds) >= 0).all()
    np.testing.assert_array_equal(world_bounds(env, tmp_path / "bound.npz"), bounds)
