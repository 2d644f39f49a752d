"""Planners that go to clusters of frontier cells."""

import numpy as np
import pytest
from plain.planar_worlds import NO_NOISE, env_with_world, open_world, set_poses
from plain.random_maps import set_cells

import coopmap_baselines
from coopmap_baselines.frontier_clusters import frontier_clusters, frontier_poses
from coopmap_env.envs.planar import PlanarEnv, PlanarSettings
from coopmap_env.sensing import PlanarCamera

CAMERA = PlanarCamera(depth_of_field=8.0)
SETTINGS = PlanarSettings(noise=NO_NOISE, camera=CAMERA, reach=6.0)
WIDE = PlanarSettings(noise=NO_NOISE, camera=CAMERA, reach=30.0)
N = 16


def poses_of(policy, belief):
    """Cells (x, y) and headings that a policy sends the robots to."""
    found = []
    for agent, action in policy.act(belief, {}).items():
        pose, reason = belief.actions.decode(agent, action, belief)
        assert reason == 0
        found.append((*divmod(int(pose) // N, belief.map.grid.shape[1]), int(pose) % N))
    return found


def corridor(x_from, x_to, *, left=False, right=False, settings=SETTINGS, at=20, n_robots=1):
    """A known corridor along x in row 20, closed by walls but for the ends named."""
    env = env_with_world(open_world(60, 40), n_robots=n_robots, settings=settings)
    known = [x * 40 + 20 for x in range(x_from, x_to + 1)]
    belief = set_poses(env, *[(at, 20, 0)] * n_robots, known=known)
    walls = [x * 40 + y for x in range(x_from - 1, x_to + 2) for y in (19, 21)]
    walls += [] if left else [(x_from - 1) * 40 + 20]
    walls += [] if right else [(x_to + 1) * 40 + 20]
    set_cells(belief.map, walls, 0.99)
    return belief


def test_clusters_are_connected_by_corners_and_small_ones_are_dropped():
    env = env_with_world(open_world(), n_robots=1)
    known = [(10, 10), (11, 11), (12, 12), (30, 30), (30, 31)]
    belief = set_poses(env, (30, 30, 0), known=[x * 40 + y for x, y in known])
    clusters = frontier_clusters(belief, 0, 3)
    assert sorted(map(tuple, np.argwhere(clusters == 1).tolist())) == known[:3]
    assert clusters.max() == 1
    assert frontier_clusters(belief, 0, 2).max() == 2
    assert frontier_clusters(belief, 0, 6).max() == 0


def test_only_clusters_that_free_space_leads_to_have_poses():
    env = env_with_world(open_world(), n_robots=1)
    known = [(10, 10), (11, 11), (12, 12), (30, 30), (30, 31)]
    belief = set_poses(env, (30, 30, 0), known=[x * 40 + y for x, y in known])
    poses, clusters = frontier_poses(belief, 0, frontier_clusters(belief, 0, 2))
    assert set((poses // N).tolist()) == {30 * 40 + 30, 30 * 40 + 31}
    assert (clusters == 2).all()
    poses, clusters = frontier_poses(belief, 0, frontier_clusters(belief, 0, 6))  # none at all
    np.testing.assert_array_equal(poses, belief.feasible_poses(0))
    assert not clusters.any()


@pytest.mark.parametrize("name", ["frontier", "allocation"])
def test_the_open_end_of_a_corridor_is_viewed_outwards(name):
    policy = coopmap_baselines.make(name, min_cells=1)
    belief = corridor(17, 24, right=True)
    assert poses_of(policy, belief) == [(24, 20, 0)]


@pytest.mark.parametrize("name", ["frontier", "allocation"])
@pytest.mark.parametrize("mode", ["pose", "candidates"])
def test_a_frontier_beyond_one_action_is_approached(name, mode):
    policy = coopmap_baselines.make(name, min_cells=1)
    belief = corridor(12, 50, right=True, at=20)
    if mode == "candidates":
        cells = np.array([15, 18, 20, 23, 25]) * 40 + 20
        belief = belief.with_candidates([(cells[:, None] * N + np.arange(N)).ravel()])
    ((x, y, _),) = poses_of(policy, belief)
    assert y == 20
    assert x == (26 if mode == "pose" else 25)


def test_a_near_frontier_is_worth_more_than_an_equal_one_far_away():
    belief = corridor(18, 50, left=True, right=True, at=22)
    policy = coopmap_baselines.make("frontier", min_cells=1)
    assert poses_of(policy, belief) == [(18, 20, N // 2)]


def test_allocation_sends_robots_to_different_ends():
    belief = corridor(10, 30, left=True, right=True, settings=WIDE, at=19, n_robots=2)
    alone = coopmap_baselines.make("frontier", min_cells=1)
    assert poses_of(alone, belief) == [(10, 20, N // 2)] * 2
    allocated = coopmap_baselines.make("allocation", min_cells=1)
    assert sorted(poses_of(allocated, belief)) == [(10, 20, N // 2), (30, 20, 0)]


def test_allocation_with_more_robots_than_clusters_gives_all_of_them_a_pose():
    belief = corridor(17, 24, right=True, settings=WIDE, n_robots=3)
    found = poses_of(coopmap_baselines.make("allocation", min_cells=1), belief)
    assert len(found) == 3
    assert (24, 20, 0) in found


def test_candidates_belong_to_the_nearest_cluster():
    belief = corridor(10, 30, left=True, right=True, settings=WIDE)
    clusters = frontier_clusters(belief, 0, 1)
    cells = np.array([11, 19, 21, 29]) * 40 + 20
    found = belief.planning.clusters_of_poses(belief, 0, cells * N, clusters)
    assert found.tolist() == [1, 1, 2, 2]
    nothing = np.zeros_like(clusters)
    assert not belief.planning.clusters_of_poses(belief, 0, cells * N, nothing).any()


def test_an_action_leads_as_far_as_the_reach():
    belief = corridor(10, 40, settings=SETTINGS)
    cells = np.array([20, 26, 27, 32, 33, 8]) * 40 + 20
    assert belief.planning.n_actions(belief, 0, cells * N).tolist() == [1, 1, 2, 2, 3, 2]


@pytest.mark.parametrize("option", ["min_cells", "motion_weight"])
@pytest.mark.parametrize("name", ["frontier", "allocation"])
def test_options_out_of_range_are_named(name, option):
    with pytest.raises(ValueError, match=f"{option} must be .*, got -1"):
        coopmap_baselines.make(name, **{option: -1})
    with pytest.raises(ValueError, match="utility must be one of 'gain', 'nearest', got 'best'"):
        coopmap_baselines.make("frontier", utility="best")


def test_nearest_and_gain_decide_differently():
    env = PlanarEnv(2, max_scans=3)
    env.reset(seed=0)
    found = [
        poses_of(coopmap_baselines.make("frontier", utility=utility), env.belief())
        for utility in ("gain", "nearest")
    ]
    assert found[0] != found[1]
