"""The planar simulator: what a camera measures in a true world."""

import math

import numpy as np
import pytest

from coopmap_env.sensing import PlanarCamera, RangeNoise, rotate_covariances
from coopmap_env.simulation import PlanarSimulator
from coopmap_env.simulation.scenes.planar import PlanarWorld

EXACT = RangeNoise(intrinsic=0.0)


def random_world(seed, shape=(40, 30), resolution=1.0, origin=(0.0, 0.0)):
    occupied = np.random.default_rng(seed).random(shape) < 0.1
    middle = shape[0] // 2, shape[1] // 2
    occupied[middle] = False
    return PlanarWorld(occupied, resolution, origin, "random")


def center_of(world):
    return np.array(world.origin) + (np.array(world.shape) // 2 + 0.5) * world.resolution


def measured(world, pose, camera, noise=EXACT, seed=0):
    scan = PlanarSimulator(world, camera, noise).scan_from(pose, np.random.default_rng(seed))
    return scan, np.linalg.norm(scan.points - scan.origin, axis=1)


def corridor(wall=7, resolution=1.0):
    """Free cells along x up to a wall."""
    occupied = np.zeros((12, 8), dtype=bool)
    occupied[wall:] = True
    return PlanarWorld(occupied, resolution, (0.0, 0.0), "corridor")


def test_a_wall_ahead_is_seen_at_its_face():
    camera = PlanarCamera(math.radians(2), 20.0, 1)
    scan, distance = measured(corridor(), (1.5, 4.5, 0.0), camera)
    assert distance == pytest.approx([5.5])
    assert scan.points == pytest.approx(np.array([[7.0, 4.5]]))
    assert scan.origin.tolist() == [1.5, 4.5]
    assert scan.hit.tolist() == [True]


def test_metres_follow_resolution_and_origin():
    occupied = np.zeros((12, 8), dtype=bool)
    occupied[:, 6] = True
    world = PlanarWorld(occupied, 0.5, (-10.0, 100.0), "")
    scan, distance = measured(world, (-7.0, 101.0, math.pi / 2), PlanarCamera(0.01, 9.0, 1))
    # row 6 begins at y = 100 + 6 * 0.5
    assert distance == pytest.approx([2.0])
    assert scan.points == pytest.approx(np.array([[-7.0, 103.0]]))


def test_a_wall_beyond_the_depth_of_field_is_not_seen():
    camera = PlanarCamera(math.radians(2), 5.4, 1)
    scan, distance = measured(corridor(), (1.5, 4.5, 0.0), camera)
    assert scan.hit.tolist() == [False]
    assert distance == pytest.approx([5.4])


def test_beyond_the_world_there_is_nothing_to_see():
    camera = PlanarCamera(math.radians(40), 20.0, 9)
    scan, distance = measured(corridor(), (1.5, 4.5, math.pi), camera)
    assert not scan.hit.any()
    assert distance == pytest.approx(np.full(9, 20.0))


def test_beams_without_return_end_at_the_depth_of_field_and_claim_no_uncertainty():
    world = random_world(0)
    camera = PlanarCamera(2 * math.pi, 6.0, 100)
    scan, distance = measured(world, (*center_of(world), 0.3), camera, RangeNoise())
    assert 10 < scan.hit.sum() < 90
    assert distance[~scan.hit] == pytest.approx(np.full((~scan.hit).sum(), 6.0))
    assert not scan.covariances[~scan.hit].any()


def test_beams_point_along_bearing_and_heading():
    camera = PlanarCamera(math.radians(80), 3.0, 7)
    heading = 2.1
    scan, _ = measured(corridor(), (3.5, 4.5, heading), camera)
    rays = scan.points - scan.origin
    angles = np.arctan2(rays[:, 1], rays[:, 0]) - heading
    assert np.angle(np.exp(1j * angles)) == pytest.approx(camera.bearings)


@pytest.mark.parametrize(("resolution", "origin"), [(1.0, (0.0, 0.0)), (0.3, (-5.0, 7.0))])
def test_distances_are_those_of_dense_sampling(resolution, origin):
    """No sample before the measured distance lies in an occupied cell; the end of a hit does."""
    rng = np.random.default_rng(1)
    steps = np.arange(0, 13.0, 2e-3)
    for seed in range(2):
        world = random_world(seed, resolution=resolution, origin=origin)
        camera = PlanarCamera(2 * math.pi, 13.0 * resolution, 90)
        position = center_of(world) + rng.uniform(-0.5, 0.5, 2) * resolution
        pose = (*position, rng.uniform(-3, 3))
        scan, distance = measured(world, pose, camera)
        assert 40 < scan.hit.sum() < 90
        for beam, bearing in enumerate(camera.bearings):
            u = np.array([math.cos(bearing + pose[2]), math.sin(bearing + pose[2])])
            d = distance[beam] / resolution
            before = steps[steps < d - 1e-9]
            assert not blocked(world, (position - origin) / resolution + before[:, None] * u).any()
            if scan.hit[beam]:
                assert blocked(world, (position - origin) / resolution + (d + 1e-6) * u[None]).all()


def blocked(world, points):
    """Whether points (n, 2), in cells, lie in occupied cells of the world."""
    index = np.floor(points).astype(int)
    inside = ((index >= 0) & (index < world.shape)).all(axis=1)
    return np.array([world.occupied[tuple(i)] for i in index[inside]] or [False])


def test_noise_has_the_covariance_of_eq_1_in_the_camera_frame():
    """Standardised errors of many scans are standard normal: their sums of squares are chi-square.

    The sum of 20,000 is 20,000 +- sqrt(2 * 20,000) = 200; more than four of these off is one chance
    in 16,000, and shows a standard deviation that is wrong by 2 %.
    """
    noise = RangeNoise(intrinsic=0.004, depth=1.0, lateral=0.3, exponent=1.5)
    pose = (1.5, 2.5, 0.25)
    camera = PlanarCamera(math.radians(30), 20.0, 4)
    simulator = PlanarSimulator(corridor(), camera, noise)
    exact, distance = measured(corridor(), pose, camera)
    assert exact.hit.all()
    rng = np.random.default_rng(2)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    errors = np.stack(
        [
            (simulator.scan_from(pose, rng).points - exact.points) @ [[c, -s], [s, c]]
            for _ in range(5000)
        ]
    )
    z = errors / noise.standard_deviations(distance, 2)
    n = z[..., 0].size
    for axis in range(2):
        assert abs((z[..., axis] ** 2).sum() - n) < 4 * math.sqrt(2 * n)
        assert abs(z[..., axis].sum()) < 4 * math.sqrt(n)
    assert abs((z**2).sum() - 2 * n) < 4 * math.sqrt(4 * n)
    # depth and lateral errors, and those of neighbouring beams, have nothing to do with each other
    assert abs((z[..., 0] * z[..., 1]).sum()) < 4 * math.sqrt(n)
    assert abs((z[:, 0] * z[:, 1]).sum()) < 4 * math.sqrt(2 * 5000)


def test_covariances_are_eq_1_rotated_into_the_world_by_eq_3():
    world = random_world(3)
    noise = RangeNoise(intrinsic=0.01, lateral=0.4, exponent=1.0)
    pose = (*center_of(world), 2.3)
    camera = PlanarCamera(2 * math.pi, 15.0, 60)
    scan, _ = measured(world, pose, camera, noise)
    distance = np.linalg.norm(scan.points - scan.origin, axis=1)  # the measured one
    c, s = math.cos(pose[2]), math.sin(pose[2])
    sigma = noise.standard_deviations(distance, 2)
    plain = rotate_covariances(sigma[..., None] ** 2 * np.eye(2), np.array([[c, -s], [s, c]]))
    assert scan.hit.sum() > 20
    assert scan.covariances[scan.hit] == pytest.approx(plain[scan.hit])


def test_the_same_generator_state_gives_the_same_scan_and_another_one_another():
    world, camera = random_world(4), PlanarCamera()
    pose = (*center_of(world), 0.0)
    one, _ = measured(world, pose, camera, RangeNoise(), seed=5)
    same, _ = measured(world, pose, camera, RangeNoise(), seed=5)
    other, _ = measured(world, pose, camera, RangeNoise(), seed=6)
    for name in ("origin", "points", "covariances", "hit"):
        assert (getattr(one, name) == getattr(same, name)).all()
    assert (one.points != other.points).any()
    assert (one.hit == other.hit).all()


def test_a_scan_draws_the_same_amount_of_randomness_from_every_pose():
    """So that what one robot sees does not shift the noise of the next."""
    world, camera = random_world(7), PlanarCamera()
    simulator = PlanarSimulator(world, camera, RangeNoise())
    states = []
    for pose in ((*center_of(world), 0.0), (0.5, 0.5, math.pi)):
        rng = np.random.default_rng(8)
        simulator.scan_from(pose, rng)
        states.append(rng.bit_generator.state)
    assert states[0] == states[1]


def test_a_scan_does_not_follow_the_pose_it_was_taken_from():
    pose = np.array([1.5, 4.5, 0.0])
    scan, _ = measured(corridor(), pose, PlanarCamera())
    pose += 1.0
    assert scan.origin.tolist() == [1.5, 4.5]


def test_a_camera_within_an_obstacle_sees_it_at_no_distance():
    scan, distance = measured(corridor(), (8.5, 4.5, 0.0), PlanarCamera(n_beams=3), RangeNoise())
    assert scan.hit.all()
    assert distance == pytest.approx([0, 0, 0])


@pytest.mark.parametrize(
    "pose",
    [
        (-0.1, 4.5, 0.0),
        (1.5, 8.0, 0.0),
        (12.0, 4.5, 0.0),
        (math.nan, 4.5, 0.0),
        (1.5, 4.5, math.inf),
    ],
)
def test_a_scan_from_outside_the_world_is_an_error(pose):
    simulator = PlanarSimulator(corridor(), PlanarCamera(), RangeNoise())
    with pytest.raises(ValueError, match="lies outside"):
        simulator.scan_from(pose, np.random.default_rng(0))
