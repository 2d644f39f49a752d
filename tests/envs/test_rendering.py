import numpy as np
import pytest

from coopmap_env.rendering import ROBOT_COLORS, HumanWindow, render_team, robot_color
from coopmap_env.rendering._planar_window import PlanarWindow, explored_window
from coopmap_env.rendering.panels import FREE, NEVER_SAMPLED, OCCUPIED, robot_marks

pytest.importorskip("PIL")
pygame = pytest.importorskip("pygame")

NOBODY = np.empty((0, 3))


def picture(nx=20, ny=20, **changes):
    """Render an empty, unsampled world without robots, but for the changes."""
    arguments = {
        "truth": np.zeros((nx, ny), dtype=bool),
        "probability": np.full((nx, ny), 0.5),
        "sampled": np.zeros((nx, ny), dtype=bool),
        "poses": NOBODY,
        "field_of_view": np.pi / 3,
        "depth_of_field": 5.0,
    }
    return render_team(**(arguments | changes))


def halves(frame):
    """Split a picture, without the legend below, into those of the truth and of the map."""
    middle = frame.shape[1] // 2
    return frame[:-28, :middle], frame[:-28, middle:]


def center_of(frame, color):
    """Return the mean (column, row) of the pixels of a colour, and how many they are."""
    rows, columns = np.nonzero((frame == color).all(axis=-1))
    return columns.mean(), rows.mean(), len(rows)


def changed(frame, other):
    """Return the (column, row) of all pixels that differ."""
    rows, columns = np.nonzero((frame != other).any(axis=-1))
    return columns, rows


def test_a_frame_is_an_rgb_image_of_two_panels_of_about_600_pixels():
    frame = picture(200, 200)
    assert frame.dtype == np.uint8
    assert frame.ndim == 3
    assert frame.shape[2] == 3
    assert 600 < frame.shape[0] < 720
    assert 1200 < frame.shape[1] < 1300


def test_a_cell_is_a_whole_number_of_pixels_wide():
    truth = np.zeros((20, 20), dtype=bool)
    truth[7, 11] = True
    left, _ = halves(picture(truth=truth))
    rows, columns = np.nonzero((left == OCCUPIED).all(axis=-1))
    assert np.ptp(rows) + 1 == np.ptp(columns) + 1 == 600 // 20
    assert len(rows) == 30 * 30


def test_x_points_right_and_y_up():
    truth = np.zeros((20, 20), dtype=bool)
    truth[0, 0] = True
    left, _ = halves(picture(truth=truth))
    column, row, _ = center_of(left, OCCUPIED)
    panel_column, panel_row, _ = center_of(left, FREE)
    assert column < panel_column
    assert row > panel_row


def test_the_truth_shows_obstacles_that_the_map_does_not_know():
    left, right = halves(picture(truth=np.ones((20, 20), dtype=bool)))
    assert center_of(left, OCCUPIED)[2] == 600 * 600
    assert center_of(right, NEVER_SAMPLED)[2] >= 600 * 600


def test_the_picture_distinguishes_free_occupied_undecided_and_never_sampled():
    probability = np.full((20, 20), 0.5)
    probability[0], probability[1] = 0.0, 1.0
    sampled = np.zeros((20, 20), dtype=bool)
    sampled[:3] = True
    _, right = halves(picture(probability=probability, sampled=sampled))
    strip = 600 * 30
    # the legend above adds a few pixels of each
    assert strip <= center_of(right, FREE)[2] < strip + 300
    assert strip <= center_of(right, OCCUPIED)[2] < strip + 300
    assert 17 * strip <= center_of(right, NEVER_SAMPLED)[2] < 17 * strip + 300
    undecided = np.rint((np.array(FREE) + OCCUPIED) / 2)
    assert (np.abs(right.astype(int) - undecided) <= 1).all(axis=-1).sum() >= strip


def test_what_an_unsampled_cell_holds_does_not_show():
    np.testing.assert_array_equal(picture(probability=np.full((20, 20), np.nan)), picture())


