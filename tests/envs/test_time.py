"""The clock of a team: how long steps last, and episodes that end when the time runs out."""

import math
from dataclasses import replace

import numpy as np
import pytest
from plain.planar_worlds import env_with_world, open_world, pose_id, set_poses
from plain.small_worlds import SETTINGS, small_world

from coopmap_env import planar_v1
from coopmap_env.envs.field.transition import path_time
from coopmap_env.robots import make_mount
from coopmap_env.robots.planar.motion_time import LatticeSpeeds, lattice_motion_time


def take(env, poses):
    """Step with a pose id for each robot; None stays."""
    belief = env.belief()
    ids = [own if pose is None else pose for own, pose in zip(belief.pose_ids, poses, strict=True)]
    actions = {agent: belief.action_for(i, ids[i]) for i, agent in enumerate(belief.agents)}
    return env.step(actions)


def test_a_motion_lasts_as_long_as_the_way_or_the_turn():
    # 16 headings, 10 cells along y; 2 cells and 4 headings a second
    speeds, at = LatticeSpeeds(2.0, 4.0), lambda x, y, heading: (x * 10 + y) * 16 + heading
    start = at(2, 3, 1)
    for goal, seconds in [
        (start, 0.0),
        (at(5, 7, 1), 2.5),  # 3 and 4 cells
        (at(2, 3, 15), 0.5),  # two steps of the heading, across 0
        (at(2, 3, 9), 2.0),  # half a turn
        (at(5, 7, 9), 2.5),  # the turn is done on the way
        (at(2, 4, 9), 2.0),
    ]:
        assert lattice_motion_time(start, goal, 16, 10, speeds) == seconds


def test_a_belief_says_how_long_motions_take_and_a_step_lasts_as_long_as_the_slowest():
    env = small_world(settings=replace(SETTINGS, speed=1.5, turn_rate=0.5, scan_time=3.0))
    env.reset(seed=0)
    clock = 0.0
    rng = np.random.default_rng(0)
    while env.agents:
        belief = env.belief()
        poses = [belief.random_poses(robot, 1, rng)[0] for robot in range(2)]
        times = [float(belief.motion_time(robot, [poses[robot]])[0]) for robot in range(2)]
        for robot, pose in enumerate(poses):
            here, there = belief.camera_poses[robot], belief.lattice.poses([pose])[0]
            turn = abs(math.remainder(there[2] - here[2], 2 * math.pi))
            way = math.dist(here[:2], there[:2])
            assert times[robot] == pytest.approx(max(way / 1.5, turn / 0.5), abs=1e-12)
        *_, infos = take(env, poses)
        collided = [infos[agent]["collided"] for agent in infos]
        clock += max(times) + 3.0
        assert not any(collided)
        assert infos["robot_0"]["elapsed_time"] == infos["robot_1"]["elapsed_time"] == clock
        assert env.belief().budget.scans == 4 - infos["robot_0"]["n_scans"]
        assert env.belief().budget.time == math.inf


def test_a_collision_takes_the_time_of_the_motion_and_a_rejected_action_none():
    settings = planar_v1.PlanarSettings()
    env = env_with_world(open_world(walls=[(23, 20)]), n_robots=1, settings=settings)
    known = np.zeros((40, 40), dtype=bool)
    known[15:26, 15:26] = True  # the wall is "known free"
    set_poses(env, (20, 20, 8), known=known)
    action = env.belief().action_for(0, pose_id(env, 23, 20))
    *_, infos = env.step({"robot_0": action})
    assert infos["robot_0"]["collided"]
    turn = 8 * math.pi / 8  # from heading 8 to heading 0, at 1 radian a second
    assert infos["robot_0"]["elapsed_time"] == pytest.approx(turn + 2.0, abs=1e-12)
    before = infos["robot_0"]["elapsed_time"]
    *_, infos = env.step({"robot_0": action})  # now the wall is mapped
    assert infos["robot_0"]["rejected_reason"]
    assert infos["robot_0"]["elapsed_time"] == before + 2.0


