"""Poses of scans are revised, and the team's map is that of the revised scans."""

from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest
from plain.rollouts import random_actions

from coopmap_env.envs.field import FieldEnv, FieldSettings
from coopmap_env.envs.field._initial_knowledge import initial_free_voxels
from coopmap_env.envs.field._recorded_scan import point_displacement, revise
from coopmap_env.envs.field.localizer import TeamLocalizer
from coopmap_env.geometry import Pose, apply_displacement, rotation_about_z
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots import PoseEstimate
from coopmap_env.sensing import transform_cloud

pytest.importorskip("pybullet")
pytest.importorskip("embreex")


def settings_with(**correction):
    s = FieldSettings()
    return replace(s, correction=replace(s.correction, **correction))


def play(seed=0, scans=5, initialization="located", motion_correction="fiducials", **correction):
    """An episode of random motions."""
    env = FieldEnv(
        max_scans=scans, motion_correction=motion_correction, initialization=initialization,
        settings=settings_with(**correction), split="train",
    )  # fmt: skip
    env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    while env.agents:
        env.step(random_actions(env, rng))
    return env


def without_robots(env, record, estimate):
    """A measured point cloud without the points that lie on robots by a camera pose."""
    past_belief = env.belief().with_poses(record.joints)
    return past_belief.remove_robot_points(record.robot, record.cloud, estimate, env.settings.noise)


