"""Point clouds placed into the world: Eqs. 1 and 3, and the camera pose's own uncertainty."""

import math

import numpy as np
import pytest
from plain.point_covariances import covariance, cross_matrix
from scipy.spatial.transform import Rotation

from coopmap_env.geometry import Pose
from coopmap_env.sensing import PointCloud, RangeNoise, transform_cloud
from coopmap_env.sensing.scan import is_covariance

NOISE = RangeNoise(intrinsic=0.01, depth=1.0, lateral=0.25, exponent=2.0)


def cloud_of(*points, hit=True):
    return PointCloud(np.array(points, dtype=float), np.full(len(points), hit))


def pose_of(axes, angles, translation=(0.0, 0.0, 0.0)):
    R = Rotation.from_euler(axes, angles, degrees=True).as_matrix()
    return Pose(np.array(translation), R)


def random_pose(rng):
    return Pose(rng.normal(size=3), Rotation.random(random_state=rng).as_matrix())


def random_pose_covariance(rng, scale=0.05):
    A = rng.normal(size=(6, 6)) * scale
    return A @ A.T


def random_cloud(rng, n=40):
    points = rng.normal(size=(n, 3)) * [2.0, 1.0, 1.0] + [3.0, 0.0, 0.0]
    return PointCloud(points, rng.random(n) < 0.7)


def test_a_point_two_metres_ahead_by_hand_eq_1():
    scan = transform_cloud(cloud_of([2, 0, 0]), pose_of("z", 0), NOISE)
    # 0.01 * 2 ** 2 = 0.04 m in depth, a quarter of it across
    assert scan.covariances[0] == pytest.approx(np.diag([0.0016, 0.0001, 0.0001]))
    assert scan.points[0].tolist() == [2, 0, 0]


@pytest.mark.parametrize(
    ("axes", "angle", "point", "expected"),
    [
        ("z", 90, [1, 4, 3], np.diag([0.0001, 0.0016, 0.0001])),  # to the left
        ("z", 180, [-1, 2, 3], np.diag([0.0016, 0.0001, 0.0001])),  # back
        ("y", 90, [1, 2, 1], np.diag([0.0001, 0.0001, 0.0016])),  # straight down
        ("x", 90, [3, 2, 3], np.diag([0.0016, 0.0001, 0.0001])),  # rolled about the axis
    ],
)
def test_the_depth_axis_rotates_with_the_camera_by_hand_eq_3(axes, angle, point, expected):
    scan = transform_cloud(cloud_of([2, 0, 0]), pose_of(axes, angle, (1.0, 2.0, 3.0)), NOISE)
    assert scan.points[0] == pytest.approx(point)
    assert scan.covariances[0] == pytest.approx(expected, abs=1e-15)
    assert scan.origin.tolist() == [1, 2, 3]


def test_halfway_between_two_axes_the_covariance_has_both_by_hand_eq_3():
    scan = transform_cloud(cloud_of([2, 0, 0]), pose_of("z", 45), NOISE)
    half_sum, half_difference = (0.0016 + 0.0001) / 2, (0.0016 - 0.0001) / 2
    expected = [[half_sum, half_difference, 0], [half_difference, half_sum, 0], [0, 0, 0.0001]]
    assert scan.covariances[0] == pytest.approx(np.array(expected))


def test_the_distance_of_eq_1_is_that_to_the_point_not_its_depth():
    scan = transform_cloud(cloud_of([2, 1, 2]), pose_of("z", 0), NOISE)
    # 3 m away: 0.09 m along the optical axis, although the point lies off that axis
    assert np.sqrt(np.diag(scan.covariances[0])) == pytest.approx([0.09, 0.0225, 0.0225])


def test_an_uncertain_position_is_added_to_every_hit_by_hand():
    sigma = np.zeros((6, 6))
    sigma[:3, :3] = np.diag([0.01, 0.04, 0.09])
    cloud, pose = cloud_of([2, 0, 0], [4, 1, -1]), pose_of("zy", [30, 20])
    gained = (
        transform_cloud(cloud, pose, NOISE, sigma).covariances
        - transform_cloud(cloud, pose, NOISE).covariances
    )
    assert gained == pytest.approx(np.array([np.diag([0.01, 0.04, 0.09])] * 2))


def test_an_uncertain_heading_spreads_distant_points_sideways_by_hand():
    sigma = np.zeros((6, 6))
    sigma[5, 5] = 0.1**2
    exact = RangeNoise(intrinsic=0.0)
    # the camera looks along +y: 3 m away, a turn of 0.1 rad moves the point by 0.3 m along x
    scan = transform_cloud(cloud_of([3, 0, 0]), pose_of("z", 90), exact, sigma)
    assert scan.covariances[0] == pytest.approx(np.diag([0.09, 0.0, 0.0]), abs=1e-15)


