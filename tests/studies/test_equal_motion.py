"""Comparison at equal motion: hand numbers, the bootstrap as a slow reference, properties."""

import numpy as np
import pytest

from coopmap_env.evaluation.statistics import training_runs
from coopmap_env.studies.benchmark.equal_motion import difference_at_equal_motion, undominated


def constant(*values, n_worlds=4):
    """Rows that are the same in all worlds."""
    return np.repeat(np.array(values, dtype=float)[:, None], n_worlds, axis=1)


def compare(score, motion, sweep):
    """Compare with a sweep of (motion, score) points."""
    return difference_at_equal_motion(
        constant(score),
        constant(motion),
        constant(*(s for _, s in sweep)),
        constant(*(m for m, _ in sweep)),
    )


SWEEP = [(300.0, 8.0), (100.0, 4.0), (200.0, 7.0)]


def test_the_planners_score_is_interpolated_at_the_motion_of_the_method():
    found = compare(score=7.0, motion=150.0, sweep=SWEEP)
    assert (found.motion, found.planners_score, found.is_equal) == (150.0, 5.5, True)
    assert found.difference.estimate == pytest.approx(1.5)
    assert compare(7.0, 225.0, SWEEP).planners_score == pytest.approx(7.25)


def test_at_the_motion_of_a_planner_its_own_score_counts():
    for motion, score in SWEEP:
        assert compare(9.0, motion, SWEEP).planners_score == pytest.approx(score)


def test_a_method_that_moves_more_than_all_is_compared_with_the_planner_of_most_motion():
    found = compare(9.0, 500.0, SWEEP)
    assert (found.motion, found.planners_score, found.is_equal) == (300.0, 8.0, False)


def test_a_method_that_moves_less_than_all_has_no_opponent():
    assert compare(9.0, 99.0, SWEEP) is None


def test_planners_that_another_one_beats_with_less_motion_are_left_out():
    worse = [*SWEEP, (250.0, 6.0), (400.0, 8.0), (200.0, 6.5)]
    for motion in (150.0, 225.0, 275.0, 500.0):
        assert compare(9.0, motion, worse) == compare(9.0, motion, SWEEP)
    scores, motions = np.array([8.0, 4, 7, 6, 8]), np.array([300.0, 100, 200, 250, 400])
    assert undominated(scores, motions).tolist() == [1, 2, 0]


def random_study(rng, n_runs, n_worlds):
    """Scores and motions of a method, and of five planners on the same worlds."""
    world = rng.normal(0, 1, n_worlds)
    motions = 200 + 10 * world + rng.normal(0, 8, (n_runs, n_worlds))
    scores = 7 + world + 0.01 * (motions - 200) + rng.normal(0, 0.3, (n_runs, n_worlds))
    price = np.arange(5)[:, None]
    sweep_motions = 320 - 50 * price + 10 * world + rng.normal(0, 8, (5, n_worlds))
    sweep_scores = 8 - 0.15 * price**2 + world + rng.normal(0, 0.3, (5, n_worlds))
    return scores, motions, sweep_scores, sweep_motions


def bootstrap_interval(study, rng):
    """Plain reference: interpolate in every resample of worlds and runs."""
    scores, motions, sweep_scores, sweep_motions = study
    sweep = np.stack([sweep_scores, sweep_motions], axis=-1).transpose(1, 0, 2)[None]
    ours = np.stack([scores, motions], axis=-1)
    differences = []
    resampled = training_runs.resample([ours, sweep], rng, 2000)
    for mine, theirs in zip(*resampled, strict=True):
        (score, motion), points = mine.mean(axis=(0, 1)), theirs.mean(axis=(0, 1))
        points = points[np.argsort(points[:, 1])]
        differences.append(score - np.interp(motion, points[:, 1], points[:, 0]))
    return np.percentile(differences, [2.5, 97.5])


@pytest.mark.parametrize("seed", range(3))
def test_the_interval_is_that_of_resampled_interpolations(seed):
    rng = np.random.default_rng(seed)
    study = random_study(rng, n_runs=1, n_worlds=80)
    found = difference_at_equal_motion(*study).difference
    low, high = bootstrap_interval(study, rng)
    width = high - low
    # 2,000 resamples know the ends of an interval to a twentieth of its width
    assert found.low == pytest.approx(low, abs=0.1 * width)
    assert found.high == pytest.approx(high, abs=0.1 * width)


def test_more_motion_of_the_method_never_raises_its_difference():
    study = random_study(np.random.default_rng(3), n_runs=3, n_worlds=20)
    scores, motions, *sweep = study
    found = [
        difference_at_equal_motion(scores, motions + more, *sweep).difference.estimate
        for more in (0.0, 20.0, 50.0, 90.0, 300.0)
    ]
    assert found == sorted(found, reverse=True)


def test_the_difference_from_a_planner_itself_is_zero():
    study = random_study(np.random.default_rng(4), n_runs=1, n_worlds=20)
    sweep_scores, sweep_motions = study[2:]
    found = difference_at_equal_motion(
        sweep_scores[2:3], sweep_motions[2:3], sweep_scores, sweep_motions
    )
    assert found.difference.estimate == pytest.approx(0.0, abs=1e-12)
    assert found.difference.high == pytest.approx(0.0, abs=1e-12)
