import json
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from browser import find_browser

from coopmap_env.envs.field import FieldEnv
from coopmap_env.evaluation.replay import Frame, Replay, record_replay, write_replay
from coopmap_env.evaluation.replay.page import (
    render_page,
    scan_times,
    voxel_colors,
    voxel_lifetimes,
)
from coopmap_env.geometry import Pose
from coopmap_env.mapping import VoxelGrid
from coopmap_env.rendering import ROBOT_COLORS
from coopmap_env.robots import Vehicle
from coopmap_env.sensing import DepthCamera

pytest.importorskip("trimesh")
GRID = VoxelGrid((40, 40, 20), 0.1, (-2.0, -2.0, -0.05))
TARGET = np.array([[[0.0, -0.5, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 1.0]]])
NO_TRIANGLES = np.empty((0, 3, 3))


def frame_with(occupied=(), robots=0, **changes):
    """Return a frame of these voxels, and robots about which nothing is said."""
    nothing = (np.zeros(1),) * robots
    parts = {
        "joints": nothing,
        "camera_poses": (Pose(np.zeros(3), np.eye(3)),) * robots,
        "occupied": np.array(occupied, dtype=np.int64),
        "observed_fraction": 0.5,
        "rewards": (0.0,) * robots,
        "notes": ("",) * robots,
    }
    return Frame(**(parts | changes))


@pytest.fixture(scope="module")
def replay():
    """Return a replay of two masts that face a growing wall of voxels."""
    turned = np.diag([-1.0, -1.0, 1.0])
    vehicles = (
        Vehicle.from_mount("mast", Pose(np.array([-1.4, 0.4, 0.0]), np.eye(3))),
        Vehicle.from_mount("mast", Pose(np.array([1.4, -0.4, 0.0]), turned)),
    )
    floor = np.array([GRID.flat_index((i, j, 0)) for i in range(40) for j in range(40)])
    wall = np.array([GRID.flat_index((19, j, k)) for j in range(15, 25) for k in range(1, 11)])
    frames = []
    for k, occupied in enumerate((np.empty(0, dtype=np.int64), floor, np.union1d(floor, wall))):
        joints = tuple(vehicle.home + 0.15 * k for vehicle in vehicles)
        frames.append(
            Frame(
                joints=joints,
                camera_poses=tuple(v.camera_pose(q) for v, q in zip(vehicles, joints, strict=True)),
                occupied=occupied,
                observed_fraction=0.2 * k,
                rewards=(0.5 * k, -0.25 * k),
                notes=("", "collided with </script> crate" if k == 2 else ""),
            )
        )
    return Replay("a wall", GRID, TARGET, NO_TRIANGLES, vehicles, DepthCamera(), tuple(frames))


def test_a_lifetime_is_from_the_frame_that_adds_a_voxel_to_the_one_that_removes_it():
    frames = tuple(map(frame_with, ([], [3, 5], [3, 5, 7], [3, 7], [3, 5, 7])))
    lifetimes = {lifetime: cells.tolist() for lifetime, cells in voxel_lifetimes(frames).items()}
    assert lifetimes == {(1, 5): [3], (1, 3): [5], (2, 5): [7], (4, 5): [5]}
    assert voxel_lifetimes((frame_with([]), frame_with([]))) == {}


def test_lifetimes_together_are_the_frames():
    rng = np.random.default_rng(0)
    frames = tuple(frame_with(np.flatnonzero(rng.random(60) < 0.4)) for _ in range(9))
    lifetimes = voxel_lifetimes(frames)
    for k, frame in enumerate(frames):
        alive = [
            cells
            for (first_frame, end_frame), cells in lifetimes.items()
            if first_frame <= k < end_frame
        ]
        np.testing.assert_array_equal(np.sort(np.concatenate(alive)), frame.occupied)


def test_scans_follow_motions_of_0_8_s_and_pauses_of_half_a_second():
    assert scan_times(4) == pytest.approx([0.0, 0.8, 2.1, 3.4])


