"""The leaderboard's page and commands."""

import json
import re
import tempfile
from pathlib import Path

import pytest
import tyro
from plain.small_families import with_small_families

from coopmap_env.core.files import FileError
from coopmap_env.evaluation.comparison import EFFICIENCY_SCORES
from coopmap_env.evaluation.statistics import Interval
from coopmap_env.studies.commands.score import Score
from coopmap_env.studies.commands.submit import Submit
from coopmap_env.studies.leaderboard.page import link_from, write_page, write_tables
from coopmap_env.studies.leaderboard.ranking import rank
from coopmap_env.studies.leaderboard.score import FIELD_SCORES, SCORES, Scored, line
from coopmap_env.studies.leaderboard.submission import SubmissionError

HOSTILE = "</td><script>alert(1)</script>&\"'"


@pytest.fixture(scope="module", autouse=True)
def small_families():
    with pytest.MonkeyPatch.context() as patch:
        with_small_families(patch)
        yield


def made_up(policy, area=None, shown_auc=0.2, family="tiny", private=None, n=200, **reported):
    values = dict.fromkeys(SCORES, 0.5) | {"shown_auc": shown_auc, "motion_distance": 50.0}
    if area is not None:
        values |= dict(zip(EFFICIENCY_SCORES, (0.75, area), strict=True))
    submission = {
        "family": family,
        "private": private,
        "policy": policy,
        "fingerprint": "",
        "options": {"action_mode": "candidates", "n_candidates": 7},
        "n_worlds": n,
        "reported": {
            "decision_ms": 1.25,
            "model_bytes": None,
            "n_parameters": None,
            "machine": {"processor": "abacus"},
            "versions": {"coopmap": "0.4.0"},
            **reported,
        },
    }
    scores = {name: Interval(value, value - 0.01, value + 0.01) for name, value in values.items()}
    by_world = {name: [value - 0.01, value + 0.03] for name, value in values.items()}
    return Scored(Path(f"board/{policy[:5].strip('</')}.json"), submission, scores, by_world)


def rows(page):
    return re.findall(r"<tr><td>.*?</tr>", page, re.DOTALL)


def test_the_area_ranks_and_where_bounds_are_missing_what_was_shown(tmp_path):
    low, high = made_up("low", 0.4, 0.9), made_up("high", 0.6, 0.1)
    (ranking,) = rank([low, high])
    assert [one.submission["policy"] for one in ranking.entries] == ["high", "low"]
    write_page(tmp_path / "page.html", [low, high], {})
    page = (tmp_path / "page.html").read_text()
    assert "Ranked by the efficiency of the area" in page
    assert [">low</a>" in row for row in rows(page)] == [False, True]
    for text in (
        "60.0<",
        "[59.0, 61.0]",
        "75.0<",
        "[74.0, 76.0]",
        "1.25",
        "candidates (7)",
    ):
        assert text in rows(page)[0]

    (ranking,) = rank([low, made_up("high", None, 0.1)])
    assert [one.submission["policy"] for one in ranking.entries] == ["low", "high"]
    assert ranking.score == "shown_auc"
    write_page(tmp_path / "page.html", ranking.entries, {})
    page = (tmp_path / "page.html").read_text()
    assert "bounds are not known for all entries" in page.replace("\n", " ")
    assert rows(page)[1].count("<td>–</td>") == 3  # the model, too
    assert "80.0<" in rows(page)[1]  # behind the first one


def field_entry(policy, area):
    entry = made_up(policy, shown_auc=1 - area)
    for name in FIELD_SCORES:
        entry.scores[name] = Interval(area, area - 0.01, area + 0.01)
        entry.by_world[name] = [area, area]
    return entry


def test_in_the_field_the_covered_surface_ranks(tmp_path):
    entries = [field_entry("air", 0.2), field_entry("surface", 0.7)]
    (ranking,) = rank(entries)
    assert [one.submission["policy"] for one in ranking.entries] == ["surface", "air"]
    write_page(tmp_path / "page.html", entries, {})
    page = (tmp_path / "page.html").read_text()
    assert "Ranked by the area under the curve of the covered surface" in page
    assert "<th>surface area, %</th>" in page
    assert "efficiency, area" not in page
    assert ">surface</a>" in rows(page)[0]
    assert "surface 20.0 [19.0, 21.0] %" in line(entries[0])


