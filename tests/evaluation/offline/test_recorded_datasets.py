"""Recorded episodes: what is written, by whom it is read, and that it is what was played."""

import json
import warnings

import numpy as np
import pytest

from coopmap_env.cli import main
from coopmap_env.core.files import FileError
from coopmap_env.evaluation import make_env, make_policy, run_episode
from coopmap_env.evaluation.offline import (
    RecordedDataset,
    RecordingError,
    default_dataset_id,
    record_dataset,
    record_episode,
)
from coopmap_env.evaluation.offline.jobs import EPISODES_FOLDER

h5py = pytest.importorskip("h5py")

ARGUMENTS = {"n_robots": 2, "max_scans": 3, "split": "train", "reward": "coverage"}
POLICY = "rating_function:search=5"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("recorded")
    record_dataset(POLICY, [4, 2], ARGUMENTS, out, progress=False)
    return out


def same(first, second):
    """Whether two episodes have the same arrays, with their types."""
    for name in ("actions", "rewards", "terminations", "truncations"):
        one, other = getattr(first, name), getattr(second, name)
        assert (one.dtype, one.tobytes()) == (other.dtype, other.tobytes())
    for name in ("observations", "infos"):
        one, other = getattr(first, name), getattr(second, name)
        assert sorted(one) == sorted(other)
        for key in one:
            assert one[key].dtype == other[key].dtype
            np.testing.assert_array_equal(one[key], other[key])


def replay(env, episode):
    """What the environment of one controller gives for the recorded actions."""
    observation, info = env.reset(seed=episode.seed)
    seen, infos, rewards, ends = [observation], [info], [], []
    for action in episode.actions:
        observation, reward, terminated, truncated, info = env.step(action)
        seen.append(observation)
        infos.append(info)
        rewards.append(reward)
        ends.append((terminated, truncated))
    return seen, infos, rewards, ends


@pytest.mark.parametrize("action_mode", ["pose", "candidates"])
@pytest.mark.parametrize("env_name", ["planar", "field"])
def test_recorded_actions_give_the_recorded_episode_again_bit_for_bit(
    env_name, action_mode, tmp_path
):
    if env_name == "field":
        pytest.importorskip("pybullet")
    arguments = {**ARGUMENTS, "max_scans": 2, "action_mode": action_mode, "n_candidates": 4}
    dataset = record_dataset("random", [7], arguments, tmp_path, None, env_name, progress=False)
    (episode,) = dataset
    env = dataset.make_env()
    seen, infos, rewards, ends = replay(env, episode)
    assert episode.rewards.tolist() == rewards
    assert ends == [(False, False), (False, True)]
    assert list(zip(episode.terminations, episode.truncations, strict=True)) == ends
    assert all(action in dataset.action_space for action in episode.actions)
    assert dataset.action_space == env.action_space
    assert dataset.observation_space == env.observation_space
    for k, (observation, info) in enumerate(zip(seen, infos, strict=True)):
        assert observation in dataset.observation_space
        assert sorted(observation) == sorted(episode.observations)
        for key, value in observation.items():
            assert episode.observations[key].dtype == value.dtype
            np.testing.assert_array_equal(episode.observations[key][k], value, strict=True)
        assert sorted(info) == sorted(episode.infos)
        for key, value in info.items():
            np.testing.assert_array_equal(episode.infos[key][k], value, strict=True)


def test_what_is_recorded_is_what_is_evaluated(folder):
    env = make_env("planar", ARGUMENTS, None)
    for episode in RecordedDataset(folder):
        played = run_episode(env, make_policy(POLICY), episode.seed)
        assert episode.infos["observed_fraction"][:, 0].tolist() == played.coverage_curve
        assert len(episode) == 3


def test_actions_of_another_type_are_rounded_before_they_are_taken():
    class Wide:
        def reset(self, rng):
            self.rng = rng

        def act(self, belief, observations):
            return {agent: self.rng.uniform(-1, 1, 3) for agent in belief.agents}

    env = make_env("planar", ARGUMENTS, None)
    episode = record_episode(env, Wide(), 0)
    assert episode.actions.dtype == np.float32
    done = [np.hstack([one[agent] for agent in env.possible_agents]) for one in env._episode[1]]
    np.testing.assert_array_equal(np.array(done), episode.actions)


def test_an_action_that_is_no_index_is_not_recorded_as_one():
    class Fractions:
        def reset(self, rng):
            pass

        def act(self, belief, observations):
            return dict.fromkeys(belief.agents, np.float64(1.5))

    env = make_env("planar", {**ARGUMENTS, "action_mode": "candidates"}, None)
    with pytest.raises(TypeError, match="Cannot cast"):
        record_episode(env, Fractions(), 0)


