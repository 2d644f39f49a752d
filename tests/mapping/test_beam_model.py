"""The inverse sensor model: occupancies of the cells that one beam crosses."""

import math
from dataclasses import replace

import numpy as np
import pytest
from plain import fusion
from scipy.stats import norm

from coopmap_env.mapping import BeamModel, beam_occupancy, to_log_odds_fixed
from coopmap_env.mapping.beam import beam_log_odds_fixed, endpoint_posterior

ENTRY, ANYWHERE = BeamModel(surface="entry"), BeamModel(surface="anywhere")
READINGS = pytest.mark.parametrize("model", [ENTRY, ANYWHERE], ids=["entry", "anywhere"])

ROUNDING = 1e-9
"""The error function is good to 1e-16, and is divided by intervals of down to 1e-6 sigma."""


def weights(entries, exits, z, sigma, model):
    w = np.empty(len(entries))
    best = endpoint_posterior(
        np.asarray(entries, float),
        np.asarray(exits, float),
        len(w),
        z,
        sigma,
        model.surface_at_entry,
        w,
    )
    return w, best


def random_beams(rng, n):
    """Faces of a random walk through a grid, some of no length, and an observation of it."""
    for _ in range(n):
        steps = rng.uniform(0, 1.5, rng.integers(1, 25)) * (rng.random() < 0.9)
        steps[rng.random(len(steps)) < 0.15] = 0.0
        faces = np.concatenate([[0.0], np.cumsum(steps + 1e-12)])
        z = rng.uniform(0, faces[-1])
        yield faces[:-1], faces[1:], z, 10 ** rng.uniform(-2, 0.7)


def test_three_cells_with_surfaces_at_their_entry_by_hand():
    # priors 1, 1/2, 1/4; z is 1, 0, 1 sigma from the faces: likelihoods e^-1/2, 1, e^-1/2
    side = math.exp(-0.5)
    total = side + 0.5 + 0.25 * side
    w, best = weights([0, 1, 2], [1, 2, 3], 1.0, 1.0, ENTRY)
    assert w == pytest.approx([side / total, 0.5 / total, 0.25 * side / total])
    assert w == pytest.approx([0.48208, 0.39741, 0.12052], abs=1e-5)
    assert best == 1  # the likeliest cell, whatever the prior
    occupied = beam_occupancy([0, 1, 2], [1, 2, 3], 1.0, 1.0, ENTRY)
    assert occupied == pytest.approx([0.48208, 0.63845, 0.56026], abs=2e-5)


def test_three_cells_with_surfaces_anywhere_by_hand():
    # z in the middle: masses 0.2417, 0.3829, 0.2417 of the normal distribution
    w, best = weights([0, 1, 2], [1, 2, 3], 1.5, 1.0, ANYWHERE)
    assert w == pytest.approx([0.48971, 0.38787, 0.12242], abs=1e-5)
    assert best == 1
    occupied = beam_occupancy([0, 1, 2], [1, 2, 3], 1.5, 1.0, ANYWHERE)
    assert occupied == pytest.approx([0.48971, 0.63272, 0.56121], abs=2e-5)


@READINGS
def test_a_sharp_beam_is_free_before_occupied_at_and_one_half_behind_the_surface(model):
    entries = np.arange(6.0)
    z = 3.0 if model.surface_at_entry else 3.5
    occupied = beam_occupancy(entries, entries + 1, z, 0.05, model)
    # the next faces are at least ten sigma away
    assert occupied == pytest.approx([0, 0, 0, 1, 0.5, 0.5], abs=1e-12)


@READINGS
def test_a_blurred_beam_rises_from_free_to_the_surface_and_falls_to_one_half(model):
    entries = np.arange(12.0)
    occupied = beam_occupancy(entries, entries + 1, 5.4, 0.6, model)
    peak = int(np.argmax(occupied))
    assert peak == 5
    assert (np.diff(occupied[: peak + 1]) > 0).all()
    assert occupied[0] < 1e-9
    assert 0.5 < occupied[peak + 1] < occupied[peak]
    assert occupied[-1] == pytest.approx(0.5, abs=1e-9)


