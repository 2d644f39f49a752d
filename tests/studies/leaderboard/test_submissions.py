"""Submissions replay bit for bit, and whatever is wrong in one is found and named."""

import gzip
import json
import math

import numpy as np
import pytest
from plain.small_families import N_FROZEN, SHORT_FIELD, with_small_families

from coopmap_env import families
from coopmap_env.core.files import FileError
from coopmap_env.evaluation import evaluate, make_policy, rollout
from coopmap_env.studies.leaderboard import play, score
from coopmap_env.studies.leaderboard.private_worlds import Salt, read_salt
from coopmap_env.studies.leaderboard.replay import replay_episode
from coopmap_env.studies.leaderboard.reported import own_versions
from coopmap_env.studies.leaderboard.score import score_file
from coopmap_env.studies.leaderboard.submission import (
    SubmissionError,
    read_submission,
    write_submission,
)

POSES = {"action_mode": "pose", "n_candidates": 32}
CANDIDATES = {"action_mode": "candidates", "n_candidates": 5}
SALT = Salt(bytes(range(40)))


@pytest.fixture(scope="module", autouse=True)
def small_families():
    with pytest.MonkeyPatch.context() as patch:
        with_small_families(patch)
        yield


def play_to(path, policy="random", n_worlds=3, options=POSES, family="tiny", salt=None):
    play.submit(family, policy, n_worlds, options, path, salt=salt, progress=False)
    return path


@pytest.fixture(scope="module")
def files(small_families, tmp_path_factory):
    """A submission of each kind."""
    folder = tmp_path_factory.mktemp("files")
    return {
        "pose": play_to(folder / "pose.json", "rating_function:search=5"),
        "candidates": play_to(folder / "candidates.json", options=CANDIDATES),
        "hasty": play_to(folder / "hasty.json", family="hasty"),
        "private": play_to(folder / "private.json", salt=SALT),
    }


def rescore(path, **arguments):
    return score_file(path, progress=False, **arguments)


@pytest.mark.parametrize("kind", ["pose", "candidates", "hasty"])
def test_a_submission_replays_with_the_scores_of_an_evaluation(kind, files):
    scored = rescore(files[kind])
    submission = scored.submission
    env = families.make(submission["family"], "test", report_shown=True, **submission["options"])
    table = evaluate(env, make_policy(submission["policy"]), range(3)).table
    for name, interval in scored.scores.items():
        assert interval.estimate == pytest.approx(table[name].mean(), rel=1e-12)
    for name in set(table) - {"seed", "planning_time_ms"}:
        stated = [episode["scores"][name] for episode in submission["episodes"]]
        np.testing.assert_array_equal(stated, table[name])
    assert "efficiency" not in scored.scores
    assert scored.notes == []


def test_field_submissions_are_scored_by_their_surface(tmp_path, monkeypatch):
    pytest.importorskip("pybullet")
    with_small_families(monkeypatch, [SHORT_FIELD])
    path = play_to(tmp_path / "field.json", family="short", n_worlds=2)
    options = {"bounds": tmp_path / "bounds", "replays": tmp_path / "replays"}
    scored = rescore(path, **options)
    env = families.make("short", "test", report_shown=True, **POSES)
    table = evaluate(env, make_policy("random"), range(2)).table
    for name in ("surface_coverage", "surface_coverage_auc", "f_score", "shown"):
        assert scored.scores[name].estimate == pytest.approx(table[name].mean(), rel=1e-12)
    assert "efficiency" not in scored.scores  # bounds are those of planar worlds
    monkeypatch.setattr(score, "replay_episode", None)  # so kept replays are not played again
    assert rescore(path, **options) == scored


def test_actions_are_read_back_to_the_same_bits(files):
    submission = read_submission(files["pose"])
    env = families.make("tiny", "test")
    for record in submission["episodes"]:
        policy = make_policy(submission["policy"])
        played = [step.actions for step in rollout(env, policy, record["world"])]
        for stated, actions in zip(record["actions"], played, strict=True):
            for own, action in zip(stated, actions.values(), strict=True):
                assert np.asarray(own).tobytes() == action.astype(np.float64).tobytes()


def test_a_submission_says_what_was_played_where(files):
    submission = read_submission(files["candidates"])
    reported = submission["reported"]
    assert reported["versions"] == own_versions()
    assert set(reported["machine"]) == {"processor", "cores", "system"}
    assert reported["decision_ms"] > 0
    assert reported["model_bytes"] is reported["n_parameters"] is None
    assert submission["options"] == CANDIDATES
    actions = [a for e in submission["episodes"] for step in e["actions"] for a in step]
    assert {type(action) for action in actions} == {int}