def test_the_same_command_gives_the_same_bytes_with_any_number_of_workers(folder, tmp_path):
    record_dataset(POLICY, [4, 2], ARGUMENTS, tmp_path, workers=2, progress=False)
    for name in ("main_data.hdf5", "metadata.json"):
        assert (tmp_path / "data" / name).read_bytes() == (folder / "data" / name).read_bytes()


def test_an_interrupted_recording_goes_on_with_its_finished_episodes(folder, tmp_path, monkeypatch):
    from coopmap_env.evaluation.offline import jobs

    played = []

    def count(env, policy, seed):
        if len(played) == 1 and not resumed:
            raise KeyboardInterrupt
        played.append(seed)
        return record_episode(env, policy, seed)

    monkeypatch.setattr(jobs, "record_episode", count)
    resumed = False
    with pytest.raises(KeyboardInterrupt):
        record_dataset(POLICY, [4, 2], ARGUMENTS, tmp_path, progress=False)
    assert played == [4]
    with pytest.raises(RecordingError, match=r"metadata\.json: there is no such file"):
        RecordedDataset(tmp_path)
    resumed = True
    record_dataset(POLICY, [4, 2], ARGUMENTS, tmp_path, progress=False)
    assert played == [4, 2]
    data = (tmp_path / "data" / "main_data.hdf5").read_bytes()
    assert data == (folder / "data" / "main_data.hdf5").read_bytes()

    broken = sorted((tmp_path / EPISODES_FOLDER).glob("*.hdf5"))[0]
    broken.write_bytes(broken.read_bytes()[:-1])  # is played again
    record_dataset(POLICY, [4, 2], ARGUMENTS, tmp_path, progress=False)
    assert len(played) == 3
    assert (tmp_path / "data" / "main_data.hdf5").read_bytes() == data


def test_the_metadata_state_what_decides_the_arrays(folder):
    recipe = RecordedDataset(folder).recipe
    assert recipe["policy"] == POLICY
    assert recipe["seeds"] == [4, 2]
    assert recipe["env_kwargs"] == ARGUMENTS
    assert recipe["settings"]["crop_cells"] == 48
    assert set(recipe["versions"]) >= {"coopmap", "numpy", "numba"}


def test_minari_reads_the_dataset_and_makes_its_environment(folder):
    minari = pytest.importorskip("minari")
    dataset, own = minari.MinariDataset(folder / "data"), RecordedDataset(folder)
    assert (dataset.total_episodes, dataset.total_steps) == (2, 6)
    assert dataset.id == default_dataset_id(POLICY, "planar")
    assert dataset.observation_space == own.observation_space
    assert dataset.action_space == own.action_space
    for read, episode in zip(dataset, own, strict=True):
        same(read, episode)
    assert [one["seed"] for one in dataset.storage.get_episode_metadata([0, 1])] == [4, 2]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of Gymnasium's checks of spaces
        env = dataset.recover_environment()
    assert replay(env, own[0])[2] == own[0].rewards.tolist()


def test_spaces_are_written_as_minari_writes_them():
    serialization = pytest.importorskip("minari.serialization")
    from coopmap_env.evaluation.env_specs import make_team_env
    from coopmap_env.evaluation.offline.minari_spaces import space_from_json, space_to_json

    env = make_team_env("planar", {"action_mode": "candidates"}, None)
    for space in (env.observation_space, env.action_space):
        text = space_to_json(space)
        assert json.loads(text) == json.loads(serialization.serialize_space(space))
        assert space_from_json(text) == space


def test_arrays_are_packed(folder):
    with h5py.File(folder / "data" / "main_data.hdf5") as file:
        maps = file["episode_0/observations/map"]
        assert maps.compression == "gzip"
        assert maps.id.get_storage_size() < maps.nbytes / 10


def test_episodes_are_read_by_index_and_slice(folder):
    dataset = RecordedDataset(folder)
    assert [episode.seed for episode in dataset[::-1]] == [2, 4]
    assert dataset[-1].seed == 2
    with pytest.raises(IndexError):
        dataset[2]


def edit(path, change):
    with h5py.File(path, "r+") as file:
        change(file)


def replace(name, **options):
    """Put another dataset into the place of one."""

    def change(file):
        del file[name]
        file.create_dataset(name, **options)

    return change


def to_external_link(file):
    del file["episode_0/actions"]
    file["episode_0/actions"] = h5py.ExternalLink("other.hdf5", "/actions")