def test_voxels_are_coloured_by_their_height():
    low, high = GRID.flat_index((3, 4, 0)), GRID.flat_index((3, 4, 19))
    colors = voxel_colors(np.array([low, high]), GRID)
    assert colors.dtype == np.uint8
    assert colors[0].mean() > colors[1].mean()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"observed_fraction": 1.5}, "fraction between 0 and 1, got 1.5"),
        ({"rewards": (1.0,)}, r"\[0, 0, 1, 0\]"),
        ({"occupied": np.array([4, 4])}, "each once"),
    ],
)
def test_an_inconsistent_frame_is_rejected(change, words):
    with pytest.raises(ValueError, match=words):
        frame_with(**change)


def test_an_inconsistent_replay_is_rejected(replay):
    with pytest.raises(ValueError, match="at least one scan, got 1"):
        replace(replay, frames=replay.frames[:1])
    with pytest.raises(ValueError, match="frame 1 has 0 robots and not 2"):
        replace(replay, frames=(replay.frames[0], frame_with([])))
    with pytest.raises(ValueError, match="target must have triangles"):
        replace(replay, target=NO_TRIANGLES)
    with pytest.raises(ValueError, match=r"obstacles must be triangles .* got \(3, 3\)"):
        replace(replay, obstacles=np.zeros((3, 3)))
    outside = replace(replay.frames[0], occupied=np.array([GRID.n_cells]))
    with pytest.raises(ValueError, match="is outside of"):
        replace(replay, frames=(replay.frames[0], outside))


class Wanderer:
    """Sends all joints somewhere."""

    def reset(self, rng):
        self._rng = rng

    def act(self, belief, observations):
        return {
            agent: self._rng.uniform(-1, 1, len(q)).astype(np.float32)
            for agent, q in zip(belief.agents, belief.joints, strict=True)
        }


def test_an_episode_is_recorded_as_it_went():
    pytest.importorskip("pybullet")
    pytest.importorskip("embreex")
    env = FieldEnv(max_scans=2, split="test")
    played = record_replay(env, Wanderer(), seed=3)
    belief = env.belief()
    assert played.title == "worksite, world 3 of test"
    assert [len(frame.occupied) > 0 for frame in played.frames] == [False, True, True]
    assert (
        played.frames[0].observed_fraction
        < played.frames[1].observed_fraction
        < played.frames[2].observed_fraction
    )
    last = played.frames[-1]
    np.testing.assert_array_equal(
        last.occupied, np.flatnonzero((belief.map.probability >= 0.5) & belief.map.sampled)
    )
    assert last.observed_fraction == belief.map.observed_fraction
    for robot, q in enumerate(belief.joints):
        np.testing.assert_array_equal(last.joints[robot], q)
        assert last.camera_poses[robot] is belief.estimates[robot].pose
        stayed = np.array_equal(played.frames[1].joints[robot], q)
        assert stayed == last.notes[robot].startswith("stayed: ")
    assert len(played.target) + len(played.obstacles) + 12 == len(env.truth.triangles)
    env.close()


def test_without_viser_the_pip_command_is_named(replay, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(ImportError, match=r"pip install 'coopmap\[replay\]'"):
        write_replay(replay, tmp_path / "replay.html")
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def page(replay, tmp_path_factory):
    pytest.importorskip("viser")
    path = tmp_path_factory.mktemp("replay") / "of" / "walls.html"
    write_replay(replay, path)
    return path


def test_the_page_is_one_small_file_that_loads_nothing(page):
    assert [file.name for file in page.parent.iterdir()] == ["walls.html"]
    assert 0.5e6 < page.stat().st_size < 2e6
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"<(?:script|img|iframe)[^>]+src=[\"']?(?:https?:)?//", text)
    assert not re.search(r"<link[^>]+href=[\"']?(?:https?:)?//", text)


