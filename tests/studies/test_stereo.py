"""Eq. 1 on a real stereo pair, and the tools that measure it."""

import json

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from coopmap_env.sensing import RangeNoise
from coopmap_env.studies.field import stereo, stereo_matching


def textured(rng, shape):
    """A random image, smooth over a pixel or two, so that it can be shifted by parts of pixels."""
    image = gaussian_filter(rng.random(shape), 1.5)
    return (image - image.min()) / np.ptp(image)


@pytest.mark.parametrize("shift", [4, 6.5, 9.25])
def test_the_matcher_finds_a_shift_to_a_tenth_of_a_pixel(shift):
    left = textured(np.random.default_rng(0), (40, 120))
    columns = np.arange(120)
    right = np.array([np.interp(columns + shift, columns, row) for row in left])
    found = stereo_matching.match_blocks(left, right, 16)
    inner = found[10:-10, 25:-25]
    assert np.isfinite(inner).mean() > 0.95
    assert np.nanmedian(inner) == pytest.approx(shift, abs=0.1)


def test_images_without_anything_in_common_mostly_have_no_disparity():
    rng = np.random.default_rng(1)
    left, right = textured(rng, (60, 160)), textured(rng, (60, 160))
    # the left-right check keeps what is best by chance in both directions
    assert np.isfinite(stereo_matching.match_blocks(left, right, 40)).mean() < 0.45


def test_images_that_do_not_fit_are_rejected():
    with pytest.raises(ValueError, match=r"one shape, got \(4, 9\), \(4, 8\)"):
        stereo_matching.match_blocks(np.zeros((4, 9)), np.zeros((4, 8)), 5)
    with pytest.raises(ValueError, match=r"\[3, 9\], got 2"):
        stereo_matching.match_blocks(np.zeros((4, 9)), np.zeros((4, 9)), 2)


@pytest.mark.parametrize("n", [1.0, 2.0])
def test_the_fit_finds_the_law_that_made_the_errors(n):
    rng = np.random.default_rng(2)
    depth = rng.uniform(2, 5, (300, 400))
    error = rng.normal(size=depth.shape) * 0.003 * depth**n
    error[rng.random(depth.shape) < 0.02] = 3.0  # gross errors hardly count
    error[:50, :50] = np.nan
    law = stereo.fit_error_law(depth, error, rng)
    # some 1600 errors a bin: sigma is known to 3 %, n to 0.05
    assert law.exponent.estimate == pytest.approx(n, abs=0.15)
    assert law.exponent.low < n < law.exponent.high
    assert law.sigmas == pytest.approx(0.003 * law.distances**n, rel=0.1)
    if n == 2:
        assert law.intrinsic_at_2 == pytest.approx(0.003, rel=0.05)


def test_too_few_errors_are_rejected():
    with pytest.raises(ValueError, match="too few"):
        stereo.fit_error_law(np.ones((30, 30)), np.ones((30, 30)), np.random.default_rng(0))


def test_pixels_become_points_forward_left_and_up_of_the_camera():
    disparity = np.full((400, 700), np.nan)
    disparity[300, 600] = 20.0
    scan = stereo.to_scan(disparity, RangeNoise())
    z = stereo_matching.FOCAL_LENGTH * stereo_matching.BASELINE / (20 + stereo_matching.DOFFS)
    right, down = (
        (600 - stereo_matching.CENTER_X) / stereo_matching.FOCAL_LENGTH,
        (300 - stereo_matching.CENTER_Y) / stereo_matching.FOCAL_LENGTH,
    )
    np.testing.assert_allclose(scan.points, [[z, -right * z, -down * z]])
    sigma = 0.0015 * z**2
    np.testing.assert_allclose(
        scan.covariances[0], np.diag([sigma**2, (sigma / 4) ** 2, (sigma / 4) ** 2])
    )


@pytest.fixture(scope="module")
def result():
    pytest.importorskip("skimage")
    return stereo.run_stereo(np.random.default_rng(0))


def test_the_true_disparity_is_that_of_the_left_image():
    pytest.importorskip("skimage")
    pair = stereo_matching.load_motorcycle()
    rows, columns = np.nonzero(np.isfinite(pair.disparity))
    there = np.rint(columns - pair.disparity[rows, columns]).astype(int)
    inside = there >= 0
    rows, columns, there = rows[inside], columns[inside], there[inside]
    same = np.abs(pair.left[rows, columns] - pair.right[rows, there]).mean()
    other = np.abs(pair.left[rows, columns] - pair.right[rows, columns]).mean()
    assert same < other / 3


def test_the_depth_error_of_a_real_pair_grows_with_the_square_of_the_distance_eq_1(result):
    n = result.law.exponent
    assert n.low < 2 < n.high
    assert n.estimate == pytest.approx(2, abs=0.25)
    # the spread that RangeNoise has by default is that of this matcher
    assert result.law.intrinsic_at_2 == pytest.approx(RangeNoise().intrinsic, rel=0.25)
    assert result.bad_fraction < 0.1


def test_most_occupied_voxels_of_the_fused_map_are_near_a_true_point(result):
    cells, means, _ = result.map.surfaces()
    means = means[result.map.probability.ravel()[cells] > 0.5]
    assert len(means) > 3000
    pair = result.pair
    columns = np.rint(
        stereo_matching.CENTER_X - means[:, 1] / means[:, 0] * stereo_matching.FOCAL_LENGTH
    ).astype(int)
    rows = np.rint(
        stereo_matching.CENTER_Y - means[:, 2] / means[:, 0] * stereo_matching.FOCAL_LENGTH
    ).astype(int)
    error = means[:, 0] - stereo_matching.depth_from_disparity(pair.disparity)[rows, columns]
    error = np.abs(error[np.isfinite(error)])
    assert np.median(error) < 0.02
    assert (error < 0.2).mean() > 0.8


def test_figures_and_picture_are_written(result, tmp_path):
    summary = json.loads(json.dumps(result.summary()))
    assert summary["exponent"]["low"] < summary["exponent"]["high"]
    pytest.importorskip("matplotlib")
    stereo.draw_stereo(result, tmp_path / "figures" / "stereo.png")
    assert (tmp_path / "figures" / "stereo.png").stat().st_size > 30_000
