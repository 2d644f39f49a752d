"""Motions of mounts: kinematic and stepped ones end alike, and none ends inside of anything."""

import math

import numpy as np
import pytest
from plain.crane import crane
from plain.field_worlds import base_pose, cluttered_world, crate, flat_world

from coopmap_env.robots import Suspension, make_mount
from coopmap_env.simulation.physics import (
    BulletWorld,
    SteppingSettings,
    move_kinematically,
    move_stepped,
)
from coopmap_env.simulation.physics._path import FREE_CLEARANCE
from coopmap_env.simulation.physics._trajectory import trapezoidal_profile

pytest.importorskip("pybullet")
OUT = np.array([0.0, 0.8, 0.9, 0.0, 0.0])
"""The mast's arm stretched out forward: the head is 1.2 m ahead, 1.6 m above ground."""
TUCKED = np.array([0.0, -1.0, 1.9, 0.0, 0.0])
BOTH = ("kinematic", "stepped")


@pytest.fixture(scope="module")
def mast():
    return make_mount("mast")


def physics_of(world, mount):
    mounts = [mount] * world.n_robots
    return BulletWorld(world.solids, mounts, world.base_poses)


def move(physics, kind, goals):
    """What each vehicle touched; afterwards none may be inside of anything."""
    if kind == "stepped":
        touched = move_stepped(physics, list(goals), SteppingSettings())
    else:
        touched = [move_kinematically(physics, robot, q) for robot, q in enumerate(goals)]
    physics.find_contacts()
    assert [what for _, what in physics.contacts()] == [""] * len(goals)
    return touched


def camera_poses(physics, mount):
    chain = mount.chain(with_suspension=True)
    return [chain.camera_poses(q) for q in physics.q]


def angle(R, S):
    return math.acos(min(1.0, (np.trace(R.T @ S) - 1) / 2))


def test_the_trapezoidal_profile_starts_and_ends_at_rest_and_is_halfway_at_half_time():
    assert trapezoidal_profile(np.array([0.0, 0.5, 1.0])).tolist() == [0.0, 0.5, 1.0]
    fraction = trapezoidal_profile(np.linspace(0, 1, 101))
    speed = np.diff(fraction) * 100
    assert speed.max() == pytest.approx(4 / 3)  # a quarter of the time up, a quarter down
    assert (speed > 0).all()
    assert speed[[0, -1]] == pytest.approx([0.0267, 0.0267], abs=1e-3)


@pytest.mark.parametrize("name", ["mast", "tiago"])
def test_both_kinds_of_physics_end_at_the_same_camera_poses(name):
    """Within 0.2 mm and 0.01 degrees, on random targets, from wherever the last one ended."""
    try:
        mount = make_mount(name)
    except ImportError as error:
        pytest.skip(str(error))
    chain = mount.chain()
    world = flat_world(bases=[base_pose(0.0, 0.0), base_pose(0.0, 4.0, 1.0)])
    kinematic, stepped = physics_of(world, mount), physics_of(world, mount)
    rng = np.random.default_rng(0)
    compared = 0
    for goals in rng.uniform(chain.lower, chain.upper, (20, 2, chain.n_joints)):
        first, second = move(kinematic, "kinematic", goals), move(stepped, "stepped", goals)
        both = zip(camera_poses(kinematic, mount), camera_poses(stepped, mount), strict=True)
        for robot, ((R, t), (S, u)) in enumerate(both):
            if not first[robot] and not second[robot]:
                assert np.linalg.norm(t - u) < 2e-4
                assert angle(R, S) < math.radians(0.01)
                compared += 1
            else:  # TIAGo's head reaches its own shoulders; from there the ways part
                assert first[robot] == second[robot]
        for physics in (kinematic, stepped):
            for robot, vehicle in enumerate(physics.vehicles):
                physics.set_configuration(robot, vehicle.home)
    assert compared > 10


