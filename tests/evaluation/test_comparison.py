import csv
import json
from dataclasses import asdict, replace
from importlib import import_module
from importlib.metadata import EntryPoint

import numpy as np
import pytest
from plain.episodes import example_episode

import coopmap_baselines
from coopmap_env import evaluation, planar_v1
from coopmap_env.core.settings import settings_from_dict, settings_to_dict
from coopmap_env.envs.field import FieldSettings
from coopmap_env.envs.planar import PlanarSettings
from coopmap_env.evaluation import (
    Evaluation,
    MappedExtent,
    Policy,
    compare,
    episode_from_dict,
    episode_jobs,
    make_policy,
    policy_names,
    run_episode,
    summarize,
    write_episodes,
)
from coopmap_env.evaluation.episode_jobs import make_job, run_job
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.mapping.files import write_map_server
from coopmap_env.sensing import DepthCamera
from coopmap_env.simulation.scenes.planar import Obstacles

POLICIES = ["rating_function:search=10", "raster"]


def small_env(**arguments):
    arguments = {"scene": Obstacles(shape=(60, 60)), "max_scans": 4, "split": "test", **arguments}
    return planar_v1.parallel_env(**arguments)


def timeless(episode):
    return replace(episode, planning_time_ms=0.0)


def episode(seed=0, coverage_curve=(0.0, 0.1, 0.3), radius_std=1.0, max_radius=9.0):
    extent = MappedExtent(max_radius, 3.0, radius_std)
    return example_episode(seed, coverage_curve, extent=extent)


def test_the_area_under_the_curve_is_the_mean_of_its_trapezoids():
    # (0 + 0.1) / 2 = 0.05 and (0.1 + 0.3) / 2 = 0.2
    assert episode().coverage_auc == pytest.approx((0.05 + 0.2) / 2)
    assert episode().coverage == 0.3


def test_the_area_over_time_ends_where_the_time_runs_out():
    # scans end after 2, 4 and 10 s; straight to the last, the curve is at 0.4 after 7 s
    timed = replace(
        episode(coverage_curve=(0.0, 0.2, 0.3, 0.5)),
        elapsed_curve=[0.0, 2.0, 4.0, 10.0],
        max_time=7.0,
    )
    assert timed.coverage_auc == pytest.approx((0.2 + 0.5 + 1.05) / 7)
    assert timed.coverage == 0.5
    early = replace(timed, max_time=20.0)  # all scans were taken after 10 s
    assert early.coverage_auc == pytest.approx((0.2 + 0.5 + 2.4 + 5.0) / 20)
    assert timed.row()["elapsed_time"] == 10.0
    assert timed.row()["n_scans"] == 3


def test_scans_that_take_no_time_are_a_jump_of_the_curve():
    timed = replace(
        episode(coverage_curve=(0.0, 0.2, 0.8, 1.0)),
        elapsed_curve=[0.0, 5.0, 5.0, 8.0],
        max_time=8.0,
    )
    assert timed.coverage_auc == pytest.approx((0.5 + 2.7) / 8)


def test_curves_of_an_episode_that_time_has_ended_go_on_level():
    evaluation = Evaluation((episode(), episode(coverage_curve=(0.0, 0.2))))
    np.testing.assert_array_equal(evaluation.curves["coverage"], [[0, 0.1, 0.3], [0, 0.2, 0.2]])


def test_the_extent_of_two_observed_cells_by_hand():
    map_ = OccupancyMap(VoxelGrid((8, 8)))
    map_.mark_free([0 * 8 + 0, 3 * 8 + 4])  # centers (0.5, 0.5) and (3.5, 4.5)
    extent = MappedExtent.from_map(map_, np.array([0.5, 0.5]))
    assert (extent.max_radius, extent.mean_radius, extent.radius_std) == (5.0, 2.5, 2.5)


def test_an_episode_measures_what_the_environment_did():
    env, policy = small_env(), make_policy("rating_function:search=10")
    result = run_episode(env, policy, seed=3)
    map_ = env.belief().map
    assert len(result.coverage_curve) == 5
    assert result.coverage == map_.observed_fraction
    assert result.entropy_curve[-1] == map_.entropy
    assert result.n_rejected_actions == 0
    assert np.all(np.diff(result.coverage_curve) >= 0)


def test_the_same_seed_gives_the_same_episode_but_for_the_time():
    first = run_episode(small_env(), make_policy("rating_function:search=10"), seed=5)
    env, policy = small_env(), make_policy("rating_function:search=10")
    run_episode(env, policy, seed=1)
    assert timeless(run_episode(env, policy, seed=5)) == timeless(first)


def test_evaluate_takes_a_policy_object_and_returns_table_and_curves():
    result = evaluation.evaluate(small_env(), coopmap_baselines.make("random"), seeds=range(3))
    assert result.table["seed"].tolist() == [0, 1, 2]
    assert result.curves["coverage"].shape == (3, 5)
    assert np.array_equal(result.table["coverage"], result.curves["coverage"][:, -1])


