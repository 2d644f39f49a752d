"""Robots that do not know where they stand: they search, are located, and share one map."""

import numpy as np
import pytest

from coopmap_env.envs.field import FieldEnv
from coopmap_env.geometry import Pose, displacement_between
from coopmap_env.localization import LocalizationFailure, Registration
from coopmap_env.mapping import OccupancyMap
from coopmap_env.sensing import transform_cloud

pytest.importorskip("pybullet")
pytest.importorskip("small_gicp")


@pytest.fixture
def make():
    made = []

    def make(**arguments):
        made.append(FieldEnv(**{"initialization": "search", "max_scans": 8} | arguments))
        return made[-1]

    yield make
    for env in made:
        env.close()


def best_rated(belief, robot, rng):
    """Of thirty random feasible poses the one with the highest rating."""
    poses = belief.random_poses(robot, 30, rng)
    return poses[np.argmax(belief.rate(robot, poses).rating)]


def wander(env, rng, until=lambda env: False):
    """Look where the rating is high until a condition holds or the episode ends; the last infos."""
    infos = {}
    while env.agents and not until(env):
        belief = env.belief()
        actions = {
            agent: belief.action_for(robot, best_rated(belief, robot, rng))
            for robot, agent in enumerate(env.agents)
        }
        _, rewards, *_, infos = env.step(actions)
        assert all(np.isfinite(reward) for reward in rewards.values())
    return infos


def all_located(env):
    return all(env.belief().located)


def found_worlds(env, seeds):
    """Seeds in which all robots find the target by these scans."""
    for seed in seeds:
        env.reset(seed=seed)
        wander(env, np.random.default_rng(seed), all_located)
        if all_located(env):
            yield seed


def test_at_the_start_a_robot_knows_only_the_space_around_its_vehicle(make):
    env = make(n_robots=3)
    observations, infos = env.reset(seed=0)
    belief = env.belief()
    assert belief.located == (False, False, False)
    assert infos["robot_0"]["observed_fraction"] == 0.0
    assert np.isnan(belief.positions).all()
    for robot in range(3):
        assert belief.planning_map(robot) is not belief.map
        assert belief.planning_map(robot).observed_fraction > 0.0
        assert belief.located_teammates(robot) == []
        assert len(belief.occluder_spheres(robot)[0]) == 0
        assert (observations[f"robot_{robot}"]["teammates"] == 0).all()
        assert (observations[f"robot_{robot}"]["located"] == 0).all()
    assert (env.state()[-29:-2] == 0).all()  # cameras of nobody


def test_all_robots_begin_alike_wherever_they_stand(make):
    """The initial belief of a robot depends neither on its true pose nor on the seed."""
    env = make()
    first, _ = env.reset(seed=0)
    second, _ = env.reset(seed=1)
    for key, value in first["robot_0"].items():
        np.testing.assert_array_equal(value, second["robot_0"][key], err_msg=key)
        np.testing.assert_array_equal(value, first["robot_1"][key], err_msg=key)


def test_headings_are_drawn_and_places_are_those_of_the_located_world(make):
    searching, located = make(), make(initialization="located")
    headings = []
    for seed in range(12):
        searching.reset(seed=seed)
        located.reset(seed=seed)
        for turned, facing in zip(
            searching.truth.base_poses, located.truth.base_poses, strict=True
        ):
            np.testing.assert_array_equal(turned.translation, facing.translation)
            off = displacement_between(turned, facing)[5]
            headings.append(off)
    assert np.std(headings) > 1.0  # uniform angles have a standard deviation of 1.8
    assert np.abs(np.mean(headings)) < 1.1  # three standard errors


def test_located_robots_stand_where_they_think_and_see_each_other(make):
    env, errors = make(), []
    for seed in found_worlds(env, range(6)):
        belief = env.belief()
        for vehicle, true in zip(belief.vehicles, env.truth.base_poses, strict=True):
            off = displacement_between(vehicle.T_world_base, true)
            errors.append((np.linalg.norm(off[:3]), np.linalg.norm(off[3:])))
        assert belief.located_teammates(0) == [1]
        assert len(belief.occluder_spheres(0)[0]) > 0
        assert np.isfinite(belief.positions).all()
        assert seed >= 0
    position, angle = np.array(errors).T
    assert len(errors) >= 6
    assert position.max() < 0.2
    assert np.degrees(angle).max() < 5.0
    assert np.median(position) < 0.02
    assert np.degrees(np.median(angle)) < 0.5