@READINGS
def test_the_kernel_is_the_plain_sum(model):
    rng = np.random.default_rng(0)
    for entries, exits, z, sigma in random_beams(rng, 300):
        wide = exits - entries > 1e-6
        entries, exits = entries[wide], exits[wide]
        if len(entries) == 0:
            continue
        plain = fusion.occupancies(list(zip(entries, exits, strict=True)), z, sigma, model.surface)
        assert beam_occupancy(entries, exits, z, sigma, model) == pytest.approx(plain, abs=1e-8)


@READINGS
def test_cells_behind_the_surface_have_the_probability_of_the_model(model):
    """Hand numbers: a sharp beam; and the plain sum of random beams."""
    thick = replace(model, behind=0.93)
    entries = np.arange(6.0)
    occupied = beam_occupancy(entries, entries + 1, 3.0 if model is ENTRY else 3.5, 0.05, thick)
    assert occupied == pytest.approx([0, 0, 0, 1, 0.93, 0.93], abs=1e-12)
    for entries, exits, z, sigma in random_beams(np.random.default_rng(3), 300):
        wide = exits - entries > 1e-6
        intervals = list(zip(entries[wide], exits[wide], strict=True))
        if intervals:
            plain = fusion.occupancies(intervals, z, sigma, model.surface, 0.93)
            found = beam_occupancy(entries[wide], exits[wide], z, sigma, thick)
            assert found == pytest.approx(plain, abs=1e-8)


@READINGS
def test_the_thicker_obstacles_are_the_more_probable_is_every_cell(model):
    for entries, exits, z, sigma in random_beams(np.random.default_rng(4), 300):
        lower, higher = (
            beam_occupancy(entries, exits, z, sigma, replace(model, behind=behind))
            for behind in (0.5, 0.9)
        )
        assert (higher >= lower).all()
        assert (higher <= 1 + ROUNDING).all()


@READINGS
def test_end_probabilities_sum_to_one_and_the_best_has_the_largest_without_the_prior(model):
    for entries, exits, z, sigma in random_beams(np.random.default_rng(1), 300):
        w, best = weights(entries, exits, z, sigma, model)
        assert w.sum() == pytest.approx(1)
        assert (w >= 0).all()
        likelihood = w * 2.0 ** np.arange(len(w))
        assert likelihood[best] == pytest.approx(likelihood.max())


@READINGS
def test_a_cell_that_lies_wholly_behind_the_observation_is_never_below_one_half(model):
    """Behind z the w_k at least halve from cell to cell, so w_k is no less than all after it."""
    for entries, exits, z, sigma in random_beams(np.random.default_rng(2), 2000):
        occupied = beam_occupancy(entries, exits, z, sigma, model)
        assert (occupied[entries >= z] >= 0.5 - ROUNDING).all()
        assert (occupied <= 1 + ROUNDING).all()


def test_a_corner_crossed_with_no_length_gets_the_likelihood_of_the_cells_around_it():
    entries, exits = [0, 1, 2, 2, 3], [1, 2, 2, 3, 4]
    corner = beam_occupancy(entries, exits, 1.9, 0.5, ANYWHERE)
    almost = beam_occupancy(entries, [1, 2, 2 + 1e-5, 3, 4], 1.9, 0.5, ANYWHERE)
    assert corner == pytest.approx(almost, abs=1e-4)
    assert corner[2] > 0.5


@READINGS
@pytest.mark.parametrize("z", [0.3, 2.25, 2.75, 3.9])
def test_a_certainty_that_no_face_explains_goes_to_the_nearest_or_holding_cell(model, z):
    entries = np.arange(5.0)
    w, best = weights(entries, entries + 1, z, 1e-4, model)
    assert best == int(z)
    assert w.tolist() == [float(k == best) for k in range(5)]


def test_the_prior_doubles_the_odds_of_the_nearer_of_two_cells():
    entries = np.arange(6.0)
    for z in (2.0, 3.3):
        w, _ = weights(entries, entries + 1, z, 1.0, ANYWHERE)
        masses = np.diff(norm.cdf(np.arange(7.0), z, 1.0))
        flat = w * 2.0 ** np.arange(6)
        assert flat / flat.sum() == pytest.approx(masses / masses.sum())


