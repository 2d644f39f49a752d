"""The field's part of the report, small."""

import json
import re
from html import escape, unescape

import pytest
from plain.pages import MAX_BYTES

from coopmap_env.cli import main
from coopmap_env.core.extras import EXTRAS, missing_extras
from coopmap_env.studies.common.pages import render_template
from coopmap_env.studies.field import study as field_study
from coopmap_env.studies.field.report import (
    MAP_COLUMNS,
    REPLAY_FILE,
    SCORE_COLUMNS,
    TABLE_SCORES,
    field_summary,
    field_text_table,
    write_field_figures,
)
from coopmap_env.studies.field.study import RANDOM, FieldSize

for module in ("pybullet", "pyoctomap", "viser", "skimage", "matplotlib"):
    pytest.importorskip(module)

SIZE = FieldSize(2, ("rating_function:search=10", RANDOM))


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(field_study, "SCANS_EACH", 2)
        return field_study.run_field_study(tmp_path_factory.mktemp("store"), SIZE, 1, print)


def test_every_policy_is_scored_against_the_surface_on_every_world(study):
    assert set(study.evaluations) == set(SIZE.policies)
    for evaluation in study.evaluations.values():
        assert len(evaluation.episodes) == 2
        assert evaluation.curves["surface_coverage"].shape == (2, 3)
        assert set(TABLE_SCORES) <= set(evaluation.table)
        assert ((evaluation.table["f_score"] > 0) & (evaluation.table["f_score"] < 1)).all()


def test_octomap_fuses_the_scans_of_the_recorded_episode(study):
    assert study.octomap.n_scans == 4
    assert study.octomap.agreement > 0.9
    losses = [s.log_loss for s in (study.octomap.ours, study.octomap.tuned, study.octomap.default)]
    assert losses == sorted(losses)


def test_the_summary_is_json_and_the_table_names_every_policy(study):
    summary = json.loads(json.dumps(field_summary(study)))
    assert summary["policies"][RANDOM]["comparison"]["policy"] == SIZE.policies[0]
    assert summary["octomap"]["n_scans"] == 4
    for policy in SIZE.policies:
        assert policy in field_text_table(study)


def test_all_parts_are_written(study, tmp_path):
    write_field_figures(study, tmp_path)
    names = {
        "field_surface.png", "field_surface.svg", "field_render.png", "stereo.png",
        "field_replay.html",
    }  # fmt: skip
    assert {path.name for path in tmp_path.iterdir()} == names


def test_the_page_has_the_tables_and_the_replay_in_it(study, tmp_path):
    pytest.importorskip("jinja2")
    write_field_figures(study, tmp_path)
    replay = (tmp_path / REPLAY_FILE).read_text(encoding="utf-8")
    page = render_template(
        "field/report.html",
        tmp_path,
        field=field_summary(study),
        field_columns=SCORE_COLUMNS,
        field_map_columns=MAP_COLUMNS,
        replay=replay,
    )
    embedded = re.search(r'<iframe [^>]*loading="lazy" srcdoc="([^"]*)"></iframe>', page).group(1)
    assert unescape(embedded) == replay
    for column in (*SCORE_COLUMNS, *MAP_COLUMNS):
        assert f"<th>{escape(column.title, quote=False)}</th>" in page
    assert page.count("<table") == page.count('<div class="scroll"') == 3
    assert page.count("<title>") > 5
    assert len(page.encode()) < MAX_BYTES


def test_no_extra_is_missing_in_the_development_environment():
    elsewhere = {"benchmarl"}  # it has an environment of its own
    assert missing_extras(EXTRAS.keys() - elsewhere) == {}


def test_the_replay_command_writes_a_page(tmp_path):
    page = tmp_path / "replay.html"
    main(["replay", "--policy", "random", "--max-scans", "1", "--out", str(page)])
    assert page.read_text(encoding="utf-8").lstrip().lower().startswith("<!doctype html>")