def test_correlated_errors_of_position_and_heading_cancel_by_hand():
    """A camera that turns about a point 3 m ahead leaves that point where it is."""
    J = np.hstack([np.eye(3), -cross_matrix([3.0, 0.0, 0.0])])
    error = np.array([0.0, -0.3, 0.0, 0.0, 0.0, 0.1])
    assert J @ error == pytest.approx(np.zeros(3))
    scan = transform_cloud(
        cloud_of([3, 0, 0]), pose_of("z", 0), RangeNoise(intrinsic=0.0), np.outer(error, error)
    )
    assert scan.covariances[0] == pytest.approx(np.zeros((3, 3)), abs=1e-15)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 1.7, 2.0])
def test_transformed_clouds_equal_the_plain_reference_eqs_1_and_3(exponent):
    rng = np.random.default_rng(0)
    noise = RangeNoise(intrinsic=0.02, depth=1.3, lateral=0.4, exponent=exponent)
    for _ in range(5):
        cloud, pose, sigma = random_cloud(rng), random_pose(rng), random_pose_covariance(rng)
        scan = transform_cloud(cloud, pose, noise, sigma)
        assert scan.points == pytest.approx(pose.transform(cloud.points))
        for k in np.flatnonzero(cloud.hit):
            expected = covariance(cloud.points[k], pose.rotation, noise, sigma)
            assert scan.covariances[k] == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_the_jacobian_of_the_pose_is_that_of_finite_differences():
    rng = np.random.default_rng(1)
    pose, r, step = random_pose(rng), np.array([3.0, 0.5, -0.7]), 1e-6

    def moved(error):
        R = Rotation.from_rotvec(error[3:]).as_matrix() @ pose.rotation
        return Pose(pose.translation + error[:3], R).transform(r)

    J = np.column_stack([(moved(step * e) - moved(-step * e)) / (2 * step) for e in np.eye(6)])
    sigma = random_pose_covariance(rng)
    scan = transform_cloud(
        PointCloud(r[None], np.array([True])), pose, RangeNoise(intrinsic=0.0), sigma
    )
    assert scan.covariances[0] == pytest.approx(J @ sigma @ J.T, rel=1e-7)


def test_the_term_of_the_pose_is_the_scatter_of_points_from_scattered_cameras():
    """20,000 draws: an entry of a covariance errs by 1 / sqrt(20,000) = 0.7 % of its diagonal."""
    rng = np.random.default_rng(2)
    pose, r, sigma = random_pose(rng), np.array([2.0, -0.4, 0.6]), random_pose_covariance(rng, 4e-3)
    errors = rng.multivariate_normal(np.zeros(6), sigma, size=20_000)
    R = Rotation.from_rotvec(errors[:, 3:]).as_matrix() @ pose.rotation
    seen = pose.translation + errors[:, :3] + R @ r
    scan = transform_cloud(
        PointCloud(r[None], np.array([True])), pose, RangeNoise(intrinsic=0.0), sigma
    )
    C = scan.covariances[0]
    assert (np.abs(np.cov(seen.T) - C) < 0.04 * np.sqrt(np.outer(np.diag(C), np.diag(C)))).all()


def test_rotating_the_camera_keeps_the_eigenvalues_eq_3():
    rng = np.random.default_rng(3)
    cloud = random_cloud(rng)
    sigma = NOISE.standard_deviations(np.linalg.norm(cloud.points, axis=1), 3)[cloud.hit]
    for _ in range(5):
        scan = transform_cloud(cloud, random_pose(rng), NOISE)
        eigenvalues = np.linalg.eigvalsh(scan.covariances[cloud.hit])
        assert eigenvalues == pytest.approx(np.sort(sigma**2, axis=1))


def test_covariances_are_symmetric_and_positive_definite_and_grow_with_the_poses_own():
    rng = np.random.default_rng(4)
    for _ in range(5):
        cloud, pose = random_cloud(rng), random_pose(rng)
        without = transform_cloud(cloud, pose, NOISE).covariances[cloud.hit]
        with_pose = transform_cloud(cloud, pose, NOISE, random_pose_covariance(rng)).covariances[
            cloud.hit
        ]
        for covariances in (without, with_pose):
            assert (covariances == covariances.transpose(0, 2, 1)).all()
            assert np.linalg.eigvalsh(covariances).min() > 0
        assert np.linalg.eigvalsh(with_pose - without).min() > -1e-12


def test_transforming_is_equivariant_under_rigid_motion():
    rng = np.random.default_rng(5)
    cloud, pose, sigma = random_cloud(rng), random_pose(rng), random_pose_covariance(rng)
    motion = random_pose(rng)
    turn = np.kron(np.eye(2), motion.rotation)
    here = transform_cloud(cloud, pose, NOISE, sigma)
    there = transform_cloud(cloud, motion @ pose, NOISE, turn @ sigma @ turn.T)
    R = motion.rotation
    assert there.points == pytest.approx(motion.transform(here.points))
    assert there.covariances == pytest.approx(R @ here.covariances @ R.T, abs=1e-12)