def test_stepped_physics_swings_to_the_equilibrium_of_a_hand_calculation(tmp_path):
    """10 kg pushed out by 0.5 m: 49.05 N m on springs of 12000 N m/rad."""
    mount = crane(tmp_path)
    physics = physics_of(flat_world(), mount)
    assert move_stepped(physics, [np.array([0.5])], SteppingSettings()) == [""]
    assert physics.q[0][2] == pytest.approx(49.05 / 12000, abs=5e-5)
    assert physics.q[0][:2] == pytest.approx([0.0, 0.0], abs=1e-4)


def test_the_body_swings_during_a_stepped_motion(tmp_path):
    """What the kinematic shortcut leaves out."""
    springy = Suspension(pitch_damping=50.0, roll_center_height=0.3)
    physics = physics_of(flat_world(), crane(tmp_path, suspension=springy))
    pitch = []
    step = physics.step

    def watched():
        step()
        physics.velocity(0)
        pitch.append(physics.q[0][2])

    physics.step = watched
    move_stepped(physics, [np.array([1.5])], SteppingSettings())
    assert max(pitch) > pitch[-1] + 1e-4


def swing_and_end(world, mount, goals, stepping):
    """How far cameras get from where they would be at rest, and where they end: (m, 2)."""
    physics = physics_of(world, mount)
    chain = mount.chain(with_suspension=True)
    off = np.zeros(world.n_robots)
    step = physics.step

    def watched():
        step()
        for robot in range(world.n_robots):
            physics.velocity(robot)
            q = physics.q[robot]
            rest = physics.rest_configurations(robot, q[None, 3:])[0]
            gap = np.linalg.norm(chain.camera_poses(q)[1] - chain.camera_poses(rest)[1])
            off[robot] = max(off[robot], gap)

    physics.step = watched
    swings = []
    for pair in goals:
        off[:] = 0.0
        assert move_stepped(physics, list(pair), stepping) == [""] * world.n_robots
        swings.append(off.copy())
    ends = np.array([t for _, t in camera_poses(physics, mount)])
    return np.array(swings), ends, physics.time_step


def test_long_steps_of_free_motions_change_neither_the_swinging_by_much_nor_the_end(mast):
    """Against steps of a hundredth of a second; and no swing leaves the room that is left free."""
    world = flat_world(bases=[base_pose(0.0, 0.0), base_pose(0.0, 6.0, 1.0)])
    chain = mast.chain()
    goals = np.random.default_rng(4).uniform(chain.lower, chain.upper, (8, 2, 5))
    goals[:, :, 1:3] = [0.3, 0.9] + 0.3 * (goals[:, :, 1:3] > 0.5)  # well above ground
    long, end, used = swing_and_end(world, mast, goals, SteppingSettings())
    fine, fine_end, _ = swing_and_end(world, mast, goals, SteppingSettings(free_time_step=0.01))
    assert used == SteppingSettings().free_time_step
    assert np.linalg.norm(end - fine_end, axis=1).max() < 2e-4
    assert 0.5 < np.median(long) / np.median(fine) < 1.5
    assert max(long.max(), fine.max()) < FREE_CLEARANCE


@pytest.mark.parametrize("time_step", [1 / 30, 1 / 12])
def test_a_heavy_arm_comes_to_rest_within_a_second_of_its_arrival(time_step):
    """Seven joints and 18 kg on a vehicle of 50: motors that are not solved well would shake it."""
    try:
        mount = make_mount("husky_panda")
    except ImportError as error:
        pytest.skip(str(error))
    chain = mount.chain()
    physics = physics_of(flat_world(), mount)
    steps = []
    step = physics.step
    physics.step = lambda: (steps.append(0), step())
    for goal in np.random.default_rng(3).uniform(-0.6, 0.6, (12, 7)) + mount.home:
        goal = np.clip(goal, chain.lower, chain.upper)
        steps.clear()
        assert move_stepped(physics, [goal], SteppingSettings(time_step, time_step)) == [""]
        assert len(steps) * time_step < 1.7
        assert np.abs(physics.q[0] - physics.rest_configurations(0, goal[None])[0]).max() < 1e-4


