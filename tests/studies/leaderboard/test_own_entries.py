"""The project's own entries, played once."""

import pytest
from plain.small_families import with_small_families

from coopmap_agents.pretrained import pretrained_names
from coopmap_env import families
from coopmap_env.evaluation import make_policy
from coopmap_env.studies.leaderboard import __main__ as command
from coopmap_env.studies.leaderboard import own_entries
from coopmap_env.studies.leaderboard.own_entries import (
    LEARNED,
    LOOKAHEAD,
    MANY_POSES,
    PLANNERS,
    SURFACE,
    WEIGHING,
    Entry,
    entries_of,
    play_missing,
)
from coopmap_env.studies.leaderboard.submission import read_submission


@pytest.fixture(scope="module", autouse=True)
def small_families():
    with pytest.MonkeyPatch.context() as patch:
        with_small_families(patch)
        yield


def test_all_planners_can_be_made():
    for entry in {**PLANNERS, **LOOKAHEAD, **WEIGHING, **MANY_POSES, **SURFACE}.values():
        make_policy(entry.policy)


def test_planners_that_weigh_motion_play_where_time_ends_planar_episodes():
    weighing = {
        name for name in families.FAMILIES if set(WEIGHING) <= set(entries_of(families.get(name)))
    }
    assert weighing == {"motion-budget", "hasty"}
    assert set(entries_of(families.get("time"))) == {*PLANNERS, *LEARNED["field"], *SURFACE}


def test_learned_policies_are_the_pretrained_ones_in_the_mode_of_their_training():
    learned = [entry for entries in LEARNED.values() for entry in entries.values()]
    assert {one.policy.removeprefix("learned:model=") for one in learned} == set(pretrained_names())
    for one in learned:
        mode = "pose" if "pose" in one.policy else "candidates"
        assert one.options["action_mode"] == mode


def test_what_is_missing_or_on_other_worlds_is_played(tmp_path, monkeypatch):
    entries = {
        "a": Entry("random"),
        "b": Entry("random", {"action_mode": "candidates", "n_candidates": 5}),
    }
    first, second = play_missing("tiny", entries, tmp_path, 2)
    assert [path.name for path in (first, second)] == ["tiny_a.json.gz", "tiny_b.json.gz"]
    assert read_submission(second)["options"] == entries["b"].options
    second.write_bytes(b"broken")
    played = []
    monkeypatch.setattr(own_entries, "submit", lambda *arguments: played.append(arguments[4]))
    play_missing("tiny", entries, tmp_path, 2)
    assert played == [second]
    play_missing("tiny", entries, tmp_path, 3)
    assert played == [second, first, second]


def test_the_command_fills_a_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(own_entries, "PLANNERS", {"raster": Entry("raster")})
    for planners in ("LOOKAHEAD", "WEIGHING", "MANY_POSES"):
        monkeypatch.setattr(own_entries, planners, {})
    monkeypatch.setattr(own_entries, "LEARNED", {"planar": {"other": Entry("random")}})
    command.main([str(tmp_path), "--families", "tiny", "hasty", "--worlds", "2"])
    names = [f"{family}_{name}" for family in ("hasty", "tiny") for name in ("other", "raster")]
    assert [path.name for path in sorted(tmp_path.glob("*.gz"))] == [
        f"{name}.json.gz" for name in names
    ]