def test_tables_in_markdown_have_the_rows_of_the_page(tmp_path):
    write_tables(tmp_path / "tables.md", [made_up("low", 0.4), made_up("high", 0.6)])
    text = (tmp_path / "tables.md").read_text()
    assert "## tiny, 200 worlds" in text
    high, low = (row for row in text.splitlines() if "`" in row and row.startswith("| "))
    assert high.startswith("| 1 | `high` | candidates (7) | 60.0 [59.0, 61.0] |  | 75.0 [74.0, ")
    assert low.startswith("| 2 | `low` | candidates (7) | 40.0 [39.0, 41.0] | 20.0 [20.0, 20.0] | ")
    assert low.endswith("| 50.0 [50.0, 50.0] | 1.25 |")
    write_tables(tmp_path / "tables.md", [made_up("unbounded", None)])
    assert (
        "| `unbounded` | candidates (7) | - |  | - | 50.0" in (tmp_path / "tables.md").read_text()
    )


def test_how_far_an_entry_is_behind_is_counted_world_by_world():
    first, second = made_up("first", 0.6), made_up("second", 0.4)
    first.by_world["efficiency_auc"][:] = [0.9, 0.5, 0.4]
    second.by_world["efficiency_auc"][:] = [0.6, 0.4, 0.2]
    (ranking,) = rank([second, first])
    none, behind = ranking.behind
    assert none == Interval(0.0, 0.0, 0.0)
    assert behind.estimate == pytest.approx(0.2)
    assert 0.099 < behind.low < 0.2 < behind.high < 0.301


def test_what_all_report_is_written_once(tmp_path):
    entries = [made_up("a", 0.4), made_up("b", 0.5)]
    write_page(tmp_path / "page.html", entries, {})
    page = (tmp_path / "page.html").read_text()
    assert page.count("<li>Reported: processor abacus, coopmap 0.4.0.</li>") == 1
    write_page(tmp_path / "page.html", [*entries, made_up("c", 0.3, machine={"cores": 3})], {})
    page = (tmp_path / "page.html").read_text()
    assert "processor abacus, coopmap 0.4.0 (b.json, a.json)." in page
    assert "cores 3, coopmap 0.4.0 (c.json)." in page


def test_the_page_has_the_fingerprint_of_a_model(tmp_path):
    entry = made_up("a", 0.4, n_parameters=5)
    entry.submission["fingerprint"] = "0123456789abcdef"
    write_page(tmp_path / "page.html", [entry], {})
    assert "<td>5 parameters<br>0123456789ab</td>" in (tmp_path / "page.html").read_text()


def test_each_family_has_a_table_and_private_worlds_have_their_own(tmp_path):
    entries = [
        made_up("a", 0.4),
        made_up("b", 0.5, family="hasty"),
        made_up("c", 0.6, private="ab"),
    ]
    write_page(tmp_path / "page.html", entries, {})
    page = (tmp_path / "page.html").read_text()
    assert re.findall(r"<h2>(.*?)</h2>", page) == [
        "hasty, 200 worlds",
        "tiny, 200 worlds",
        "tiny, 200 private worlds of the salt ab",
    ]
    assert page.count("<table>") == 3
    assert "Tiny worlds with a clock." in page


def test_only_submissions_on_the_same_worlds_are_ranked_with_each_other(tmp_path):
    entries = [
        made_up("few", 0.9, n=20),
        made_up("many", 0.4),
        made_up("few more", 0.8, n=20),
        made_up("most", 0.5),
        made_up("unbounded", None, n=50),
    ]
    tables = rank(entries)
    assert [ranking.n_worlds for ranking in tables] == [200, 50, 20]
    assert [[one.submission["policy"] for one in ranking.entries] for ranking in tables] == [
        ["most", "many"],
        ["unbounded"],
        ["few", "few more"],
    ]
    assert [ranking.score for ranking in tables] == [
        "efficiency_auc",
        "shown_auc",
        "efficiency_auc",
    ]
    write_page(tmp_path / "page.html", entries, {})
    page = (tmp_path / "page.html").read_text()
    assert re.findall(r"<h2>(.*?)</h2>", page) == [
        "tiny, 200 worlds",
        "tiny, 50 worlds",
        "tiny, 20 worlds",
    ]
    assert "each number of worlds has a table of its own" in page