def test_other_versions_are_a_note_and_no_error(files, tmp_path):
    path = tampered(
        files["pose"], tmp_path, lambda s: s["reported"]["versions"].update(numpy="1.0")
    )
    (note,) = rescore(path).notes
    assert note.startswith("numpy 1.0 (here ")


def test_an_interrupted_submission_is_resumed(files, tmp_path, monkeypatch):
    path = play_to(tmp_path / "first.json")
    first = path.read_text()
    (sorted((tmp_path / "first.episodes").iterdir())[1]).unlink()
    played = []

    def count(job):
        played.append(job["world"])
        return play_job(job)

    play_job = play.play_job
    monkeypatch.setattr(play, "play_job", count)
    path.unlink()
    play_to(path)
    assert len(played) == 1
    again = json.loads(path.read_text())
    assert again["episodes"] == json.loads(first)["episodes"]


def test_another_policy_or_mode_does_not_use_stored_episodes(tmp_path):
    path = tmp_path / "one.json"
    play_to(path)
    play_to(path, options=CANDIDATES)
    play_to(path, "frontier")
    rescore(path)
    assert len(list((tmp_path / "one.episodes").glob("*.json"))) == 9


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"n_worlds": 1}, "episodes must be from 2 to 4, as many as are frozen, got 1"),
        ({"n_worlds": N_FROZEN + 1}, "from 2 to 4, as many as are frozen, got 5"),
        ({"n_worlds": 1, "salt": SALT}, "episodes must be at least 2, got 1"),
        ({"family": "huge"}, "unknown family 'huge'"),
        ({"policy": "nobody"}, "unknown policy 'nobody'"),
        ({"options": {**CANDIDATES, "n_candidates": 0}}, "n_candidates"),
        ({"options": {**CANDIDATES, "reward": "coverage"}}, "options is not of its type"),
        ({"policy": f"random:{'+' * 300}"}, "texts must be .* of at most 300 characters"),
        ({"policy": "random:+\x1b"}, "written key=value"),
    ],
)
def test_what_cannot_be_played_is_refused_before_the_first_episode(arguments, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        play_to(tmp_path / "none.json", **arguments)
    assert not list(tmp_path.iterdir())


class Boastful:
    """A policy that says of itself what no submission can state."""

    def __init__(self, **said):
        vars(self).update(said)

    def reset(self, rng):
        pass

    def act(self, belief, observations):
        return {agent: belief.actions.encode(0, p, belief) for agent, p in self.poses(belief)}

    def poses(self, belief):
        return zip(belief.agents, belief.pose_ids, strict=True)


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ({"fingerprint": "x" * 301}, "texts must be printable and of at most 300 characters"),
        ({"fingerprint": "a\nb"}, "texts must be printable"),
        ({"n_parameters": -1}, "n_parameters must be at least 0, got -1"),
        ({"model_bytes": 2**64}, "reported is not of its type"),
    ],
)
def test_what_a_policy_says_of_itself_is_checked_before_the_first_episode(
    said, message, tmp_path, monkeypatch
):
    monkeypatch.setattr(play, "make_policy", lambda spec: Boastful(**said))
    with pytest.raises(ValueError, match=message):
        play_to(tmp_path / "none.json")
    assert not list(tmp_path.iterdir())


def test_a_folder_in_place_of_the_file_is_named_before_the_first_episode(tmp_path):
    (tmp_path / "board").mkdir()
    for name in ("board", "frontier.episodes"):
        with pytest.raises(FileError, match=f"{name} is a folder, or the one of the episodes"):
            play_to(tmp_path / name)
    assert not list((tmp_path / "board").iterdir())


def tampered(path, folder, change):
    submission = json.loads(path.read_text())
    change(submission)
    out = folder / "tampered.json"
    out.write_text(json.dumps(submission))
    return out


def episode(k, **changed):
    return lambda s: s["episodes"][k].update(changed)


def scores(k, **changed):
    return lambda s: s["episodes"][k]["scores"].update(changed)


def last_bit(name):
    def change(s):
        own = s["episodes"][1]["scores"]
        own[name] = math.nextafter(own[name], math.inf)

    return change


def action(value, step=1, robot=0):
    def change(s):
        s["episodes"][1]["actions"][step][robot] = value

    return change


def steps(change_steps):
    return lambda s: change_steps(s["episodes"][2]["actions"])


def swap_actions(s):
    first, second = s["episodes"][:2]
    first["actions"], second["actions"] = second["actions"], first["actions"]


def swap_worlds(s):
    s["episodes"][0]["world"], s["episodes"][1]["world"] = 1, 0