@pytest.mark.parametrize(
    ("heading", "right", "up"), [(0, 1, 0), (np.pi / 2, 0, 1), (np.pi, -1, 0), (-np.pi / 2, 0, -1)]
)
def test_the_view_opens_along_the_heading_in_both_panels(heading, right, up):
    pose = [[10.0, 10.0, heading]]
    for panel, empty in zip(halves(picture(poses=pose)), halves(picture()), strict=True):
        columns, rows = changed(panel, empty)
        dot_column, dot_row, _ = center_of(panel, ROBOT_COLORS[0])
        # 5 cells of 30 pixels: the wedge reaches 150 pixels, its center of mass about 90
        assert np.mean(columns - dot_column) == pytest.approx(90 * right, abs=30)
        assert np.mean(dot_row - rows) == pytest.approx(90 * up, abs=30)


def test_a_wider_view_tints_more():
    pose = [[10.0, 10.0, 0.3]]
    sizes = [
        len(changed(picture(poses=pose, field_of_view=angle), picture())[0])
        for angle in (0.5, 1.5, 3.0, 2 * np.pi)
    ]
    assert sizes == sorted(sizes)
    # a full circle on each panel
    assert sizes[-1] == pytest.approx(2 * np.pi * 150**2, rel=0.05)


def test_robots_have_colours_of_their_own():
    frame = picture(poses=[[3.0, 3.0, 0.0], [15.0, 15.0, 0.0]])
    for color in ROBOT_COLORS[:2]:
        assert center_of(frame, color)[2] > 100
    assert robot_color(len(ROBOT_COLORS)) == robot_color(0)
    assert len(set(ROBOT_COLORS)) == len(ROBOT_COLORS)


def test_a_trail_runs_through_the_visited_positions():
    trail = np.array([[2.0, 10.0], [18.0, 10.0]])
    left, _ = halves(picture(trails=[trail]))
    columns, rows = changed(left, halves(picture())[0])
    # 16 cells of 30 pixels, and a knot at either end
    assert np.ptp(columns) == pytest.approx(16 * 30, abs=10)
    assert np.ptp(rows) < 10


@pytest.mark.parametrize("trail", [np.empty((0, 2)), [[4.0, 4.0]]])
def test_a_trail_may_be_empty_or_a_single_position(trail):
    assert picture(trails=[trail]).shape == picture().shape


@pytest.mark.parametrize("position", [(0.0, 0.0), (20.0, 20.0), (-500.0, 7.0)])
def test_a_camera_at_or_beyond_the_edge_draws_only_inside_its_panel(position):
    frame, empty = picture(poses=[[*position, 2.0]]), picture()
    panel_columns, panel_rows = np.nonzero((empty == FREE).all(axis=-1))[::-1]
    columns, rows = changed(halves(frame)[0], halves(empty)[0])
    assert np.isin(columns, panel_columns).all()
    assert np.isin(rows, panel_rows).all()


def test_the_caption_is_written_below_the_panels():
    _, rows = changed(picture(caption="scan 3 of 32"), picture())
    _, panel_rows = changed(picture(truth=np.ones((20, 20), dtype=bool)), picture())
    assert rows.min() > panel_rows.max()


@pytest.mark.parametrize(("nx", "ny"), [(200, 30), (30, 200), (1, 1), (700, 650)])
def test_worlds_of_any_size_keep_their_proportions(nx, ny):
    left, _ = halves(picture(nx, ny, truth=np.ones((nx, ny), dtype=bool)))
    rows, columns = np.nonzero((left == OCCUPIED).all(axis=-1))
    assert (np.ptp(columns) + 1) * ny == (np.ptp(rows) + 1) * nx


def test_drawing_leaves_its_inputs_alone_and_repeats_itself():
    arguments = {"probability": np.full((20, 20), 0.3), "poses": np.array([[5.0, 5.0, 1.0]])}
    copies = {name: array.copy() for name, array in arguments.items()}
    np.testing.assert_array_equal(picture(**arguments), picture(**arguments))
    for name, array in arguments.items():
        np.testing.assert_array_equal(array, copies[name])


def test_maps_and_poses_of_the_wrong_shape_are_rejected():
    with pytest.raises(ValueError, match=r"\(20, 20\), \(20, 20\) and \(20, 19\)"):
        picture(sampled=np.zeros((20, 19), dtype=bool))
    with pytest.raises(ValueError, match=r"poses must have shape \(n, 3\), got \(2,\)"):
        picture(poses=[1.0, 2.0])