def test_evaluate_without_seeds_says_so():
    with pytest.raises(ValueError, match="at least one seed"):
        evaluation.evaluate(small_env(), make_policy("random"), seeds=[])


def test_episodes_survive_json():
    original = run_episode(small_env(), make_policy("raster"), seed=0)
    assert episode_from_dict(json.loads(json.dumps(asdict(original)))) == original


def test_the_numbers_do_not_depend_on_the_number_of_workers(tmp_path):
    arguments = {"max_scans": 3, "split": "test"}
    one = compare(POLICIES, range(2), arguments, tmp_path / "a", progress=False)
    two = compare(POLICIES, range(2), arguments, tmp_path / "b", workers=2, progress=False)
    for name in POLICIES:
        assert list(map(timeless, one[name].episodes)) == list(map(timeless, two[name].episodes))


def test_splits_give_different_worlds_for_the_same_seed(tmp_path):
    coverage = {
        split: compare(["raster"], [0], {"max_scans": 2, "split": split}, tmp_path, progress=False)[
            "raster"
        ]
        .episodes[0]
        .coverage
        for split in ("train", "validation", "test")
    }
    assert len(set(coverage.values())) == 3


def test_a_bad_policy_is_rejected_before_any_episode(tmp_path):
    with pytest.raises(ValueError, match="unknown policy 'nobody'"):
        compare(["raster", "nobody"], range(2), {}, tmp_path / "new", progress=False)
    assert not (tmp_path / "new").exists()


def test_a_policy_that_is_installed_while_a_program_runs_is_found(monkeypatch):
    make_policy("random")
    module = import_module("coopmap_env.evaluation.policy")
    group = module.ENTRY_POINT_GROUP
    late = EntryPoint("late", "coopmap_baselines:RandomPolicy", group)
    installed = [*module.entry_points(group=group), late]
    monkeypatch.setattr(module, "entry_points", lambda group: installed)
    assert isinstance(make_policy("late"), coopmap_baselines.RandomPolicy)
    monkeypatch.undo()
    with pytest.raises(ValueError, match="unknown policy 'nobody'"):
        make_policy("nobody")  # forgets the policy of this test


def test_every_installed_policy_is_made_by_name():
    assert set(policy_names()) >= set(coopmap_baselines.POLICIES)
    for name in coopmap_baselines.POLICIES:
        assert isinstance(make_policy(name), Policy)


def test_options_of_a_spec_are_numbers_or_words():
    policy = make_policy("rating_function:search=exhaustive+coordination=sequential")
    assert (policy.search, policy.coordination) == ("exhaustive", "sequential")
    assert make_policy("rating_function:search=50").search == 50


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("raster:speed=3", "raster has no argument 'speed'; it takes none"),
        ("rating_function:search", "written key=value, got 'search'"),
        ("rating_function:search=0", "got 0"),
    ],
)
def test_bad_specs_name_the_option(spec, message):
    with pytest.raises(ValueError, match=message):
        make_policy(spec)


@pytest.mark.parametrize(
    "settings",
    [
        PlanarSettings.for_resolution(0.2),
        FieldSettings(physics="stepped", crop_cells=(8, 4), camera=DepthCamera(width=32)),
    ],
)
def test_settings_survive_json(settings):
    values = json.loads(json.dumps(settings_to_dict(settings)))
    assert settings_from_dict(values, type(settings)) == settings


def test_unknown_settings_are_named():
    with pytest.raises(ValueError, match="unknown settings \\['colour'\\]"):
        settings_from_dict({"colour": 1}, PlanarSettings)
    with pytest.raises(ValueError, match=r"unknown settings \['zoom'\]; known are \['depth"):
        settings_from_dict({"camera": {"zoom": 2}}, PlanarSettings)


