"""Mutual information between a map in space and the beams of a depth camera."""

import math

import numpy as np
import pytest
from plain import dense_views
from plain.random_maps import set_cells
from plain.random_voxel_map import random_poses, random_voxel_map

from coopmap_env.information import (
    FieldMutualInformation,
    FieldRatingFunction,
    ViewContext,
    entropy,
)
from coopmap_env.information._mutual_information import MIN_REACH_PROBABILITY
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.sensing import DepthCamera

SMALL = DepthCamera(far=1.5)
BEAM = DepthCamera(0.01, 0.01, near=0.0, far=3.0)
"""A single pixel whose ray follows a row of voxels."""


def information_of(map_, camera, **kwargs):
    return FieldMutualInformation(FieldRatingFunction(camera, map_.grid), **kwargs)


def row(*probabilities):
    """A row along x behind the voxel of the camera, with these probabilities; None is unknown."""
    map_ = OccupancyMap(VoxelGrid((len(probabilities) + 1, 1, 1), 0.1))
    set_cells(map_, 0, 0.001)
    for k, p in enumerate(probabilities):
        if p is not None:
            set_cells(map_, k + 1, p)
    return map_


def one_beam(map_, **kwargs):
    # the center of the camera's own voxel lies behind it
    information = information_of(map_, BEAM, **kwargs)
    (value,) = information.mutual_information(map_, ([np.eye(3)], [[0.06, 0.05, 0.05]]))
    return float(value)


def test_a_beam_through_unknown_voxels_by_hand():
    # the first one for certain, then with chances 1/2 and 1/4
    assert one_beam(row(None, None, None)) == pytest.approx(1.75 * math.log(2))


def test_the_information_of_a_beam_is_the_entropy_of_the_first_occupied_voxel():
    p = [0.1, 0.3, 0.6, 0.2]
    reading, passed = [], 1.0
    for q in p:
        reading.append(passed * q)
        passed *= 1 - q
    # a level is 1 / 1024 nat
    assert one_beam(row(*p)) == pytest.approx(entropy([*reading, passed]), rel=1e-3)


def test_the_prior_is_that_of_unknown_voxels_and_known_ones_count_for_nothing():
    h = entropy([0.1, 0.9])
    assert one_beam(row(None, None), prior=0.1) == pytest.approx(1.9 * h, rel=1e-6)
    residue = entropy([0.999, 0.001])
    value = one_beam(row(0.001, None), prior=0.1, known_probability=0.999)
    assert value == pytest.approx(0.999 * (h - residue), rel=1e-4)


@pytest.mark.parametrize("camera", [SMALL, DepthCamera(1.9, 1.6, near=0.1, far=0.9)])
def test_a_view_is_the_plain_sum_over_its_voxels(camera):
    rng = np.random.default_rng(0)
    map_ = random_voxel_map(rng, (22, 18, 15), 6, 3)
    information, prior = information_of(map_, camera, prior=0.2), 0.2
    frustum = FieldRatingFunction(camera, map_.grid).fine.frustum
    p = np.where(map_.sampled, map_.probability, prior)
    h = np.array([entropy([q, 1 - q]) for q in p.ravel()])
    reserved_mask = (rng.random(map_.grid.n_cells) < 0.2).astype(np.uint8)
    R, t = random_poses(rng, map_, 5, any_orientation=True)
    occluder_spheres = (t.mean(axis=0) + rng.normal(0, 0.3, (3, 3)), np.array([0.2, 0.1, 0.15]))
    found = information.mutual_information(
        map_, (R, t), ViewContext(occluder_spheres=occluder_spheres)
    )
    rest = information.mutual_information(
        map_, (R, t), ViewContext(reserved_mask, occluder_spheres)
    )
    cells = dense_views.all_cells(map_.grid.shape)
    spheres = list(
        zip(map_.grid.to_cell_units(occluder_spheres[0]), occluder_spheres[1] / 0.1, strict=True)
    )
    for k in range(5):
        position = map_.grid.to_cell_units(t[k])
        depth, u, v, _, inside = dense_views.in_frustum(cells, position, R[k], frustum)
        curves = {}
        for pixel in {*zip(u[inside].tolist(), v[inside].tolist(), strict=True)}:
            direction, forward = dense_views.ray(*pixel, R[k], frustum)
            blocked = dense_views.sphere_distance(position, direction, spheres)
            curves[pixel] = dense_views.visibility_probabilities(
                p, position, direction, forward, frustum, MIN_REACH_PROBABILITY, blocked
            )
        terms = np.zeros(len(cells))
        for cell in np.flatnonzero(inside):
            terms[cell] = curves[u[cell], v[cell]][int(2 * depth[cell])] * h[cell]
        # chances are kept in single precision
        assert found[k] == pytest.approx(terms.sum(), rel=1e-5)
        assert rest[k] == pytest.approx(terms[reserved_mask == 0].sum(), rel=1e-5)
    assert len(set(found)) == 5


def test_a_wall_hides_what_is_behind():
    map_ = OccupancyMap(VoxelGrid((31, 31, 31), 0.1))
    information = information_of(map_, SMALL, prior=0.05)
    pose = [np.eye(3)], [[1.53, 1.52, 1.51]]
    (whole,) = information.mutual_information(map_, pose)
    cells = np.arange(map_.grid.n_cells).reshape(map_.grid.shape)
    set_cells(map_, cells[22].ravel(), 0.999)
    (near,) = information.mutual_information(map_, pose)
    set_cells(map_, cells[23:].ravel(), 0.5)
    (filled,) = information.mutual_information(map_, pose)
    assert near < 0.3 * whole
    # nothing but a thousandth passes the wall
    assert filled == pytest.approx(near, rel=1e-2)


def test_the_pooled_map_ranks_views_alike():
    rng = np.random.default_rng(1)
    map_ = random_voxel_map(rng, (64, 64, 32), 12, 4)
    information = information_of(map_, DepthCamera(far=4.0), prior=0.12, known_probability=0.999)
    R, t = random_poses(rng, map_, 60)
    fine = information.mutual_information(map_, (R, t))
    coarse = information.mutual_information(map_, (R, t), ViewContext(coarse=True))
    assert np.corrcoef(fine, coarse)[0, 1] > 0.95


def test_a_camera_outside_the_grid_learns_nothing():
    map_ = OccupancyMap(VoxelGrid((31, 31, 31), 0.1))
    information = information_of(map_, SMALL)
    assert information.mutual_information(map_, ([np.eye(3)], [[-0.1, 1.5, 1.5]])) == 0


@pytest.mark.parametrize(("prior", "known"), [(0.0, 1.0), (1.0, 1.0), (0.5, 0.5), (0.5, 1.1)])
def test_expectations_that_are_no_probabilities_are_refused(prior, known):
    with pytest.raises(ValueError, match="must lie in"):
        information_of(
            OccupancyMap(VoxelGrid((5, 5, 5))), SMALL, prior=prior, known_probability=known
        )