def test_a_legend_names_the_robots_in_their_colours():
    poses = [[3.0, 3.0, 0.0], [15.0, 15.0, 0.0], [9.0, 3.0, 0.0]]
    frame, two = picture(poses=poses), picture(poses=poses[:2])
    below = frame[36 + 600 + 36 :]
    for color in ROBOT_COLORS[:3]:
        assert center_of(below, color)[2] > 50
    assert not (two[36 + 600 + 36 :] == ROBOT_COLORS[2]).all(axis=-1).any()


def test_robots_that_share_a_colour_share_an_entry_of_the_legend():
    assert [text for _, text in robot_marks(2)] == ["robot_0", "robot_1"]
    labels = [text for _, text in robot_marks(13)]
    assert labels[0] == "robots 0, 6, ..."
    assert labels[1:] == [f"robots {k}, {k + 6}" for k in range(1, 6)]
    assert [text for _, text in robot_marks(7)][:2] == ["robots 0, 6", "robot_1"]


def test_a_legend_that_has_no_room_in_a_row_has_another():
    poses = np.zeros((6, 3)) + 5.0
    narrow = picture(30, 60, poses=poses).shape[0] - picture(30, 60).shape[0]
    wide = picture(60, 60, poses=poses).shape[0] - picture(60, 60).shape[0]
    assert wide == 0
    assert 20 < narrow < 40


def explored(nx, ny, part, n=200, visited=NOBODY[:, :2], **changes):
    """The window of a map (n, n) of which nx times ny cells at a corner `part` are sampled."""
    sampled = np.zeros((n, n), dtype=bool)
    sampled[part[0] : part[0] + nx, part[1] : part[1] + ny] = True
    arguments = {"margin": 10.0, "smallest": 60.0} | changes
    return explored_window(sampled, visited, whole=PlanarWindow.whole((n, n), 600), **arguments)


@pytest.mark.parametrize("part", [(0, 0), (90, 40), (170, 170), (0, 185)])
@pytest.mark.parametrize("side", [3, 15])
def test_a_window_has_all_that_is_explored_and_stays_on_the_map(part, side):
    window = explored(side, side, part)
    x, y, width, height = window.extent
    assert not window.is_whole
    assert (window.width, window.height) == (600, 600)
    assert x >= 0
    assert y >= 0
    assert x + width <= 200 + 1e-9
    assert y + height <= 200 + 1e-9
    for low, start, extent in ((x, part[0], width), (y, part[1], height)):
        assert low <= max(start - 10, 0) + 1e-9
        assert low + extent >= min(start + side + 10, 200) - 1e-9
    # of 4, 5, 6, 7, 9 and 11 pixels a cell, the most with which 60 cells fit
    assert window.scale == 9


def test_cells_become_smaller_as_more_is_explored():
    scales = [explored(side, side, (0, 0)).scale for side in (10, 60, 100, 160, 200)]
    assert scales == sorted(scales, reverse=True)
    assert scales[0] == 9
    assert scales[-1] == 3
    assert explored(200, 200, (0, 0)).is_whole


def test_a_window_holds_still_while_little_changes():
    corners = {explored(20, 20, (90 + k, 90)).extent for k in range(8)}
    assert len(corners) <= 2


def test_a_small_map_is_shown_whole():
    assert explored(5, 5, (0, 0), n=60).is_whole
    assert explored(5, 5, (0, 0), smallest=200.1).is_whole


def test_a_window_has_all_visited_positions():
    far = np.array([[150.5, 20.5], [np.nan, np.nan]])
    window = explored(20, 20, (90, 90), visited=far)
    x, y, width, height = window.extent
    assert x <= 90
    assert x + width >= 150.5
    assert y <= 20.5
    assert y + height >= 110
    nothing = PlanarWindow.whole((200, 200), 600)
    empty = np.zeros((200, 200), dtype=bool)
    assert explored_window(empty, NOBODY[:, :2], 10.0, 60.0, nothing) is nothing


def zoomed(part=(20, 150), n=200, **changes):
    """Render a world with one obstacle in the middle of the explored part."""
    truth, sampled = np.zeros((2, n, n), dtype=bool)
    x, y = part
    sampled[x : x + 20, y : y + 20] = True
    truth[x + 10, y + 10] = True
    probability = np.where(truth, 1.0, 0.0)
    maps = {"truth": truth, "probability": probability, "sampled": sampled}
    return picture(n, n, **(maps | {"min_window": 60.0} | changes))