def repeat_world(s):
    s["episodes"][2] = s["episodes"][1]


def rename_world(s):
    s["episodes"][2] = {**s["episodes"][1], "world": 2}


CHANGES = {
    "action": (action([0.1, -0.2, 0.3]), "does not replay: world 1: .* a replay gives"),
    "action out of range": (action([2.0, 0.0, 0.0]), r"world 1: robot_0: each number .* \[-1, 1\]"),
    "huge action": (action([1e300, 0.0, 0.0]), r"world 1: robot_0: each number .* got \[1e\+300"),
    "long action": (action([0.0] * 4), "world 1: robot_0: a pose action is 3 numbers"),
    "action of another mode": (action(3), "world 1: robot_0: a pose action is 3 numbers"),
    "no action": (lambda s: s["episodes"][1]["actions"][1].pop(), "step 1 needs an action of each"),
    "text as action": (action("stay"), r"episodes\[1\] is not of its type"),
    "truth as action": (action(True), r"episodes\[1\] is not of its type"),
    "huge integer as action": (action(10**30), r"episodes\[1\] is not of its type"),
    "actions of another world": (swap_actions, "does not replay: world 0: "),
    "extra step": (steps(lambda a: a.append(a[-1])), "world 2: there are 5 steps, and .* after 4"),
    "missing step": (steps(lambda a: a.pop()), "world 2: there are 3 steps, and .* goes on"),
    "no steps": (steps(lambda a: a.clear()), "world 2: there are 0 steps, and .* goes on"),
    "score": (scores(1, shown=0.9), "world 1: shown 0.9 is stated, and a replay gives 0"),
    "last bit of a score": (last_bit("shown_auc"), "world 1: shown_auc .* a replay gives"),
    "digit of a logarithm": (scores(1, log_loss=0.01), "world 1: log_loss 0.01 is stated"),
    "undefined score": (scores(1, shown=None), "world 1: shown None is stated"),
    "text as score": (scores(1, shown="0.5"), r"episodes\[1\] is not of its type"),
    "missing score": (
        lambda s: s["episodes"][1]["scores"].pop("shown"),
        "world 1: the scores must be coverage, ",
    ),
    "score of its own": (scores(1, beauty=1.0), "world 1: the scores must be .*'beauty'"),
    "map": (episode(1, map_hash="0" * 16), "world 1: map_hash '0000000000000000' is stated"),
    "world hash": (episode(1, world_hash="f" * 16), "world 1: world_hash 'ffffffffffffffff' is"),
    "worlds in another order": (swap_worlds, "0 ... 2 in order: 1 stands where 0 is expected"),
    "world twice": (repeat_world, "0 ... 2 in order: 1 stands twice or too late"),
    "world of another number": (rename_world, "world 2: world_hash .* is stated"),
    "missing world": (lambda s: s["episodes"].pop(1), "2 stands where 1 is expected"),
    "missing last world": (lambda s: s["episodes"].pop(), "n_worlds is 3, and there are 2 ep"),
    "negative world": (episode(0, world=-1), "-1 stands twice"),
    "huge world": (episode(2, world=10**30), r"episodes\[2\] is not of its type"),
    "one world": (
        lambda s: s.update(n_worlds=1, episodes=s["episodes"][:1]),
        "n_worlds must be at least 2, got 1",
    ),
    "no worlds": (lambda s: s.update(n_worlds=0, episodes=[]), "at least 2, got 0"),
    "definition": (
        lambda s: s.update(definition="0" * 16),
        "another definition of the family 'tiny', with the hash '0000000000000000'; this version",
    ),
    "another family": (lambda s: s.update(family="hasty"), "another definition of the family"),
    "unknown family": (lambda s: s.update(family="huge"), "unknown family 'huge'; choose"),
    "split": (lambda s: s.update(split="train"), "split must be 'test', got 'train'"),
    "format": (lambda s: s.update(format="submission 2"), "format 'coopmap submission 1', got"),
    "mode": (lambda s: s["options"].update(action_mode="fly"), "options .*action_mode must be"),
    "candidates": (lambda s: s["options"].update(n_candidates=0), "options .*n_candidates must"),
    "option of the family": (lambda s: s["options"].update(max_scans=9), "options is not of its"),
    "missing entry": (lambda s: s.pop("policy"), "the entries must be .*; one is 'policy'"),
    "unknown entry": (lambda s: s.update(prize=1), "the entries must be .*; one is 'prize'"),
    "fraction as number": (lambda s: s.update(n_worlds=3.0), "n_worlds is not of its type: 3.0"),
    "episodes by name": (lambda s: s.update(episodes={}), "episodes must be a list, got {}"),
    "control characters": (lambda s: s.update(policy="\x1b[2J"), "texts must be printable"),
    "long text": (lambda s: s.update(policy="x" * 301), "at most 300 characters"),
    "text in reported": (
        lambda s: s["reported"]["machine"].update(processor="a\nb"),
        "texts must be printable",
    ),
    "negative time": (lambda s: s["reported"].update(decision_ms=-1), "decision_ms must be at le"),
    "private by word": (lambda s: s.update(private="0" * 16), "private: give the salt with the"),
}  # fmt: skip