def test_names_are_text_and_failures_are_listed(tmp_path):
    entry = made_up(HOSTILE, 0.5, machine={HOSTILE: HOSTILE})
    write_page(tmp_path / "page.html", [entry], {Path("bad.json"): f"bad.json: {HOSTILE}"})
    page = (tmp_path / "page.html").read_text()
    assert "<script" not in page
    assert page.count("&lt;script&gt;") == 4  # the policy, the machine twice, the failure
    assert "Not verified" in page


def test_a_long_policy_can_be_wrapped_at_its_options(tmp_path):
    write_page(tmp_path / "page.html", [made_up("p:a=1+b=<2", 0.5)], {})
    assert ">p:<wbr>a=1+<wbr>b=&lt;2</a>" in (tmp_path / "page.html").read_text()


def test_links_are_relative_and_quoted(tmp_path):
    assert link_from(tmp_path, tmp_path / "a b.json") == "a%20b.json"
    assert link_from(tmp_path / "pages", tmp_path / "javascript:x.json") == "../javascript%3Ax.json"


def test_a_line_has_what_was_scored_and_what_is_reported():
    text = line(made_up("frontier", 0.5, n_parameters=12_345, model_bytes=49_380))
    for part in (
        "frontier ",
        "tiny, 200 worlds, candidates (7)",
        "end 75.0 [74.0, 76.0] %",
        "area 50.0 [49.0, 51.0] %",
        "shown 50.0 ",
        "motion 50.0 [50.0, 50.0]",
        "decision 1.250 ms (reported)",
        "model 12,345 parameters, 0.05 MB",
    ):
        assert part in text
    assert "efficiency" not in line(made_up("frontier"))
    assert line(made_up("frontier")).endswith("model -")


@pytest.fixture(scope="module")
def board(small_families, tmp_path_factory):
    """A folder with two submissions, made by the command."""
    folder = tmp_path_factory.mktemp("board")
    salt = folder / "salt"
    salt.write_bytes(b"0123456789abcdef")
    for name, more in (("frontier", []), ("raster", ["--salt", str(salt)])):
        tyro.cli(Submit, args=[
            "--family", "tiny", "--policy", name, "--episodes", "2",
            "--out", str(folder / f"{name}.json"), *more,
        ]).run()  # fmt: skip
    return folder


def test_the_command_scores_a_folder_and_writes_the_page(board, capsys, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(board / "temporary"))
    (board / "bounds").mkdir()  # beside the files, a folder of others means nothing
    tyro.cli(Score, args=[str(board), "--salt", str(board / "salt"),
                          "--page", str(board / "page.html")]).run()  # fmt: skip
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("frontier ")
    assert "tiny, 2 private worlds" in second
    (own,) = (board / "temporary").iterdir()
    assert len(list((own / "bounds").iterdir())) == 4
    assert not list((board / "bounds").iterdir())
    page = (board / "page.html").read_text()
    assert 'href="frontier.json"' in page
    assert len(rows(page)) == 2


def test_the_command_fails_after_all_files_if_one_does_not_replay(board, tmp_path, capsys):
    bad = json.loads((board / "frontier.json").read_text())
    bad["episodes"][0]["scores"]["shown"] = 0.99
    (tmp_path / "bad.json").write_text(json.dumps(bad))
    (tmp_path / "good.json").write_bytes((board / "frontier.json").read_bytes())
    command = Score(files=(tmp_path,), page=tmp_path / "page.html", efficiency=False)
    with pytest.raises(SubmissionError, match=r"bad\.json: does not replay: world 0: shown 0\.99"):
        command.run()
    (out,) = capsys.readouterr().out.splitlines()
    assert "efficiency" not in out
    page = (tmp_path / "page.html").read_text()
    assert "Not verified" in page
    assert len(rows(page)) == 1
    assert not (tmp_path / "bounds").exists()


def test_the_command_names_a_missing_salt_and_missing_files(board):
    with pytest.raises(FileError, match=r"raster\.json: its worlds are private"):
        Score(files=(board / "raster.json",), efficiency=False).run()
    with pytest.raises(ValueError, match="no files to score"):
        Score(files=()).run()
