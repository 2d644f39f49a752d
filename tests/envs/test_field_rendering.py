import numpy as np
import pytest

from coopmap_env.geometry import Pose
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.rendering import (
    HEIGHT_COLORS,
    ROBOT_COLORS,
    ViewCamera,
    cluster_vertices,
    height_colors,
    overview_camera,
    render_field,
    robot_triangles,
    scene_meshes,
    simplified_links,
)
from coopmap_env.rendering._ray_tracing import FrustumTint, RayTracedScene
from coopmap_env.rendering.field import BACKGROUND, SAMPLED_FLOOR_COLOR, ColoredMesh
from coopmap_env.rendering.meshes import MESH_DETAIL, exposed_faces
from coopmap_env.rendering.panels import NEVER_SAMPLED
from coopmap_env.robots import Vehicle
from coopmap_env.sensing import DepthCamera
from coopmap_env.simulation.scenes.field import Solid, make_field_scene

pytest.importorskip("PIL")
pytest.importorskip("embreex")
pytest.importorskip("trimesh")


GRID = VoxelGrid((20, 20, 10), 0.2, (-2.0, -2.0, -0.3))
AHEAD = ViewCamera((-4.0, 0.0, 0.0), (0.0, 0.0, 0.0), np.pi / 2, 101, 81)
CAMERA = DepthCamera()


def box(center, size):
    """Return the triangles of an upright box."""
    grid = VoxelGrid((1, 1, 1), 1.0, (-0.5, -0.5, -0.5))
    return exposed_faces(np.ones((1, 1, 1), dtype=bool), grid)[0] * size + center


def ground(z=0.0, half=50.0):
    """Return a square on the ground."""
    a, b, c, d = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * half
    return np.array([[a, b, c], [a, c, d]]) + np.array([0, 0, z])