def test_a_changed_mesh_changes_the_jobs_of_its_scene(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    scene = tmp_path / "scene.yaml"
    scene.write_text("objects:\n  - {mesh: part.stl, position: [0, 0, 0.5], target: true}\n")
    jobs = []
    for side in (1.0, 1.0, 1.1):
        trimesh.creation.box([side] * 3).export(tmp_path / "part.stl")
        jobs.append(make_job("random", 0, {"scene": str(scene)}, FieldSettings(), "field"))
    assert jobs[0] == jobs[1] != jobs[2]


def test_the_summary_compares_with_the_reference():
    better = Evaluation(tuple(episode(s, (0.0, 0.2, 0.4 + 0.01 * s)) for s in range(8)))
    worse = Evaluation(tuple(episode(s, (0.0, 0.1, 0.3 + 0.01 * s)) for s in range(8)))
    summary = summarize({"ref": worse, "new": better}, reference="ref")
    assert "comparison" not in summary["ref"]
    against = summary["new"]["comparison"]
    assert against["policy"] == "ref"
    assert against["probability_of_improvement"]["estimate"] == 1.0
    assert against["difference"]["estimate"] == pytest.approx(0.075)
    assert summary["ref"]["coverage"]["mean"]["estimate"] == pytest.approx(0.335)


def test_a_single_episode_has_no_interval():
    summary = summarize({"only": Evaluation((episode(),))}, reference="only")
    assert summary == {"only": {"episodes": 1}}


def test_the_table_has_one_row_for_each_policy_and_world(tmp_path):
    evaluations = {name: Evaluation((episode(0), episode(1))) for name in ("a", "b")}
    write_episodes(evaluations, tmp_path / "episodes.csv")
    rows = list(csv.DictReader((tmp_path / "episodes.csv").read_text().splitlines()))
    assert [(row["policy"], row["seed"]) for row in rows] == [
        ("a", "0"),
        ("a", "1"),
        ("b", "0"),
        ("b", "1"),
    ]
    assert float(rows[0]["coverage_auc"]) == episode().coverage_auc


def write_map(path, wall):
    occupied = np.zeros((30, 24))
    occupied[wall, 2:] = 1.0
    write_map_server(path, occupied, resolution=0.1, origin=(0.0, 0.0))


def test_a_changed_map_is_played_again(tmp_path):
    path = tmp_path / "map.yaml"
    arguments = {"scene": str(path), "max_scans": 3, "split": "test"}

    def coverage():
        result = compare(["raster"], [0], arguments, tmp_path / "store", progress=False)
        return result["raster"].episodes[0].coverage

    write_map(path, wall=15)
    first = coverage()
    assert coverage() == first
    write_map(path, wall=6)
    assert coverage() != first


def test_episodes_that_were_played_with_other_default_settings_are_played_again(
    tmp_path, monkeypatch
):
    def play(settings=None):
        arguments = {"max_scans": 3, "split": "test"}
        found = compare(["raster"], [0], arguments, tmp_path, settings, progress=False)
        return timeless(found["raster"].episodes[0])

    first = play()
    assert play(PlanarSettings()) == first
    assert len(list(tmp_path.glob("*.json"))) == 1  # the defaults by name are the defaults
    others = replace(PlanarSettings(), reach=4.0, initial_free_radius=1.0)
    monkeypatch.setattr(PlanarSettings, "for_resolution", lambda resolution: others)
    assert play() == play(others) != first
    assert len(list(tmp_path.glob("*.json"))) == 2


def test_the_default_settings_of_a_scene_are_those_of_its_job(tmp_path, monkeypatch):
    jobs = []
    module = import_module("coopmap_env.evaluation.comparison")
    monkeypatch.setattr(module, "run_job", lambda job: jobs.append(job) or run_job(job))
    write_map(tmp_path / "map.yaml", wall=15)
    arguments = {"scene": str(tmp_path / "map.yaml"), "max_scans": 1}  # cells of a decimetre
    compare(["random"], [0], arguments, tmp_path / "store", progress=False)
    defaults = planar_v1.parallel_env(**arguments).settings
    assert defaults != PlanarSettings()
    (job,) = jobs
    assert settings_from_dict(json.loads(json.dumps(job["settings"])), PlanarSettings) == defaults


class Reader:
    """A policy that is made from a file."""

    def __init__(self, notes="", fingerprint=""):
        self.fingerprint = fingerprint

    def reset(self, rng):
        pass

    def act(self, belief, observations):
        return {}


def test_the_content_of_a_file_in_a_spec_enters_the_job(tmp_path, monkeypatch):
    monkeypatch.setattr(episode_jobs, "make_policy", lambda spec: Reader())
    notes = tmp_path / "notes.txt"
    notes.write_bytes(b"one")
    before = make_job(f"reader:notes={notes}", 0, {}, PlanarSettings())
    assert make_job(f"reader:notes={notes}", 0, {}, PlanarSettings()) == before
    notes.write_bytes(b"two")
    assert make_job(f"reader:notes={notes}", 0, {}, PlanarSettings()) != before


def test_a_policy_fingerprint_enters_the_job(monkeypatch):
    jobs = []
    for fingerprint in ("one", "two"):
        episode_jobs._fingerprint.cache_clear()
        learned = Reader(fingerprint=fingerprint)
        monkeypatch.setattr(episode_jobs, "make_policy", lambda spec, learned=learned: learned)
        jobs.append(make_job("reader", 0, {}, PlanarSettings()))
    episode_jobs._fingerprint.cache_clear()
    assert [job["fingerprint"] for job in jobs] == ["one", "two"]


class Cheat:
    def reset(self, rng):
        pass

    def act(self, belief, observations):
        belief.map.mark_free(range(100))
        return {agent: np.zeros(3, dtype=np.float32) for agent in belief.agents}


def test_a_policy_that_changes_the_map_raises_an_error():
    with pytest.raises(RuntimeError, match="changed the map"):
        run_episode(small_env(), Cheat(), seed=0)


def test_an_object_that_is_no_policy_is_rejected():
    with pytest.raises(ValueError, match="needs the methods reset and act"):
        evaluation.evaluate(small_env(), object(), seeds=[0])
