"""The main job from end to end, as small as it goes."""

import csv
import json

import pytest
from plain.pages import check_report_page

from coopmap_env.studies.section3 import study as section3
from coopmap_env.studies.section3.setting import PAPER_TABLE_1, TABLE_1_SCORES, TableConstants
from coopmap_env.studies.section3.study import READINGS, Section3Size
from coopmap_env.studies.section3.table_fit.record import read_record

SMALL = Section3Size(
    worlds=4,
    sweep_worlds=2,
    k_factors=(0.5, 1.0),
    house_runs=1,
    calibration_worlds=1,
    clairvoyant=True,
)


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    report = pytest.importorskip("coopmap_env.studies.section3.report")
    for needed in ("matplotlib", "jinja2", "rtbdata", "PIL"):
        pytest.importorskip(needed)
    out = tmp_path_factory.mktemp("section3")
    study = section3.run_section3(
        out / "episodes", SMALL, workers=1, log=lambda _: None, progress=False
    )
    report.write_report(study, out)
    (out / "table.txt").write_text(report.text_table_1(study))
    return out


@pytest.mark.slow
def test_all_files_are_written(out):
    names = "report.html table1.csv figure7.png figure8.png summary.json render.png"
    for name in names.split():
        assert (out / name).stat().st_size > 500


@pytest.mark.slow
def test_table_1_has_the_papers_values_beside(out):
    rows = {
        row["search"]: row for row in csv.DictReader((out / "table1.csv").read_text().split("\n"))
    }
    assert list(rows) == [
        "m = 10",
        "m = 50",
        "m = 100",
        "m = 200",
        "m = 300",
        "exhaustive",
        "raster",
        "random",
        "clairvoyant, greedy",
    ]
    efficiency = {search: float(row["efficiency"]) for search, row in rows.items()}
    assert max(efficiency, key=efficiency.get) == "clairvoyant, greedy"
    assert efficiency["random"] < min(efficiency["m = 10"], efficiency["m = 300"])
    for search, (farthest, _, sigma) in PAPER_TABLE_1.items():
        row = rows[f"m = {search}" if isinstance(search, int) else search]
        assert (float(row["paper_max_radius"]), float(row["paper_radius_std"])) == (farthest, sigma)
        assert (
            float(row["radius_std_low"])
            <= float(row["radius_std"])
            <= float(row["radius_std_high"])
        )
    assert "54.89" in (out / "table.txt").read_text()


@pytest.mark.slow
def test_the_summary_gives_verdicts_not_assertions(out):
    summary = json.loads((out / "summary.json").read_text())
    assert set(summary["trends"]) == {"T1", "T2", "T3", "T4"}
    for trend in summary["trends"].values():
        assert isinstance(trend["held"], bool)
        assert {"statistic", "value", "p_value"} <= set(trend)
    assert summary["settings"]["planar"]["rating"]["K"] == TableConstants().K
    assert summary["settings"]["scene"]["shape"] == [TableConstants().side] * 2
    assert len(summary["readings"]) == len(READINGS)
    assert (
        summary["killian_court"]["gaussian_beam"]["all"]
        < summary["killian_court"]["hit_miss"]["all"]
    )


@pytest.mark.slow
def test_the_deviation_from_the_papers_numbers_is_that_of_the_table(out):
    summary = json.loads((out / "summary.json").read_text())
    deviations = [
        abs(summary["table_1"][label][column]["estimate"] / number - 1)
        for search, numbers in PAPER_TABLE_1.items()
        for label in (f"m = {search}" if isinstance(search, int) else search,)
        for column, number in zip(TABLE_1_SCORES, numbers, strict=True)
    ]
    interval = summary["mean_deviation"]
    assert interval["estimate"] == pytest.approx(sum(deviations) / 18)
    assert interval["low"] < interval["high"]
    assert "mean absolute relative deviation" in (out / "table.txt").read_text()


@pytest.mark.slow
def test_the_report_says_which_constants_the_table_determines(out):
    html = (out / "report.html").read_text()
    assert "field of view, degrees" in html
    assert '<td class="text">by the 18 numbers</td>' in html
    assert '<td class="text">by the observed fraction, not by the 18 numbers alone</td>' in html


@pytest.mark.slow
def test_the_report_says_what_the_record_played_and_what_the_command_plays(out):
    html = " ".join((out / "report.html").read_text().split())
    record = read_record()
    assert f"{record['trials']} trials of a search" in html
    assert "moved to 0.8 and 1.25 times its best value, on 16 further training worlds" in html
    assert "By default it plays more than was played for this one: 400 trials" in html
    assert f"{record['least_values']['first']:.3f} from the first robot's start" in html


@pytest.mark.slow
def test_the_report_is_self_contained(out):
    html = (out / "report.html").read_text()
    check_report_page(html)
    assert 'src="data:image/png;base64,' in html
    assert html.count('class="chart"') == 4
    assert "held" in html
