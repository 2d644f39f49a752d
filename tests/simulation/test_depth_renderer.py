"""Distances to triangles, still and moving: what a depth camera measures."""

import copy
import math
import pickle
import sys

import numpy as np
import pytest
from plain import triangles as plain
from scipy.spatial.transform import Rotation

from coopmap_env.sensing import DepthCamera

pytest.importorskip("embreex")

from coopmap_env.simulation.depth import DepthRenderer, TracedMesh

NOTHING = np.empty((0, 3, 3))
CAMERA = DepthCamera()
HERE = np.eye(3), np.zeros(3)
WALL = np.array([[[3.0, -9, -9], [3, 9, -9], [3, 9, 9]], [[3, -9, -9], [3, 9, 9], [3, -9, 9]]])
"""A wall 3 m ahead, across the whole view."""


def random_triangles(rng, n, size=0.6, spread=4.0):
    return rng.uniform(-spread, spread, (n, 1, 3)) + rng.normal(size=(n, 3, 3)) * size


def random_rotations(rng, n):
    return Rotation.random(n, random_state=rng).as_matrix().reshape(n, 3, 3)


def random_view(rng, n_bodies):
    """A camera somewhere, and bodies around it and ahead."""
    R = random_rotations(rng, 1)[0]
    return (
        R,
        rng.normal(size=3),
        random_rotations(rng, n_bodies),
        rng.normal(size=(n_bodies, 3)) * 1.5,
    )


def moved(meshes, Rs, ts):
    return [mesh @ R.T + t for mesh, R, t in zip(meshes, Rs, ts, strict=True)]


def reference(scene, meshes, directions, R, t, Rs, ts):
    """Everything in the world frame, every ray with every triangle."""
    return plain.ray_distances(t, directions @ R.T, np.concatenate([scene, *moved(meshes, Rs, ts)]))


def renderer_of(scene, meshes):
    renderer = DepthRenderer(scene)
    for mesh in meshes:
        renderer.add_body(mesh)
    return renderer


@pytest.fixture(scope="module")
def crowd():
    """A random scene, 12 bodies of random triangles, and their renderer."""
    rng = np.random.default_rng(0)
    scene = random_triangles(rng, 60)
    meshes = [random_triangles(rng, 12, 0.2, 0.3) + rng.normal(size=3) * 0.3 for _ in range(12)]
    return scene, meshes, renderer_of(scene, meshes)


def test_a_wall_across_the_axis_has_one_depth_and_both_of_its_sides_are_seen():
    renderer = DepthRenderer(WALL)
    distances = renderer.distances(*HERE, CAMERA.directions)
    assert CAMERA.depth_image(distances) == pytest.approx(np.full((48, 64), 3.0), abs=1e-6)
    behind = renderer.distances(np.diag([-1.0, -1, 1]), np.array([5.0, 0, 0]), CAMERA.directions)
    assert CAMERA.depth_image(behind) == pytest.approx(np.full((48, 64), 2.0), abs=1e-6)


def test_what_stands_at_the_top_left_is_seen_there():
    corner = plain.box([3.0, 1.2, 0.9], [0.01, 0.5, 0.4])
    seen = np.isfinite(
        CAMERA.depth_image(DepthRenderer(corner).distances(*HERE, CAMERA.directions))
    )
    assert seen[0, 0]
    assert not seen[24:].any()
    assert not seen[:, 32:].any()


def test_an_empty_scene_shows_nothing_but_its_bodies():
    renderer = DepthRenderer(NOTHING)
    assert np.isinf(renderer.distances(*HERE, CAMERA.directions)).all()
    assert renderer.add_body(NOTHING) == 0
    assert renderer.add_body(plain.box(0, [1, 9, 9])) == 1
    places = np.array([[2.0, 0, 0], [5.0, 0, 0]])
    distances = renderer.distances(*HERE, CAMERA.directions, [np.eye(3)] * 2, places)
    assert CAMERA.depth_image(distances) == pytest.approx(np.full((48, 64), 4.0), abs=1e-6)
    behind = renderer.distances(*HERE, CAMERA.directions, [np.eye(3)] * 2, -places)
    assert np.isinf(behind).all()


def test_bodies_hide_the_scene_and_the_scene_hides_bodies():
    renderer = renderer_of(WALL, [plain.box(0, 0.2), plain.box(0, 0.2)])
    distances = renderer.distances(
        *HERE, [[1.0, 0, 0]], [np.eye(3)] * 2, [[4.0, 0, 0], [2.0, 0, 0]]
    )
    assert distances == pytest.approx([1.8], abs=1e-6)
    distances = renderer.distances(
        *HERE, [[1.0, 0, 0]], [np.eye(3)] * 2, [[4.0, 0, 0], [5.0, 0, 0]]
    )
    assert distances == pytest.approx([3.0], abs=1e-6)


