import pytest

from coopmap_env import planar_v1
from coopmap_env.evaluation.bounds import PlanarViews, load_bound
from coopmap_env.simulation.scenes.planar import Obstacles
from coopmap_env.studies import bounds

SCENE = '{"name": "obstacles", "shape": [24, 24]}'


def test_a_row_for_each_world_and_their_means(tmp_path, capsys):
    bounds.main([SCENE, "--scans", "3", "--seeds", "4", "7", "--out", str(tmp_path)])
    lines = capsys.readouterr().out.splitlines()
    table = [line.split() for line in lines]
    assert table[0] == ["seed", "known", "bound", "choice", "gap", "seconds"]
    assert [row[0] for row in table[1:]] == ["4", "7", "mean"]
    env = planar_v1.parallel_env(scene=Obstacles(shape=(24, 24)), split="train", max_scans=3)
    for row in table[1:3]:
        env.reset(seed=int(row[0]))
        found = load_bound(tmp_path / f"{row[0]}.npz", PlanarViews.from_env(env))
        shown = [found.bounds[0], found.bounds[-1], found.choice_shown[-1]]
        assert [int(value) for value in row[1:4]] == shown
        assert row[4] == f"{found.gap:.2%}"
    assert len({len(line) for line in lines}) == 1


def test_by_hand_means():
    rows = [bounds.Row("0", 10, 200, 100, 1.0, 2.0), bounds.Row("1", 20, 300, 200, 0.5, 4.0)]
    assert bounds.mean_row(rows) == ("mean", 15.0, 250.0, 150.0, 0.75, 3.0)
    assert bounds.format_row(rows[0]).split() == ["0", "10", "200", "100", "100.00%", "2.0"]


def test_an_unknown_scene_is_refused():
    with pytest.raises(ValueError, match="the name of a scene with fields must be one of"):
        bounds.main(['{"name": "moon"}'])
