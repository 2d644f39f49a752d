"""Names from policies, scenes and mounts are text on pages, never markup, scripts or paths."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from coopmap_env.evaluation import make_policy
from coopmap_env.evaluation.replay import Frame, Replay
from coopmap_env.evaluation.replay.page import _overlay, _RobotNodes
from coopmap_env.geometry import Pose
from coopmap_env.mapping import VoxelGrid
from coopmap_env.robots import Vehicle
from coopmap_env.sensing import DepthCamera
from coopmap_env.studies.common import pages

HOSTILE = "</script><script>alert(1)</script><!--<script>&\"'\u2028"


def small_replay(title, vehicle=None):
    vehicle = vehicle or Vehicle.from_mount("mast", Pose(np.zeros(3), np.eye(3)))
    frame = Frame(
        (vehicle.home,), (vehicle.camera_pose(vehicle.home),), np.empty(0, np.int64), 0.5, (0.0,),
        (title,),
    )  # fmt: skip
    target = np.array([[[0.0, -0.5, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 1.0]]])
    grid = VoxelGrid((40, 40, 20), 0.1, (-2.0, -2.0, -0.05))
    empty = np.empty((0, 3, 3))
    return Replay(title, grid, target, empty, (vehicle,), DepthCamera(), (frame, frame))


def test_titles_and_notes_of_a_replay_cannot_end_or_hide_its_script():
    overlay = _overlay(small_replay(HOSTILE))
    assert overlay.count("<script") == overlay.count("</script") == 1
    assert "<!--" not in overlay
    data = json.loads(re.search(r"const data = (\{.*\});", overlay).group(1))
    assert data["title"] == HOSTILE
    assert data["notes"] == [[HOSTILE], [HOSTILE]]


class Scene:
    """Keeps the names of nodes, as viser does: a second node of a name replaces the first."""

    def __init__(self):
        self.names = []

    def add_mesh_simple(self, name, *_, **__):
        self.names.append(name)
        return self

    add_camera_frustum = add_mesh_simple


def test_links_of_any_name_are_nodes_of_their_own():
    vehicle = Vehicle.from_mount("mast", Pose(np.zeros(3), np.eye(3)))
    names = tuple(
        ("camera", "a/b", "../robot_1")[k % 3] for k in range(len(vehicle.chain.link_names))
    )
    hostile = replace(vehicle, chain=replace(vehicle.chain, link_names=names))
    scene = Scene()
    _RobotNodes(scene, small_replay("a mast", hostile), 0)
    assert len(scene.names) > 2
    assert len(set(scene.names)) == len(scene.names)
    assert all(re.fullmatch(r"/robot_0/(links/\d+|camera)", name) for name in scene.names)


@pytest.fixture
def template(tmp_path, monkeypatch):
    pytest.importorskip("jinja2")
    monkeypatch.setattr(pages, "STUDIES", tmp_path)
    (tmp_path / "report.html").write_text(
        "<b>{{ name|code }}</b>{% if picture %}{{ image(picture) }}{% endif %}"
    )
    (tmp_path / "figures").mkdir()
    return lambda **values: pages.render_template("report.html", tmp_path / "figures", **values)


def test_names_on_report_pages_are_escaped(template):
    page = template(name="<script>alert('1')</script>", picture="")
    assert page == "<b>&lt;script&gt;alert(&#39;1&#39;)&lt;/script&gt;</b>"


def test_names_between_backticks_are_code(template):
    page = template(name="`a<b` is lower than `c`, by 1 & more", picture="")
    assert page == ("<b><code>a&lt;b</code> is lower than <code>c</code>, by 1 &amp; more</b>")


def test_tables_scroll_in_boxes_and_the_contents_list_every_heading():
    html = (
        "<nav></nav><h2>Maps &amp; <code>poses</code></h2><table><tr></tr></table>"
        "<h3>all scores</h3><h2>Field\n2</h2><h3>all scores</h3>"
    )
    page = pages.with_contents(pages.with_scroll_boxes(html))
    assert page == (
        '<nav aria-label="Contents"><h2>Contents</h2>\n<ul>\n'
        '<li class="level-2"><a href="#maps-poses">Maps &amp; poses</a></li>\n'
        '<li class="level-3"><a href="#all-scores">all scores</a></li>\n'
        '<li class="level-2"><a href="#field-2">Field\n2</a></li>\n'
        '<li class="level-3"><a href="#all-scores-2">all scores</a></li>\n</ul></nav>'
        '<h2 id="maps-poses">Maps &amp; <code>poses</code></h2>'
        '<div class="scroll" tabindex="0"><table><tr></tr></table></div>'
        '<h3 id="all-scores">all scores</h3><h2 id="field-2">Field\n2</h2>'
        '<h3 id="all-scores-2">all scores</h3>'
    )


def test_a_page_shows_pictures_of_its_own_folder_only(template, tmp_path):
    (tmp_path / "figures" / "curve.png").write_bytes(b"curve")
    (tmp_path / "secret.png").write_bytes(b"secret")
    assert template(name="", picture="curve.png") == "<b></b>data:image/png;base64,Y3VydmU="
    for name in ("../secret.png", str(tmp_path / "secret.png"), "figures/../../secret.png"):
        with pytest.raises(ValueError, match=r"a page's picture must be a file in .*figures, got"):
            template(name="", picture=name)


@pytest.mark.parametrize(
    ("spec", "named"),
    [
        ("nobody", "unknown policy 'nobody'.*rating_function"),
        ("", "unknown policy ''.*rating_function"),
        ("x" * 10**6, "unknown policy 'xxx.*'; choose from "),
        ("random:search", r"policy 'random:search': an option is written key=value, got 'search'"),
        ("random:a=1", r"policy 'random:a=1': random has no argument 'a'; it takes "),
        ("rating_function:search=1+search=2", "the option 'search' is given twice"),
        ("random:a=" + "(" * 10**4, "random has no argument 'a'"),
        ("random:a=" + "-" * 10**5 + "1", "random has no argument 'a'"),
        ("random:a={[]:1}", "random has no argument 'a'"),
        ("random:a=\0", "random has no argument 'a'"),
        ("random:=1", "random has no argument ''"),
    ],
)
def test_a_policy_s_spec_that_is_none_is_refused_in_one_line(spec, named):
    with pytest.raises(ValueError, match=named) as caught:
        make_policy(spec)
    assert len(str(caught.value)) < 1000