@pytest.mark.parametrize("what", CHANGES)
def test_what_was_changed_is_found_and_named(what, files, tmp_path):
    change, message = CHANGES[what]
    path = tampered(files["pose"], tmp_path, change)
    with pytest.raises(FileError, match=message) as raised:
        rescore(path)
    assert str(path) in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("value", [5, -1, [2.0]])
def test_a_candidate_that_is_not_offered_is_found(value, files, tmp_path):
    path = tampered(files["candidates"], tmp_path, action(value))
    with pytest.raises(SubmissionError, match=r"world 1: robot_0: a candidate action"):
        rescore(path)


def test_an_episode_goes_on_until_its_time_is_over(files, tmp_path):
    path = tampered(files["hasty"], tmp_path, steps(lambda a: a.pop()))
    with pytest.raises(SubmissionError, match=r"world 2: there are \d steps, and .* goes on"):
        rescore(path)


def test_kept_replays_count_again_for_the_same_records_alone(files, tmp_path, monkeypatch):
    path, kept = files["pose"], tmp_path / "replays"
    first = rescore(path, replays=kept)
    replayed = []

    def replay(env, family, seed, record, is_private):
        replayed.append(record["world"])
        return replay_episode(env, family, seed, record, is_private)

    monkeypatch.setattr(score, "replay_episode", replay)
    assert rescore(path, replays=kept) == first
    assert replayed == []
    for broken in ("high", [0.5], [0.5, "high"]):
        sorted(kept.glob("*.json"))[0].write_text(json.dumps({"efficiency": broken}))
        assert rescore(path, replays=kept) == first
    assert len(replayed) == 3
    with pytest.raises(SubmissionError, match="does not replay"):
        rescore(tampered(path, tmp_path, scores(1, shown=0.9)), replays=kept)
    monkeypatch.setattr(score, "source_hash", lambda: "others")
    replayed.clear()
    rescore(path, replays=kept)
    assert replayed == [0, 1, 2]


def test_the_last_bit_of_a_logarithm_may_differ(files, tmp_path):
    rescore(tampered(files["pose"], tmp_path, last_bit("log_loss_free")))


TEXTS = {
    "nothing": (lambda text: "", "expected JSON"),
    "half": (lambda text: text[: len(text) // 2], "expected JSON"),
    "NaN": (lambda text: text.replace('"shown": 0', '"shown": NaN, "x": 0'), "NaN is no number"),
    "infinity": (lambda text: text.replace('"n_worlds": 3', '"n_worlds": 1e999'), "type: inf"),
    "endless digits": (lambda text: text.replace('"world": 1', f'"world": {"9" * 5000}'), "JSON"),
    "name twice": (
        lambda text: text.replace('"n_worlds"', '"family": "crowded",\n "n_worlds"'),
        "a name stands twice among",
    ),
    "list": (lambda text: "[]", "expected the format 'coopmap submission 1', got \\[\\]"),
    "nested": (lambda text: "[" * 100_000, "expected JSON"),
}  # fmt: skip


@pytest.mark.parametrize("what", TEXTS)
def test_what_is_no_json_of_a_submission_is_named(what, files, tmp_path):
    change, message = TEXTS[what]
    path = tmp_path / "broken.json"
    path.write_text(change(files["pose"].read_text()))
    with pytest.raises(SubmissionError, match=message) as raised:
        read_submission(path)
    assert str(path) in str(raised.value)


def test_a_packed_submission_is_the_same_in_fewer_bytes(files, tmp_path):
    submission = read_submission(files["pose"])
    for folder in ("one", "two"):
        write_submission(tmp_path / folder / "pose.json.gz", submission)
    packed = tmp_path / "one" / "pose.json.gz"
    assert packed.read_bytes() == (tmp_path / "two" / "pose.json.gz").read_bytes()
    assert read_submission(packed) == submission
    assert packed.stat().st_size < 0.5 * files["pose"].stat().st_size
    assert score.expand([packed.parent]) == [packed]


def test_episodes_of_a_packed_submission_are_beside_it(tmp_path):
    play_to(tmp_path / "random.json.gz", n_worlds=2)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["random.episodes", "random.json.gz"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "expected JSON"),
        (b"{}", "not a gzip file"),
        (gzip.compress(b"\xff"), "UTF-8"),
        (
            gzip.compress(bytes(3_000_000)),
            "the unpacked file has .* more than the limit of 100,000",
        ),
        (gzip.compress(b"{}" * 99)[:-12], "not a gzip file that can be read"),
    ],
    ids=["empty", "text", "no UTF-8", "too large", "cut off"],  # packed bytes hold the time
)
def test_what_is_no_packed_submission_is_named(content, message, tmp_path, monkeypatch):
    monkeypatch.setenv("COOPMAP_MAX_BYTES", "100000")
    path = tmp_path / "bad.json.gz"
    path.write_bytes(content)
    with pytest.raises(SubmissionError, match=rf"bad\.json\.gz: .*{message}"):
        read_submission(path)


