"""Bounds in files: what is read is what was written, and follows from its certificates."""

from dataclasses import replace

import numpy as np
import pytest
from plain.small_worlds import SETTINGS, small_world

from coopmap_env.core.array_files import read_arrays, write_arrays
from coopmap_env.evaluation.bounds import (
    BoundFileError,
    BoundSearch,
    PlanarViews,
    bound_shown,
    load_bound,
    save_bound,
)
from coopmap_env.evaluation.bounds.stored import ARRAYS, TEXTS
from coopmap_env.sensing import PlanarCamera


def make_views(seed=0, n_scans=4, **arguments):
    env = small_world(max_scans=n_scans, **arguments)
    env.reset(seed=seed)
    return PlanarViews.from_env(env)


@pytest.fixture(scope="module")
def views():
    return make_views()


@pytest.fixture(scope="module")
def found(views):
    return bound_shown(views, 4, BoundSearch(n_rounds=4, n_exchanges=100))


@pytest.fixture
def path(tmp_path, views, found):
    save_bound(tmp_path / "bound.npz", found, views)
    return tmp_path / "bound.npz"


def tamper(path, **changed):
    arrays = read_arrays(path, (*TEXTS, *ARRAYS))
    write_arrays(path, arrays | {name: np.array(value) for name, value in changed.items()})


def test_a_bound_is_read_as_it_was_written(path, views, found):
    again = load_bound(path, make_views())
    for name in ("bounds", "choice", "choice_shown"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))
    np.testing.assert_array_equal(
        [one.weights for one in again.certificates], [one.weights for one in found.certificates]
    )
    assert again.search == found.search
    assert again.gap == found.gap
    assert [file.name for file in path.parent.iterdir()] == ["bound.npz"]


def test_a_bound_of_fewer_scans_than_the_views_is_read(tmp_path, views):
    short = bound_shown(views, 2, BoundSearch(n_rounds=1, n_exchanges=10))
    save_bound(tmp_path / "short.npz", short, views)
    assert len(load_bound(tmp_path / "short.npz", views).bounds) == 3


@pytest.mark.parametrize(
    "arguments",
    [
        {"seed": 1},
        {"n_scans": 5},
        {"n_robots": 3},
        {"settings": replace(SETTINGS, reach=5.0)},
        {"settings": replace(SETTINGS, initial_free_radius=2.0)},
        {"settings": replace(SETTINGS, camera=PlanarCamera(depth_of_field=6.0, n_beams=17))},
        {"settings": replace(SETTINGS, camera=PlanarCamera(depth_of_field=5.0, n_beams=16))},
    ],
)
def test_a_bound_of_another_world_is_refused(path, arguments):
    with pytest.raises(BoundFileError, match=r"bound\.npz belongs to another world, or to other"):
        load_bound(path, make_views(**arguments))


def test_each_bit_of_the_world_counts(path, views):
    occupied = views.occupied.copy()
    occupied[0, 0] ^= True
    assert replace(views, occupied=occupied).digest != views.digest
    known = views.known.copy()
    known[5] ^= True
    assert replace(views, known=known).digest != views.digest


def test_what_does_not_follow_from_the_certificates_is_refused(path, views, found):
    lower = found.bounds.copy()
    lower[-1] -= 1
    tamper(path, bounds=lower)
    with pytest.raises(BoundFileError, match=r"bound\.npz: bounds \[.*follow from the certif"):
        load_bound(path, views)
    with pytest.raises(ValueError, match=r"bounds \[.*follow from the certificates"):
        save_bound(path, found._replace(bounds=lower), views)


@pytest.mark.parametrize("seed", range(5))
def test_other_weights_give_other_bounds(path, views, found, seed):
    """Whatever the weights are, the bounds hold; these are not those of the search."""
    weights = np.array([one.weights for one in found.certificates])
    rng = np.random.default_rng(seed)
    weights[:, rng.random(weights.shape[1]) < 0.3] = 0
    tamper(path, weights=weights)
    with pytest.raises(BoundFileError, match="follow from the certificates"):
        load_bound(path, views)


def test_a_choice_that_is_not_possible_or_shows_something_else_is_refused(path, views, found):
    tamper(path, choice_shown=found.choice_shown + 1)
    with pytest.raises(BoundFileError, match=r"choice_shown .* are shown"):
        load_bound(path, views)
    save_bound(path, found, views)
    choice = found.choice.copy()
    choice[0, 0] = views.cells[views.earliest[0] > 1][0] * views.n_headings
    tamper(path, choice=choice)
    with pytest.raises(BoundFileError, match="where robots cannot be at their scans"):
        load_bound(path, views)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"format": "coopmap map 1"}, "is of format 'coopmap map 1', not 'coopmap bound 1'"),
        ({"search": "{"}, "Expecting property name"),
        ({"search": "[]"}, "BoundSearch must be a mapping"),
        ({"search": '{"n_rounds": -1, "n_exchanges": 1, "tolerance": 0}'}, "BoundSearch.n_rounds"),
        ({"bounds": [1.0, 2.0]}, "bounds must be an array of int64 with 1 axes, got .*float64"),
        ({"bounds": np.zeros(0, np.int64)}, "n_scans must be an integer of at least 1"),
        ({"bounds": np.zeros(500, np.int64)}, "were made for 4 scans"),
        ({"choice": np.zeros((3, 2), np.int64)}, r"of shape \(4, 2\), got \(3, 2\)"),
        ({"weights": np.zeros(576, np.uint16)}, "weights must be .* with 2 axes"),
        ({"weights": np.zeros((0, 576), np.uint16)}, "at least one certificate"),
        ({"weights": np.zeros((1, 575), np.uint16)}, "needs 576 weights"),
        ({"weights": np.full((1, 576), 5_000, np.uint16)}, "from 0 to 5000"),
    ],
)
def test_a_broken_file_is_refused(path, views, changed, message):
    tamper(path, **changed)
    with pytest.raises(BoundFileError, match=message):
        load_bound(path, views)


def test_a_cut_missing_or_other_file_is_refused(path, views):
    content = path.read_bytes()
    for length in range(0, len(content), len(content) // 12):
        path.write_bytes(content[:length])
        with pytest.raises(BoundFileError, match=r"bound\.npz"):
            load_bound(path, views)
    with pytest.raises(BoundFileError, match="there is no such file"):
        load_bound(path.parent / "none.npz", views)


def test_a_pickle_is_not_run(path, views):
    arrays = read_arrays(path, (*TEXTS, *ARRAYS))
    np.savez(path, **(arrays | {"choice": np.array([print], dtype=object)}))
    with pytest.raises(BoundFileError, match=r"choice\.npy is broken"):
        load_bound(path, views)
