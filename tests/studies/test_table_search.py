"""Interruptions of the search of Table 1's constants, and folders of other searches."""

from dataclasses import replace

import numpy as np
import pytest

from coopmap_env.envs.planar import PlanarSettings
from coopmap_env.studies.section3.deviation import PAPER_NUMBERS
from coopmap_env.studies.section3.setting import RASTER, SEARCHES, TableConstants
from coopmap_env.studies.section3.table_fit import record, search
from coopmap_env.studies.section3.table_fit.points import Range, point_of

pytest.importorskip("optuna")
BASE = PlanarSettings()
SEEDS = range(2)


@pytest.fixture
def plays(monkeypatch):
    """Trials without episodes, whose value is a function of the point; the list of their points."""
    played = []

    def play_all(constants, seeds, base, after_world, split="train"):
        if played and played[-1] == "interrupt":
            raise KeyboardInterrupt
        played.append(constants)
        factor = 1.1 + abs(np.log(constants.field_of_view / 30))
        columns = {
            one: np.array([[*factor * numbers, 0.09]] * len(seeds))
            for one, numbers in zip(SEARCHES, PAPER_NUMBERS, strict=True)
        }
        columns[RASTER] = np.array([[1.0, 1.0, 1.0, 0.04]] * len(seeds))
        return {"center": columns, "first": columns}

    monkeypatch.setattr(search, "play_all", play_all)
    monkeypatch.setattr(search, "N_STARTUP_TRIALS", 3)
    return played


def open_search(folder, base=BASE, seeds=SEEDS):
    return search.open_search(folder, search.describe_setup(seeds, base))


def interrupt_next_trial(plays, study, n_trials):
    plays.append("interrupt")
    with pytest.raises(KeyboardInterrupt):
        search.run_search(study, n_trials, SEEDS, BASE)
    plays.pop()


def points(study):
    return [t.params for t in study.trials if t.state.name in ("COMPLETE", "PRUNED")]


def test_an_interrupted_trial_does_not_count_and_the_first_point_is_played_again(plays, tmp_path):
    interrupt_next_trial(plays, open_search(tmp_path), 4)
    study = open_search(tmp_path)
    assert [trial.state.name for trial in study.trials] == ["FAIL"]
    assert search.count_trials(study) == 0
    search.run_search(study, 1, SEEDS, BASE)
    assert points(study) == [pytest.approx(point_of(TableConstants()))]


def test_an_interrupted_search_has_the_points_of_one_without_interruption(plays, tmp_path):
    whole = open_search(tmp_path / "whole")
    search.run_search(whole, 9, SEEDS, BASE)
    for n in (2, 6):  # one of the random trials, and one of the sampler's
        study = open_search(tmp_path / "parts")
        search.run_search(study, n, SEEDS, BASE)
        interrupt_next_trial(plays, study, 9)
    study = open_search(tmp_path / "parts")
    search.run_search(study, 9, SEEDS, BASE)
    assert points(study) == points(whole)
    exponents = [point["exponent"] for point in points(whole)]
    assert len(set(exponents)) == 9


def test_searches_of_other_seeds_draw_other_points(plays, tmp_path):
    setup = search.describe_setup(SEEDS, BASE)
    studies = [search.open_search(tmp_path / str(seed), setup, seed) for seed in (0, 1)]
    for study in studies:
        search.run_search(study, 2, SEEDS, BASE)
    (_, one), (_, other) = map(points, studies)
    assert one != other


@pytest.mark.parametrize(
    ("other", "difference"),
    [
        (
            {"base": replace(BASE, rating=PlanarSettings.v0().rating)},
            "base.rating.hidden is empty there and printed here",
        ),
        ({"seeds": range(5)}, "seeds is 0 to 1 there and 0 to 4 here"),
    ],
)
def test_a_folder_with_trials_of_another_search_is_refused(plays, tmp_path, other, difference):
    search.run_search(open_search(tmp_path), 1, SEEDS, BASE)
    with pytest.raises(ValueError, match=difference) as raised:
        open_search(tmp_path, **other)
    assert "Choose another --out" in str(raised.value)
    open_search(tmp_path)


def test_a_folder_of_another_version_or_other_ranges_is_refused(plays, tmp_path, monkeypatch):
    open_search(tmp_path)
    monkeypatch.setattr(search, "__version__", "9.9.9")
    with pytest.raises(ValueError, match=r"version is .* there and 9\.9\.9 here"):
        open_search(tmp_path)
    monkeypatch.undo()
    ranges = {**search.RANGES, "views": Range(0.1, 0.2)}
    monkeypatch.setattr(search, "RANGES", ranges)
    with pytest.raises(ValueError, match="searched"):
        open_search(tmp_path)


def test_a_folder_that_does_not_say_what_was_played_is_refused(plays, tmp_path):
    import optuna

    backend = optuna.storages.journal.JournalFileBackend(str(tmp_path / "trials.journal"))
    study = optuna.create_study(
        study_name="table 1", storage=optuna.storages.JournalStorage(backend)
    )
    study.enqueue_trial(point_of(TableConstants()))
    with pytest.raises(ValueError, match="does not say with which settings"):
        open_search(tmp_path)


def test_a_search_without_a_complete_trial_says_so(plays, tmp_path, monkeypatch):
    monkeypatch.setattr(record, "run_search", lambda *arguments: None)
    size = record.SearchSize(trials=1)
    with pytest.raises(ValueError, match="no trial of the search was played to its end"):
        record.fit_table(tmp_path, size, BASE, 1, print, progress=False)
