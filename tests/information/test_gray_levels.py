"""Gray levels of voxels, Eqs. 8a and 8b, and their bins, Eq. 7."""

import numpy as np
import pytest
from plain import views

from coopmap_env.information import (
    PlanarRatingSettings,
    entropy,
    gray_bin,
    sampled_gray_level,
    unknown_gray_level,
)
from coopmap_env.information.gray_levels import GrayLevelTable, histogram_entropy
from coopmap_env.mapping import LogOddsRange
from coopmap_env.sensing import BeamFan, PlanarCamera

INTERPRETATIONS = ["literal", "distance_free"]
READINGS = pytest.mark.parametrize("interpretation", INTERPRETATIONS)


@pytest.mark.parametrize(
    ("p", "d", "gray"),
    [
        # p' = 1 / 0.8 = 1.25, p'' = 0.125
        (0.2, 1.0, 0.125),
        # p' = 1 / (0.6 * 1.25) = 4 / 3, p'' = 1 / 6
        (0.4, 1.25, 1 / 6),
        # p' = 1 / (0.9 * 2) < 1: below 0, clamped
        (0.1, 2.0, 0.0),
        (0.0, 1.0, 0.0),
        # p' = 1 / 0.8 = 1.25, p'' = 1 - 0.125
        (0.8, 1.0, 0.875),
        (0.5, 1.0, 0.5),
        # p' = 1 / (0.5 * 1.6) = 1.25
        (0.5, 1.6, 0.875),
        # p' = 1 / (0.8 * 2) < 1: above 1, clamped
        (0.8, 2.0, 1.0),
        (1.0, 1.0, 1.0),
    ],
)
def test_literal_gray_levels_by_hand_eq_8a(p, d, gray):
    assert sampled_gray_level(p, d, "literal") == pytest.approx(gray)


@pytest.mark.parametrize(
    ("p", "gray"), [(0.0, 0.0), (0.2, 0.125), (0.4, 1 / 3), (0.5, 0.5), (0.8, 0.875), (1.0, 1.0)]
)
@pytest.mark.parametrize("d", [0.0, 1.0, 7.0])
def test_distance_free_gray_levels_by_hand_eq_8a(p, gray, d):
    assert sampled_gray_level(p, d, "distance_free") == pytest.approx(gray)


def test_less_than_a_voxel_counts_as_one_voxel_eq_8a():
    assert sampled_gray_level([0.3, 0.7], [0.0, 0.4], "literal") == pytest.approx(
        sampled_gray_level([0.3, 0.7], 1, "literal")
    )


def test_both_readings_agree_at_one_voxel_eq_8a():
    p = np.linspace(0, 1, 101)
    literal, distance_free = (sampled_gray_level(p, 1.0, name) for name in INTERPRETATIONS)
    assert literal == pytest.approx(distance_free)


def test_from_two_voxels_on_the_literal_reading_knows_free_and_occupied_only_eq_8a():
    """1 / ((1 - p) d) <= 1 for p < 1/2 and d >= 2: the clamp decides, not p."""
    p = np.linspace(0, 1, 201)
    for d in (2.0, 2.3, 10.0, 400.0):
        assert (sampled_gray_level(p, d, "literal") == (p >= 0.5)).all()


@READINGS
def test_gray_of_sampled_voxels_rises_with_p_on_its_side_of_one_half_eq_8a(interpretation):
    p = np.linspace(0, 1, 1001)
    for d in (1.0, 1.2, 1.9, 5.0):
        gray = sampled_gray_level(p, d, interpretation)
        assert (np.diff(gray) >= -1e-15).all()
        assert (gray[p < 0.5] <= 0.5).all()
        assert (gray[p >= 0.5] >= 0.5).all()
        assert gray[0] == 0
        assert gray[-1] == 1


def test_gray_tells_probabilities_near_one_half_apart_four_times_as_finely_as_certain_ones_eq_8a():
    p = np.array([0.01, 0.02, 0.48, 0.49, 0.51, 0.52, 0.98, 0.99])
    gray = sampled_gray_level(p, 1.0, "distance_free")
    low, below, above, high = gray[1::2] - gray[::2]
    # slopes 1 / (2 (1 - p)^2) and 1 / (2 p^2): 1/2 at 0 and 1, 2 at 1/2
    assert below / low == pytest.approx(4, rel=0.1)
    assert above / high == pytest.approx(4, rel=0.1)


