"""Comparison at equal motion: hand numbers, the bootstrap as a slow reference, properties."""

import numpy as np
import pytest

from coopmap_env.evaluation.statistics import training_runs
from coopmap_env.studies.benchmark.equal_motion import concave_hull, difference_at_equal_motion


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


SWEEP = [(100.0, 4.0), (200.0, 7.0), (300.0, 8.0)]


def test_the_planners_score_is_interpolated_at_the_motion_of_the_method():
    found = compare(score=7.0, motion=150.0, sweep=SWEEP)
    assert (found.motion, found.planners_score, found.is_equal) == (150.0, 5.5, True)
    assert found.difference.estimate == pytest.approx(1.5)
    assert compare(7.0, 225.0, SWEEP).planners_score == pytest.approx(7.25)


def test_at_the_motion_of_a_planner_its_own_score_counts():
    for motion, score in SWEEP:
        assert compare(9.0, motion, SWEEP).planners_score == pytest.approx(score)


def test_a_method_that_moves_more_than_all_is_compared_with_the_best_of_the_training_worlds():
    found = compare(9.0, 500.0, SWEEP)
    assert (found.motion, found.planners_score, found.is_equal) == (300.0, 8.0, False)
    unlucky = [*SWEEP[:2], (190.0, 6.0)]  # training worlds have said that it is the best
    found = compare(9.0, 500.0, unlucky)
    assert (found.motion, found.planners_score, found.is_equal) == (190.0, 6.0, False)


def test_planners_are_joined_in_the_order_of_their_motion_on_the_worlds_of_the_comparison():
    assert compare(9.0, 150.0, SWEEP[::-1]).planners_score == 5.5
    assert compare(9.0, 195.0, [*SWEEP[:2], (190.0, 6.0)]).planners_score == 6.5


def test_a_method_that_moves_less_than_all_has_no_opponent():
    assert compare(9.0, 99.0, SWEEP) is None


def hull(points):
    """The points (motion, score) of the upper concave hull."""
    rows = concave_hull([score for _, score in points], [motion for motion, _ in points])
    return [points[row] for row in rows]


def test_planners_that_another_one_beats_with_less_motion_are_left_out():
    worse = [(250.0, 6.0), (400.0, 8.0), (200.0, 6.5), (100.0, 3.0)]
    assert hull([*worse, *SWEEP]) == SWEEP
    assert hull([(100.0, 4.0), (100.0, 4.0)]) == [(100.0, 4.0)]


def test_planners_that_a_mixture_of_two_others_beats_are_left_out():
    planners = [(0.0, 0.0), (50.0, 1.0), (100.0, 10.0)]
    assert hull(planners) == [planners[0], planners[2]]
    assert compare(5.0, 50.0, hull(planners)).difference.estimate == 0.0
    on_the_line = [(0.0, 0.0), (50.0, 5.0), (100.0, 10.0)]
    assert hull(on_the_line) == [on_the_line[0], on_the_line[2]]


def test_no_mixture_of_planners_is_above_the_hull():
    rng = np.random.default_rng(6)
    points = [tuple(point) for point in rng.uniform(0, 1, (40, 2)).tolist()]
    chosen = hull(points)
    assert chosen[0] == min(points)
    assert chosen[-1] == max(points, key=lambda point: point[1])
    weights = rng.dirichlet(np.full(40, 0.1), 500)
    for motion, score in weights @ np.array(points):
        assert score <= np.interp(motion, *np.transpose(chosen)) + 1e-12


def studies_of_equal_methods(n_studies, rng, n_worlds=100, n_planners=44):
    """Training and test worlds of planners, and of a method with three runs; all are equal."""
    for _ in range(n_studies):
        parts = []
        for n_rows in (n_planners, n_planners, 3):
            mean = np.full((n_rows, 1), 450.0) if n_rows == 3 else np.linspace(300, 460, n_rows)
            noise = rng.normal(0, 1, (2, n_rows, n_worlds))
            parts.append((0.075 + 0.005 * noise[0], mean.reshape(-1, 1) + 25 * noise[1]))
        yield parts


def test_equal_methods_are_called_lower_as_rarely_as_the_intervals_say():
    lower = {"training": 0, "test": 0}
    for training, test, method in studies_of_equal_methods(200, np.random.default_rng(0)):
        for worlds, (scores, motions) in (("training", training), ("test", test)):
            rows = concave_hull(scores.mean(axis=1), motions.mean(axis=1))
            line = (values[rows] for values in test)
            lower[worlds] += difference_at_equal_motion(*method, *line).difference.high < 0
    # nominally 2.5 % of 200 studies; 12 or more in one of a hundred
    assert lower["training"] < 12
    assert lower["test"] > 40  # planners that are chosen on the worlds of the comparison had luck


def random_study(rng, n_runs, n_worlds):
    """Scores and motions of a method, and of five planners on the same worlds."""
    world = rng.normal(0, 1, n_worlds)
    motions = 200 + 10 * world + rng.normal(0, 8, (n_runs, n_worlds))
    scores = 7 + world + 0.01 * (motions - 200) + rng.normal(0, 0.3, (n_runs, n_worlds))
    price = np.arange(5)[::-1, None]
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