def test_the_teams_map_holds_each_scan_of_located_robots_exactly_once(make):
    """A map rebuilt from the points of the scans is the same, bit for bit."""
    env = make(motion_correction="exact", max_scans=10)
    scans = []
    original = env._reset_world

    def start(rngs):
        belief = original(rngs)
        simulator = env._simulator
        measured = simulator.scan

        def scan(robot, rng):
            cloud = measured(robot, rng)
            scans.append((robot, cloud, simulator.true_camera_pose(robot)))
            return cloud

        simulator.scan = scan
        return belief

    env._reset_world = start
    seed = next(found_worlds(env, range(8)))
    scans.clear()
    env.reset(seed=seed)
    wander(env, np.random.default_rng(seed), all_located)
    belief = env.belief()
    hits = OccupancyMap(env.scene.grid, env.settings.beam, env.settings.log_odds_range)
    for robot, cloud, true in scans:
        # with exact poses, the hits that are no robot's carry the same points as the true ones
        hits.integrate(transform_cloud(cloud, true, env.settings.noise))
        assert robot in (0, 1)
    ours, theirs = (
        dict(zip(map_.hit_cells.tolist(), map_.hit_cell_sums()[1].precision[:, 0, 0], strict=True))
        for map_ in (belief.map, hits)
    )
    shared = sorted(set(ours) & set(theirs))
    assert len(shared) > 0.5 * len(ours)
    ratio = np.array([ours[cell] / theirs[cell] for cell in shared])
    # twice the points would mean that a scan was counted twice
    assert np.median(ratio) == pytest.approx(1.0, abs=0.02)
    assert (ratio < 1.5).mean() > 0.95


def test_moving_in_is_not_paid_again(make):
    """Cells that a robot's own map brought count once, when they were first seen."""
    env = make(reward="coverage", max_scans=10)
    seed = next(found_worlds(env, range(8)))
    rng = np.random.default_rng(seed)
    env.reset(seed=seed)
    while env.agents and not all_located(env):
        before = env.belief()
        poses = [best_rated(before, robot, rng) for robot in range(2)]
        actions = {f"robot_{robot}": before.action_for(robot, q) for robot, q in enumerate(poses)}
        sampled = [before.planning_map(robot).observed_fraction for robot in range(2)]
        maps = [before.planning_map(robot) for robot in range(2)]
        *_, infos = env.step(actions)
        for robot in range(2):
            if not before.located[robot]:
                grown = maps[robot].observed_fraction - sampled[robot]
                new = infos[f"robot_{robot}"]["new_cells"] / maps[robot].grid.n_cells
                assert new == pytest.approx(grown)


def test_a_robot_that_is_not_located_leaves_nothing_in_the_teams_map(make, monkeypatch):
    def lost(*_, **__):
        nothing = LocalizationFailure.NOTHING_ALIKE
        return Registration(nothing, nothing.words)

    monkeypatch.setattr("coopmap_env.envs.field.target_search.register", lost)
    env = make(max_scans=4)
    env.reset(seed=0)
    infos = wander(env, np.random.default_rng(0))
    belief = env.belief()
    assert belief.map.observed_fraction == 0.0
    assert belief.located == (False, False)
    assert belief.planning_map(0).observed_fraction > 0.0
    assert np.isinf(infos["robot_0"]["base_error"])
    assert infos["robot_0"]["localization_failure"] == LocalizationFailure.NOTHING_ALIKE
    assert infos["robot_0"]["located"] is False
    assert env.localizer.registrations[0].reason.startswith("nothing")


