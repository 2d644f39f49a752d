"""Environments in threads share nothing: each does what it does alone."""

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from plain.rollouts import env_trajectory_hash, trajectory_hash

from coopmap_env.core.caches import freeze, thread_cache
from coopmap_env.envs.field import FieldEnv, FieldSettings
from coopmap_env.envs.planar import PlanarEnv, PlanarSettings
from coopmap_env.robots import make_mount
from coopmap_env.sensing import DepthCamera
from coopmap_env.simulation.scenes.planar import Obstacles


def in_threads(functions):
    """Results of functions that run at the same time, each in a thread of its own."""
    with ThreadPoolExecutor(len(functions)) as pool:
        return [future.result() for future in [pool.submit(function) for function in functions]]


class RecordingBullet:
    """PyBullet that notes the vertices it is given, and lets the other thread in meanwhile."""

    GEOM_MESH = 5

    def __init__(self, bullet):
        self._bullet = bullet
        self._both_inside = threading.Barrier(2)
        self.given = {}

    def createCollisionShape(self, kind, vertices, **_):  # noqa: N802 - PyBullet's name
        first = [tuple(row) for row in vertices[:4]]
        try:
            self._both_inside.wait(timeout=0.2)  # longer changes nothing: they never meet
        except threading.BrokenBarrierError:
            self._both_inside.reset()
        self.given[threading.get_ident()] = first + [tuple(row) for row in vertices[4:]]
        return 0

    def __getattr__(self, name):
        return getattr(self._bullet, name)


def test_a_shape_has_the_vertices_of_its_own_thread():
    pytest.importorskip("pybullet")
    from coopmap_env.simulation.physics.client import BulletClient

    clients = [BulletClient(), BulletClient()]
    bullet = RecordingBullet(clients[0].p)
    shapes = [np.full((8, 3), 1.0), np.full((8, 3), 2.0)]

    def create(client, vertices):
        client.p = bullet
        client.create_shape(vertices)
        return bullet.given[threading.get_ident()]

    given = in_threads(
        [lambda pair=pair: create(*pair) for pair in zip(clients, shapes, strict=True)]
    )
    for vertices, rows in zip(shapes, given, strict=True):
        np.testing.assert_array_equal(rows, vertices)
    for client in clients:
        client.close()


def test_many_shapes_made_in_threads_are_those_made_alone():
    pytest.importorskip("pybullet")
    from coopmap_env.simulation.physics.client import BulletClient

    def boxes(seed):
        """Boxes around random shapes, as the physics engine has them."""
        client, rng, found = BulletClient(), np.random.default_rng(seed), []
        for _ in range(150):
            vertices = rng.normal(size=(int(rng.integers(8, 40)), 3))
            shape = client.create_shape(vertices)
            body = client.p.createMultiBody(0, shape, physicsClientId=client.id)
            found.append(client.p.getAABB(body, physicsClientId=client.id))
            client.p.removeBody(body, physicsClientId=client.id)
        client.close()
        return found

    alone = [boxes(seed) for seed in range(3)]
    assert in_threads([lambda seed=seed: boxes(seed) for seed in range(3)]) == alone


def test_shapes_share_as_many_rows_as_the_largest_has():
    pytest.importorskip("pybullet")
    from coopmap_env.simulation.physics import client as module

    client = module.BulletClient()
    for n in (50, 8, 50, 20, 49):
        client.create_shape(np.random.default_rng(n).normal(size=(n, 3)))
    rows = module._vertex_rows._rows
    before = [id(row) for row in rows]
    client.create_shape(np.random.default_rng(0).normal(size=(50, 3)))
    assert len(rows) >= 50
    assert [id(row) for row in rows] == before
    client.close()


PLANAR = {
    "scene": Obstacles(shape=(40, 40)),
    "settings": PlanarSettings(crop_cells=8),
    "max_scans": 5,
    "action_mode": "candidates",
    "n_candidates": 6,
}
FIELD = {
    "settings": FieldSettings(crop_cells=(8, 4), camera=DepthCamera(width=16, height=12)),
    "max_scans": 3,
    "action_mode": "candidates",
    "n_candidates": 4,
}


def test_environments_stepped_in_threads_play_their_own_episodes():
    pytest.importorskip("pybullet")
    played = [(PlanarEnv, PLANAR, 0), (PlanarEnv, PLANAR, 1), (FieldEnv, FIELD, 0),
              (FieldEnv, FIELD, 1)]  # fmt: skip
    alone = [env_trajectory_hash(arguments, seed, make) for make, arguments, seed in played]
    rounds = threading.Barrier(len(played))

    def play(make, arguments, seed):
        """All begin at once, and take the first steps side by side."""
        env, steps = make(**arguments), iter(range(FIELD["max_scans"]))
        rounds.wait()

        def before_step(_):
            if next(steps, None) is not None:
                rounds.wait()

        try:
            return trajectory_hash(env, seed, before_step)
        except BaseException:
            rounds.abort()
            raise
        finally:
            env.close()

    assert in_threads([lambda one=one: play(*one) for one in played]) == alone


def test_what_environments_share_cannot_be_changed():
    pytest.importorskip("pybullet")
    chain = make_mount("mast").chain()
    assert chain is make_mount("mast").chain()
    shared = [chain.lower, chain.upper, *chain.tree, *chain.meshes, chain.link_rotations]
    for array in shared:
        assert not array.flags.writeable
    with pytest.raises(ValueError, match="read-only"):
        chain.lower[0] = 0.0


def test_frozen_arrays_are_read_only_wherever_they_are():
    value = {"arrays": [np.zeros(2), (np.zeros(3),)], "number": 1}
    assert freeze(value) is value
    for array in (value["arrays"][0], value["arrays"][1][0]):
        assert not array.flags.writeable


def test_a_thread_cache_makes_one_object_for_each_thread():
    made = thread_cache(maxsize=2)(lambda name: object())
    barrier = threading.Barrier(2)

    def ask():
        barrier.wait()
        return made("one"), made("one")

    (first, again), (other, _) = in_threads([ask, ask])
    assert first is again
    assert first is not other
