import pytest

from coopmap_env.cli import main, warm_up


@pytest.fixture
def played(monkeypatch):
    episodes = []
    monkeypatch.setattr(warm_up, "warm_up", lambda *arguments: episodes.append(arguments))
    return episodes


def test_each_environment_and_action_mode_is_played(played, monkeypatch):
    monkeypatch.setattr(warm_up, "missing_extras", lambda extras: {})
    main(["warm-up", "--policies", "raster, random"])
    assert played == [
        (env, mode, policy)
        for env in ("planar", "field")
        for mode in ("pose", "candidates")
        for policy in ("raster", "random")
    ]


def test_without_the_extra_there_is_the_plane(played, monkeypatch, capsys):
    monkeypatch.setattr(warm_up, "missing_extras", lambda extras: {"field": ["pybullet"]})
    main(["warm-up", "--policies", "raster"])
    assert {env for env, _, _ in played} == {"planar"}
    assert "pip install 'coopmap[field]'" in capsys.readouterr().err


def test_an_unknown_policy_is_refused_before_anything_is_compiled(played):
    with pytest.raises(SystemExit, match="unknown policy 'raste'; did you mean 'raster'"):
        main(["warm-up", "--policies", "random,raste"])
    assert played == []


def test_a_short_episode_says_what_it_compiled(capsys):
    warm_up.warm_up("planar", "candidates", "raster")
    first, *_, last = capsys.readouterr().err.splitlines()
    assert first == "planar, candidates mode, raster ..."
    assert "kernels compiled in" in last