def test_a_file_that_is_not_there_or_no_text_is_named(tmp_path):
    with pytest.raises(SubmissionError, match=r"none\.json: there is no such file"):
        read_submission(tmp_path / "none.json")
    (tmp_path / "bytes.json").write_bytes(b"\xff\xfe")
    with pytest.raises(SubmissionError, match="expected UTF-8"):
        read_submission(tmp_path / "bytes.json")


def test_what_is_written_is_read_back(files, tmp_path):
    submission = read_submission(files["pose"])
    write_submission(tmp_path / "again.json", submission)
    assert read_submission(tmp_path / "again.json") == submission
    assert (tmp_path / "again.json").read_bytes() == files["pose"].read_bytes()


# --- private worlds


def test_private_worlds_replay_with_their_salt(files):
    scored = rescore(files["private"], salt=SALT)
    assert scored.submission["private"] == SALT.digest
    public = read_submission(play_to(files["private"].with_name("public.json")))
    hashes = {episode["world_hash"] for episode in public["episodes"]}
    assert not hashes & {one["world_hash"] for one in scored.submission["episodes"]}


def test_private_worlds_have_seeds_of_256_bits_that_no_file_has(files):
    seeds = {SALT.seed(family, k) for family in ("tiny", "hasty") for k in range(20)}
    assert len(seeds) == 40
    assert max(seeds).bit_length() > 250
    env = families.make("tiny", "test")
    env.reset(seed=SALT.seed("tiny", 1))
    stated = read_submission(files["private"])["episodes"][1]["world_hash"]
    assert families.world_hash(env) == stated
    folder = files["private"].with_name("private.episodes")
    texts = [files["private"].read_text(), *(one.read_text() for one in folder.glob("*.json"))]
    for seed in (SALT.seed("tiny", k) for k in range(3)):
        assert not any(str(seed) in text or f"{seed:x}" in text for text in texts)


def test_the_seed_of_a_private_world_does_not_change():
    assert f"{SALT.seed('tiny', 1):x}" == (
        "87eb101d3856439fbae96500d1de3880ca3f1c04134b6e90bbf034bbe7e637a3"
    )
    assert SALT.digest == "c37071ca4d5b078d"


def test_a_wrong_or_missing_salt_is_named(files):
    with pytest.raises(FileError, match=f"salt with the hash {SALT.digest} by --salt"):
        rescore(files["private"])
    other = Salt(b"x" * 16)
    with pytest.raises(
        FileError, match=f"belong to the salt with the hash {SALT.digest}, .* has {other.digest}"
    ):
        rescore(files["private"], salt=other)
    assert rescore(files["pose"], salt=other).submission["private"] is None


def test_a_salt_is_a_file_of_at_least_sixteen_bytes(tmp_path):
    path = tmp_path / "salt"
    path.write_bytes(SALT.content)
    assert read_salt(path) == SALT
    path.write_bytes(b"\n" * 16)
    assert read_salt(path).content == b"\n" * 16
    path.write_bytes(b"short")
    with pytest.raises(FileError, match="at least 16 random bytes, got 5: make one by head -c 32"):
        read_salt(path)
    with pytest.raises(FileError, match="no such file"):
        read_salt(tmp_path / "none")


# --- files and folders


def test_a_folder_stands_for_its_json_files_each_once(files):
    folder = files["pose"].parent
    found = score.expand([files["hasty"], folder, folder / "pose.json"])
    assert found[0] == files["hasty"]
    assert sorted(found) == sorted(folder.glob("*.json"))


def test_a_folder_without_submissions_is_named(tmp_path):
    with pytest.raises(FileError, match=r"has no \*\.json and no"):
        score.expand([tmp_path])