CHANGES = {
    "no episode": (lambda file: file.pop("episode_0"), "episode_0 is missing"),
    "another shape": (replace("episode_0/rewards", data=np.zeros(4)), r"the shape \(3,\)"),
    "another type": (replace("episode_0/rewards", data=np.zeros(3, np.float32)), "the type"),
    "texts": (replace("episode_0/infos/n_scans", data=[["a"]] * 4), "the type"),
    "a link": (to_external_link, "actions is missing, or in another file"),
    "external bytes": (
        replace(
            "episode_0/rewards",
            shape=(3,),
            dtype="f8",
            external=[("/etc/passwd", 0, h5py.h5f.UNLIMITED)],
        ),
        "rewards is in another file",
    ),
    "a bomb": (
        replace("episode_0/infos/n_scans", shape=(4, 1 << 40), dtype="i8", chunks=(1, 1 << 20)),
        "more than the limit",
    ),
    "no steps": (lambda file: file["episode_0"].attrs.modify("total_steps", 0), "and 0"),
    "another seed": (
        lambda file: file["episode_0"].attrs.modify("seed", 3),
        "not of the seed in the metadata",
    ),
}


@pytest.fixture
def copied(folder, tmp_path):
    (tmp_path / "data").mkdir()
    for path in (folder / "data").iterdir():
        (tmp_path / "data" / path.name).write_bytes(path.read_bytes())
    return tmp_path


@pytest.mark.parametrize("case", CHANGES)
def test_a_broken_file_is_one_error_that_names_it(case, copied):
    change, message = CHANGES[case]
    edit(copied / "data" / "main_data.hdf5", change)
    with pytest.raises(RecordingError, match=message) as raised:
        RecordedDataset(copied)[0]
    assert "main_data.hdf5" in str(raised.value)
    assert issubclass(RecordingError, FileError)


def test_a_file_that_is_no_hdf5_is_one_error(copied):
    path = copied / "data" / "main_data.hdf5"
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(RecordingError, match=r"main_data\.hdf5: episode_0 cannot be read"):
        RecordedDataset(copied)[0]
    path.unlink()
    with pytest.raises(RecordingError, match="there is no such file"):
        RecordedDataset(copied)[0]


def test_random_damage_is_read_or_is_one_error(copied):
    path = copied / "data" / "main_data.hdf5"
    content, rng, messages = path.read_bytes(), np.random.default_rng(0), []
    for _ in range(40):
        damaged = bytearray(content)
        for place in rng.integers(len(content), size=rng.integers(1, 8)):
            damaged[place] = rng.integers(256)
        path.write_bytes(damaged[: rng.integers(len(content) // 2, 2 * len(content))])
        try:
            list(RecordedDataset(copied))
        except RecordingError as error:
            messages.append(str(error))
    assert len(messages) > 20
    assert all(str(path) in message for message in messages)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("coopmap", None),
        ("coopmap", {"seeds": [1]}),
        ("observation_space", "{}"),
        ("observation_space", '{"type":"MultiDiscrete","dtype":"int64","nvec":[2],"start":[0]}'),
        ("action_space", '{"type":"Text"}'),
        ("action_space", '{"type":"Box","dtype":"object","shape":[1],"low":[0],"high":[1]}'),
        ("action_space", 3),
        ("action_space", None),
    ],
)
def test_metadata_of_another_form_are_one_error(name, value, copied):
    path = copied / "data" / "metadata.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), name: value}))
    with pytest.raises(RecordingError, match=r"metadata\.json: "):
        RecordedDataset(copied)


def test_a_wrong_argument_is_refused_before_the_first_episode(tmp_path):
    with pytest.raises(ValueError, match="at least one seed"):
        record_dataset(POLICY, [], ARGUMENTS, tmp_path)
    with pytest.raises(ValueError, match=r"NAMESPACE/NAME-vN .* got 'a b'"):
        record_dataset(POLICY, [0], ARGUMENTS, tmp_path, dataset_id="a b")
    with pytest.raises(ValueError, match="candidates"):
        record_dataset("learned:model=planar-candidates", [0], ARGUMENTS, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_command_records_the_worlds_of_a_family(tmp_path, capsys):
    main([
        "record", "--family", "crowded", "--policy", "random", "--episodes", "1", "--seed", "3",
        "--split", "validation", "--action-mode", "candidates", "--out", str(tmp_path),
    ])  # fmt: skip
    dataset = RecordedDataset(tmp_path)
    assert dataset.recipe["seeds"] == [3]
    assert dataset.recipe["env_kwargs"]["split"] == "validation"
    assert len(dataset[0]) == 29
    metadata = json.loads((tmp_path / "data" / "metadata.json").read_text())
    assert metadata["dataset_id"] == "coopmap/crowded/random-v0"
    assert "1 episodes, " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--episodes", "0"], "--episodes must be from 1 to 1,000,000, got 0"),
        (["--seed", "-1"], "--seed must be at least 0, got -1"),
        (["--policy", "nobody"], "unknown policy 'nobody'"),
        (["--dataset-id", "nothing"], "NAMESPACE/NAME-vN"),
    ],
)
def test_bad_input_is_one_line(arguments, message, tmp_path):
    with pytest.raises(SystemExit) as raised:
        main(["record", "--out", str(tmp_path), *arguments])
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)