def test_the_page_holds_the_numbers_of_each_frame(page):
    data = json.loads(re.search(r"const data = (\{.*\});", page.read_text("utf-8")).group(1))
    assert data["observed_fraction"] == [0.0, 0.2, 0.4]
    assert data["voxels"] == [0, 1600, 1700]
    assert data["rewards"][2] == [1.0, -0.5]
    assert data["notes"][2] == ["", "collided with </script> crate"]
    assert data["times"] == pytest.approx([0.0, 0.8, 2.1])
    assert data["truth_opacities"] == [0.2, 0.15]


def test_writing_prints_nothing(replay, capsys):
    pytest.importorskip("viser")
    render_page(replay)
    assert capsys.readouterr().out == ""


def opened(page, folder, milliseconds):
    """Open a page offline; returns a screenshot (400, 800, 3) and the document after a while."""
    image_module = pytest.importorskip("PIL.Image")
    picture = folder / "shot.png"
    command = [
        find_browser(), "--headless=new", "--no-sandbox", "--disable-dev-shm-usage",
        "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--hide-scrollbars",
        "--host-resolver-rules=MAP * ~NOTFOUND", f"--user-data-dir={folder / 'profile'}",
        "--window-size=800,400", f"--virtual-time-budget={milliseconds}",
        f"--screenshot={picture}", "--dump-dom", page.as_uri(),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert picture.exists(), done.stderr[-2000:]
    with image_module.open(picture) as image:
        return np.asarray(image.convert("RGB")), done.stdout


def like(pixels, color, tolerance=0.12):
    """Count pixels of a colour whatever the light."""
    shade = pixels / np.maximum(pixels.max(axis=-1, keepdims=True), 1)
    wanted = np.array(color) / max(color)
    return int((np.abs(shade - wanted).max(axis=-1) < tolerance).sum())


def test_a_browser_draws_the_scene_and_the_numbers_follow_the_timeline(page, tmp_path):
    pixels, document = opened(page, tmp_path, 2500)
    # right of the numbers and above the timeline there is the canvas alone
    canvas = pixels[10:340, 320:]
    assert len(np.unique(canvas.reshape(-1, 3), axis=0)) > 300
    assert (canvas < 245).any(axis=-1).mean() > 0.1
    for color in ROBOT_COLORS[:2]:
        assert like(canvas, color) > 100
    assert "<canvas" in document
    # the document is taken a little after the picture, wherever the timeline is then
    time = float(re.search(r'role="slider"[^>]*aria-valuenow="([\d.]+)"', document).group(1))
    shown = sum(t <= time for t in scan_times(3)[1:])
    assert re.search(rf'<section id="coopmap"[^>]*data-frame="{shown}"', document)
    assert f"{shown} of 2" in document
    assert f"{20 * shown}.0 %" in document
    assert re.search(r'<div id="coopmap-loading"[^>]* hidden', document)


COUNT_HIDDEN = """<script>
const scenes = [];
window.__THREE_DEVTOOLS__ = new EventTarget();
window.__THREE_DEVTOOLS__.addEventListener(
  "observe", ({ detail }) => detail.isScene && scenes.push(detail)
);
setInterval(() => {
  let hidden = 0;
  for (const scene of scenes)
    scene.traverse(({ material }) => hidden += material?.visible === false);
  if (document.querySelector("#root [role=slider]")) document.body.dataset.hidden = hidden;
}, 50);
</script>"""


@pytest.mark.parametrize(("box", "hidden"), [(" checked", 0), ("", 1)])
def test_a_browser_hides_the_true_solids_alone(page, tmp_path, box, hidden):
    text = page.read_text(encoding="utf-8")
    checked = 'id="coopmap-truth" checked'
    assert text.count(checked) == 1
    text = text.replace(checked, checked.replace(" checked", box))
    path = tmp_path / "page.html"
    path.write_text(text.replace("<head>", f"<head>{COUNT_HIDDEN}", 1), encoding="utf-8")
    _, document = opened(path, tmp_path, 2500)
    assert re.search(rf'<body[^>]* data-hidden="{hidden}"', document)