def test_when_a_robot_is_located_its_scan_is_in_the_frame_of_its_camera(make):
    """No measured point lies further away than the camera sees."""
    env = make(max_scans=10)
    seed = next(found_worlds(env, range(8)))
    env.reset(seed=seed)
    rng, moved_in = np.random.default_rng(seed), 0

    def check(env):
        nonlocal moved_in
        for scan, estimate in zip(env.last_scans, env.belief().estimates, strict=False):
            np.testing.assert_array_equal(scan.origin, estimate.pose.translation)
            moved_in += 1
        return all_located(env)

    wander(env, rng, check)
    assert moved_in > 0


def test_infos_contain_why_a_robot_is_not_located(make):
    env = make(max_scans=10)
    seed = next(found_worlds(env, range(8)))
    env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    first = wander(env, rng, lambda env: env.last_scans)
    assert any(info["localization_failure"] for info in first.values())
    last = wander(env, rng, all_located)
    assert all(info["localization_failure"] == 0 for info in last.values())


def test_headings_of_a_scene_file_are_kept_and_bases_out_of_range_rejected(make, tmp_path):
    pytest.importorskip("yaml")
    path = tmp_path / "shed.yaml"
    scene = """
objects:
  - {name: shed, box: [1.2, 0.8, 1.6], position: [0, 0, 0.8], target: true}
bases:
  - [%s, 0.0, 75]
"""
    path.write_text(scene % 3.0)
    env = make(n_robots=1, scene=str(path))
    env.reset(seed=0)
    (base,) = env.truth.base_poses
    assert np.degrees(np.arctan2(base.rotation[1, 0], base.rotation[0, 0])) == pytest.approx(75.0)
    path.write_text(scene % 5.3)
    far = make(n_robots=1, scene=str(path))
    with pytest.raises(ValueError, match=r"robot_0 stands 5.30 m .* the searched 2 to 5.2 m"):
        far.reset(seed=0)


def test_a_match_that_puts_the_camera_outside_of_the_map_is_rejected(make, monkeypatch):
    def far_off(*_, **__):
        there = Pose(np.array([50.0, 0.0, 0.0]), np.eye(3))
        return Registration(LocalizationFailure.NONE, "", there, 1e-4 * np.eye(6), None, (there,))

    monkeypatch.setattr("coopmap_env.envs.field.target_search.register", far_off)
    env = make(max_scans=4)
    env.reset(seed=0)
    infos = wander(env, np.random.default_rng(0))
    assert env.belief().located == (False, False)
    outside = LocalizationFailure.OUTSIDE_MAP
    (lost, *_) = [agent for agent, i in infos.items() if i["localization_failure"] == outside]
    assert "outside of the map" in env.explain(lost)["localization_failure"]


def test_local_frames_do_not_change_the_gain_of_a_scan(make):
    """Before it is located, a robot's pose is off by its encoders only, as it is afterwards."""
    env = make(max_scans=2)
    env.reset(seed=0)
    infos = wander(env, np.random.default_rng(0))
    for info in infos.values():
        assert info["camera_error"] < 0.06
        assert np.degrees(info["camera_angle_error"]) < 2.5


def test_every_policy_searches(make):
    baselines = pytest.importorskip("coopmap_baselines")
    env = make(max_scans=3)
    small = {
        "rating_function": {"search": 8, "coordination": "sequential"},
        "projection": {"search": 8},
        "tour": {"search": 8},
        "lookahead": {"search": 8, "width": 2, "samples": 4},
    }
    for name in baselines.POLICIES:
        policy = baselines.make(name, **small.get(name, {}))
        observations, _ = env.reset(seed=1)
        policy.reset(np.random.default_rng(0))
        while env.agents:
            observations, *_ = env.step(policy.act(env.belief(), observations))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"initialization": "lost"}, "initialization must be one of .*'lost'"),
        ({"motion_correction": "stereo"}, "motion_correction must be one of .*'stereo'"),
    ],
)
def test_unknown_choices_are_rejected(make, arguments, message):
    with pytest.raises(ValueError, match=message):
        make(**arguments)


def test_pictures_show_who_is_located(make):
    pytest.importorskip("PIL")
    env = make(render_mode="rgb_array", max_scans=6)
    env.reset(seed=0)
    first = env.render()
    wander(env, np.random.default_rng(0), all_located)
    assert first.shape == env.render().shape
