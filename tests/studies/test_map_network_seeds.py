"""Map networks of several training seeds beside planners."""

import re

import numpy as np
import pytest

from coopmap_env.studies import map_network_seeds
from coopmap_env.studies.map_network_seeds import TASKS, Task, main, table_text

SMALL = {"scene": {"name": "obstacles", "shape": [40, 40], "side_max": 8.0}, "max_scans": 3}


def test_tasks_are_of_both_environments_with_their_scores():
    scores = {task.env_name: task.score for task in TASKS.values()}
    assert scores == {"planar": "efficiency", "field": "surface_coverage_auc"}
    for task in TASKS.values():
        assert task.seeds[0] == 0
        assert "predictive" not in " ".join(task.opponents)


def test_the_page_has_the_network_of_each_seed(monkeypatch, tmp_path, capsys):
    task = Task("planar", SMALL)
    monkeypatch.setattr(map_network_seeds, "TASKS", {"small": task})
    monkeypatch.setattr(map_network_seeds, "OPPONENTS", {"planar": ("random", "raster")})
    page = tmp_path / "page.md"
    main(["--split", "train", "--worlds", "2", "--out", str(tmp_path / "out"), "--page", str(page)])
    text = page.read_text()
    assert capsys.readouterr().out.strip() in text
    (row,) = re.findall(r"^\| small \| efficiency at the end \| `predictive` \|.*$", text, re.M)
    assert row.count(",") == 1 + len(task.seeds) - 1
    for opponent in ("random", "raster"):
        assert re.search(rf"^\| small \| .* \| `{opponent}` \| .* \|  \| [+-].* \|$", text, re.M)


def test_differences_are_means_over_seeds(monkeypatch):
    monkeypatch.setattr(map_network_seeds, "TASKS", {"small": Task("planar", {})})
    ours = np.array([[0.5, 0.7, 0.6], [0.7, 0.9, 0.8]])
    text = table_text({"small": {"predictive": ours, "random": np.full((1, 3), 0.25)}})
    assert "| 70.0 [" in text
    assert "| 60.0, 80.0 |" in text
    assert "| +45.0 [" in text


def test_one_world_is_too_few(capsys):
    with pytest.raises(SystemExit):
        main(["--worlds", "1", "--out", "nowhere"])
    assert "--worlds must be at least 2, got 1" in capsys.readouterr().err