@pytest.mark.parametrize(
    ("bases", "solids", "free"),
    [
        ([base_pose(0, 0), base_pose(0, 6)], (), True),
        ([base_pose(-0.9, 0), base_pose(0.9, 0, math.pi)], (), False),  # they reach for each other
        ([base_pose(-2.2, 0), base_pose(2.2, 0, math.pi)], (), True),
        ([base_pose(0, 0)], (crate("ahead", 1.5, 0.0, 1.65, 0.4),), False),
        ([base_pose(0, 0)], (crate("far", 2.5, 0.0, 1.65, 0.4),), True),
    ],
)
def test_steps_are_long_only_where_nothing_is_near(mast, bases, solids, free):
    physics = physics_of(flat_world(*solids, bases=bases), mast)
    move_stepped(physics, [OUT] * len(bases), SteppingSettings())
    assert physics.time_step == (
        SteppingSettings().free_time_step if free else SteppingSettings().time_step
    )


@pytest.mark.parametrize("kind", BOTH)
def test_a_crate_on_the_path_stops_the_mount(mast, kind):
    """It hangs where the head would go; the mount ends before it and off it."""
    physics = physics_of(flat_world(crate("crate", 1.0, 0.0, 1.65, 0.4)), mast)
    assert move(physics, kind, [TUCKED]) == [""]
    assert physics.q[0][3:] == pytest.approx(TUCKED, abs=1e-4)
    assert move(physics, kind, [OUT]) == ["crate"]
    fraction = (physics.q[0][3:] - TUCKED)[1] / (OUT - TUCKED)[1]
    assert 0.1 < fraction < 0.95
    assert move(physics, kind, [TUCKED]) == [""]
    assert physics.q[0][3:] == pytest.approx(TUCKED, abs=1e-4)


def test_both_kinds_of_physics_stop_at_about_the_same_place(mast):
    ends = []
    for kind in BOTH:
        physics = physics_of(flat_world(crate("crate", 1.0, 0.0, 1.65, 0.4)), mast)
        move(physics, kind, [TUCKED])
        move(physics, kind, [OUT])
        ends.append(mast.chain().camera_poses(physics.q[0][3:])[1])
    assert np.linalg.norm(ends[0] - ends[1]) < 0.06


@pytest.mark.parametrize("kind", BOTH)
def test_a_crate_beside_the_path_does_not_stop_the_mount(mast, kind):
    physics = physics_of(flat_world(crate("crate", 1.0, 0.6, 1.65, 0.4)), mast)
    assert move(physics, kind, [TUCKED]) == [""]
    assert move(physics, kind, [OUT]) == [""]
    assert physics.q[0][3:] == pytest.approx(OUT, abs=1e-4)


@pytest.mark.parametrize("kind", BOTH)
def test_two_arms_that_reach_for_each_other_meet(mast, kind):
    bases = [base_pose(-0.9, 0.0), base_pose(0.9, 0.0, math.pi)]
    physics = physics_of(flat_world(bases=bases), mast)
    touched = move(physics, kind, [OUT, OUT])
    if kind == "kinematic":  # the first goes first
        assert touched == ["", "robot_0"]
    else:
        assert touched == ["robot_1", "robot_0"]


@pytest.mark.parametrize("kind", BOTH)
def test_an_arm_does_not_enter_its_own_body(kind):
    try:
        mount = make_mount("husky_panda")
    except ImportError as error:
        pytest.skip(str(error))
    physics = physics_of(flat_world(), mount)
    folded = np.array(mount.home)
    folded[[1, 3, 5]] = 1.7, -1.2, 2.0
    assert move(physics, kind, [folded]) == ["its own body"]