def volume(triangles):
    """Return the volume inside of a closed surface, positive if anticlockwise from outside."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6


@pytest.mark.parametrize(("other", "faces"), [((2, 2, 2), 12), ((0, 0, 1), 20)])
def test_a_side_between_two_filled_voxels_is_not_drawn(other, faces):
    filled = np.zeros((3, 3, 3), dtype=bool)
    filled[0, 0, 0] = True
    single = exposed_faces(filled, VoxelGrid((3, 3, 3), 0.1))
    assert len(single[0]) == 12
    filled[other] = True
    triangles, voxels = exposed_faces(filled, VoxelGrid((3, 3, 3), 0.1))
    assert len(triangles) == len(voxels) == faces + (12 if faces == 12 else 0)


def test_the_exposed_faces_of_random_voxels_enclose_their_volume():
    filled = np.random.default_rng(0).random((5, 6, 7)) < 0.4
    filled[0, 0, 0] = True  # at the border of the grid
    grid = VoxelGrid((5, 6, 7), 0.2, (1.0, -2.0, 0.5))
    triangles, voxels = exposed_faces(filled, grid)
    assert volume(triangles) == pytest.approx(filled.sum() * 0.2**3)
    assert filled.ravel()[voxels].all()
    middle = triangles.mean(axis=1)
    centers = grid.center(np.stack(np.unravel_index(voxels, grid.shape), axis=1))
    assert np.abs(middle - centers).max() == pytest.approx(0.1)


def test_simplified_triangles_keep_near_their_place_and_lose_only_what_is_small():
    triangles = box((1.0, 2.0, 3.0), (1.0, 2.0, 0.5))
    vertices, faces = cluster_vertices(triangles, 0.01)
    assert len(vertices) == 8
    np.testing.assert_allclose(np.sort(vertices[faces], axis=0), np.sort(triangles, axis=0))
    speck = box((5.005, 5.005, 5.005), 1e-4)
    vertices, faces = cluster_vertices(np.concatenate([triangles, speck]), 0.01)
    assert len(faces) == 12
    rng = np.random.default_rng(0)
    cloud = rng.random((500, 3, 3))
    vertices, faces = cluster_vertices(cloud, 0.1)
    nearest = np.linalg.norm(cloud.reshape(-1, 1, 3) - vertices, axis=2).min(axis=1)
    assert nearest.max() <= 0.1 * np.sqrt(3)
    assert len(faces) == len(np.unique(np.sort(faces, axis=1), axis=0))


@pytest.fixture(scope="module")
def vehicle():
    turned = Pose(np.array([1.0, -2.0, 0.0]), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))
    return Vehicle.from_mount("mast", turned)


def test_a_drawn_robot_is_where_its_links_are(vehicle):
    q = vehicle.home + 0.2
    drawn = robot_triangles(vehicle, q).reshape(-1, 3)
    rotations, translations = vehicle.link_poses(q)
    true = np.concatenate(
        [
            (mesh @ R.T + t).reshape(-1, 3)
            for mesh, R, t in zip(vehicle.chain.meshes, rotations, translations, strict=True)
        ]
    )
    far = np.linalg.norm(true[:, None] - drawn, axis=2).min(axis=1)
    assert far.max() <= MESH_DETAIL * np.sqrt(3)
    assert len(simplified_links(vehicle.chain)) == vehicle.chain.n_joints + 1


def test_rays_and_projection_belong_together():
    view = ViewCamera((3.0, -2.0, 5.0), (0.5, 0.2, 0.3), 0.8, 320, 200)
    pixels = np.random.default_rng(0).random((50, 2)) * (320, 200)
    rays = view.rays(pixels.astype(np.float32))
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1, atol=1e-6)
    at, depth = view.project(view.eye + 7.0 * rays)
    np.testing.assert_allclose(at, pixels, atol=1e-3)
    np.testing.assert_allclose(depth, 7.0, rtol=1e-6)
    np.testing.assert_allclose(view.project(view.look_at)[0], (160, 100))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"eye": (0.0, 0.0, 9.0)}, "straight down"),
        ({"field_of_view": 4.0}, "field_of_view"),
        ({"width": 0}, "0 x 81"),
    ],
)
def test_an_invalid_view_camera_is_rejected(change, words):
    good = {
        "eye": AHEAD.eye, "look_at": AHEAD.look_at, "field_of_view": 1.0, "width": 10, "height": 81
    }  # fmt: skip
    with pytest.raises(ValueError, match=words):
        ViewCamera(**(good | change))


def painted(triangles, colors, tints=(), view=AHEAD):
    """Take a picture before a green nothing."""
    return RayTracedScene(triangles, colors, (0, 255, 0), (0, 0, 0), (90, 99)).render(view, tints)


def test_a_box_is_seen_in_its_colour_at_its_distance_before_the_background():
    image, distance = painted([box((0, 0, 0), 2.0)], [(200, 40, 40)])
    assert image.shape == (81, 101, 3)
    assert distance[40, 50] == pytest.approx(3.0, abs=1e-5)
    assert image[40, 50] / image[40, 50].max() == pytest.approx([1, 0.2, 0.2], abs=1e-3)
    assert image[0, 0] == pytest.approx([0, 1, 0])
    assert distance[0, 0] == np.inf
    # 3 m ahead a pixel is 6 / 101 m wide: the box covers 2 * 101 / 6 columns
    assert np.isfinite(distance[40]).sum() == pytest.approx(2 * 101 / 6, abs=1)


def test_edges_are_smoothed_and_planes_are_unchanged():
    view = ViewCamera(AHEAD.eye, (0.0, 0.6, 0.0), 1.0, 101, 81)
    image, _ = painted([box((0, 0, 0), 2.0)], [(255, 0, 0)], view=view)
    shares = image[..., 1]
    assert len(np.unique(np.round(shares[(shares > 0.01) & (shares < 0.99)], 2))) >= 3


def test_the_sun_throws_a_shadow_on_the_ground():
    above = ViewCamera((-6.0, 0.0, 6.0), (0.0, 0.0, 0.0), 1.0, 120, 90)
    bare, _ = painted([ground()], [(200, 200, 200)], view=above)
    image, distance = painted([ground(), box((0, 0, 3), 1.0)], [(200,) * 3] * 2, view=above)
    plain = np.isclose(distance, painted([ground()], [(0, 0, 0)], view=above)[1], rtol=1e-5)
    shadow = plain & (image[..., 0] < 0.8 * bare[..., 0])
    assert 20 < shadow.sum() < 0.1 * shadow.size


def test_a_torch_tints_what_its_camera_sees_and_nothing_behind_it():
    wall = box((2.0, 0, 0), (0.1, 8.0, 8.0))
    screen = box((0.5, 1.0, 0), (0.1, 0.8, 8.0))
    view = ViewCamera((-1.0, 0.0, 0.5), (2.0, 0.0, 0.5), np.pi / 2, 121, 81)
    camera = DepthCamera(np.pi / 2, np.pi / 2)
    tint = FrustumTint(Pose(np.array([-0.5, -3.0, 0.5]), np.eye(3)), camera, (255, 0, 0))
    dark, _ = painted([wall, screen], [(90, 90, 90)] * 2, view=view)
    lit, distance = painted([wall, screen], [(90, 90, 90)] * 2, [tint], view)
    tinted = lit[..., 0] > dark[..., 0] + 0.05
    rays = view.rays(view.centers) * distance.reshape(-1, 1)
    y = (rays[:, 1] + view.eye[1]).reshape(distance.shape)
    on_wall = np.isclose((rays[:, 0] + view.eye[0]).reshape(distance.shape), 1.95, atol=0.01)
    # the left edge of its view, 45 degrees, meets the wall at y = -3 + 2.45
    assert tinted[on_wall & (y < -0.6)].mean() > 0.99
    assert not tinted[on_wall & (y > -0.5)].any()
    blind = FrustumTint(tint.pose, DepthCamera(np.pi / 2, np.pi / 2, far=2.0), (255, 0, 0))
    np.testing.assert_array_equal(painted([wall, screen], [(90,) * 3] * 2, [blind], view)[0], dark)


def test_a_torch_does_not_shine_through_a_screen():
    wall, screen = box((2.0, 0, 0), (0.1, 8.0, 8.0)), box((0.5, 0, 0), (0.1, 9.0, 9.0))
    view = ViewCamera((1.0, 0.0, 0.5), (2.0, 0.0, 0.5), np.pi / 2, 60, 40)
    tint = FrustumTint(Pose(np.array([-1.0, 0.0, 0.0]), np.eye(3)), CAMERA, (255, 0, 0))
    colors = [(90, 90, 90)] * 2
    np.testing.assert_array_equal(
        painted([wall, screen], colors, [tint], view)[0],
        painted([wall, screen], colors, (), view)[0],
    )


@pytest.mark.parametrize("n_robots", [1, 2, 3, 5])
def test_the_overview_shows_target_and_vehicles_from_above(n_robots):
    angles = np.arange(n_robots) * 1.1
    bases = [Pose(np.array([3 * np.cos(a), 3 * np.sin(a), 0.0]), np.eye(3)) for a in angles]
    target = box((0.3, 0, 0.7), 1.2)
    view = overview_camera(target, bases)
    at, _ = view.project([*target.reshape(-1, 3), *(base.translation for base in bases)])
    assert (at >= -1e-9).all()  # the farthest point lies on the edge, but for rounding
    assert (at <= np.add((view.width, view.height), 1e-9)).all()
    assert view.eye[2] > 2
    # no vehicle stands in front of the target
    azimuth = np.arctan2(view.eye[1], view.eye[0])
    assert np.abs((angles - azimuth + np.pi) % (2 * np.pi) - np.pi).min() > 0.5


def test_height_colours_run_from_the_first_to_the_last():
    colors = height_colors([-1.0, 0.0, 0.2, 2.0, 9.0])
    np.testing.assert_allclose(colors[[0, 1, 3, 4]], np.array(HEIGHT_COLORS)[[0, 0, -1, -1]])
    np.testing.assert_allclose(colors[2], np.mean(HEIGHT_COLORS[:2], axis=0))


def map_with(occupied=(), free=()):
    """Return a map that knows these cells."""
    map_ = OccupancyMap(GRID)
    map_.mark_free(np.array([GRID.flat_index(cell) for cell in free], dtype=np.int64))
    map_.mark_occupied(np.array([GRID.flat_index(cell) for cell in occupied], dtype=np.int64))
    return map_


def picture(vehicle, **changes):
    """Draw an empty world and map with one robot, but for the changes."""
    target = box((0, 0, 0.5), 1.0)
    arguments = {
        "truth": [ColoredMesh(ground(), (236, 234, 229)), ColoredMesh(target, (74, 84, 112))],
        "map_": map_with(),
        "robots": [robot_triangles(vehicle, vehicle.home)],
        "cameras": [vehicle.camera_pose(vehicle.home)],
        "camera": CAMERA,
        "view": overview_camera(target, [vehicle.T_world_base]),
    }
    return render_field(**(arguments | changes))


def halves(frame):
    """Split a picture into the panels of the truth and of the map, without what is around."""
    middle = frame.shape[1] // 2
    return frame[36:-64, :middle], frame[36:-64, middle:]


def like(panel, color, tolerance=0.06):
    """Count pixels of a colour whatever the light."""
    shade = panel / np.maximum(panel.max(axis=-1, keepdims=True), 1)
    wanted = np.array(color) / max(color)
    return int((np.abs(shade - wanted).max(axis=-1) < tolerance).sum())


def test_a_frame_shows_the_truth_at_the_left_and_the_map_at_the_right(vehicle):
    frame = picture(vehicle)
    assert frame.dtype == np.uint8
    assert frame.shape == (540, 1248, 3)
    np.testing.assert_array_equal(picture(vehicle), frame)
    left, right = halves(frame)
    assert like(left, (74, 84, 112)) > 1000
    assert like(left, ROBOT_COLORS[0]) > 500
    assert like(right, ROBOT_COLORS[0]) > 500
    assert like(right, NEVER_SAMPLED, 0.02) > 10_000
    assert like(left, NEVER_SAMPLED, 0.02) == 0


def test_the_map_shows_what_was_sampled_and_the_occupied_voxels_alone(vehicle):
    columns = [(i, j, 5) for i in range(20) for j in range(20)]
    left, right = halves(picture(vehicle))
    seen_left, seen_right = halves(picture(vehicle, map_=map_with(free=columns)))
    np.testing.assert_array_equal(seen_left, left)
    assert like(right, SAMPLED_FLOOR_COLOR, 0.01) < 500  # nothing but edges
    assert like(seen_right, SAMPLED_FLOOR_COLOR, 0.01) > 10_000
    block = [(i, j, 9) for i in range(8, 12) for j in range(8, 12)]
    block_left, block_right = halves(picture(vehicle, map_=map_with(block, columns)))
    np.testing.assert_array_equal(block_left, left)
    changed = (block_right != seen_right).any(axis=-1)
    assert 500 < changed.sum() < 0.3 * changed.size


def test_trails_and_captions_are_drawn(vehicle):
    camera = vehicle.camera_pose(vehicle.home).translation
    trail = np.array([camera + np.array([0, 0, dz]) for dz in (0.9, 0.5, 0.0)])
    plain, drawn = picture(vehicle), picture(vehicle, trails=[trail], caption="scan 3 of 4 each")
    for before, after in zip(halves(plain), halves(drawn), strict=True):
        assert (before != after).any(axis=-1).sum() > 100
    assert (plain[-64:] != drawn[-64:]).any()


def test_the_second_robot_keeps_its_colour_when_it_is_alone(vehicle):
    left, right = halves(picture(vehicle, numbers=[1]))
    for panel in (left, right):
        assert like(panel, ROBOT_COLORS[1]) > 500
        assert like(panel, ROBOT_COLORS[0]) == 0


def test_robots_that_are_not_located_are_in_the_truth_alone(vehicle):
    triangles = robot_triangles(vehicle, vehicle.home)
    left, right = halves(picture(vehicle, robots=[], cameras=[], unlocated={1: triangles}))
    assert like(left, ROBOT_COLORS[1]) > 500
    assert like(right, ROBOT_COLORS[1]) == 0


def test_the_legend_names_all_robots_located_or_not(vehicle):
    triangles = robot_triangles(vehicle, vehicle.home)
    both = picture(vehicle, numbers=[1], unlocated={0: triangles})
    nobody = picture(vehicle, robots=[], cameras=[], numbers=[], unlocated={0: triangles})
    assert both.shape == nobody.shape
    for frame, shown in ((both, 2), (nobody, 1)):
        found = [bool((frame[-28:] == color).all(axis=-1).any()) for color in ROBOT_COLORS[:3]]
        assert found == [True] * shown + [False] * (3 - shown)


def test_the_solids_of_a_world_have_the_colours_of_ground_target_and_others():
    world = make_field_scene("worksite").world(np.random.default_rng(0), 2)
    surfaces = scene_meshes(world)
    assert sum(len(surface.triangles) for surface in surfaces) == len(world.triangles)
    colors = {
        kind: {s.color for s, solid in zip(surfaces, world.solids, strict=True) if which(solid)}
        for kind, which in {
            "ground": lambda solid: solid.is_ground,
            "target": lambda solid: solid.is_target,
            "others": lambda solid: not (solid.is_ground or solid.is_target),
        }.items()
    }
    assert len(colors["ground"]) == len(colors["target"]) == 1
    assert not colors["ground"] & colors["target"]
    assert not colors["others"] & (colors["ground"] | colors["target"])
    assert isinstance(world.solids[0], Solid)
    assert BACKGROUND not in colors["others"]
