import numpy as np
import pytest
from plain.planar_worlds import NO_NOISE, env_with_world, open_world, pose_id, set_poses
from plain.random_maps import set_cells
from plain.rollouts import MODES, random_rollout

import coopmap_baselines
from coopmap_env.envs import InvalidActionError, RejectedReason
from coopmap_env.envs.planar import PlanarEnv, PlanarSettings

SETTINGS = PlanarSettings(noise=NO_NOISE)
REACH = SETTINGS.reach


def alone(known=None, start=(20, 20, 0)):
    """One robot in an open world, on a map that knows some cells to be free."""
    env = env_with_world(open_world(), n_robots=1, settings=SETTINGS)
    set_poses(env, start, known=known)
    return env


def box(x, y, shape=(40, 40)):
    """A mask of the cells of a box."""
    mask = np.zeros(shape, dtype=bool)
    mask[x, y] = True
    return mask


def step(env, ahead, left, turn=0.0):
    """Ask for a pose that lies so many metres ahead and to the left; return the robot's info."""
    *_, infos = env.step({"robot_0": np.array([ahead / REACH, left / REACH, turn])})
    return infos["robot_0"]


def test_a_feasible_pose_is_taken():
    env = alone(box(slice(18, 30), slice(18, 23)))
    info = step(env, 5, -2, turn=0.25)
    assert env.belief().pose_ids == (pose_id(env, 25, 18, heading=2),)
    assert info["rejected_reason"] == RejectedReason.NONE
    assert info["distance"] == pytest.approx(np.hypot(5, 2))
    assert info["n_scans"] == 1


@pytest.mark.parametrize(
    ("ahead", "left", "reason"),
    [
        (15, 0, RejectedReason.GOAL_UNKNOWN),
        (-20, 0, RejectedReason.GOAL_UNKNOWN),
        (0, 19.6, RejectedReason.OUTSIDE_WORLD),
        (4, 2, RejectedReason.GOAL_NOT_FREE),  # known to be occupied
        (4, -2, RejectedReason.GOAL_NOT_FREE),  # seen, but P is above 0.05
        (8, 0, RejectedReason.NO_PATH),
    ],
)
def test_an_infeasible_pose_does_not_move_the_camera(ahead, left, reason):
    # Free are a room around the robot and one cell that nothing leads to.
    env = alone(box(slice(15, 26), slice(15, 26)) | box(28, 20), start=(20, 20, 3))
    map_ = env.belief().map
    set_cells(map_, [24 * 40 + 22], 0.99)
    set_cells(map_, [24 * 40 + 18], 0.06)
    before = env.belief().pose_ids
    heading = 3 * np.pi / 8
    c, s = np.cos(heading), np.sin(heading)
    info = step(env, c * ahead + s * left, c * left - s * ahead, turn=0.5)
    assert info["rejected_reason"] == reason
    assert env.explain("robot_0") == {"rejected_reason": reason.words}
    assert env.belief().pose_ids == before
    assert info["distance"] == 0
    assert info["n_scans"] == 1
    assert info["new_cells"] > 0


def test_where_the_robot_stands_it_may_always_turn():
    env = alone()
    set_cells(env.belief().map, [20 * 40 + 20], 0.7)  # teammates' readings may be wrong
    info = step(env, 0, 0, turn=-0.5)
    assert info["rejected_reason"] == RejectedReason.NONE
    assert env.belief().pose_ids == (pose_id(env, 20, 20, heading=12),)


def test_a_path_may_lead_around_an_obstacle():
    known = box(slice(15, 26), slice(15, 26))
    known[22, 15:25] = False
    env = alone(known)
    assert step(env, 4, 0)["rejected_reason"] == RejectedReason.NONE
    known[22, 25] = False
    env = alone(known)
    assert step(env, 4, 0)["rejected_reason"] == RejectedReason.NO_PATH


def test_no_path_slips_between_two_cells_that_touch_at_a_corner():
    known = box(slice(18, 21), slice(18, 21)) | box(slice(21, 24), slice(21, 24))
    assert step(alone(known), 2, 2)["rejected_reason"] == RejectedReason.NO_PATH
    known[20, 21] = True
    assert step(alone(known), 2, 2)["rejected_reason"] == RejectedReason.NONE


