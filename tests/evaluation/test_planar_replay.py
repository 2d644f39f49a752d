import base64
import json
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from browser import find_browser

from coopmap_env.cli import main
from coopmap_env.cli.replay import Replay as ReplayCommand
from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation import make_policy, rollout
from coopmap_env.evaluation.replay import planar_page, record_replay, write_replay
from coopmap_env.evaluation.replay.planar_page import render_planar_page, run_lengths, varints
from coopmap_env.evaluation.replay.planar_recording import occupancy_levels
from coopmap_env.simulation.scenes.planar import Obstacles

SEED, N_SCANS = 3, 4
HOSTILE = "</script><script>alert(1)</script><!--<script>&\"'\u2028"


def make_env(**changes):
    arguments = {"scene": Obstacles(shape=(48, 40)), "max_scans": N_SCANS, "split": "test"}
    return PlanarEnv(**(arguments | changes))


@pytest.fixture(scope="module")
def replay():
    return record_replay(make_env(), make_policy("random"), SEED)


@pytest.fixture(scope="module")
def bounded():
    """Return a replay with what can be shown at most, of a map that is explored in part."""
    env = make_env(scene=Obstacles(shape=(120, 100)), report_shown=True)
    return record_replay(env, make_policy("random"), SEED, efficiency=True)


def data_of(page):
    return json.loads(re.search(r"const data = (\{.*\});", page).group(1))


def unpack(text):
    """Read the variable-length integers of a text in base64."""
    values, value, shift = [], 0, 0
    for byte in base64.b64decode(text):
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            values.append(value)
            value = shift = 0
    assert shift == 0
    return values


def decoded_maps(data):
    """Levels (nx, ny) at each frame, from the data of a page alone."""
    levels = np.full(np.prod(data["shape"]), 255, dtype=np.uint8)
    for frame in data["frames"]:
        cells = np.cumsum(unpack(frame["cells"]), dtype=int)
        levels[cells] = np.frombuffer(base64.b64decode(frame["levels"]), dtype=np.uint8)
        yield levels.reshape(data["shape"]).copy()


def test_the_page_s_maps_are_those_of_the_episode_at_each_scan(replay):
    env, data = make_env(), data_of(render_planar_page(replay))
    steps = rollout(env, make_policy("random"), SEED)
    maps = [occupancy_levels(env.belief().map).reshape(48, 40)]
    for _ in steps:
        belief = env.belief()
        maps.append(occupancy_levels(belief.map).reshape(48, 40))
        frame, position = data["frames"][len(maps) - 1], belief.camera_poses[:, :2]
        np.testing.assert_allclose(np.array(frame["poses"])[:, :2], position, atol=1e-4)
        np.testing.assert_allclose(
            np.array(frame["poses"])[:, 2], belief.camera_poses[:, 2], atol=1e-4
        )
        assert frame["observed"] == pytest.approx(belief.map.observed_fraction, abs=1e-6)
        for robot, scan in enumerate(env.last_scans):
            rows = np.frombuffer(base64.b64decode(frame["beams"][robot]), dtype="<i2")
            rows = rows.reshape(-1, 3)
            ends = position[robot] + rows[:, :2] / data["beam_scale"]
            np.testing.assert_allclose(ends, scan.points, atol=0.5 / data["beam_scale"] + 1e-9)
            np.testing.assert_array_equal(rows[:, 2], scan.hit)
    assert len(maps) == N_SCANS + 1
    found = list(decoded_maps(data))
    np.testing.assert_array_equal(found, maps)
    np.testing.assert_array_equal(found, list(replay.maps()))
    assert len(np.unique(found[-1])) > 10


def test_levels_are_probabilities_and_255_where_nothing_was_sampled():
    env = make_env()
    env.reset(seed=0)
    map_ = env.belief().map
    levels = occupancy_levels(map_)
    np.testing.assert_array_equal(levels == 255, ~map_.sampled.ravel())
    known = levels != 255
    np.testing.assert_allclose(levels[known] / 254, map_.probability.ravel()[known], atol=0.5 / 254)


