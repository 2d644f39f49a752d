"""Planning calls name poses that are none, before a kernel reads past the end of a map."""

import numpy as np
import pytest

from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.information import PlanarExpectedViews
from coopmap_env.mapping import OccupancyMap, VoxelGrid


@pytest.fixture(scope="module")
def belief():
    env = PlanarEnv(2, max_scans=2)
    env.reset(seed=0)
    return env.belief()


def clusters(belief):
    numbers = np.zeros(belief.map.grid.shape, dtype=np.int32)
    numbers[0, 0] = 1
    return numbers


OF_POSES = {
    "unknown": lambda b, ids: b.unknown_fraction(0, ids),
    "rate": lambda b, ids: b.rate(0, ids),
    "rate all": lambda b, ids: b.planning.rate_all(b, 0, ids, None),
    "distance": lambda b, ids: b.distance(0, ids),
    "motion time": lambda b, ids: b.motion_time(0, ids),
    "information": lambda b, ids: b.planning.mutual_information_fraction(b, 0, ids, 0.1, None),
    "expected": lambda b, ids: b.planning.expected_unknown_fraction(b, 0, ids, None),
    "nearest": lambda b, ids: b.planning.nearest_frontier_mask(b, 0, ids, np.full(2, True)),
    "clusters": lambda b, ids: b.planning.clusters_of_poses(b, 0, ids, clusters(b)),
    "no clusters": lambda b, ids: b.planning.clusters_of_poses(b, 0, ids, 0 * clusters(b)),
    "frames": lambda b, ids: b.planning.camera_frames(b, 0, ids),
    "actions": lambda b, ids: b.planning.n_actions(b, 0, ids),
    "raster": lambda b, ids: b.planning.raster_offset(b, 0, ids),
    "gain": lambda b, ids: b.planning.foresight(b).gain(0, ids),
    "future distance": lambda b, ids: b.planning.foresight(b).distance(0, ids, 0),
}
OF_A_POSE = {
    "visible": lambda b, pose: b.visible_cells(0, pose),
    "poses": lambda b, pose: b.with_poses((0, pose)),
    "take": lambda b, pose: b.planning.foresight(b).take(0, pose),
    "from": lambda b, pose: b.planning.foresight(b).distance(0, np.array([0]), pose),
    "random": lambda b, pose: b.planning.foresight(b).random_poses(
        0, pose, 5, np.random.default_rng(0)
    ),
}


CALLS = OF_A_POSE | {
    name: lambda b, pose, call=call: call(b, np.array([0, pose])) for name, call in OF_POSES.items()
}


@pytest.mark.parametrize("outside", [-1, 10**6, -(2**62), 2**62])
@pytest.mark.parametrize("name", CALLS)
def test_a_planning_call_names_a_pose_that_is_none(name, outside, belief):
    with pytest.raises(ValueError, match=rf"pose ids lie in 0 \.\.\. \d+, .*, got {outside}: take"):
        CALLS[name](belief, outside)


def test_a_pose_beyond_the_last_one_is_outside_of_the_world(belief):
    for outside in (-1, belief.lattice.n_poses, 2**62):
        assert belief.infeasibility_reason(0, outside) == belief.infeasibility_reason(0, -1) != ""


def test_other_numbers_of_poses_are_named(belief):
    with pytest.raises(ValueError, match="2 robots need a pose id each, got \\(0,\\)"):
        belief.with_poses((0,))
    with pytest.raises(ValueError, match="3 distances need 1 or 3 current poses, got 2"):
        belief.rating_function.distance([0, 1, 2], [0, 1])


def test_views_on_a_map_of_another_shape_are_refused(belief):
    with pytest.raises(ValueError, match="does not fit this rating function"):
        PlanarExpectedViews(belief.rating_function).cells(OccupancyMap(VoxelGrid((3, 3))))
