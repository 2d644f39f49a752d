"""Bases at the border of the map: the camera has to be inside of it from the start."""

import numpy as np
import pytest
from plain.rollouts import random_actions

from coopmap_env.envs.field import FieldEnv, FieldSettings
from coopmap_env.mapping import VoxelGrid
from coopmap_env.sensing import DepthCamera
from coopmap_env.simulation.scenes.field import Worksite

pytest.importorskip("pybullet")
pytest.importorskip("yaml")

TARGET = "objects:\n  - {box: [1, 1, 1], position: [0, 0, 0.5], target: true}\n"
SETTINGS = FieldSettings(crop_cells=(8, 4), camera=DepthCamera(width=16, height=12))


@pytest.fixture
def make(tmp_path):
    made = []

    def make(bases, grid="", **arguments):
        path = tmp_path / "yard.yaml"
        path.write_text(f"{grid}bases: {bases}\n{TARGET}")
        env = FieldEnv(n_robots=len(bases), scene=path, settings=SETTINGS, **arguments)
        made.append(env)
        return env

    yield make
    for env in made:
        env.close()


def overhang(make):
    """Metres that the camera is ahead of its base at home."""
    env = make([[3, 0, 180]])
    env.reset(seed=0)
    base = env.truth.base_poses[0]
    return float((base.inverse() @ env.diagnostics.true_cameras[0]).translation[0])


def test_a_base_whose_camera_hangs_outside_is_named_at_reset(make):
    x = 6.4 - 0.5 * overhang(make)
    env = make([[3, 0, 180], [x, 0, 0]])
    with pytest.raises(ValueError, match=r"base 1 of scene 'yard', at \(6\...") as raised:
        env.reset(seed=0)
    message = str(raised.value)
    assert "the camera of robot_1 at home" in message
    assert "inside of the map, (-6.40, -6.40, -0.35) to (6.40, 6.40, 3.65) m" in message
    with pytest.raises(RuntimeError, match=r"reset\(\)"):
        env.step({})


def test_the_same_base_turned_inwards_is_used(make):
    x = 6.4 - 0.5 * overhang(make)
    for correction in ("kinematic", "exact", "fiducials"):
        env = make([[x, 0, 180]], motion_correction=correction, max_scans=4)
        env.reset(seed=0)
        rng = np.random.default_rng(0)
        while env.agents:
            observations, *_ = env.step(random_actions(env, rng))
            assert env.observation_space("robot_0").contains(observations["robot_0"])


def test_a_map_that_is_lower_than_the_camera_is_refused_at_reset(make):
    grid = "grid: {shape: [128, 128, 10], resolution: 0.1, origin: [-6.4, -6.4, -0.35]}\n"
    for initialization in ("located", "search"):
        env = make([[3, 0, 180]], grid, initialization=initialization)
        with pytest.raises(ValueError, match=r"camera of robot_0 .* \(6.40, 6.40, 0.65\) m"):
            env.reset(seed=0)


def test_a_refused_world_leaves_the_running_episode_as_it_is():
    class Shifted(Worksite):
        """A worksite that puts its bases at the border, from the second world on."""

        worlds = 0

        def world(self, rng, n_robots, footprint=1.2):
            world = super().world(rng, n_robots, footprint)
            Shifted.worlds += 1
            if Shifted.worlds > 1:
                for base in world.base_poses:
                    base.translation[0] = 100.0
            return world

    env = FieldEnv(scene=Shifted(), settings=SETTINGS, n_robots=1)
    env.reset(seed=0)
    before = env.state()
    with pytest.raises(ValueError, match="base 0 of scene 'worksite'"):
        env.reset(seed=1)
    np.testing.assert_array_equal(env.state(), before)
    env.step({"robot_0": np.zeros(env.action_space("robot_0").shape)})
    env.close()


def test_a_scene_that_makes_no_world_or_declares_no_grid_is_named():
    class NoWorld(Worksite):
        def world(self, rng, n_robots, footprint=1.2):
            return None

    env = FieldEnv(scene=NoWorld(), settings=SETTINGS)
    with pytest.raises(ValueError, match="scene 'worksite' must make a FieldWorld, not None"):
        env.reset(seed=0)

    class NoGrid:
        name, grid = "flat", VoxelGrid((8, 8))
        world = Worksite.world

    with pytest.raises(ValueError, match="grid of a scene must be a VoxelGrid of three axes"):
        FieldEnv(scene=NoGrid(), settings=SETTINGS)