def test_the_page_s_truth_is_the_world(replay):
    env, data = make_env(), data_of(render_planar_page(replay))
    env.reset(seed=SEED)
    lengths = unpack(data["truth"])
    truth = np.repeat(np.arange(len(lengths)) % 2 == 1, lengths).reshape(data["shape"])
    np.testing.assert_array_equal(truth, env.truth.occupied)
    assert truth.any()


def test_positions_are_in_cells_whatever_the_resolution(replay):
    env = make_env(scene=Obstacles(shape=(48, 40), resolution=0.1))
    fine = data_of(render_planar_page(record_replay(env, make_policy("random"), SEED)))
    assert fine["depth_of_field"] == data_of(render_planar_page(replay))["depth_of_field"]
    belief = env.belief()
    cells = belief.map.grid.to_cell_units(belief.camera_poses[:, :2])
    np.testing.assert_allclose(np.array(fine["frames"][-1]["poses"])[:, :2], cells, atol=1e-4)


@pytest.mark.parametrize("first", [False, True])
def test_runs_of_random_flags_are_read_back(first):
    flags = np.random.default_rng(0).random(5000) < 0.02
    flags[0] = first
    lengths = unpack(base64.b64encode(run_lengths(flags).tobytes()))
    np.testing.assert_array_equal(np.repeat(np.arange(len(lengths)) % 2 == 1, lengths), flags)


def test_integers_of_any_size_are_read_back():
    values = [0, 1, 127, 128, 16_383, 16_384, 2**24, 2**35 - 1]
    assert varints([5]).tolist() == [5]
    assert varints([300]).tolist() == [0b10101100, 0b10]
    assert unpack(base64.b64encode(varints(values).tobytes())) == values
    assert varints([]).tolist() == []


def test_rewards_times_and_reasons_are_those_of_the_steps():
    class Stubborn:
        """Asks again and again for a pose that is far away."""

        def reset(self, rng):
            pass

        def act(self, belief, observations):
            return {agent: np.array([1.0, 1.0, 0.0]) for agent in belief.agents}

    env = make_env(max_scans=2)
    rewards, times = [], []
    for step in rollout(env, Stubborn(), SEED):
        rewards.append(list(step.rewards.values()))
        times.append(step.infos["robot_0"]["elapsed_time"])
    frames = data_of(render_planar_page(record_replay(env, Stubborn(), SEED)))["frames"]
    np.testing.assert_allclose([frame["rewards"] for frame in frames[1:]], rewards, atol=1e-4)
    np.testing.assert_allclose([frame["time"] for frame in frames], [0.0, *times], atol=0.01)
    assert frames[0]["notes"] == ["", ""]
    assert frames[1]["notes"][0] == f"stayed: {env.explain('robot_0')['rejected_reason']}"


def test_an_efficiency_is_what_is_shown_of_what_can_be_shown(bounded):
    shown = np.array([frame.n_shown for frame in bounded.frames])
    curve = bounded.efficiency_curve()
    assert (shown <= bounded.bounds).all()
    assert curve[0] is None
    expected = (shown - shown[0])[1:] / (bounded.bounds - shown[0])[1:]
    np.testing.assert_allclose(curve[1:], expected)
    assert 0 < curve[-1] < 1
    data = data_of(render_planar_page(bounded))
    assert data["efficiency"] == curve
    assert data["bounds"] == bounded.bounds.tolist()


def test_an_efficiency_that_is_not_known_is_refused():
    with pytest.raises(ValueError, match="report_shown=True"):
        record_replay(make_env(), make_policy("random"), SEED, efficiency=True)


