"""Bounds of worlds: searched once, kept, checked when they are read."""

import tempfile

import numpy as np
import pytest
from plain.small_families import with_small_families

from coopmap_env import families
from coopmap_env.core.files import FileError
from coopmap_env.evaluation import make_policy, run_episode
from coopmap_env.evaluation.bounds import (
    BoundFileError,
    BoundSearch,
    PlanarViews,
    bound_shown,
    load_bound,
    save_bound,
    stored,
)
from coopmap_env.studies.leaderboard.play import submit
from coopmap_env.studies.leaderboard.score import score_file
from coopmap_env.studies.leaderboard.world_bounds import episode_efficiency, own_folder


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    options = {"action_mode": "pose", "n_candidates": 32}
    with pytest.MonkeyPatch.context() as patch:
        with_small_families(patch)
        for family in ("tiny", "hasty"):
            submit(family, "frontier", 2, options, folder / f"{family}.json", progress=False)
        yield {family: folder / f"{family}.json" for family in ("tiny", "hasty")}


def stop(*arguments):
    raise AssertionError("a bound was searched again")


@pytest.mark.parametrize("family", ["tiny", "hasty"])
def test_scores_have_efficiencies_and_bounds_are_kept(family, files, tmp_path, monkeypatch):
    bounds = tmp_path / "bounds"
    scored = score_file(files[family], bounds=bounds, progress=False)
    kept = sorted(bounds.iterdir())
    hashes = {episode["world_hash"] for episode in scored.submission["episodes"]}
    assert {path.stem.rpartition("_")[2] for path in kept} == hashes
    for name in ("efficiency", "efficiency_auc"):
        assert 0.1 < scored.scores[name].low <= scored.scores[name].high < 1.0
    monkeypatch.setattr(stored, "bound_shown", stop)
    assert score_file(files[family], bounds=bounds, progress=False).scores == scored.scores


def test_a_bound_that_is_wrong_is_no_fault_of_the_submission(files, tmp_path):
    bounds = tmp_path / "bounds"
    score_file(files["tiny"], bounds=bounds, progress=False)
    first, second = sorted(bounds.iterdir())
    first.write_bytes(second.read_bytes())
    with pytest.raises(BoundFileError, match=f"{first.name} belongs to another world"):
        score_file(files["tiny"], bounds=bounds, progress=False)


@pytest.mark.parametrize("search", [BoundSearch(n_rounds=0), BoundSearch(n_exchanges=0)])
def test_a_bound_of_a_short_search_lowers_nobodys_efficiency(search, files, tmp_path):
    bounds = tmp_path / "bounds"
    scored = score_file(files["tiny"], bounds=bounds, progress=False)
    env, kept = families.get("tiny").make("test"), {}
    for world in range(2):
        env.reset(seed=world)
        views = PlanarViews.from_env(env)
        (path,) = bounds.glob(f"*{families.world_hash(env)}*")
        kept[path] = load_bound(path, views).bounds
        save_bound(path, bound_shown(views, env.max_scans, search), views)
    assert score_file(files["tiny"], bounds=bounds, progress=False).scores == scored.scores
    for world, (path, expected) in enumerate(kept.items()):
        env.reset(seed=world)
        np.testing.assert_array_equal(load_bound(path, PlanarViews.from_env(env)).bounds, expected)


def test_the_default_folder_is_that_of_the_user_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    folder = own_folder()
    assert folder.parent.parent == tmp_path
    folder.parent.chmod(0o777)
    with pytest.raises(FileError, match="yours alone"):
        own_folder()


def test_worlds_of_another_kind_have_no_efficiency(tmp_path):
    assert episode_efficiency(None, None, 0, None, tmp_path) is None
    assert not list(tmp_path.iterdir())


def test_the_efficiency_of_an_episode_by_its_own_bound(files, tmp_path):
    family = families.get("tiny")
    env = family.make("test", report_shown=True)
    episode = run_episode(env, make_policy("random"), 1)
    found = episode_efficiency(env, family, 1, episode, tmp_path)
    (path,) = tmp_path.iterdir()
    env.reset(seed=1)
    assert families.world_hash(env) in path.name
    bounds = load_bound(path, PlanarViews.from_env(env)).bounds / 24**2
    shown = np.array(episode.shown_curve)
    assert found.end == pytest.approx((shown[-1] - shown[0]) / (bounds[-1] - shown[0]))