def map_from_the_start(env, estimates, filtered_by=None):
    """All scans of located robots, fused step by step into an empty map with these poses.

    Points on robots are removed by the same poses, or by those of `filtered_by`.
    """
    belief, s, recorded = env.belief(), env.settings, env.localizer._recorded_scans
    map_ = OccupancyMap(env.scene.grid, s.beam, s.log_odds_range)
    bases = [v.T_world_base for v, is_there in zip(belief.vehicles, belief.located, strict=True)
             if is_there]  # fmt: skip
    map_.mark_free(initial_free_voxels(map_.grid, bases, s.initial_free_radius))
    scans = [
        (k // len(belief.agents), without_robots(env, r, filter_pose), estimate)
        for k, (r, estimate, filter_pose) in enumerate(
            zip(recorded, estimates, filtered_by or estimates, strict=True)
        )
        if belief.located[r.robot]
    ]
    for _, step in groupby(scans, key=lambda scan: scan[0]):
        map_.integrate(
            [transform_cloud(cloud, e.pose, s.noise, e.covariance) for _, cloud, e in step]
        )
    return map_


def same_map(one, other):
    for name in ("log_odds_fixed", "sampled_mask"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    (cells, sums), (other_cells, other_sums) = one.hit_cell_sums(), other.hit_cell_sums()
    np.testing.assert_array_equal(cells, other_cells)
    for array, other_array in zip(sums, other_sums, strict=True):
        np.testing.assert_array_equal(array, other_array)


@pytest.mark.parametrize("initialization", ["located", "search"])
def test_the_map_is_that_of_the_revised_scans_fused_from_the_start(initialization):
    pytest.importorskip("small_gicp")
    env = play(seed=3, initialization=initialization, min_revision=0.0)
    recorded, localizer = env.localizer._recorded_scans, env.localizer
    revised = localizer._corrector.revised_estimates()
    estimates = [r.estimate if r.pose_index is None else revised[r.pose_index] for r in recorded]
    assert len(recorded) == 10
    if initialization == "located":
        assert [r.pose_index for r in recorded] == list(range(10))
        vehicles = env.belief().vehicles
        assert any(
            point_displacement(
                r.estimate.pose, vehicles[r.robot].camera_pose(r.joints[r.robot])
            ) > 1e-3
            for r in recorded
        )  # fmt: skip
    same_map(env.belief().map, map_from_the_start(env, estimates))


def test_points_on_robots_are_removed_by_the_revised_poses():
    """By the poses as they were predicted the map is another one."""
    env = play(seed=3, scans=8, min_revision=0.0)
    belief, recorded = env.belief(), env.localizer._recorded_scans
    revised = env.localizer.revised_estimates()
    predicted = [belief.vehicles[r.robot].camera_estimate(r.joints[r.robot]) for r in recorded]
    same_map(belief.map, map_from_the_start(env, revised))
    other = map_from_the_start(env, revised, filtered_by=predicted)
    assert (belief.map.log_odds_fixed != other.log_odds_fixed).any()


@pytest.mark.parametrize("min_revision", [0.0, 0.005])
def test_the_cameras_of_the_belief_are_those_of_the_last_scans_in_the_map(min_revision):
    """Also of a robot whose pose the scan of another one revised in the same step."""
    env = play(seed=7, min_revision=min_revision)
    last = env.localizer._recorded_scans[-2:]
    assert [record.robot for record in last] == [0, 1]
    for record, estimate in zip(last, env.belief().estimates, strict=True):
        np.testing.assert_array_equal(estimate.pose.translation, record.estimate.pose.translation)
        np.testing.assert_array_equal(estimate.covariance, record.estimate.covariance)
    scans = [record.scan(env.settings.noise) for record in last]
    for scan, mapped in zip(env.last_scans, scans, strict=True):
        np.testing.assert_array_equal(scan.points, mapped.points)
        np.testing.assert_array_equal(scan.hit, mapped.hit)
    alone = env.localizer.corrections[0].estimate.pose
    assert point_displacement(alone, last[0].estimate.pose) > 0.005


@pytest.mark.parametrize("motion_correction", ["kinematic", "fiducials"])
def test_the_map_that_is_rebuilt_after_a_search_is_that_of_the_scans_step_by_step(
    monkeypatch, motion_correction
):
    """All scans of a step are summed before the log-odds are limited, as when they came."""
    pytest.importorskip("small_gicp")
    rebuild, batches = TeamLocalizer._rebuild_team_map, []

    def record(localizer, belief):
        rebuild(localizer, belief)
        batches.append([scan.batch for scan in localizer._recorded_scans])

    monkeypatch.setattr(TeamLocalizer, "_rebuild_team_map", record)
    play(seed=3, initialization="search", motion_correction=motion_correction)
    assert len(batches) == 2
    for found in batches:
        assert found == [k // 2 for k in range(len(found))]


def test_without_a_revision_the_map_is_that_of_the_scans_as_they_came():
    smoothed, plain = play(min_revision=10.0), play(smoothing=False)
    same_map(smoothed.belief().map, plain.belief().map)
    assert plain.localizer._recorded_scans == []


def test_a_revised_map_differs_and_its_poses_are_better_known():
    env, plain = play(seed=3, min_revision=0.0), play(seed=3, smoothing=False)
    assert (env.belief().map.log_odds_fixed != plain.belief().map.log_odds_fixed).any()
    first = env.localizer._recorded_scans[0].estimate
    at_first = env.belief().vehicles[0].camera_estimate(env.localizer._recorded_scans[0].joints[0])
    assert np.trace(first.covariance) < np.trace(at_first.covariance)


def test_by_hand_a_turn_of_a_milliradian_moves_a_point_at_three_metres_by_three_millimetres():
    here = Pose(np.zeros(3), np.eye(3))
    there = Pose(np.array([0.0, 0.002, 0.0]), rotation_about_z(0.001))
    assert point_displacement(here, there) == pytest.approx(0.005)
    assert point_displacement(there, there) == 0.0


def test_scans_are_revised_together_once_one_of_them_has_moved_enough():
    env = play(scans=2, min_revision=10.0)
    recorded, grid = list(env.localizer._recorded_scans), env.scene.grid

    def moved(by):
        return [
            PoseEstimate(apply_displacement(r.estimate.pose, np.array([x, 0, 0, 0, 0, 0])),
                         r.estimate.covariance)
            for r, x in zip(recorded, by, strict=True)
        ]  # fmt: skip

    assert revise(recorded, moved([0.001, 0.001, 0.0, 0.0]), 0.002, grid) is None
    new = moved([0.001, 0.003, 0.0, 0.0])
    found = revise(recorded, new, 0.002, grid)
    assert [r.estimate for r in found] == new
    unlocated = [recorded[0]._replace(pose_index=None), *recorded[1:]]
    assert revise(unlocated, new, 0.002, grid)[0].estimate is recorded[0].estimate
    # a map without one of its scans would be worse than one with scans a little off
    assert revise(recorded, moved([0.001, 100.0, 0.0, 0.0]), 0.002, grid) is None