def test_without_an_efficiency_there_are_no_bounds(replay):
    data = data_of(render_planar_page(replay))
    assert data["bounds"] is None
    assert data["efficiency"] is None
    assert replay.efficiency_curve() is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"rewards": (1.0,)}, r"\[2, 2, 2, 1, 2\]"),
        ({"beams": (np.zeros((3, 2)), np.zeros((3, 3)))}, r"as many hits, got \(3, 2\) and"),
        ({"observed_fraction": -0.5}, "fraction between 0 and 1, got -0.5"),
        ({"changed": np.array([4, 4])}, "each once"),
        ({"levels": np.zeros(1, dtype=np.uint8)}, r"changed cells, got \(1,\) of uint8"),
    ],
)
def test_an_inconsistent_frame_is_rejected(replay, change, words):
    with pytest.raises(ValueError, match=words):
        replace(replay.frames[1], **change)


def test_an_inconsistent_replay_is_rejected(replay, bounded):
    with pytest.raises(ValueError, match="at least one scan, got 1"):
        replace(replay, frames=replay.frames[:1])
    outside = replace(
        replay.frames[0], changed=np.array([48 * 40]), levels=np.zeros(1, dtype=np.uint8)
    )
    with pytest.raises(ValueError, match="frame 0: cells 1920 to 1920 are not all among the 1920"):
        replace(replay, frames=(outside, replay.frames[1]))
    alone = record_replay(make_env(n_robots=1), make_policy("random"), SEED)
    with pytest.raises(ValueError, match="frame 1 has 1 robots and not 2"):
        replace(replay, frames=(replay.frames[0], alone.frames[1]))
    with pytest.raises(ValueError, match="5 frames need as many bounds, got 3"):
        replace(bounded, bounds=bounded.bounds[:3])
    with pytest.raises(ValueError, match="n_shown"):
        replace(replay, bounds=bounded.bounds)


def test_a_map_that_browsers_cannot_draw_is_refused(replay, tmp_path, monkeypatch):
    monkeypatch.setattr(planar_page, "MAX_CELLS", 1919)
    with pytest.raises(ValueError, match="at most 1,919 cells, and this one has 1,920"):
        write_replay(replay, tmp_path / "replay.html")
    assert list(tmp_path.iterdir()) == []


def test_titles_and_notes_cannot_end_or_hide_the_script(replay):
    noted = replace(replay.frames[-1], notes=(HOSTILE, HOSTILE))
    page = render_planar_page(replace(replay, title=HOSTILE, frames=(*replay.frames[:-1], noted)))
    assert page.count("<script") == page.count("</script") == 1
    assert "<!--" not in page
    data = data_of(page)
    assert data["title"] == HOSTILE
    assert data["frames"][-1]["notes"] == [HOSTILE, HOSTILE]


def test_the_page_is_one_small_file_that_loads_nothing(replay, tmp_path):
    write_replay(replay, tmp_path / "of" / "blocks.html")
    assert [file.name for file in (tmp_path / "of").iterdir()] == ["blocks.html"]
    text = (tmp_path / "of" / "blocks.html").read_text(encoding="utf-8")
    assert len(text) < 60_000
    addresses = set(re.findall(r"https?://[^\"' )]+", text))
    assert addresses == {"http://www.w3.org/2000/svg"}
    assert re.findall(r"(?:src|href)=\"([^\"]*)\"", text) == ["data:,"]
    assert "@import" not in text
    assert "url(" not in text


def test_the_same_episode_gives_the_same_page(replay):
    again = record_replay(make_env(), make_policy("random"), SEED)
    assert render_planar_page(again) == render_planar_page(replay)


