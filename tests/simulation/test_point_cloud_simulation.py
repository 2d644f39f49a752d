"""What a depth camera makes of true distances: its range and its noise (Eq. 1)."""

import math

import numpy as np
import pytest

from coopmap_env.geometry import Pose
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.sensing import DepthCamera, RangeNoise, transform_cloud
from coopmap_env.simulation.depth import simulate_point_cloud

EXACT = RangeNoise(intrinsic=0.0)
SMALL = DepthCamera(width=4, height=3)


def simulated(distances, camera=SMALL, noise=EXACT, seed=0):
    if np.ndim(distances) == 0:
        distances = np.full(camera.n_pixels, distances)
    return simulate_point_cloud(distances, camera, noise, np.random.default_rng(seed))


def test_without_noise_a_hit_is_where_the_surface_is():
    distances = np.linspace(0.3, 6.0, 12)
    cloud = simulated(distances)
    assert cloud.hit.all()
    assert cloud.points == pytest.approx(SMALL.directions * distances[:, None])


@pytest.mark.parametrize("distance", [6.0001, 40.0, math.inf])
def test_a_beam_without_a_surface_up_to_the_far_end_is_free_up_to_there(distance):
    cloud = simulated(distance, noise=RangeNoise())
    assert not cloud.hit.any()
    assert cloud.points == pytest.approx(6.0 * SMALL.directions)


@pytest.mark.parametrize("distance", [0.0, 0.1, 0.2999])
def test_a_surface_nearer_than_near_gives_no_information(distance):
    cloud = simulated(distance, noise=RangeNoise())
    assert not cloud.hit.any()
    assert not cloud.points.any()


def test_a_surface_nearer_than_near_leaves_the_map_as_it_was():
    map_ = OccupancyMap(VoxelGrid((20, 20, 20), 0.1, (-1.0, -1.0, -1.0)))
    map_.integrate(transform_cloud(simulated(0.2), Pose(np.full(3, 0.03), np.eye(3)), EXACT))
    assert not map_.sampled.any()


def test_noise_has_the_covariance_of_eq_1_in_the_camera_frame():
    """Standardised errors are standard normal: a sum of n squares is n +- sqrt(2 n).

    More than four standard deviations off is one chance in 16,000.
    """
    noise = RangeNoise(intrinsic=0.004, depth=1.0, lateral=0.3, exponent=1.5)
    camera = DepthCamera()
    distances = np.random.default_rng(1).uniform(0.3, 6.0, camera.n_pixels)
    exact = simulated(distances, camera).points
    rng = np.random.default_rng(2)
    errors = np.stack(
        [simulate_point_cloud(distances, camera, noise, rng).points - exact for _ in range(10)]
    )
    z = errors / noise.standard_deviations(distances, 3)
    n = z[..., 0].size
    for axis in range(3):
        assert abs((z[..., axis] ** 2).sum() - n) < 4 * math.sqrt(2 * n)
        assert abs(z[..., axis].sum()) < 4 * math.sqrt(n)
        # neither axes nor neighbouring pixels have anything to do with each other
        assert abs((z[..., axis] * z[..., axis - 1]).sum()) < 4 * math.sqrt(n)
        assert abs((z[:, 1:, axis] * z[:, :-1, axis]).sum()) < 4 * math.sqrt(n)


def test_stated_covariances_are_those_of_the_errors_that_are_made_eqs_1_and_3():
    """Mahalanobis distances of placed points are chi-square of 3 degrees: 3 n +- sqrt(6 n)."""
    camera, noise = DepthCamera(), RangeNoise()
    pose = Pose(np.array([1.0, 2.0, 3.0]), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))
    distances = np.random.default_rng(3).uniform(0.3, 6.0, camera.n_pixels)
    truth = transform_cloud(simulated(distances, camera), pose, EXACT).points
    scan = transform_cloud(simulated(distances, camera, noise, 4), pose, noise)
    errors = scan.points - truth
    squares = np.einsum("ni,nij,nj", errors, np.linalg.inv(scan.covariances), errors)
    assert abs(squares - 3 * camera.n_pixels) < 4 * math.sqrt(6 * camera.n_pixels)


def test_covariances_state_eq_1_at_the_distance_that_was_measured():
    noise = RangeNoise(intrinsic=0.1)
    cloud = simulated(2.0, noise=noise)
    scan = transform_cloud(cloud, Pose(np.zeros(3), np.eye(3)), noise)
    measured = np.linalg.norm(cloud.points, axis=1)
    assert np.ptp(measured) > 0.1
    assert scan.covariances[:, 0, 0] == pytest.approx((0.1 * measured**2) ** 2)


@pytest.mark.parametrize("intrinsic", [0.1, 10.0, 1e3])
def test_whatever_the_noise_a_hit_stays_a_hit_in_front_of_the_camera(intrinsic):
    camera = DepthCamera()
    cloud = simulated(4.0, camera, RangeNoise(intrinsic=intrinsic, lateral=1.0))
    depth = 4.0 * camera.directions[:, 0]
    errors = np.abs(cloud.points - 4.0 * camera.directions)
    assert cloud.hit.all()
    assert (errors <= 0.5 * depth[:, None] + 1e-12).all()
    assert (cloud.points[:, 0] >= 0.5 * depth - 1e-12).all()


def test_the_same_generator_draws_the_same_errors():
    noise = RangeNoise()
    assert (simulated(4.0, noise=noise).points == simulated(4.0, noise=noise).points).all()
    assert (simulated(4.0, noise=noise).points != simulated(4.0, noise=noise, seed=1).points).all()


def test_what_is_seen_does_not_change_which_numbers_are_drawn():
    left = []
    for distances in (np.full(12, math.inf), np.full(12, 3.0), np.linspace(0, 9, 12)):
        rng = np.random.default_rng(5)
        simulate_point_cloud(distances, SMALL, RangeNoise(), rng)
        left.append(rng.random())
    assert left[0] == left[1] == left[2]
    seen = np.full(12, 3.0)
    alone = simulated(seen, noise=RangeNoise()).points[7]
    seen[:7] = math.inf
    assert (simulated(seen, noise=RangeNoise()).points[7] == alone).all()


def test_distances_of_another_camera_are_an_error():
    with pytest.raises(ValueError, match=r"a camera of 12 pixels needs distances \(12,\)"):
        simulated(np.ones((3, 4)))


@pytest.mark.parametrize("value", [-1.0, math.nan])
def test_invalid_distances_are_errors(value):
    with pytest.raises(ValueError, match=rf"distances must be >= 0, got {value}"):
        simulated(np.array([1.0] * 11 + [value]))
