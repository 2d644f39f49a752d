"""The true worlds of planar environments: drawn together, looked at one by one."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from coopmap_env import planar_v1
from coopmap_env.envs.planar.true_worlds import TrueWorlds
from coopmap_env.envs.planar.worlds import PlanarWorlds
from coopmap_env.envs.step_data import EpisodeSeeds
from coopmap_env.mapping import VoxelGrid
from coopmap_env.simulation.scenes.planar import Obstacles, PlanarWorld, Rooms

SMALL = Obstacles(shape=(40, 30), side_max=9.0)
FAR = 2**200 + 1


class Mirrored(Obstacles):
    """Obstacles that make other worlds than those they are derived from."""

    def world(self, rng):
        world = super().world(rng)
        return replace(world, occupied=world.occupied[::-1])


@dataclass
class Failing:
    """A scene whose third world has another shape."""

    made: int = 0
    name = "failing"
    shape, resolution, origin = (10, 10), 1.0, (0.0, 0.0)

    def world(self, rng):
        self.made += 1
        side = 11 if self.made == 3 else 10
        return PlanarWorld(rng.random((side, 10)) < 0.1, 1.0, (0.0, 0.0), f"number {self.made}")


def worlds_of(scene, n):
    return TrueWorlds(scene, VoxelGrid(scene.shape, scene.resolution, scene.origin), n)


@pytest.mark.parametrize("scene", [SMALL, Mirrored(shape=(40, 30)), Rooms(shape=(50, 50))])
def test_worlds_are_those_that_the_scene_makes_from_their_seeds(scene):
    truths, indices = worlds_of(scene, 6), [3, 0, FAR, 5]
    seeds = [EpisodeSeeds("test", index) for index in indices]
    truths.draw([5, 1, 0, 2], seeds)
    for number, own in zip([5, 1, 0, 2], seeds, strict=True):
        expected = scene.world(np.random.default_rng(own.scene))
        world = truths.world(number)
        np.testing.assert_array_equal(world.occupied, expected.occupied)
        np.testing.assert_array_equal(truths.occupied[number], expected.occupied.ravel())
        assert (world.resolution, world.origin, world.name) == (
            expected.resolution, expected.origin, expected.name,
        )  # fmt: skip
        assert truths.world(number) is world


def test_a_world_that_was_looked_at_stays_as_it_was():
    truths = worlds_of(SMALL, 1)
    truths.draw([0], [EpisodeSeeds("train", 0)])
    first = truths.world(0)
    kept = first.occupied.copy()
    truths.draw([0], [EpisodeSeeds("train", 1)])
    np.testing.assert_array_equal(first.occupied, kept)
    assert (truths.world(0).occupied != kept).any()


def test_no_world_changes_if_one_cannot_be_made():
    scene = Failing()
    truths, seeds = worlds_of(scene, 2), [EpisodeSeeds("train", 0), EpisodeSeeds("train", 1)]
    truths.draw([0, 1], seeds)
    before, first = truths.occupied.copy(), truths.world(0)
    with pytest.raises(ValueError, match=r"'failing' made a world of shape \(11, 10\), not"):
        truths.draw([0, 1], seeds)
    np.testing.assert_array_equal(truths.occupied, before)
    assert truths.world(0) is first
    assert truths.world(1).name == "number 2"


def test_each_world_needs_a_seed():
    truths = worlds_of(SMALL, 2)
    truths.draw([], [])
    with pytest.raises(ValueError, match="2 worlds need as many seeds, got 1"):
        truths.draw([0, 1], [EpisodeSeeds("train", 0)])


def test_a_map_that_was_cleared_by_hand_leaves_nothing_behind():
    def episode(env):
        env.reset(seed=2)
        for k, agent in enumerate(env.agents):
            env.action_space(agent).seed(k)
        steps = [
            env.step({agent: env.action_space(agent).sample() for agent in env.agents})
            for _ in range(4)
        ]
        return [(step[1], step[4]) for step in steps]

    env, other = (planar_v1.parallel_env(scene=SMALL) for _ in range(2))
    expected = episode(other)
    assert episode(env) == expected
    env.belief().map.clear()
    assert episode(env) == expected


@pytest.mark.parametrize("action_mode", ["pose", "candidates"])
@pytest.mark.parametrize("keep_surfaces", [False, True])
def test_a_world_that_starts_again_is_like_a_new_one(action_mode, keep_surfaces):
    task = planar_v1.parallel_env(scene=SMALL, n_robots=3, action_mode=action_mode).task
    used, new = (PlanarWorlds(task, SMALL, 2, keep_surfaces) for _ in range(2))
    rng, observations = np.random.default_rng(0), used.empty_observations()
    both = np.arange(2)
    seeds = [EpisodeSeeds("train", 0), EpisodeSeeds("train", 1)]
    used.truths.draw([0, 1], seeds)
    used.start(both, seeds)
    used.observe(both, observations)
    for _ in range(30):
        m = task.n_candidates
        choices = rng.integers(m, size=(2, 3)) if m else np.empty((2, 0), dtype=np.int64)
        poses = np.empty((2, 0, 3)) if m else rng.uniform(-1, 1, (2, 3, 3))
        used.step(both, poses, choices, observations)
    later = [EpisodeSeeds("train", 2), EpisodeSeeds("train", 3)]
    for worlds in (used, new):
        worlds.truths.draw([0, 1], later)
        worlds.start(both, later)
    for field, ours, theirs in zip(used.arrays._fields, used.arrays, new.arrays, strict=True):
        if field in ("candidates", "n_candidates"):
            continue  # offered again before they are read
        for own, other in zip(
            ours if isinstance(ours, tuple) else [ours],
            theirs if isinstance(theirs, tuple) else [theirs],
            strict=True,
        ):
            np.testing.assert_array_equal(own, other, err_msg=field)