@pytest.mark.parametrize("kind", BOTH)
@pytest.mark.parametrize("n_robots", [2, 3, 5])
def test_no_mount_ends_inside_of_anything(mast, kind, n_robots):
    """Vehicles in a narrow circle among boulders: many contacts, all of them resolved."""
    around = np.arange(n_robots) * 2 * math.pi / n_robots
    radius = 0.55 / math.sin(math.pi / n_robots)
    bases = [base_pose(radius * math.cos(a), radius * math.sin(a), a + 2.0) for a in around]
    physics = physics_of(cluttered_world(6, bases, n=80, nearest=0.7), mast)
    physics.find_contacts()
    assert not any(what for _, what in physics.contacts())
    chain = mast.chain()
    rng = np.random.default_rng(n_robots)
    touched = []
    for goals in rng.uniform(chain.lower, chain.upper, (8, n_robots, 5)):
        touched += move(physics, kind, goals)
    assert sum(map(bool, touched)) >= 3
    for q in physics.q:
        assert q[:3] == pytest.approx(physics.rest_configurations(0, q[None, 3:])[0, :3], abs=3e-4)


def test_the_fast_test_changes_nothing_but_time(mast):
    """With every segment marked, so that the engine checks all configurations: the same ends."""
    bases = [base_pose(-0.7, 0.0), base_pose(0.7, 0.0, 2.0)]
    world = cluttered_world(5, bases, n=80, nearest=0.7)
    quick, thorough = physics_of(world, mast), physics_of(world, mast)
    swept_collisions = thorough.swept_collisions
    thorough.swept_collisions = lambda robot, q: (
        np.ones(len(q) - 1, bool),
        swept_collisions(robot, q)[1],
    )
    chain = mast.chain()
    contacts = 0
    for goals in np.random.default_rng(5).uniform(chain.lower, chain.upper, (15, 2, 5)):
        one, other = move(quick, "kinematic", goals), move(thorough, "kinematic", goals)
        assert one == other
        contacts += sum(map(bool, one))
        for p, q in zip(quick.q, thorough.q, strict=True):
            assert p.tolist() == q.tolist()
    assert contacts > 5


class EagerWorld(BulletWorld):
    """The engine gets to know every configuration, also those that nothing asks it about."""

    def set_configuration(self, robot, q):
        super().set_configuration(robot, q)
        assert self.client is self.client


def test_when_the_engine_gets_to_know_a_configuration_does_not_matter(mast):
    bases = [base_pose(-0.7, 0.0), base_pose(0.7, 0.0, 2.0)]
    world = cluttered_world(5, bases, n=80, nearest=0.7)
    late, eager = (
        make(world.solids, [mast] * 2, world.base_poses) for make in (BulletWorld, EagerWorld)
    )
    chain = mast.chain()
    kinds = {"free": 0, "touched": 0}
    for goals in np.random.default_rng(6).uniform(chain.lower, chain.upper, (40, 2, 5)):
        one, other = (
            [move_kinematically(physics, robot, q) for robot, q in enumerate(goals)]
            for physics in (late, eager)
        )
        assert one == other
        assert [q.tolist() for q in late.q] == [q.tolist() for q in eager.q]
        for obstacle in one:
            kinds["touched" if obstacle else "free"] += 1
    assert min(kinds.values()) > 10


def test_a_mount_that_begins_in_contact_may_leave_but_not_go_deeper(mast):
    physics = physics_of(flat_world(crate("crate", 1.0, 0.0, 1.65, 0.4)), mast)
    physics.set_configuration(0, physics.rest_configurations(0, OUT[None])[0])
    aside = OUT + np.array([1.5, 0, 0, 0, 0])
    assert move_kinematically(physics, 0, aside) == ""
    assert physics.q[0][3:].tolist() == aside.tolist()


@pytest.mark.parametrize(
    "field", ["time_step", "free_time_step", "speed_factor", "rest_speed", "settle_timeout"]
)
def test_stepping_needs_positive_numbers(field):
    with pytest.raises(
        ValueError, match=rf"SteppingSettings.{field} must be a finite number > 0, got 0"
    ):
        SteppingSettings(**{field: 0.0})
