import json

import pytest
from plain.episodes import example_episode

from coopmap_env.cli import main
from coopmap_env.core.files import FileError
from coopmap_env.core.version import __version__
from coopmap_env.evaluation import Evaluation, report
from coopmap_env.evaluation.report import (
    differences,
    join_runs,
    table_lines,
    write_report,
)
from coopmap_env.evaluation.saved_run import RUN_FILE, SavedRun, load_run, save_run

ENV = {"id": "planar_v1", "scene": "obstacles", "n_robots": 2, "max_scans": 2, "split": "test"}


def evaluation(shift, seeds=(0, 1, 2)):
    return Evaluation(
        tuple(example_episode(seed, [0.0, 0.1 + 0.01 * seed, 0.2 + shift]) for seed in seeds)
    )


@pytest.fixture
def run():
    return SavedRun(ENV, {"raster": evaluation(0.0), "random": evaluation(0.1)})


def test_a_saved_run_is_read_as_it_was(run, tmp_path):
    save_run(run, tmp_path)
    assert load_run(tmp_path) == run
    assert load_run(tmp_path).n_robots == 2


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "run.json"),
        ("[]", "no env with n_robots"),
        (json.dumps({"env": ENV}), "no episodes of this version"),
        (json.dumps({"env": ENV, "episodes": {"raster": [{}]}}), "no episodes of this version"),
        (json.dumps({"env": ENV, "episodes": {}}), "no episodes of this version"),
    ],
)
def test_a_broken_run_is_one_error_that_names_the_file(content, message, tmp_path):
    (tmp_path / RUN_FILE).write_text(content)
    with pytest.raises(FileError, match=message) as raised:
        load_run(tmp_path)
    assert str(tmp_path / RUN_FILE) in str(raised.value)


def test_a_folder_without_a_run_says_who_writes_one(tmp_path):
    with pytest.raises(FileError, match=r"no run\.json in it, which coopmap evaluate writes"):
        load_run(tmp_path / "nothing")


def test_the_table_has_means_with_intervals(run):
    head, line, raster, random = table_lines(run)
    assert head.startswith("| policy | worlds | observed, %")
    assert set(line) == {"|", "-"}
    assert raster.startswith("| raster | 3      | 20.00 [20.00, 20.00]")
    assert "surface" not in head, "no episode has one"
    assert len({len(row) for row in (head, line, raster, random)}) == 1


def test_a_single_world_has_no_interval():
    _, _, row = table_lines(SavedRun(ENV, {"raster": evaluation(0.0, seeds=[0])}))
    assert "| 20.00 " in row
    assert "[" not in row


def test_runs_are_joined_and_equal_policies_are_named_with_their_run(run):
    other = SavedRun(ENV, {"raster": evaluation(0.2), "frontier": evaluation(0.3)})
    joined = join_runs({"a": run, "b": other})
    assert list(joined.evaluations) == ["raster (a)", "random", "raster (b)", "frontier"]
    assert joined.evaluations["raster (b)"] is other.evaluations["raster"]


def test_runs_of_the_same_worlds_need_no_note_and_others_do(run):
    assert differences({"a": run, "b": run}) == []
    rooms = SavedRun({**ENV, "scene": "rooms"}, {"raster": evaluation(0.0, seeds=[5, 6])})
    scene, worlds = differences({"a": run, "b": rooms})
    assert scene == "scene differs: obstacles in a; rooms in b"
    assert worlds.startswith("the worlds differ")


def test_the_report_has_the_table_the_notes_and_the_figure(run, tmp_path):
    pytest.importorskip("matplotlib")
    paths = write_report(run, tmp_path, "a title", ["a note"])
    assert [path.name for path in paths] == ["report.md", "figure.png"]
    text = (tmp_path / "report.md").read_text()
    assert text.startswith("# a title\n")
    assert "\n".join(table_lines(run)) in text
    assert "- a note\n" in text
    assert f"\ncoopmap {__version__}, python " in text
    assert "](figure.png)" in text
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")


def test_the_report_of_a_command_has_its_line(run, tmp_path):
    write_report(run, tmp_path, "a title", command="coopmap evaluate --episodes 3")
    assert "```\ncoopmap evaluate --episodes 3\n```\n" in (tmp_path / "report.md").read_text()


def test_a_missing_figure_is_said_in_one_line(monkeypatch):
    assert report.missing_figure_text() is None
    monkeypatch.setattr(report, "missing_extras", lambda extras: {"report": ["matplotlib"]})
    line = "figure.png is left out, which needs: pip install 'coopmap[report]'"
    assert report.missing_figure_text() == line


def test_evaluate_writes_the_report_and_says_what_is_missing(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(report, "missing_extras", lambda extras: {"report": ["matplotlib"]})
    out = tmp_path / "of one"
    main(
        ["evaluate", "--policies", "raster", "--episodes", "2", "--max-scans", "1", "--out",
         str(out)]
    )  # fmt: skip
    text = (out / "report.md").read_text()
    line = f"coopmap evaluate --max-scans 1 --out '{out}' --policies raster --episodes 2"
    assert sorted(line.split()) == sorted(text.split("```")[1].split())
    assert "| raster | 2 " in text
    assert "figure.png is left out, which needs: pip install" in capsys.readouterr().err
    assert (out / "episodes.csv").is_file()


def test_without_matplotlib_there_is_no_figure(run, tmp_path, monkeypatch):
    monkeypatch.setattr(report, "missing_extras", lambda extras: {"report": ["matplotlib"]})
    assert [path.name for path in write_report(run, tmp_path, "a title")] == ["report.md"]
    assert "figure" not in (tmp_path / "report.md").read_text()


def test_the_command_compares_folders(run, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(report, "missing_extras", lambda extras: {"report": ["matplotlib"]})
    folders = [tmp_path / "a", tmp_path / "b"]
    for folder in folders:
        folder.mkdir()
        save_run(run, folder)
    main(["report", *map(str, folders), "--out", str(tmp_path / "both")])
    printed = capsys.readouterr()
    assert f"raster ({folders[1]})" in printed.out
    assert printed.err.splitlines()[-1].endswith(f"results: {tmp_path / 'both'}")
    assert (tmp_path / "both" / "report.md").is_file()


def test_the_command_names_a_folder_that_has_no_run(tmp_path):
    with pytest.raises(SystemExit, match=r"^coopmap: .*no run\.json in it"):
        main(["report", str(tmp_path)])
