"""Eqs. 10 to 13, and the rigid solutions beside them."""

import numpy as np
import pytest
from plain import identification as plain
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from coopmap_env.geometry import Pose, apply_displacement, displacement_between
from coopmap_env.localization.correction.pose_estimators import (
    DegenerateGeometryError,
    RecursiveMoments,
    back_project,
    consistent_subset,
    gaussian_pose,
    linear_pose,
    linear_transform,
    pose_from_transform,
    recursive_pose,
    rigid_pose,
)

ROUNDING = 1e-9
"""Metres and radians: points of some metres, solved by matrices of moderate condition."""
AHEAD = np.array([3.0, 0.0, 0.0])
HERE = Pose(np.zeros(3), np.eye(3))
QUARTER = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""R_01 of a quarter turn about the optical axis: what was left of the camera is up now."""
SHIFT = np.array([2.0, 0.5, -1.0])
CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
SEEN_CORNERS = np.array([[2.0, 0.5, -1], [3, 0.5, -1], [2, 0.5, 0], [2, -0.5, -1]])
"""QUARTER @ corner + SHIFT, by hand."""


def random_pose(rng):
    return Pose(rng.uniform(-2, 2, 3), Rotation.random(random_state=rng).as_matrix())


def seen(pose, base_points):
    """The points as a camera at T_base_camera sees them."""
    return pose.inverse().transform(base_points)


def scattered(rng, m=12):
    """Fiducials in a room of 2 m around a point 3 m away."""
    return rng.uniform(-1, 1, (m, 3)) + AHEAD


def in_a_plane(rng, m=6):
    """Points that lie in one tilted plane."""
    return rng.uniform(-1, 1, (m, 2)) @ rng.normal(size=(2, 3)) + AHEAD


def in_a_line(rng, m=5):
    return rng.uniform(-1, 1, (m, 1)) * rng.normal(size=3) + AHEAD


def error(pose, true):
    """Metres and radians, as one number."""
    return np.linalg.norm(displacement_between(pose, true))


def anisotropic(rng, m):
    """Covariances (m, 3, 3) of 2 cm along one axis and a tenth across, each turned another way."""
    turns = Rotation.random(m, random_state=rng).as_matrix()
    return turns @ (np.diag([0.02, 0.002, 0.002]) ** 2) @ turns.transpose(0, 2, 1)


def drawn(rng, covariances):
    L = np.linalg.cholesky(covariances)
    return (L @ rng.normal(size=(len(L), 3, 1)))[:, :, 0]


# Eq. 10


def test_by_hand_an_image_point_and_its_scale_are_a_point_eq_10():
    """At 2 m, left of the axis by a quarter and below it by a half of the focal length."""
    np.testing.assert_array_equal(back_project([[0.25, -0.5]], [2.0]), [[2.0, 0.5, -1.0]])
    np.testing.assert_array_equal(back_project([[0, 0], [1, 2]], [1, 3]), [[1, 0, 0], [3, 3, 6]])


def test_the_scale_of_a_stereo_pair_is_depth_over_focal_length_eq_10():
    """A focal length of 500 pixels: k = 2 m / 500, and u, v are pixels too."""
    point = back_project([[125.0, -250.0]], [2.0 / 500.0], 500.0)
    np.testing.assert_allclose(point, [[2.0, 0.5, -1.0]], rtol=1e-15)


# Eq. 12


def test_by_hand_a_quarter_turn_and_a_shift_eq_12():
    g = linear_transform(CORNERS, SEEN_CORNERS)
    np.testing.assert_allclose(g, np.column_stack([QUARTER, SHIFT]), atol=1e-14)
    # the camera is where R c + x = 0: c = -R^T x
    pose = pose_from_transform(g)
    np.testing.assert_allclose(pose.translation, [-2.0, 1.0, 0.5], atol=1e-14)
    np.testing.assert_allclose(pose.rotation, QUARTER.T, atol=1e-14)
    same = linear_pose(CORNERS, SEEN_CORNERS)
    np.testing.assert_allclose(same.translation, [-2.0, 1.0, 0.5], atol=1e-14)
    np.testing.assert_allclose(same.rotation, QUARTER.T, atol=1e-14)


@pytest.mark.parametrize("m", [4, 5, 30])
def test_without_noise_eq_12_is_exact(m):
    rng = np.random.default_rng(m)
    for _ in range(20):
        true, points = random_pose(rng), scattered(rng, m)
        g = linear_transform(points, seen(true, points))
        inverse = true.inverse()
        wanted = np.column_stack([inverse.rotation, inverse.translation])
        # four points drawn at random can be nearly in a plane: condition up to 1e4
        np.testing.assert_allclose(g, wanted, atol=1e-8)
        assert error(linear_pose(points, seen(true, points)), true) < 1e-8


def test_eq_12_is_the_plain_least_squares_of_twelve_unknowns():
    """Far from the origin too, where the normal equations as written lose half of their digits."""
    rng = np.random.default_rng(0)
    for far in (0.0, 1000.0):
        points = scattered(rng) + far
        image = rng.uniform(-1, 1, points.shape)  # no rigid motion at all
        g = linear_transform(points, image)
        wanted = plain.affine_fit(points, image)
        middle = np.append(points.mean(axis=0), 1.0)
        np.testing.assert_allclose(g[:, :3], wanted[:, :3], atol=1e-8)
        np.testing.assert_allclose(g @ middle, wanted @ middle, atol=1e-8)


@pytest.mark.parametrize("solve", [linear_transform, linear_pose])
@pytest.mark.parametrize(
    ("points", "message"),
    [
        (CORNERS[:3], "got 3$"),
        (np.zeros((0, 3)), "got 0$"),
        (in_a_plane(np.random.default_rng(1)), "got 6 in a plane$"),
        (in_a_line(np.random.default_rng(2)), "got 5 in a plane$"),
        (np.ones((7, 3)), "got 7 in a plane$"),
    ],
)
def test_eq_12_refuses_points_from_which_it_does_not_follow(solve, points, message):
    with pytest.raises(
        DegenerateGeometryError, match=f"four points that are not in one plane, {message}"
    ):
        solve(points, points)


def test_the_rotation_after_eq_12_is_proper_and_the_nearest():
    rng = np.random.default_rng(3)
    points = scattered(rng)
    image = seen(random_pose(rng), points) + 0.2 * rng.normal(size=points.shape)
    G = linear_transform(points, image)[:, :3]
    R = linear_pose(points, image).rotation.T
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-12)
    assert np.linalg.norm(G - R) > 0.05  # there is something to be done
    for w in 0.01 * rng.normal(size=(200, 3)):
        other = Rotation.from_rotvec(w).as_matrix() @ R
        assert np.linalg.norm(G - other) > np.linalg.norm(G - R)


def test_a_translation_that_goes_with_the_rotation_errs_less():
    """Points 3 m away and 1 cm of noise: paired over 100 draws."""
    rng = np.random.default_rng(4)
    recomputed, as_it_was = [], []
    for _ in range(100):
        true, points = random_pose(rng), scattered(rng)
        image = seen(true, points) + 0.01 * rng.normal(size=points.shape)
        recomputed.append(error(linear_pose(points, image), true))
        as_it_was.append(error(pose_from_transform(linear_transform(points, image)), true))
    better = np.array(as_it_was) - recomputed
    assert better.mean() > 3 * better.std() / 10  # three standard errors of the mean


def test_points_of_other_shapes_and_values_are_rejected():
    with pytest.raises(ValueError, match=r"\(4, 3\), \(3, 3\)"):
        linear_transform(CORNERS, SEEN_CORNERS[:3])
    with pytest.raises(ValueError, match=r"\(4, 2\)"):
        rigid_pose(CORNERS[:, :2], CORNERS[:, :2])
    with pytest.raises(ValueError, match="not finite"):
        rigid_pose(CORNERS, SEEN_CORNERS * np.nan)


# Eq. 13


def test_by_hand_mean_and_covariance_of_three_values_eq_13():
    moments = RecursiveMoments(1)
    steps = []
    for value in (1.0, 3.0, 8.0):
        moments.add([value])
        steps.append((moments.count, moments.mean[0], moments.covariance[0, 0]))
    # (1 + 9 + 16) / 3 about 4
    assert steps == [(1, 1.0, 0.0), (2, 2.0, 1.0), (3, 4.0, pytest.approx(26.0 / 3.0))]


def test_the_recursion_is_the_batch_at_each_step_eq_13():
    rng = np.random.default_rng(5)
    values = rng.normal(size=(40, 12)) @ rng.normal(size=(12, 12)) + 5.0
    moments = RecursiveMoments(12)
    for i, value in enumerate(values, start=1):
        moments.add(value)
        np.testing.assert_allclose(moments.mean, values[:i].mean(axis=0), atol=1e-12)
        if i > 1:
            batch = np.cov(values[:i].T, bias=True)
            np.testing.assert_allclose(moments.covariance, batch, atol=1e-11)


def test_the_order_of_values_does_not_matter_in_the_end_eq_13():
    rng = np.random.default_rng(6)
    values = rng.normal(size=(30, 3))
    one, other = RecursiveMoments(3), RecursiveMoments(3)
    for a, b in zip(values, rng.permutation(values), strict=True):
        one.add(a)
        other.add(b)
    np.testing.assert_allclose(one.mean, other.mean, atol=1e-14)  # rounding of 30 sums
    np.testing.assert_allclose(one.covariance, other.covariance, atol=1e-14)


def test_without_noise_the_recursive_pose_is_exact_and_has_no_spread():
    rng = np.random.default_rng(7)
    true, points = random_pose(rng), scattered(rng)
    pose, covariance = recursive_pose(points, seen(true, points))
    assert error(pose, true) < 1e-8  # the first four may be nearly in a plane
    assert np.abs(covariance).max() < 1e-16


def test_the_recursive_pose_is_that_of_the_mean_over_first_points():
    rng = np.random.default_rng(8)
    points = scattered(rng, 9)
    points[:5, 2] = 0.3  # the first five in a plane: nothing follows from them
    image = seen(random_pose(rng), points) + 0.01 * rng.normal(size=points.shape)
    found = [linear_transform(points[:m], image[:m]) for m in range(6, 10)]
    pose, covariance = recursive_pose(points, image)
    wanted = pose_from_transform(np.mean(found, axis=0))
    assert error(pose, wanted) < ROUNDING
    batch = np.cov(np.reshape(found, (4, 12)).T, bias=True)
    np.testing.assert_allclose(covariance, batch, atol=1e-12)


def test_no_recursive_pose_of_points_in_a_plane():
    rng = np.random.default_rng(9)
    points = in_a_plane(rng)
    with pytest.raises(DegenerateGeometryError, match="6 points, of which no first ones"):
        recursive_pose(points, points)
    with pytest.raises(DegenerateGeometryError, match="3 points, of which no first ones"):
        recursive_pose(CORNERS[:3], CORNERS[:3])


# Umeyama


def test_by_hand_three_points_tell_a_quarter_turn():
    pose = rigid_pose(CORNERS[:3], SEEN_CORNERS[:3])
    np.testing.assert_allclose(pose.translation, [-2.0, 1.0, 0.5], atol=1e-14)
    np.testing.assert_allclose(pose.rotation, QUARTER.T, atol=1e-14)


@pytest.mark.parametrize("place", [scattered, in_a_plane])
@pytest.mark.parametrize("m", [3, 6])
def test_without_noise_the_rigid_pose_is_exact_in_a_plane_too(place, m):
    rng = np.random.default_rng(10)
    for _ in range(20):
        true, points = random_pose(rng), place(rng, m)
        weights = rng.uniform(0.1, 10.0, m)
        # three points can be nearly in a line: their scatter's condition times rounding
        assert error(rigid_pose(points, seen(true, points), weights), true) < 1e-7


def test_the_rigid_rotation_is_that_of_scipy_on_centered_points():
    rng = np.random.default_rng(11)
    for _ in range(20):
        points, weights = scattered(rng), rng.uniform(0.1, 10.0, 12)
        image = seen(random_pose(rng), points) + 0.1 * rng.normal(size=points.shape)
        pose = rigid_pose(points, image, weights)
        middle, middle_image = (np.average(p, axis=0, weights=weights) for p in (points, image))
        wanted, _ = Rotation.align_vectors(points - middle, image - middle_image, weights)
        np.testing.assert_allclose(pose.rotation, wanted.as_matrix(), atol=ROUNDING)
        np.testing.assert_allclose(pose.transform(middle_image), middle, atol=ROUNDING)
        scaled = rigid_pose(points, image, 7.0 * weights)
        assert error(scaled, pose) < ROUNDING


def test_no_pose_leaves_less_than_the_rigid_one():
    rng = np.random.default_rng(12)
    points, weights = scattered(rng), rng.uniform(0.1, 10.0, 12)
    image = seen(random_pose(rng), points) + 0.1 * rng.normal(size=points.shape)
    information = weights[:, None, None] * np.eye(3)
    pose = rigid_pose(points, image, weights)
    least = plain.sum_of_squares(pose, points, image, information)
    for d in 0.01 * rng.normal(size=(200, 6)):
        assert plain.sum_of_squares(apply_displacement(pose, d), points, image, information) > least


def test_a_weight_of_zero_leaves_a_point_out():
    rng = np.random.default_rng(13)
    points = scattered(rng)
    image = seen(random_pose(rng), points) + 0.01 * rng.normal(size=points.shape)
    image[4] += 5.0
    weights = np.ones(12)
    weights[4] = 0.0
    without = rigid_pose(np.delete(points, 4, axis=0), np.delete(image, 4, axis=0))
    assert error(rigid_pose(points, image, weights), without) < ROUNDING


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (CORNERS[:2], "got 2$"),
        (in_a_line(np.random.default_rng(14)), "got 5 in a line$"),
        (np.ones((3, 3)), "got 3 in a line$"),
    ],
)
def test_no_rigid_pose_of_points_in_a_line(points, message):
    with pytest.raises(
        DegenerateGeometryError, match=f"three points that are not in one line, {message}"
    ):
        rigid_pose(points, points)


def test_no_rigid_pose_of_weights_that_leave_a_line():
    line = in_a_line(np.random.default_rng(15), 4)
    points = np.vstack([line, [3.0, 5, 0]])
    with pytest.raises(DegenerateGeometryError, match="in a line"):
        rigid_pose(points, points, [1, 1, 1, 1, 0])


# outliers


@pytest.mark.parametrize("moved", [[], [3], [0], [2, 5]])
def test_fiducials_that_have_moved_are_found(moved):
    """By 15 to 25 cm, where 1 cm is known of each: 20 sets of eight."""
    rng = np.random.default_rng(16)
    for _ in range(20):
        points = scattered(rng, 8)
        image = seen(random_pose(rng), points)
        for i in moved:
            step = rng.normal(size=3)
            image[i] += rng.uniform(0.15, 0.25) * step / np.linalg.norm(step)
        selected = consistent_subset(points, image, np.full(8, 0.01))
        np.testing.assert_array_equal(np.flatnonzero(~selected), moved)


def test_two_fiducials_that_moved_together_are_found():
    """They agree with each other, and six agree that they moved."""
    rng = np.random.default_rng(17)
    points = scattered(rng, 8)
    image = seen(random_pose(rng), points)
    image[[2, 5]] += [0.1, 0.15, 0.0]
    selected = consistent_subset(points, image, np.full(8, 0.01))
    np.testing.assert_array_equal(np.flatnonzero(~selected), [2, 5])


def test_by_hand_distances_agree_up_to_so_many_deviations():
    """A pair whose distance grew by 5 cm, known to 1 cm and 4/3 cm: 1.667 cm together."""
    points, image = np.array([[0.0, 0, 0], [1, 0, 0]]), np.array([[0.0, 0, 0], [1.05, 0, 0]])
    deviations = np.array([0.01, 0.04 / 3])
    assert consistent_subset(points, image, deviations, 3.01).tolist() == [True, True]
    assert consistent_subset(points, image, deviations, 2.99).tolist() == [True, False]


def test_those_selected_all_agree_and_are_about_as_many_as_can():
    """The greedy choice against every set of nine fiducials, half of which are anywhere."""
    rng = np.random.default_rng(18)
    sizes = []
    for _ in range(30):
        points = scattered(rng, 9)
        image = seen(random_pose(rng), points) + 0.01 * rng.normal(size=points.shape)
        image[:4] += rng.normal(size=(4, 3)) * rng.choice([0.02, 0.2])
        deviations = rng.uniform(0.005, 0.02, 9)
        selected = np.flatnonzero(consistent_subset(points, image, deviations))
        for i in range(9):
            others = [j for j in selected if j != i]
            agree = [plain.distances_agree(points, image, deviations, i, j, 3.0) for j in others]
            assert all(agree) == (i in selected)  # a clique that nothing can be added to
        sizes.append((len(selected), plain.largest_clique(points, image, deviations, 3.0)))
    found, largest = np.array(sizes).T
    assert (found <= largest).all()
    assert (found == largest).mean() > 0.8  # what greedy means


def test_noise_seldom_makes_an_outlier():
    """A pair in 370 is off by three deviations; of eight fiducials, 28 pairs."""
    rng = np.random.default_rng(19)
    kept = 0
    for _ in range(200):
        points = scattered(rng, 8)
        image = seen(HERE, points) + 0.01 * rng.normal(size=points.shape)
        kept += consistent_subset(points, image, np.full(8, 0.01)).sum()
    # at most one of eight in 28 / 370 of the sets: 15 of 1600, and as much again
    assert kept >= 1600 - 30


# Gaussians


def test_with_equal_round_gaussians_the_likeliest_pose_is_umeyamas():
    rng = np.random.default_rng(20)
    for _ in range(20):
        true, points = random_pose(rng), scattered(rng)
        image = seen(true, points) + 0.01 * rng.normal(size=points.shape)
        start = apply_displacement(true, rng.normal(size=6) * 0.02)
        information = np.broadcast_to(1e4 * np.eye(3), (12, 3, 3))
        found = gaussian_pose(points, image, information, start)
        # residuals of 1 cm at arms of a metre: each iteration leaves a hundredth
        assert error(found.estimate.pose, rigid_pose(points, image)) < 1e-8
        left = points - found.estimate.pose.transform(image)
        np.testing.assert_allclose(
            found.squared_mahalanobis, 1e4 * (left**2).sum(axis=1), rtol=1e-9
        )


def test_no_pose_is_likelier():
    rng = np.random.default_rng(21)
    true, points = random_pose(rng), scattered(rng)
    covariances = anisotropic(rng, 12)
    image = seen(true, points + drawn(rng, covariances))
    information = np.linalg.inv(covariances)
    pose = gaussian_pose(points, image, information, true).estimate.pose
    least = plain.sum_of_squares(pose, points, image, information)
    for d in 1e-3 * rng.normal(size=(200, 6)):
        assert plain.sum_of_squares(apply_displacement(pose, d), points, image, information) > least


FACE = np.array([[3.0, 1, 1], [3, -1, 1], [3, 1, -1], [3, -1, -1]])
"""Four points of a wall 3 m ahead."""
ALONG_X = np.broadcast_to(np.diag([1e4, 0.0, 0.0]), (4, 3, 3))
"""A wall measures a point to 1 cm across it, and not at all along it."""


def test_by_hand_a_wall_leaves_the_directions_along_it_to_the_prior():
    """The wall is seen 5 cm too near: the camera stands 5 cm nearer to it."""
    prior = np.diag([1.0, 0.02, 0.03, 0.04, 1.0, 1.0]) ** 2
    found = gaussian_pose(FACE, FACE - [0.05, 0, 0], ALONG_X, HERE, prior)
    # four points of 1 cm each along x, and a prior of 1 m: 0.05 / (1 + 1e-4 / 4)
    wanted = [0.05 / (1 + 1e-4 / 4), 0.0, 0.0]
    np.testing.assert_allclose(found.estimate.pose.translation, wanted, atol=1e-12)
    np.testing.assert_allclose(found.estimate.pose.rotation, np.eye(3), atol=1e-12)
    C = found.estimate.covariance
    np.testing.assert_allclose(np.sqrt(np.diag(C)[1:4]), [0.02, 0.03, 0.04], rtol=1e-9)
    # arms of 1 m: yaw and pitch as well as x, 1 cm / sqrt(4), and the prior hardly helps
    np.testing.assert_allclose(np.sqrt(np.diag(C)[[0, 4, 5]]), 0.005, rtol=1e-4)


@pytest.mark.parametrize("k", [0, 1, 4])
def test_a_wall_without_a_prior_does_not_determine_the_pose(k):
    with pytest.raises(DegenerateGeometryError, match=f"{k} fiducials do not determine the pose"):
        gaussian_pose(FACE[:k], FACE[:k], ALONG_X[:k], HERE)


def test_a_turn_about_the_line_of_two_fiducials_is_open():
    points = np.array([[3.0, 1, 0.2], [2.0, -1, 0.5]])
    with pytest.raises(DegenerateGeometryError, match="2 fiducials do not determine the pose"):
        gaussian_pose(points, points, np.broadcast_to(1e4 * np.eye(3), (2, 3, 3)), HERE)


def test_a_prior_that_is_sure_keeps_the_pose():
    rng = np.random.default_rng(22)
    true, points = random_pose(rng), scattered(rng)
    start = apply_displacement(true, [0.01, 0, 0, 0, 0.01, 0])
    information = np.broadcast_to(1e4 * np.eye(3), (12, 3, 3))
    found = gaussian_pose(points, seen(true, points), information, start, 1e-14 * np.eye(6))
    assert error(found.estimate.pose, start) < 1e-6  # 1e-7 against 1 cm: squares are 1e-10 apart


@pytest.fixture(scope="module")
def anisotropic_draws():
    """300 times ten fiducials of known covariance: displacements from the truth of each method.

    The prediction from which the likeliest pose is searched is off by 2 cm and 0.6 degrees.
    """
    rng = np.random.default_rng(23)
    names = ("gaussian", "rigid", "linear")
    errors = {name: np.empty((300, 6)) for name in names}
    nees, left = np.empty(300), np.empty(300)
    for k in range(300):
        true, points = random_pose(rng), scattered(rng, 10)
        covariances = anisotropic(rng, 10)
        image = seen(true, points + drawn(rng, covariances))
        start = apply_displacement(true, rng.normal(size=6) * 0.01)
        found = gaussian_pose(points, image, np.linalg.inv(covariances), start)
        poses = (found.estimate.pose, rigid_pose(points, image), linear_pose(points, image))
        for name, pose in zip(names, poses, strict=True):
            errors[name][k] = displacement_between(pose, true)
        e = errors["gaussian"][k]
        nees[k] = e @ np.linalg.solve(found.estimate.covariance, e)
        left[k] = found.squared_mahalanobis.sum()
    return errors, nees, left


def test_the_covariance_of_the_likeliest_pose_is_that_of_its_errors(anisotropic_draws):
    """Squared errors in it have the mean 6: their sum is chi-square with 1800 degrees."""
    _, nees, left = anisotropic_draws
    low, high = chi2.ppf([0.005, 0.995], 6 * 300) / 300
    assert low < nees.mean() < high
    # what is left of 30 coordinates, of which six went into the pose
    low, high = chi2.ppf([0.005, 0.995], 24 * 300) / 300
    assert low < left.mean() < high


@pytest.mark.parametrize("other", ["rigid", "linear"])
def test_who_knows_the_directions_of_errors_errs_less(anisotropic_draws, other):
    """Paired over the draws, in metres and in radians."""
    errors, _, _ = anisotropic_draws
    for part in (slice(0, 3), slice(3, 6)):
        mine, theirs = (np.linalg.norm(errors[k][:, part], axis=1) for k in ("gaussian", other))
        less = theirs - mine
        assert less.mean() > 4 * less.std() / np.sqrt(300)  # four standard errors
        assert np.median(mine) < 0.7 * np.median(theirs)