def test_gray_of_unknown_voxels_by_hand_eq_8b():
    assert unknown_gray_level([5.0, 20.0, 21.0], 20.0) == pytest.approx([1.25, 2.0, 2.0])


def test_gray_of_unknown_voxels_lies_above_that_of_sampled_ones_and_rises_with_distance_eq_8b():
    gray = unknown_gray_level(np.linspace(0.1, 25, 100), 25.0)
    assert (gray > 1).all()
    assert (np.diff(gray) > 0).all()
    assert gray.max() == 2


def test_bins_divide_zero_to_two_evenly_eq_7():
    gray = [0.0, 0.49, 0.5, 0.99, 1.0, 1.49, 1.5, 2.0]
    assert gray_bin(gray, 4).tolist() == [0, 0, 1, 1, 2, 2, 3, 3]


@pytest.mark.parametrize("n_gray_bins", [2, 3, 64, 255])
def test_every_gray_level_falls_into_a_bin_eq_7(n_gray_bins):
    bins = gray_bin(np.linspace(0, 2, 10 * n_gray_bins + 1), n_gray_bins)
    assert sorted(set(bins.tolist())) == list(range(n_gray_bins))
    assert (np.diff(bins) >= 0).all()


@READINGS
@pytest.mark.parametrize("n_gray_bins", [5, 64, 256])
def test_the_tables_look_up_the_bins_of_the_formulas(interpretation, n_gray_bins):
    limits = LogOddsRange()
    fan = BeamFan.from_camera(PlanarCamera(depth_of_field=7.5), 1.0, 4)
    settings = PlanarRatingSettings(n_gray_bins=n_gray_bins, interpretation=interpretation)
    table = GrayLevelTable.from_distances(fan.distance, fan.depth, settings, limits)
    rng = np.random.default_rng(0)
    for k in range(len(fan.distance)):
        d = float(fan.distance[k])
        unknown = min(
            int(views.gray_level(0.5, False, d, 7.5, interpretation) * n_gray_bins / 2),
            n_gray_bins - 1,
        )
        assert table.unknown[k] == unknown
        for level in rng.integers(0, len(limits.probability), 20):
            gray = views.gray_level(float(limits.probability[level]), True, d, 7.5, interpretation)
            found = table.sampled[table.distance_class[k], level]
            # a gray level on the border of two bins may fall to either side by rounding
            assert found in {
                min(int((gray + e) * n_gray_bins / 2), n_gray_bins - 1) for e in (-1e-12, 1e-12)
            }


@pytest.mark.parametrize("hidden", ["empty", "printed"])
def test_the_entropy_of_a_histogram_by_hand_eqs_6_and_7(hidden):
    """N = 8; three empty voxels, two of gray level 1.2, one is hidden and two out of the map."""
    settings = PlanarRatingSettings(n_gray_bins=4, hidden=hidden)
    table = GrayLevelTable.from_distances(np.array([1.0]), 5.0, settings, LogOddsRange())
    value = histogram_entropy(np.array([3, 0, 2, 0]), table.arrays(8))
    q = {"empty": [6 / 8, 2 / 8], "printed": [3 / 8, 2 / 8]}[hidden]
    assert value == pytest.approx(entropy(q))
    # one more than N: no bin has a negative entropy
    assert histogram_entropy(np.array([0, 0, 9, 0]), table.arrays(8)) == 0
    assert histogram_entropy(np.array([9, 0, 0, 0]), table.arrays(8)) == 0


@pytest.mark.parametrize("hidden", ["empty", "printed"])
def test_the_entropy_of_a_histogram_is_the_plain_one_eqs_6_and_7(hidden):
    rng = np.random.default_rng(0)
    for n_gray_bins in (2, 7, 64):
        settings = PlanarRatingSettings(n_gray_bins=n_gray_bins, hidden=hidden)
        table = GrayLevelTable.from_distances(np.array([1.0]), 5.0, settings, LogOddsRange())
        for _ in range(50):
            counts = rng.integers(0, 20, n_gray_bins) * (rng.random(n_gray_bins) < 0.4)
            n = max(int(counts.sum() * rng.uniform(0.98, 3)), 1)
            plain = views.histogram_entropy(counts.tolist(), n, hidden)
            assert histogram_entropy(counts, table.arrays(n)) == pytest.approx(plain, abs=1e-12)