def test_a_camera_does_not_see_the_housing_that_is_hidden_from_it():
    renderer = renderer_of(WALL, [plain.box(0, 0.2), plain.box(0, 0.2)])
    places = [[0.0, 0, 0], [2.0, 0, 0]]
    for hidden, distance in (((), 0.2), ((0,), 1.8), ((1,), 0.2), ({0, 1}, 3.0)):
        seen = renderer.distances(*HERE, [[1.0, 0, 0]], [np.eye(3)] * 2, places, hidden)
        assert seen == pytest.approx([distance], abs=1e-6)


def test_random_triangles_and_moving_bodies_are_seen_as_by_the_plain_reference(crowd):
    """Single precision: 1e-4 m at grazing incidence, otherwise micrometres."""
    scene, meshes, renderer = crowd
    rng = np.random.default_rng(1)
    met_bodies = 0
    for _ in range(6):
        R, t, Rs, ts = random_view(rng, len(meshes))
        distances = renderer.distances(R, t, CAMERA.directions, Rs, ts)
        expected = reference(scene, meshes, CAMERA.directions, R, t, Rs, ts)
        assert distances == pytest.approx(expected, abs=1e-4)
        hit = np.isfinite(expected)
        assert np.median(np.abs(distances[hit] - expected[hit])) < 2e-6
        met_bodies += (expected < plain.ray_distances(t, CAMERA.directions @ R.T, scene)).sum()
    assert met_bodies > 1000


def test_rays_all_around_are_traced_as_those_of_an_image(crowd):
    scene, meshes, renderer = crowd
    rng = np.random.default_rng(2)
    directions = rng.normal(size=(2000, 3))
    directions = np.concatenate([directions, -directions])  # their middle is nowhere
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    R, t, Rs, ts = random_view(rng, len(meshes))
    distances = renderer.distances(R, t, directions, Rs, ts)
    assert distances == pytest.approx(reference(scene, meshes, directions, R, t, Rs, ts), abs=1e-4)


@pytest.mark.parametrize("inside", [0.0, 0.99, 1.0, 1.01])
def test_a_camera_at_the_edge_of_a_bodys_box_sees_the_body(inside):
    """Rays along the axes and flat boxes are where a cull goes wrong."""
    rng = np.random.default_rng(3)
    directions = np.concatenate([np.eye(3), -np.eye(3), rng.normal(size=(500, 3))])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for half_size in ([0.5, 0.5, 0.5], [0.5, 0.3, 0.0], [1.0, 0.01, 0.02]):
        mesh = plain.box(0, half_size)
        t = np.array([inside * half_size[0], 0.001, 0.002])
        distances = renderer_of(NOTHING, [mesh]).distances(
            np.eye(3), t, directions, np.eye(3)[None], np.zeros((1, 3))
        )
        expected = plain.ray_distances(t, directions, mesh)
        assert np.isfinite(expected).any()
        assert distances == pytest.approx(expected, abs=1e-5)


def test_the_order_of_bodies_changes_nothing(crowd):
    scene, meshes, renderer = crowd
    rng = np.random.default_rng(4)
    order = rng.permutation(len(meshes))
    other = renderer_of(scene, [meshes[k] for k in order])
    for _ in range(5):
        R, t, Rs, ts = random_view(rng, len(meshes))
        one = renderer.distances(R, t, CAMERA.directions, Rs, ts)
        assert (other.distances(R, t, CAMERA.directions, Rs[order], ts[order]) == one).all()


def test_a_moved_world_looks_the_same_from_a_camera_moved_along(crowd):
    _, meshes, _ = crowd
    rng = np.random.default_rng(5)
    renderer = renderer_of(NOTHING, meshes)
    R, t, Rs, ts = random_view(rng, len(meshes))
    (Q,), q = random_rotations(rng, 1), rng.normal(size=3)
    here = renderer.distances(R, t, CAMERA.directions, Rs, ts)
    there = renderer.distances(Q @ R, Q @ t + q, CAMERA.directions, Q @ Rs, ts @ Q.T + q)
    assert np.isfinite(here).sum() > 100
    assert there == pytest.approx(here, abs=1e-4)


def test_no_ray_slips_through_between_neighbouring_triangles():
    rng = np.random.default_rng(6)
    mesh = plain.box([0.3, 0.1, -0.2], [1.0, 0.7, 1.3])
    renderer = renderer_of(mesh, [])
    for _ in range(20):
        eye = mesh.mean(axis=(0, 1)) + rng.uniform(-0.4, 0.4, 3)
        along = rng.random((len(mesh), 100, 1))
        aims = (mesh[:, None, 0] * along + mesh[:, None, 1] * (1 - along)).reshape(-1, 3) - eye
        aims /= np.linalg.norm(aims, axis=1, keepdims=True)
        assert np.isfinite(renderer.distances(np.eye(3), eye, aims)).all()