def test_the_explored_part_of_a_large_map_is_shown_larger_in_both_panels():
    for panel in halves(zoomed()):
        rows, columns = np.nonzero((panel == OCCUPIED).all(axis=-1))
        inside = (rows > 40) & (rows < 630)
        assert np.ptp(rows[inside]) + 1 == np.ptp(columns[inside]) + 1 == 9
    whole = halves(zoomed(min_window=None))[0]
    rows, _ = np.nonzero((whole == OCCUPIED).all(axis=-1))
    assert np.ptp(rows[(rows > 40) & (rows < 630)]) + 1 == 3


def test_a_zoom_keeps_the_shape_of_the_picture():
    assert zoomed().shape == zoomed(min_window=None).shape == zoomed((100, 100)).shape


def test_marks_are_where_the_cells_are():
    position = np.array([[30.5, 160.5]])  # the middle of the obstacle
    frame = zoomed(poses=[[*position[0], 0.0]])
    column, row, _ = center_of(halves(zoomed())[0][40:630], OCCUPIED)
    columns, rows = changed(halves(frame)[0][40:630], halves(zoomed())[0][40:630])
    near = (np.abs(columns - column) < 8) & (np.abs(rows - row) < 8)
    assert near.sum() > 150


def test_the_whole_map_is_in_a_corner_that_hides_little():
    frame = zoomed()
    red = (frame == (214, 39, 40)).all(axis=-1)
    for panel in halves(red):
        rows, columns = np.nonzero(panel)
        # a third of 200 cells, 162 pixels wide
        assert np.ptp(columns) + 1 == pytest.approx(162 / 3, abs=2)
        assert np.ptp(rows) + 1 == pytest.approx(162 / 3, abs=2)
        assert rows.min() < 200
        assert columns.min() > 300
    # where the part explored lies in the upper right corner of the map, the inset is elsewhere
    moved = (zoomed((175, 175)) == (214, 39, 40)).all(axis=-1)
    assert np.nonzero(halves(moved)[0])[1].min() < 200 or np.nonzero(moved)[0].min() > 400


@pytest.fixture
def window(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    window = HumanWindow()
    yield window
    window.close()


def frame_of(color, height=40, width=60):
    return np.full((height, width, 3), color, dtype=np.uint8)


def test_the_window_shows_the_frame_under_its_title(window):
    frame = frame_of((10, 20, 30))
    frame[5, 7] = (200, 100, 50)
    window.show(frame)
    screen = pygame.display.get_surface()
    assert screen.get_size() == (60, 40)
    assert tuple(screen.get_at((0, 0)))[:3] == (10, 20, 30)
    assert tuple(screen.get_at((7, 5)))[:3] == (200, 100, 50)
    assert pygame.display.get_caption()[0] == "coopmap"


def test_the_window_follows_a_frame_of_another_size(window):
    window.show(frame_of((1, 2, 3)))
    window.show(frame_of((1, 2, 3), height=80, width=90))
    assert pygame.display.get_surface().get_size() == (90, 80)


def test_no_window_opens_before_the_first_frame(window):
    assert not pygame.display.get_init()
    window.close()


def test_closing_the_window_by_hand_drops_later_frames(window):
    window.show(frame_of((1, 2, 3)))
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    window.show(frame_of((1, 2, 3)))
    assert window.closed_by_user
    window.show(frame_of((1, 2, 3)))
    assert not pygame.display.get_init()


def test_a_window_closed_by_the_program_may_be_closed_again_and_reopened(window):
    window.show(frame_of((1, 2, 3)))
    window.close()
    window.close()
    window.show(frame_of((4, 5, 6)))
    assert tuple(pygame.display.get_surface().get_at((0, 0)))[:3] == (4, 5, 6)


def test_a_window_survives_another_one_that_closes(window):
    other = HumanWindow()
    window.show(frame_of((1, 2, 3)))
    other.show(frame_of((1, 2, 3)))
    other.close()
    window.show(frame_of((7, 8, 9)))
    assert tuple(pygame.display.get_surface().get_at((0, 0)))[:3] == (7, 8, 9)