def test_a_masked_candidate_does_not_move_the_camera():
    env = env_with_world(
        open_world(), n_robots=1, settings=SETTINGS, action_mode="candidates", n_candidates=40
    )
    set_poses(env, (20, 20, 0), known=[20 * 40 + 21])
    before = env.belief().pose_ids  # two cells of 16 headings are 32 candidates
    assert len(env.belief().candidates[0]) == 32
    *_, infos = env.step({"robot_0": 32})
    assert infos["robot_0"]["rejected_reason"] == RejectedReason.MASKED
    assert env.explain("robot_0") == {"rejected_reason": "candidate is masked out"}
    assert env.belief().pose_ids == before
    assert infos["robot_0"]["new_cells"] > 0


@pytest.mark.parametrize("mode", MODES)
def test_robots_stand_only_where_the_map_before_the_step_knew_free_space(mode, scene):
    env = PlanarEnv(3, mode, scene=scene, max_scans=12)
    moved = n_rejected = 0
    for seed in range(3):
        episode = random_rollout(env, seed, np.random.default_rng(seed))
        next(episode)
        while env.agents:
            belief = env.belief()
            map_ = belief.map.copy()
            before = belief.pose_ids
            feasible = [set(belief.feasible_cells(robot).tolist()) for robot in range(3)]
            *_, infos, _ = next(episode)
            free = (map_.probability < 0.05) & map_.sampled
            for robot, info in enumerate(infos.values()):
                cell = env.belief().cell(robot)
                n_rejected += bool(info["rejected_reason"])
                if info["rejected_reason"]:
                    assert env.belief().pose_ids[robot] == before[robot]
                elif cell != belief.cell(robot):
                    moved += 1
                    assert free.flat[cell]
                    assert cell in feasible[robot]
    assert moved > 20
    assert n_rejected > 20 or mode == "candidates"


@pytest.mark.parametrize("n_headings", [1, 5, 16])
@pytest.mark.parametrize("resolution", [1.0, 0.2, 0.3])
def test_every_feasible_pose_has_an_action_that_leads_there(resolution, n_headings):
    world = open_world(64, 64, resolution, origin=(-3.0, 7.7), walls=[(30, 33), (31, 33), (33, 29)])
    base = PlanarSettings.for_resolution(resolution)
    settings = PlanarSettings(
        camera=base.camera, reach=3 * resolution, n_headings=n_headings, noise=NO_NOISE
    )
    env = env_with_world(world, n_robots=1, settings=settings)
    for heading in range(n_headings):
        known = ~world.occupied
        belief = set_poses(env, (32, 31, heading), known=known)
        cells = belief.feasible_cells(0)
        ids = (cells[:, None].astype(int) * n_headings + np.arange(n_headings)).ravel()
        assert len(cells) >= 21
        for pose in ids.tolist():
            action = belief.action_for(0, pose)
            assert action.dtype == np.float32
            assert env.action_space("robot_0").contains(action)
            assert belief.actions.decode("robot_0", action, belief) == (pose, 0)
            assert belief.actions.decode("robot_0", action.astype(float), belief) == (pose, 0)


def test_a_pose_out_of_reach_has_no_action():
    belief = alone(np.ones((40, 40), dtype=bool), start=(1, 20, 0)).belief()
    near, far = pose_id_of(belief, 21, 20), pose_id_of(belief, 22, 20)
    np.testing.assert_allclose(belief.action_for(0, near), [1, 0, 0])
    with pytest.raises(InvalidActionError, match=f"robot_0: pose {far} is out of reach"):
        belief.action_for(0, far)
    assert 21 * 40 + 20 in belief.feasible_cells(0)
    assert 22 * 40 + 20 not in belief.feasible_cells(0)


def pose_id_of(belief, ix, iy):
    return (ix * belief.lattice.grid.shape[1] + iy) * belief.lattice.n_headings


def test_the_reach_is_a_square_that_turns_with_the_camera():
    known = np.ones((40, 40), dtype=bool)
    settings = PlanarSettings(noise=NO_NOISE, reach=4.0)
    env = env_with_world(open_world(), n_robots=1, settings=settings)
    straight = set_poses(env, (20, 20, 0), known=known).feasible_cells(0)
    assert len(straight) == 81
    turned = set_poses(env, (20, 20, 2), known=known).feasible_cells(0)
    dx, dy = turned // 40 - 20, turned % 40 - 20
    assert (np.maximum(abs(dx + dy), abs(dx - dy)) <= 4 * np.sqrt(2)).all()
    assert len(turned) == 61  # |dx + dy| and |dx - dy| at most 5