def test_the_step_in_which_the_time_runs_out_is_the_last():
    stay = [None, None]
    env = small_world(max_scans=100, max_time=7.0)  # scans take 2 s
    env.reset(seed=3)
    left = []
    while env.agents:
        left.append(env.belief().budget)
        _, _, terminations, truncations, infos = take(env, stay)
    assert [budget.time for budget in left] == [7.0, 5.0, 3.0, 1.0]
    assert [budget.scans for budget in left] == [100, 99, 98, 97]
    assert not any(terminations.values())
    assert all(truncations.values())
    assert infos["robot_0"]["elapsed_time"] == 8.0
    assert env.belief().budget == (96, 0.0)
    with pytest.raises(RuntimeError, match="ended after 4 scans"):
        take(env, stay)
    env.reset(seed=3)
    assert env.belief().budget == (100, 7.0)
    assert take(env, stay)[4]["robot_0"]["elapsed_time"] == 2.0


def test_scans_end_an_episode_before_the_time_does():
    env = small_world(max_scans=2, max_time=1e6)
    env.reset(seed=0)
    take(env, [None, None])
    assert all(take(env, [None, None])[3].values())


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.nan, math.inf, "ten"])
def test_a_time_that_is_none_is_refused(wrong):
    with pytest.raises(ValueError, match="max_time"):
        planar_v1.parallel_env(max_time=wrong)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
def test_worlds_of_a_vector_environment_end_by_time_as_single_ones_do(mode):
    arguments = {"max_scans": 30, "max_time": 25.0, "settings": SETTINGS}
    many = planar_v1.vector_env(3, autoreset_mode=mode, **arguments)
    single = planar_v1.parallel_env(**arguments)
    for world in range(3):
        many.reset(seed=[4, 5, 6])
        single.reset(seed=4 + world)
        rng = np.random.default_rng(world)
        ended = False
        while not ended:
            actions = rng.uniform(-1, 1, (6, 3)).astype(np.float32)
            _, _, _, truncations, infos = many.step(actions)
            own = {f"robot_{i}": actions[2 * world + i] for i in range(2)}
            *_, ends, single_infos = single.step(own)
            ended = ends["robot_0"]
            assert truncations[2 * world] == ended
            if not (ended and mode == "SameStep"):
                expected = single_infos["robot_0"]["elapsed_time"]
                assert infos["elapsed_time"][2 * world] == expected
            if truncations.any() and not ended:
                break  # another world is reset: the streams of actions part
    many.close()


def test_limits_of_worlds_that_are_stepped_together_cannot_be_set():
    env = planar_v1.vector_env(2, max_scans=3, max_time=8.0, settings=SETTINGS)
    env.reset(seed=0)
    assert (env.world(0).max_scans, env.world(0).max_time) == (3, 8.0)
    for name in ("max_scans", "max_time"):
        with pytest.raises(AttributeError):
            setattr(env.world(1), name, 1)
    env.close()


def test_joints_arrive_together_the_slowest_at_its_full_speed():
    chain = make_mount("mast").chain()  # 1, 1, 1, 2 and 2 rad a second
    assert chain.max_speeds.tolist() == [1.0, 1.0, 1.0, 2.0, 2.0]
    start = np.array([0.1, -0.8, 1.8, 0.0, 0.0])
    goals = np.add(start, [[0.5, 0, 0, 0.9, 0], [0, 0, 0, -1.2, 0], [0, 0, 0, 0, 0]])
    np.testing.assert_allclose(chain.motion_times(start, goals), [0.5, 0.6, 0.0], atol=1e-15)
    waypoints = [goals[0], None, start]
    assert path_time(chain, start, waypoints) == pytest.approx(1.0, abs=1e-12)
    assert path_time(chain, start, [None]) == 0.0


def test_field_steps_last_as_long_as_the_slowest_motion_and_the_scans():
    pytest.importorskip("pybullet")
    from coopmap_env import field_v1

    env = field_v1.parallel_env(max_scans=9, max_time=6.0)
    env.reset(seed=0)
    rng, clock = np.random.default_rng(0), 0.0
    while env.agents:
        belief = env.belief()
        assert belief.budget.time == max(6.0 - clock, 0.0)
        poses = [belief.random_poses(robot, 1, rng)[0] for robot in range(2)]
        slowest = max(belief.motion_time(robot, pose)[0] for robot, pose in enumerate(poses))
        actions = {
            agent: belief.action_for(robot, poses[robot])
            for robot, agent in enumerate(belief.agents)
        }
        infos = env.step(actions)[4]
        clock = infos["robot_0"]["elapsed_time"]
        n = infos["robot_0"]["n_scans"]
        if n == 1:
            assert clock == pytest.approx(slowest + env.settings.scan_time, rel=1e-6)
    assert clock >= 6.0
    assert n < 9
    env.close()