def test_a_scan_has_a_pose_covariance_of_its_own_which_is_zero_if_the_pose_is_exact():
    sigma = random_pose_covariance(np.random.default_rng(9))
    scan = transform_cloud(cloud_of([1, 0, 0]), pose_of("z", 0), NOISE, sigma)
    wanted = sigma.copy()
    sigma[:] = 0.0  # as a filter may do that goes on
    np.testing.assert_array_equal(scan.pose_covariance, wanted)
    exact = transform_cloud(cloud_of([1, 0, 0]), pose_of("z", 0), NOISE)
    np.testing.assert_array_equal(exact.pose_covariance, np.zeros((6, 6)))


def test_points_are_independent_of_each_other():
    rng = np.random.default_rng(6)
    cloud, pose, sigma = random_cloud(rng), random_pose(rng), random_pose_covariance(rng)
    order = rng.permutation(len(cloud.points))
    scan = transform_cloud(cloud, pose, NOISE, sigma)
    mixed = transform_cloud(PointCloud(cloud.points[order], cloud.hit[order]), pose, NOISE, sigma)
    assert (mixed.points == scan.points[order]).all()
    assert (mixed.covariances == scan.covariances[order]).all()


def test_beams_without_return_keep_their_ends_and_have_no_covariance():
    pose = pose_of("z", 90, (1.0, 2.0, 3.0))
    scan = transform_cloud(cloud_of([6, 0, 0], hit=False), pose, NOISE, np.eye(6))
    assert scan.points == pytest.approx(np.array([[1, 8, 3]]))
    assert not scan.hit.any()
    assert not scan.covariances.any()


def test_a_beam_that_observes_nothing_ends_exactly_at_the_camera():
    rng = np.random.default_rng(7)
    pose = random_pose(rng)
    scan = transform_cloud(cloud_of([0, 0, 0], hit=False), pose, NOISE)
    assert (scan.points[0] == scan.origin).all()


def test_a_cloud_of_no_points_becomes_a_scan_of_none():
    cloud = PointCloud(np.zeros((0, 3)), np.zeros(0, dtype=bool))
    assert len(transform_cloud(cloud, pose_of("z", 0), NOISE).points) == 0


@pytest.mark.parametrize(
    ("points", "hit"),
    [((4, 2), (4,)), ((4, 3), (3,)), ((12,), (12,)), ((4, 3), (4, 1))],
)
def test_arrays_of_different_sizes_are_rejected(points, hit):
    with pytest.raises(ValueError, match="a point cloud needs points"):
        PointCloud(np.zeros(points), np.zeros(hit, dtype=bool))


def test_hits_that_are_no_bools_are_rejected():
    with pytest.raises(ValueError, match="of float64"):
        PointCloud(np.zeros((4, 3)), np.zeros(4))


def test_a_planar_pose_is_rejected():
    with pytest.raises(ValueError, match=r"needs a pose in 3-D, got translation \(2,\)"):
        transform_cloud(cloud_of([1, 0, 0]), Pose.planar(0, 0, 0), NOISE)


@pytest.mark.parametrize(
    ("sigma", "message"),
    [
        (np.eye(3), r"must be finite and \(6, 6\), got \(3, 3\)"),
        (np.full((6, 6), math.nan), "must be finite"),
        (np.diag([1.0, 1, 1, 1, 1, -1]), "positive semi-definite"),
        (np.eye(6) + np.eye(6, k=1), "symmetric"),
    ],
)
def test_an_invalid_pose_covariance_is_rejected(sigma, message):
    with pytest.raises(ValueError, match=message):
        transform_cloud(cloud_of([1, 0, 0]), pose_of("z", 0), NOISE, sigma)


def test_covariances_are_recognised_as_by_their_eigenvalues():
    rng = np.random.default_rng(5)
    accepted = []
    for _ in range(300):
        Q = np.linalg.qr(rng.normal(size=(6, 6)))[0]
        values = rng.choice([0.0, 1.0, 1e-3, 1e-6, -1e-6], size=6, p=[0.3, 0.3, 0.2, 0.15, 0.05])
        sigma = (Q * values) @ Q.T
        sigma = 0.5 * (sigma + sigma.T)
        wanted = np.linalg.eigvalsh(sigma)[0] >= -1e-9 * np.abs(sigma).max()
        accepted.append(is_covariance(sigma))
        assert accepted[-1] == wanted
    assert 50 < sum(accepted) < 250
    assert is_covariance(np.zeros((6, 6)))
    crooked = np.eye(6)
    crooked[0, 1] = 1e-6
    assert not is_covariance(crooked)