def test_candidates_are_feasible_distinct_and_reproducible():
    arguments = {"n_robots": 2, "action_mode": "candidates", "max_scans": 6, "scene": "rooms"}
    env, same = PlanarEnv(**arguments), PlanarEnv(**arguments)
    env.reset(seed=1)
    same.reset(seed=1)
    offered = []
    while env.agents:
        belief = env.belief()
        for robot in range(2):
            offer = belief.candidates[robot]
            assert len(set(offer.tolist())) == len(offer) == 32
            assert np.isin(offer // belief.lattice.n_headings, belief.feasible_cells(robot)).all()
            assert all(belief.infeasibility_reason(robot, pose) == "" for pose in offer.tolist())
            np.testing.assert_array_equal(offer, same.belief().candidates[robot])
            for index, pose in enumerate(offer.tolist()):
                assert belief.action_for(robot, pose) == index
                agent = belief.agents[robot]
                assert belief.actions.decode(agent, np.int64(index), belief) == (pose, 0)
            offered.append(offer.tobytes())
        env.step(dict.fromkeys(env.agents, 0))
        same.step(dict.fromkeys(same.agents, 0))
    assert len(set(offered)) == len(offered)


def test_every_feasible_pose_is_a_candidate_equally_often():
    env = env_with_world(
        open_world(), n_robots=1, settings=SETTINGS, action_mode="candidates", n_candidates=8
    )
    belief = set_poses(env, (20, 20, 0), known=[20 * 40 + 21])
    rng = np.random.default_rng(0)
    picks = np.concatenate([belief.random_poses(0, 8, rng) for _ in range(2000)])
    counts = np.unique(picks, return_counts=True)[1]
    assert len(counts) == 32
    np.testing.assert_allclose(counts, 500, atol=4 * np.sqrt(500 * 0.75))  # four standard errors


def test_a_pose_that_is_no_candidate_has_no_action():
    env = PlanarEnv(action_mode="candidates")
    env.reset(seed=0)
    belief = env.belief()
    other = next(
        pose for pose in range(belief.lattice.n_poses) if pose not in belief.candidates[1].tolist()
    )
    with pytest.raises(InvalidActionError, match=f"robot_1: pose {other} is not among"):
        belief.action_for(1, other)


def test_a_collision_with_a_wall_that_is_mapped_as_free_corrects_the_map():
    env = env_with_world(
        open_world(walls=[(23, 20)]), n_robots=1, settings=PlanarSettings(noise=NO_NOISE)
    )
    set_poses(env, (20, 20, 8), known=box(slice(15, 26), slice(15, 26)))  # the wall is "known free"
    here = env.belief().pose_ids[0]
    action = env.belief().action_for(0, pose_id(env, 23, 20))
    _, _, _, _, infos = env.step({"robot_0": action})
    assert infos["robot_0"]["collided"] is True
    what = {"collided": "an obstacle in a cell that is mapped as free"}
    assert env.explain("robot_0") == what
    assert infos["robot_0"]["rejected_reason"] == RejectedReason.NONE
    assert infos["robot_0"]["distance"] == 0
    assert env.belief().pose_ids == (here,)
    assert env.belief().map.probability[23, 20] == pytest.approx(0.9999, abs=1e-6)
    _, _, _, _, infos = env.step({"robot_0": action})
    assert infos["robot_0"]["collided"] is False
    assert infos["robot_0"]["rejected_reason"] == RejectedReason.GOAL_NOT_FREE


@pytest.mark.parametrize("scene", ["obstacles", "rooms"])
def test_no_camera_ever_stands_inside_a_wall(scene):
    env = PlanarEnv(scene=scene, max_scans=24)
    policy = coopmap_baselines.make("frontier")
    observations, _ = env.reset(seed=3)
    policy.reset(np.random.default_rng(0))
    while env.agents:
        observations, *_ = env.step(policy.act(env.belief(), observations))
        cells = env.belief().map.grid.index(env.belief().camera_poses[:, :2])
        assert not env.truth.occupied[tuple(cells.T)].any()
