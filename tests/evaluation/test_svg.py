import re

import numpy as np
import pytest
from plain.episodes import example_episode

pytest.importorskip("matplotlib")

from coopmap_env.evaluation import Evaluation
from coopmap_env.evaluation.figures import (
    COLORS,
    draw_coverage_curves,
    import_pyplot,
    label_curves,
    plot_band,
    plot_bars,
    save_chart,
    spread,
    wrap_label,
)
from coopmap_env.evaluation.svg import add_readings, save_svg, svg_panels

HOSTILE = "</svg><script>alert('a') & \"b\"</script>"


@pytest.fixture
def figure():
    figure, axes = import_pyplot().subplots(1, 2, figsize=(8, 3))
    for axis in axes:
        axis.set(xlabel="scans", ylabel="% observed")
    yield figure
    import_pyplot().close(figure)


def test_values_are_titles_of_circles_with_the_labels_of_the_axes(figure, tmp_path):
    plot_bars(figure.axes[0], [1, 2], [10.0, 20.5], ([9.0, 19.0], [11.0, 22.0]), "raster", "C0")
    save_svg(figure, tmp_path / "curve.svg")
    first, second = svg_panels(tmp_path / "curve.svg")
    titles = re.findall(r'<circle [^>]*class="reading"[^>]*><title>([^<]*)</title>', first)
    assert titles == [
        "raster\nscans: 1\n% observed: 10 [9, 11]",
        "raster\nscans: 2\n% observed: 20.5 [19, 22]",
    ]
    assert "<title>" not in second


def test_a_circle_is_where_its_point_is(figure, tmp_path):
    axis = figure.axes[0]
    axis.set(xlim=(0, 10), ylim=(0, 10))
    add_readings(axis, "corner", [2.5], [10.0], places=[5.0])
    save_svg(figure, tmp_path / "point.svg")
    panel = svg_panels(tmp_path / "point.svg")[0]
    x, y = (float(re.search(rf'<circle [^>]*c{c}="([\d.]+)"', panel).group(1)) for c in "xy")
    box = axis.get_position()
    assert x == pytest.approx(72 * 8 * (box.x0 + box.x1) / 2, abs=0.1)
    assert y == pytest.approx(72 * 3 * (1 - box.y1), abs=0.1)


def test_a_point_that_is_not_finite_has_no_circle(figure, tmp_path):
    add_readings(figure.axes[0], "gap", [1.0, 2.0], [np.nan, 3.0])
    save_svg(figure, tmp_path / "gap.svg")
    assert svg_panels(tmp_path / "gap.svg")[0].count("<circle") == 1


def test_panels_show_their_axis_and_the_legend_comes_first(figure, tmp_path):
    for axis in figure.axes:
        axis.plot([0, 1], [0, 1], label="line")
    figure.legend(loc="upper center")
    save_svg(figure, tmp_path / "two.svg")
    legend, *panels = svg_panels(tmp_path / "two.svg")
    assert legend.startswith('<div class="legend"><svg')
    assert "line" in legend
    views = [list(map(float, re.search(r'viewBox="([^"]+)"', p).group(1).split())) for p in panels]
    assert len(views) == 2
    assert views[0][0] + views[0][2] <= views[1][0] + 8  # two margins of four points
    for panel in panels:
        assert panel.count(">scans</text>") == 1


def test_a_figure_of_a_page_names_itself_and_loads_nothing(figure, tmp_path):
    for name in ("one", "two"):
        figure.axes[0].plot([0, 1], [0, 1], "o-")
        save_svg(figure, tmp_path / f"{name}.svg")
    pages = ["".join(svg_panels(tmp_path / f"{name}.svg")) for name in ("one", "two")]
    ids = [re.findall(r' id="([^"]+)"', page) for page in pages]
    assert all(name.startswith("one-") for name in ids[0])
    assert not set(ids[0]) & set(ids[1])
    for page, known in zip(pages, ids, strict=True):
        assert "http" not in page
        assert "metadata" not in page
        assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', page)) <= set(known)


def test_writing_twice_gives_the_same_bytes(figure, tmp_path):
    figure.axes[0].plot([0, 1], [0, 1], "o-")
    for name in ("a", "b"):
        save_svg(figure, tmp_path / name / "figure.svg")
    first, second = ((tmp_path / name / "figure.svg").read_bytes() for name in ("a", "b"))
    assert first == second


def test_names_are_text_and_never_markup(figure, tmp_path):
    plot_band(figure.axes[0], [0, 1], [0, 1], None, HOSTILE, COLORS[0])
    label_curves(figure.axes[0])
    save_svg(figure, tmp_path / "hostile.svg")
    page = "".join(svg_panels(tmp_path / "hostile.svg"))
    assert "<script" not in page
    assert page.count("</svg>") == 2


def test_a_chart_is_a_png_and_an_svg(figure, tmp_path):
    save_chart(figure, tmp_path / "chart.png")
    assert (tmp_path / "chart.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "chart.svg").read_text().startswith("<svg")


@pytest.mark.parametrize("seed", range(5))
def test_labels_keep_their_order_and_do_not_overlap(seed):
    rng = np.random.default_rng(seed)
    wanted, sizes = rng.uniform(0, 1, 6), rng.uniform(0.02, 0.15, 6)
    found = spread(wanted, sizes)
    order = np.argsort(wanted)
    assert (np.argsort(found) == order).all()
    gaps = np.diff(found[order]) - (sizes[order][1:] + sizes[order][:-1]) / 2
    assert (gaps > -1e-9).all()
    assert ((found - sizes / 2 > -1e-9) & (found + sizes / 2 < 1 + 1e-9)).all()


def test_labels_that_have_room_stay_where_they_belong():
    assert spread([0.8, 0.2], [0.1, 0.1]) == pytest.approx([0.8, 0.2])
    # two at one place share the way
    assert spread([0.5, 0.5], [0.1, 0.1]) == pytest.approx([0.45, 0.55])


def test_long_names_of_policies_break_at_their_options():
    assert wrap_label("m = 10") == "m = 10"
    assert wrap_label("rating_function:search=30+coordination=sequential") == (
        "rating_function:\nsearch=30+\ncoordination=sequential"
    )


def test_every_curve_has_one_label_in_its_colour(figure):
    axis = figure.axes[0]
    for k, name in enumerate(("first", "second")):
        plot_band(axis, [0, 1, 2], [2, 1 + k, 0], None, name, COLORS[k])
    label_curves(axis, at_height=1.5)
    assert [text.get_text() for text in axis.texts] == ["first", "second"]
    assert [text.get_color() for text in axis.texts] == list(COLORS[:2])
    assert [text.xy for text in axis.texts] == [(1.0, 1.0), (2.0, 0.0)]


@pytest.mark.parametrize(("n_worlds", "n_bands"), [(1, 0), (3, 1)])
def test_the_curve_of_a_single_world_has_no_band(n_worlds, n_bands, tmp_path):
    episodes = tuple(example_episode(seed) for seed in range(n_worlds))
    draw_coverage_curves({"raster": Evaluation(episodes)}, 2, tmp_path / "curve.png", "a title")
    (panel,) = svg_panels(tmp_path / "curve.svg")
    titles = re.findall(r"<title>([^<]*)</title>", panel)
    assert len(titles) == 3
    assert titles[-1].startswith("raster\nscans of the team: 4\n% of world observed: 30")
    assert len(re.findall(r'id="[^"]*PolyCollection_\d+"', panel)) == n_bands
    assert titles[-1].endswith("]") == bool(n_bands)