def test_triangles_without_area_are_not_seen():
    point, line = np.full((1, 3, 3), 2.0), np.array([[[2.0, -1, 0], [2, 0, 0], [2, 1, 0]]])
    renderer = DepthRenderer(np.concatenate([point, line, WALL]))
    distances = renderer.distances(*HERE, CAMERA.directions)
    assert CAMERA.depth_image(distances) == pytest.approx(np.full((48, 64), 3.0), abs=1e-6)


def test_a_scene_far_from_the_origin_is_seen_as_exactly_as_one_around_it():
    far = np.array([4000.0, -9000.0, 300.0])
    distances = DepthRenderer(WALL + far).distances(np.eye(3), far, CAMERA.directions)
    assert CAMERA.depth_image(distances) == pytest.approx(np.full((48, 64), 3.0), abs=1e-6)


def test_images_of_different_cameras_are_independent(crowd):
    _, meshes, renderer = crowd
    rng = np.random.default_rng(7)
    views = [random_view(rng, len(meshes)) for _ in range(4)]
    sizes = [DepthCamera(width=w, height=h) for w, h in ((64, 48), (3, 2), (90, 60), (1, 1))]
    alone = [
        copy.deepcopy(renderer).distances(R, t, camera.directions, Rs, ts)
        for (R, t, Rs, ts), camera in zip(views, sizes, strict=True)
    ]
    for (R, t, Rs, ts), camera, expected in zip(views, sizes, alone, strict=True):
        assert (renderer.distances(R, t, camera.directions, Rs, ts) == expected).all()


def test_no_rays_have_no_distances(crowd):
    _, meshes, renderer = crowd
    R, t, Rs, ts = random_view(np.random.default_rng(8), len(meshes))
    assert renderer.distances(R, t, np.empty((0, 3)), Rs, ts).shape == (0,)


def test_a_mesh_is_built_once_for_many_renderers_and_survives_pickling(crowd):
    scene, meshes, renderer = crowd
    rng = np.random.default_rng(9)
    R, t, Rs, ts = random_view(rng, len(meshes))
    expected = renderer.distances(R, t, CAMERA.directions, Rs, ts)
    again = renderer_of(TracedMesh(scene), renderer.bodies)
    assert again.bodies[3] is renderer.bodies[3]
    for other in (again, pickle.loads(pickle.dumps(renderer))):
        assert (other.distances(R, t, CAMERA.directions, Rs, ts) == expected).all()


@pytest.mark.parametrize("shape", [(3, 3), (4, 3, 2), (9,), (0,)])
def test_triangles_of_another_shape_are_an_error(shape):
    with pytest.raises(ValueError, match=r"triangles must be \(m, 3, 3\), got"):
        DepthRenderer(np.zeros(shape))


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_triangles_that_are_not_finite_are_named_by_their_number(value):
    mesh = plain.box(0, 1)
    mesh[5, 1, 2] = value
    with pytest.raises(ValueError, match=rf"triangle 5 is not finite: .*{value}"):
        DepthRenderer(NOTHING).add_body(mesh)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("rotation", np.full((3, 3), math.nan), "rotation has a value that is not finite"),
        ("rotation", np.eye(2), r"rotation must be \(3, 3\), got \(2, 2\)"),
        ("translation", [0, math.inf, 0], "translation has a value that is not finite"),
        ("translation", [0, 0], r"translation must be \(3,\), got \(2,\)"),
        ("directions", [1.0, 0, 0], r"directions must be \(n, 3\), got \(3,\)"),
        ("directions", [[1.0, 0, 0], [1.0, 1, 0]], "directions must be unit vectors"),
        ("directions", [[math.nan, 0, 0]], "directions must be unit vectors"),
        ("body_rotations", np.eye(3), r"body_rotations must be \(1, 3, 3\), got \(3, 3\)"),
        ("body_translations", np.zeros((2, 3)), r"body_translations must be \(1, 3\)"),
        ("body_translations", [[0, 0, math.nan]], "body_translations has a value that is not"),
        ("hidden", (1,), "hidden names body 1, and there are 1"),
    ],
)
def test_invalid_arguments_of_an_image_are_errors(name, value, message):
    arguments = {
        "rotation": np.eye(3),
        "translation": np.zeros(3),
        "directions": CAMERA.directions,
        "body_rotations": np.eye(3)[None],
        "body_translations": np.zeros((1, 3)),
    }
    with pytest.raises(ValueError, match=message):
        renderer_of(NOTHING, [WALL]).distances(**{**arguments, name: value})


def test_without_embree_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "embreex.rtcore_scene", None)
    with pytest.raises(ImportError, match=r"pip install 'coopmap\[field\]'"):
        DepthRenderer(WALL)
