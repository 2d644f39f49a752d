"""The frustum of a depth camera and its voxel columns."""

import math

import numpy as np
import pytest
from plain.dense_views import all_cells, in_frustum
from plain.random_voxel_map import rotation

from coopmap_env.geometry import RigidTransform
from coopmap_env.information.field.frustum import Frustum, projection_rows
from coopmap_env.information.field.frustum_runs import FrustumRuns, frustum_runs
from coopmap_env.sensing import DepthCamera

WIDE = DepthCamera(math.radians(110), math.radians(95), near=0.15, far=0.9)
NARROW = DepthCamera(math.radians(25), math.radians(8), near=0.0, far=1.4)


def runs_of(frustum, shape, position, R):
    """The runs, in the fields of `FrustumRuns`, and the rows of the projection."""
    most = frustum.max_runs(shape)
    first, length = np.empty((2, most), dtype=np.int64)
    runs = FrustumRuns(first, length, *np.empty((5, most)))
    rows = projection_rows(R, frustum.geometry)
    n = frustum_runs(shape, RigidTransform(R, position), rows, frustum.geometry, runs)
    return FrustumRuns(*(column[:n] for column in runs)), rows


@pytest.mark.parametrize("camera", [DepthCamera(far=1.5), WIDE, NARROW])
def test_the_runs_are_the_voxels_whose_centers_lie_in_the_frustum(camera):
    rng = np.random.default_rng(0)
    frustum = Frustum.from_camera(camera, 0.1)
    shape = (23, 17, 19)
    for _ in range(30):
        position, R = rng.uniform(0, shape), rotation(*rng.uniform(-np.pi, np.pi, 3))
        runs, _ = runs_of(frustum, shape, position, R)
        assert (runs.length > 0).all()
        spans = zip(runs.first, runs.length, strict=True)
        cells = np.concatenate([np.arange(0), *(np.arange(f, f + n) for f, n in spans)])
        inside = in_frustum(all_cells(shape), position, R, frustum)[4]
        assert len(set(cells.tolist())) == len(cells)
        assert sorted(cells.tolist()) == np.flatnonzero(inside).tolist()


def test_each_run_starts_at_the_image_coordinates_of_its_first_voxel():
    rng = np.random.default_rng(1)
    camera, shape = DepthCamera(far=1.5), (23, 17, 19)
    frustum = Frustum.from_camera(camera, 0.1)
    position, R = rng.uniform(5, 12, 3), rotation(2.0, 0.3, -0.2)
    runs, rows = runs_of(frustum, shape, position, R)
    assert len(runs.first) > 20
    centers = np.stack(np.unravel_index(runs.first, shape), axis=-1) + 0.5
    x, y, z = R.T @ (centers - position).T
    (a, b), (w, h) = frustum.tangents, frustum.pixels
    assert runs.x == pytest.approx(x)
    assert runs.u / runs.x == pytest.approx(w / 2 * (1 + y / (a * x)))
    assert runs.v / runs.x == pytest.approx(h / 2 * (1 + z / (b * x)))
    quarters = runs.half_height**2 + runs.horizontal_quarters
    assert quarters == pytest.approx(4 * ((centers - position) ** 2).sum(axis=1))
    assert rows[0] == pytest.approx(R[:, 0])


def test_n_of_eq_7_by_hand_and_by_counting():
    """A cube's face is a sixth of the sphere."""
    cube_face = DepthCamera(math.pi / 2, math.pi / 2, near=0.2, far=1.0)
    frustum = Frustum.from_camera(cube_face, 0.1)
    assert frustum.max_visible_cells == round(4 / 3 * math.pi * (1000 - 8) / 6)
    rng = np.random.default_rng(2)
    default = Frustum.from_camera(DepthCamera(), 0.1)
    assert default.max_visible_cells == pytest.approx(55441)
    counts = []
    for _ in range(5):
        R = rotation(*rng.uniform(-np.pi, np.pi, 3))
        counts.append(runs_of(default, (130,) * 3, rng.uniform(64, 66, 3), R)[0].length.sum())
    assert counts == pytest.approx([default.max_visible_cells] * 5, rel=5e-3)


def test_depth_buffer_pixels_are_square_enough_and_look_through_their_middle():
    frustum = Frustum.from_camera(DepthCamera(), 0.1)
    assert frustum.pixels == (24, 18)
    assert frustum.far == pytest.approx(60)
    d = frustum.directions.reshape(24, 18, 3)
    assert np.linalg.norm(d, axis=-1) == pytest.approx(np.ones((24, 18)))
    # pixels are counted from the right and from below
    assert d[0, 0, 1] < 0
    assert d[0, 0, 2] < 0
    edge = math.tan(math.radians(30))
    assert d[-1, 0, 1] / d[-1, 0, 0] == pytest.approx(edge * (1 - 1 / 24))


def test_a_camera_without_a_blind_zone_never_meets_a_depth_of_zero():
    frustum = Frustum.from_camera(NARROW, 0.1)
    center = np.array([5.5, 5.5, 5.5])
    runs, _ = runs_of(frustum, (11, 11, 11), center, np.eye(3))
    assert len(runs.x)
    assert (runs.x > 0).all()