def test_the_command_writes_a_planar_page_without_any_extra(tmp_path, monkeypatch, capsys):
    for module in ("viser", "jinja2", "PIL", "trimesh", "matplotlib"):
        monkeypatch.setitem(sys.modules, module, None)
    out = tmp_path / "page.html"
    arguments = ["--env", "planar", "--policy", "random", "--max-scans", "2", "--efficiency"]
    assert main(["replay", *arguments, "--out", str(out)]) in (None, 0)
    data = data_of(out.read_text(encoding="utf-8"))
    assert data["title"] == "obstacles, world 0 of test: random"
    assert len(data["frames"]) == len(data["bounds"]) == 3
    assert ReplayCommand(out=tmp_path, env="planar").extras() == []


def test_the_command_takes_planar_families(tmp_path):
    command = ReplayCommand(out=tmp_path / "page.html", family="crowded", policy="random")
    assert command.env_name == "planar"
    assert command.extras() == []
    command.run()
    assert len(data_of(command.out.read_text(encoding="utf-8"))["frames"]) > 2


def test_a_field_page_needs_viser_and_has_no_efficiency(tmp_path):
    assert ReplayCommand(out=tmp_path).extras() == ["field", "replay"]
    with pytest.raises(ValueError, match="--efficiency needs bounds, which only planar worlds"):
        ReplayCommand(out=tmp_path, efficiency=True).run()


SCENARIO = """
<script>
  const log = [], at = (id) => document.getElementById(id);
  const frame = () => document.body.dataset.frame;
  const canvas = document.querySelector("canvas"), note = (value) => log.push(String(value));
  const pixels = () => {
    const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
    return data.reduce((sum, value, k) => (sum * 31 + value) % 1000003, 0);
  };
  const key = (name) =>
    document.body.dispatchEvent(new KeyboardEvent("keydown", { key: name, bubbles: true }));
  const run = () => {
  note(frame());
  at("next").click(); note(frame());
  at("back").click(); note(frame());
  key("ArrowRight"); key("ArrowRight"); note(frame());
  key("End"); note(frame()); note(at("scan").textContent); note(at("observed").textContent);
  key("Home"); note(frame());
  at("slider").value = 3; at("slider").dispatchEvent(new Event("input")); note(frame());
  for (const name of ["truth", "whole", "beams", "fresh", "views", "paths"]) {
    const before = pixels();
    at("show-" + name).click(); const after = pixels(); at("show-" + name).click();
    note(before !== after && before === pixels());
  }
  key("End"); key(" "); note(frame()); note(at("play").getAttribute("aria-label"));
  setTimeout(() => {
    note(frame()); note(at("play").getAttribute("aria-label"));
    note(document.documentElement.scrollWidth <= window.innerWidth);
    const out = document.createElement("pre");
    out.id = "log"; out.textContent = JSON.stringify(log);
    document.body.append(out);
  }, 20000);
  };
  setTimeout(run, 1000);  // after the page has its size
</script>
"""


def test_a_browser_steps_plays_and_toggles(bounded, tmp_path):
    browser = find_browser()
    page = tmp_path / "page.html"
    text = render_planar_page(bounded)
    catcher = "<script>window.onerror = (words) => { document.title = 'ERROR ' + words; };</script>"
    text = text.replace("<head>", "<head>" + catcher)
    page.write_text(text.replace("</body>", SCENARIO + "</body>"), encoding="utf-8")
    command = [
        browser, "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu",
        "--host-resolver-rules=MAP * ~NOTFOUND", f"--user-data-dir={tmp_path / 'profile'}",
        "--window-size=800,600", "--virtual-time-budget=30000", "--dump-dom", f"{page.as_uri()}#1",
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "<title>obstacles, world 3 of test</title>" in done.stdout, done.stdout[:3000]
    log = json.loads(re.search(r'<pre id="log">(.*?)</pre>', done.stdout).group(1))
    observed = f"{100 * bounded.frames[-1].observed_fraction:.1f} %"
    assert log[:8] == ["1", "2", "1", "3", "4", "4 of 4", observed, "0"]
    assert log[8] == "3"
    assert log[9:15] == ["true"] * 6
    assert log[15:] == ["0", "pause", "4", "play", "true"]
