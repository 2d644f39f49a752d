"""The comparison of planners on predicted maps and without."""

import re

import pytest

from coopmap_env.studies import predicted_maps
from coopmap_env.studies.predicted_maps import CONDITIONS, Condition, main

SMALL = {"scene": {"name": "obstacles", "shape": [40, 40], "side_max": 8.0}, "max_scans": 3}


def test_conditions_change_one_thing_of_a_family():
    crowded, louder = CONDITIONS["crowded, 1 robot"], CONDITIONS["crowded, 3 times the noise"]
    assert crowded.arguments == {**louder.arguments, "n_robots": 1, "max_scans": 58}
    assert louder.settings.noise.intrinsic == 3 * crowded.settings.noise.intrinsic
    trained_on = [name for name, own in CONDITIONS.items() if own.is_of_training]
    assert trained_on == ["the setting of the paper"]


@pytest.fixture
def small(monkeypatch):
    conditions = {"seen": Condition(SMALL, is_of_training=True), "unseen": Condition(SMALL)}
    monkeypatch.setattr(predicted_maps, "CONDITIONS", conditions)
    monkeypatch.setattr(predicted_maps, "OPPONENTS", {"drawn": "random", "rows": "raster"})
    monkeypatch.setattr(predicted_maps, "PREDICTIVE", {"predicted map": "predictive:search=20"})


def test_the_page_has_all_policies_in_all_conditions(small, tmp_path, capsys):
    page = tmp_path / "page.md"
    main(["--split", "train", "--worlds", "2", "--out", str(tmp_path / "out"), "--page", str(page)])
    text = page.read_text()
    assert capsys.readouterr().out.strip() in text
    assert 'Means over 2 worlds of\nthe split "train"' in text
    for condition in ("seen", r"unseen \(not trained on\)"):
        for policy in ("predicted map", "drawn", "rows"):
            (row,) = re.findall(rf"^\| {condition} \| {policy} \|.*$", text, re.MULTILINE)
            assert row.endswith("(drawn) |") == (policy == "predicted map")


def test_one_world_is_too_few(capsys):
    with pytest.raises(SystemExit):
        main(["--worlds", "1", "--out", "nowhere"])
    assert "--worlds must be at least 2, got 1" in capsys.readouterr().err
