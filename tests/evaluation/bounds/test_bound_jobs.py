"""Bounds of many worlds, with their certificates in a folder."""

import numpy as np
import pytest

from coopmap_env import planar_v1
from coopmap_env.cli.evaluate import Evaluate
from coopmap_env.evaluation import make_env
from coopmap_env.evaluation.bounds import (
    BoundFileError,
    Certificate,
    PlanarViews,
    bound_shown,
    bound_worlds,
    load_bound,
    save_bound,
)

SCENE = {"name": "obstacles", "shape": [32, 32], "side_min": 3.0, "side_max": 7.0}
TASK = {"scene": SCENE, "max_scans": 3, "split": "train"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bounds")
    bound_worlds([4, 5], TASK, folder, progress=False)
    return folder


def test_bounds_and_certificates_are_kept_and_checked(folder):
    found_before = bound_worlds([5, 4], TASK, folder, progress=False)
    assert len(list(folder.glob("*.npz"))) == 2
    assert [len(own.bounds) for own in found_before] == [4, 4]
    assert all(own.cpu_seconds > 0 for own in found_before)
    env = make_env("planar", TASK, None)
    for seed, own in zip([5, 4], found_before, strict=True):
        env.reset(seed=seed)
        views = PlanarViews.from_env(env, 3)
        found = load_bound(folder / f"{views.digest[:16]}.npz", views)
        np.testing.assert_array_equal(found.bounds, own.bounds)
        np.testing.assert_array_equal(found.choice_shown, own.choice_shown)
        assert own.gap == found.gap


def test_a_bound_is_found_again_from_its_file_alone_which_is_checked(folder, tmp_path):
    for path in folder.glob("*.npz"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (again,) = bound_worlds([4], TASK, tmp_path, progress=False)
    (expected,) = bound_worlds([4], TASK, folder, progress=False)
    np.testing.assert_array_equal(again.bounds, expected.bounds)
    assert np.isnan(again.cpu_seconds)  # not searched here
    for path in tmp_path.glob("*.npz"):
        path.write_bytes(b"broken")
    with pytest.raises(BoundFileError):
        bound_worlds([5], TASK, tmp_path, progress=False)


def test_a_bound_of_fewer_scans_is_refused(tmp_path):
    env = make_env("planar", TASK, None)
    env.reset(seed=4)
    views = PlanarViews.from_env(env, 3)
    save_bound(tmp_path / f"{views.digest[:16]}.npz", bound_shown(views, 2), views)
    with pytest.raises(BoundFileError, match="bounds of 2 scans, not 3"):
        bound_worlds([4], TASK, tmp_path, progress=False)


def test_weights_that_are_no_integers_are_no_certificate():
    env = make_env("planar", TASK, None)
    env.reset(seed=4)
    views = PlanarViews.from_env(env, 3)
    for weights in (np.full(1024, np.nan), np.ones(1024)):
        with pytest.raises(ValueError, match="got float64"):
            Certificate(weights).bounds(views, 3)


@pytest.mark.parametrize(
    "damaged",
    [
        '{"bounds": [3, 2], "choice_shown": [3, 2], "cpu_seconds": null}',
        '{"bounds": [2, 3], "choice_shown": [3], "cpu_seconds": null}',
        '{"bounds": [2, 3], "choice_shown": [2, 3], "cpu_seconds": "long"}',
        '{"bounds": [2, 3], "choice_shown": [2, 3]}',
    ],
)
def test_a_damaged_result_is_found_again(folder, damaged):
    expected = bound_worlds([4, 5], TASK, folder, progress=False)
    for path in (folder / "jobs").glob("*.json"):
        path.write_text(damaged)
    for own, other in zip(
        expected, bound_worlds([4, 5], TASK, folder, progress=False), strict=True
    ):
        np.testing.assert_array_equal(own.bounds, other.bounds)


def test_time_bounds_the_number_of_scans(tmp_path):
    task = {**TASK, "max_scans": 50, "max_time": 7.0}  # 2 s each by default
    (found,) = bound_worlds([0], task, tmp_path, progress=False)
    assert len(found.bounds) == 5
    assert planar_v1.PlanarSettings().scan_time == 2.0


def test_evaluate_adds_efficiencies(tmp_path, capsys):
    options = Evaluate(
        out=tmp_path, policies="coverage:search=20,random", episodes=2, max_scans=2, scene="rooms",
        efficiency=True, split="train",
    )  # fmt: skip
    options.run()
    header, *rows = (tmp_path / "episodes.csv").read_text().splitlines()
    assert header.endswith("shown,shown_auc,efficiency,efficiency_auc")
    for row in rows:
        assert 0 < float(row.split(",")[-1]) <= 1
    assert "efficiency" in capsys.readouterr().out
    assert len(list((tmp_path / "bounds").glob("*.npz"))) == 2


def test_the_field_has_no_bound_yet(tmp_path):
    with pytest.raises(ValueError, match="--efficiency needs bounds, which only planar worlds"):
        Evaluate(out=tmp_path, env="field", efficiency=True).run()
