"""Eq. 7 with hidden="empty": what a view does not count is known and empty. Both worlds."""

import math

import numpy as np
import pytest
from plain import dense_views, views
from plain.random_maps import random_map, set_cells
from plain.random_voxel_map import random_poses, random_voxel_map

from coopmap_env.information import (
    FieldRatingFunction,
    FieldRatingSettings,
    PlanarRatingFunction,
    PlanarRatingSettings,
    ViewContext,
    entropy,
)
from coopmap_env.mapping import to_log_odds_fixed
from coopmap_env.robots import PoseLattice
from coopmap_env.sensing import DepthCamera, PlanarCamera

PLANAR_CAMERA = PlanarCamera(depth_of_field=7.0)
FIELD_CAMERA = DepthCamera(far=1.5)


class Plane:
    """Random planar maps and their views; a view is the id of a pose."""

    n_maps = 30

    def random_map(self, rng):
        return random_map(rng, (21, 15), rng.uniform(0, 0.6), rng.uniform(0, 0.1))

    def rating(self, map_, **settings):
        constants, lattice = PlanarRatingSettings(**settings), PoseLattice(map_.grid, 16)
        return PlanarRatingFunction(PLANAR_CAMERA, lattice, constants, map_.log_odds_range)

    def random_views(self, rng, map_, n):
        return rng.integers(0, 16 * map_.grid.n_cells, n).tolist()

    def new_information(self, rating, map_, view, **context):
        return float(rating.new_information(map_, [view], ViewContext(**context))[0])

    def distances(self, rating, map_, view):
        """Cells in view and their distances from the camera, cells."""
        visible, here = rating.visible_cells(map_, view), view // 16
        ny = map_.grid.shape[1]
        return visible, np.hypot(visible // ny - here // ny, visible % ny - here % ny)

    def histogram(self, rating, map_, view, cells):
        cells = [divmod(int(cell), map_.grid.shape[1]) for cell in cells]
        args = PLANAR_CAMERA, rating.lattice, view, rating.settings, cells
        return views.gray_histogram(map_, *args)

    def occlude(self, rng, rating, map_, view):
        """Cells in view if one of the occupied ones hides nothing, those in view, and NI."""
        visible = rating.visible_cells(map_, view)
        occupied = visible[map_.sampled_mask[visible] * (map_.log_odds_fixed[visible] >= 0) == 1]
        if not len(occupied):
            return visible, visible, self.new_information(rating, map_, view)
        occluder = divmod(int(rng.choice(occupied)), map_.grid.shape[1])
        before = views.visible_cells(map_, PLANAR_CAMERA, rating.lattice, view, [occluder])
        flat = np.array([x * map_.grid.shape[1] + y for x, y in before])
        return flat, visible, self.new_information(rating, map_, view)


class Space:
    """Random maps and views in space; a view is a rotation and a translation."""

    n_maps = 16

    def random_map(self, rng):
        return random_voxel_map(rng, (22, 18, 15), 6, int(rng.integers(2, 40)))

    def rating(self, map_, **settings):
        constants = FieldRatingSettings(**settings)
        return FieldRatingFunction(FIELD_CAMERA, map_.grid, constants, map_.log_odds_range)

    def random_views(self, rng, map_, n):
        return list(zip(*random_poses(rng, map_, n), strict=True))

    def new_information(self, rating, map_, view, **context):
        poses = view[0][None], view[1][None]
        return float(rating.new_information(map_, poses, ViewContext(**context))[0])

    def distances(self, rating, map_, view):
        """Voxels in view and their distances from the camera, voxels."""
        visible = rating.visible_cells(map_, view)
        centers = np.array(np.unravel_index(visible, map_.grid.shape)).T + 0.5
        offset = centers - map_.grid.to_cell_units(view[1])
        return visible, np.sqrt((offset**2).sum(axis=1))

    def histogram(self, rating, map_, view, cells):
        centers = np.array(np.unravel_index(cells, map_.grid.shape)).T + 0.5
        distance = np.full(map_.grid.n_cells, math.nan)
        offset = centers - map_.grid.to_cell_units(view[1])
        distance[cells] = np.sqrt((offset**2).sum(axis=1))
        seen, far = np.isfinite(distance), rating.fine.frustum.far
        return dense_views.gray_histogram(map_, seen, distance, rating.settings, far)

    def occlude(self, rng, rating, map_, view):
        """Voxels in view without a ball in front of the camera, those with it, and NI with it."""
        R, t = view
        ball = (t + R[:, 0] * rng.uniform(0.3, 1.2))[None], np.array([rng.uniform(0.05, 0.2)])
        before = rating.visible_cells(map_, view)
        after = rating.visible_cells(map_, view, ViewContext(occluder_spheres=ball))
        return before, after, self.new_information(rating, map_, view, occluder_spheres=ball)


WORLDS = pytest.mark.parametrize("world", [Plane(), Space()], ids=["planar", "field"])


def with_rest(counts, n):
    """A histogram in which everything else of N is empty."""
    return np.array([n - sum(counts[1:]), *counts[1:]])


@WORLDS
def test_a_known_map_pays_for_the_surfaces_in_view_and_not_for_what_they_hide_eq_7(world):
    """Empty and occupied cells are two events, however much of the view is hidden."""
    rng = np.random.default_rng(0)
    fractions, printed = [], []
    map_ = world.random_map(rng)
    rating, as_printed = world.rating(map_), world.rating(map_, hidden="printed")
    for _ in range(world.n_maps):
        map_ = world.random_map(rng)
        occupied = (map_.log_odds_fixed >= 0) & (map_.sampled_mask == 1)
        map_.log_odds_fixed[:] = np.where(occupied, 1, -1) * map_.log_odds_range.clamp
        map_.sampled_mask[:] = 1
        for view in world.random_views(rng, map_, 10):
            visible = rating.visible_cells(map_, view)
            q = occupied[visible].sum() / rating.max_visible_cells
            found = world.new_information(rating, map_, view)
            assert found == pytest.approx(entropy([q, 1 - q]), abs=1e-12)
            # of a view with only empty voxels nothing at all is left
            surfaces = np.zeros(map_.grid.n_cells, dtype=np.uint8)
            surfaces[visible[occupied[visible]]] = 1
            assert world.new_information(rating, map_, view, reserved_mask=surfaces) == 0
            printed.append(world.new_information(as_printed, map_, view, reserved_mask=surfaces))
            fractions.append(len(visible) / rating.max_visible_cells)
    assert min(fractions) < 0.3
    assert np.mean(printed) > 0.1


def cannot_raise(full, seen):
    """Whether no bin of a hidden voxel keeps more voxels than were empty, if it keeps any."""
    kept = seen[1:][full[1:] != seen[1:]]
    return bool((kept <= full[0]).all())


def play_occlusions(world, rng):
    """Histograms without and with an occluder, whether what it hides is known, and NI of both."""
    rating = world.rating(world.random_map(rng))
    n = rating.max_visible_cells
    for _ in range(world.n_maps):
        map_ = world.random_map(rng)
        for view in world.random_views(rng, map_, 10):
            before, after, ni_after = world.occlude(rng, rating, map_, view)
            full, seen = (
                with_rest(world.histogram(rating, map_, view, cells), n)
                for cells in (before, after)
            )
            hidden = np.setdiff1d(before, after)
            assert not len(np.setdiff1d(after, before))
            ni_before = views.histogram_entropy(full.tolist(), n, "empty")
            yield full, seen, map_.sampled_mask[hidden], ni_before, ni_after


@WORLDS
def test_what_hides_known_voxels_never_raises_new_information_eq_7(world):
    """The same map and pose, with and without the occlusion.

    What is hidden moves to the empty bin. Two bins of a given sum have the less entropy, the
    further apart they are: so NI cannot rise if no bin of a hidden voxel keeps more voxels than
    there were empty ones, or if it keeps none. Known voxels are mostly empty, so this always holds
    for them here. It fails where one gray level fills a view with next to nothing empty.
    """
    rng = np.random.default_rng(1)
    n_known, n_unknown, n_raised = 0, 0, 0
    for full, seen, known, before, after in play_occlusions(world, rng):
        if not len(known):
            assert after == pytest.approx(before, abs=1e-12)
            continue
        if cannot_raise(full, seen) or known.all():
            assert after <= before + 1e-12
        n_known += bool(known.all())
        n_unknown += not known.all()
        n_raised += after > before + 1e-12
    assert n_known > 15
    assert n_unknown > 60
    assert n_raised <= 0.01 * n_unknown  # 0.4 % were measured


def test_hiding_any_voxels_of_any_histogram_never_raises_its_entropy_if_enough_are_empty_eq_7():
    rng = np.random.default_rng(3)
    raised = {True: 0, False: 0}
    for _ in range(3000):
        full = rng.integers(0, 30, 6) * (rng.random(6) < 0.7)
        hidden = rng.binomial(full, rng.random()) * (rng.random(6) < 0.5)
        seen = full - hidden
        seen[0] += hidden.sum()
        before, after = (
            views.histogram_entropy(h.tolist(), max(full.sum(), 1), "empty") for h in (full, seen)
        )
        raised[cannot_raise(full, seen)] += after > before + 1e-12
    assert raised[True] == 0
    assert raised[False] > 100


@WORLDS
def test_voxels_that_are_known_with_doubt_bring_more_once_a_half_of_them_is_reserved_eq_7(world):
    """The limit of the above: with p = 0.3 everywhere, the reserved half is the other event."""
    rng = np.random.default_rng(5)
    map_ = world.random_map(rng)
    rating, n_raised = world.rating(map_), 0
    map_.mark_free(np.arange(map_.grid.n_cells))
    map_.log_odds_fixed[:] = to_log_odds_fixed(0.3)
    for view in world.random_views(rng, map_, 10):
        visible = rating.visible_cells(map_, view)
        q = len(visible) / rating.max_visible_cells
        reserved = np.zeros(map_.grid.n_cells, dtype=np.uint8)
        reserved[visible[: len(visible) // 2]] = 1
        kept = (len(visible) - len(visible) // 2) / rating.max_visible_cells
        full = world.new_information(rating, map_, view)
        half = world.new_information(rating, map_, view, reserved_mask=reserved)
        assert full == pytest.approx(entropy([q, 1 - q]), abs=1e-12)
        assert half == pytest.approx(entropy([kept, 1 - kept]), abs=1e-12)
        n_raised += half > full
    assert n_raised > 0


def test_the_first_empty_voxels_raise_the_information_of_a_view_that_is_all_unknown_eq_7():
    """Eq. 6 is the entropy of a histogram, in which they are a rare event of their own."""
    assert views.histogram_entropy([0, 0, 50, 50], 100, "empty") == pytest.approx(math.log(2))
    assert views.histogram_entropy([0, 0, 45, 45], 100, "empty") > math.log(2)


@WORLDS
def test_the_more_of_a_view_is_unknown_the_more_it_tells_eq_8b(world):
    """From a known and empty view on, voxel by voxel, until the empty ones are the rarest event."""
    rng = np.random.default_rng(2)
    map_ = world.random_map(rng)
    rating, n_steps = world.rating(map_), 0
    for view in world.random_views(rng, map_, 10):
        map_.clear()
        visible = rng.permutation(rating.visible_cells(map_, view))
        values = []
        for unknown in np.unique(np.linspace(0, len(visible), 12).astype(int)):
            map_.clear()
            map_.mark_free(np.delete(np.arange(map_.grid.n_cells), visible[:unknown]))
            counts = with_rest(
                world.histogram(rating, map_, view, visible), rating.max_visible_cells
            )
            if counts[0] < counts[1:].max():
                break
            values.append(world.new_information(rating, map_, view))
        assert (np.diff(values) > 0).all()
        n_steps += len(values)
    assert n_steps > 60


@WORLDS
def test_doubtful_voxels_count_for_more_than_certain_ones_at_every_distance_eq_8a(world):
    """One voxel near one half counts, one near 0 does not; a spread near one half fills more bins.

    Of occupied voxels each is an event of its own, whatever its p: what tells doubt from certainty
    is how finely p is told apart, four times as finely at one half as at one.
    """
    rng = np.random.default_rng(4)
    map_ = world.random_map(rng)
    rating = world.rating(map_)
    literal = world.rating(map_, interpretation="literal")
    for view in world.random_views(rng, map_, 6):
        map_.clear()
        visible, distances = world.distances(rating, map_, view)

        def information(rating, cells, low, high, view=view):
            map_.mark_free(np.arange(map_.grid.n_cells))
            for cell, p in zip(cells, np.linspace(low, high, len(cells)), strict=True):
                set_cells(map_, cell, p)
            return world.new_information(rating, map_, view)

        for shell in range(1, int(distances.max()) + 1):
            cells = visible[(distances >= shell) & (distances < shell + 1)]
            if not len(cells):
                continue
            one = cells[:1]
            assert information(rating, one, 0.01, 0.01) == 0
            assert information(rating, one, 0.45, 0.45) > 0
            assert (information(literal, one, 0.45, 0.45) > 0) == (shell < 2)
            for certain, doubtful in (((0.01, 0.11), (0.39, 0.49)), ((0.89, 0.99), (0.51, 0.61))):
                values = [information(rating, cells, *spread) for spread in (certain, doubtful)]
                assert values[0] <= values[1]
                assert values[0] < values[1] or len(cells) < 8