def test_for_three_sigma_cells_it_is_the_closed_form_of_loop_et_al_but_for_the_prior():
    """P(s) = F(s) - F(s - 3) / 2 (Loop et al. 2016), s being the far face in sigma behind z.

    With a prior that is flat over the cells, P_k = mass of cell k + half of the mass before it =
    F(far) - F(near) / 2, and near is three sigma before far: the closed form exactly. The prior
    (1/2)**k of independent cells is what makes our sum different, by up to 0.18.
    """
    faces = 3.0 * np.arange(-6, 8)
    differences = []
    for z in np.linspace(0, 3, 31):
        s = faces[1:] - z
        closed = norm.cdf(s) - norm.cdf(s - 3) / 2
        w, _ = weights(faces[:-1] + 18, faces[1:] + 18, z + 18, 1.0, ANYWHERE)
        flat = w * 2.0 ** np.arange(len(w))
        flat /= flat.sum()
        assert flat + (np.cumsum(flat) - flat) / 2 == pytest.approx(closed, abs=1e-9)
        ours = beam_occupancy(faces[:-1] + 18, faces[1:] + 18, z + 18, 1.0, ANYWHERE)
        differences.append(np.abs(ours - closed).max())
    assert max(differences) < 0.18
    # less where the observation is in the middle of a cell
    assert differences[15] < 0.07


@READINGS
def test_for_fine_cells_it_is_half_a_normal_cdf_moved_toward_the_camera_by_the_prior(model):
    """Not the closed form of Loop et al.: each of many cells had its chance to end the beam.

    2**-k times a Gaussian is a Gaussian moved by sigma^2 ln 2 / h toward the camera, h being the
    length of a cell; single cells weigh next to nothing, so P is half of the mass before. A beam
    through cells much finer than sigma gives "free" far before z and nothing where it ended.
    """
    h, z = 0.15, 25.0
    entries = np.arange(0.0, 35.0, h)
    occupied = beam_occupancy(entries, entries + h, z, 1.0, model)
    moved = 0.5 * norm.cdf(entries - z + math.log(2) / h)
    # the limit leaves out a cell's own weight of at most h / sqrt(2 pi), and where in it z lies
    assert occupied == pytest.approx(moved, abs=0.5 * h)
    assert occupied.max() < 0.5 + h
    closed = norm.cdf(entries - z) - norm.cdf(entries - z - 3) / 2
    assert closed.max() > 0.9


def test_updates_of_a_beam_stay_inside_the_bounds_of_one_scan():
    model = BeamModel(free=0.01, occupied=0.97)
    lowest, highest = model.log_odds_bounds
    assert (lowest, highest) == (to_log_odds_fixed(0.01), to_log_odds_fixed(0.97))
    beam = model.parameters
    assert beam_log_odds_fixed(0.0, 0.0, beam) == lowest
    assert beam_log_odds_fixed(1e-9, 0.0, beam) == lowest
    assert beam_log_odds_fixed(1.0, 0.0, beam) == highest
    assert beam_log_odds_fixed(0.0, 1.0, beam) == 0
    assert beam_log_odds_fixed(0.3, 0.2, beam) == to_log_odds_fixed(0.4)
    thick = replace(model, behind=0.9).parameters
    assert beam_log_odds_fixed(0.0, 1.0, thick) == to_log_odds_fixed(0.9)
    assert beam_log_odds_fixed(0.3, 0.2, thick) == to_log_odds_fixed(0.48)


@pytest.mark.parametrize(
    "arguments",
    [{"free": 0.0}, {"free": 0.5}, {"occupied": 0.5}, {"occupied": 1.0}, {"free": math.nan}],
)
def test_bounds_on_the_wrong_side_of_one_half_are_rejected(arguments):
    (name,) = arguments
    with pytest.raises(ValueError, match=rf"BeamModel\.{name} must be a finite number > .* and < "):
        BeamModel(**arguments)


def test_an_unknown_interpretation_of_the_surface_is_rejected():
    with pytest.raises(ValueError, match="one of 'entry', 'anywhere', 'partial', got 'exit'"):
        BeamModel(surface="exit")


@pytest.mark.parametrize("sigma", [0.0, -1.0, math.nan])
def test_a_beam_without_uncertainty_or_without_faces_is_rejected(sigma):
    with pytest.raises(ValueError, match="sigma"):
        beam_occupancy([0, 1], [1, 2], 0.5, sigma, ENTRY)
    with pytest.raises(ValueError, match="entries"):
        beam_occupancy([0, 1], [1], 0.5, 1.0, ENTRY)
