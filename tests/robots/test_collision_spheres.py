import numpy as np
import pytest

from coopmap_env.robots import CollisionSpheres, CollisionSphereSettings
from coopmap_env.robots.kinematics.collision_spheres import cover_with_spheres


def random_points(triangles, rng, n):
    """Points (n, 3) on triangles, and all their corners."""
    a, b = rng.random((2, n, 1))
    fold = a + b > 1
    a, b = np.where(fold, 1 - a, a), np.where(fold, 1 - b, b)
    t = triangles[rng.integers(len(triangles), size=n)]
    inside = t[:, 0] + a * (t[:, 1] - t[:, 0]) + b * (t[:, 2] - t[:, 0])
    return np.concatenate([inside, triangles.reshape(-1, 3)])


def test_all_triangles_lie_in_the_spheres_of_their_rigid_body(any_mount):
    rng = np.random.default_rng(0)
    chain = any_mount.chain()
    body = CollisionSpheres.from_chain(chain, any_mount.home)
    for link, triangles in enumerate(chain.meshes):
        if not len(triangles):
            continue
        points = random_points(triangles, rng, 3000)
        points = points @ chain.link_rotations[link].T + chain.link_translations[link]
        mine = body.sphere_body_index == chain.link_body[link]
        gaps = np.linalg.norm(points[:, None] - body.local_centers[mine], axis=2)
        assert (gaps - body.radii[mine]).min(axis=1).max() < 1e-9, chain.link_names[link]


def test_spheres_are_few_and_small_where_links_move(any_mount):
    body = CollisionSpheres.from_chain(any_mount.chain(), any_mount.home)
    moving = body.sphere_body_index > 0
    assert np.count_nonzero(moving) <= 20
    assert np.bincount(body.link).max() <= 8
    assert (body.radii[moving] <= 0.17).all()
    assert not moving[: body.n_static_spheres].any()
    assert moving[body.n_static_spheres :].all()


def test_finer_settings_give_smaller_spheres(mast):
    fine = CollisionSpheres.from_chain(
        mast.chain(), mast.home, CollisionSphereSettings(radius=0.08, max_spheres=32)
    )
    assert (fine.radii[fine.sphere_body_index > 0] <= 0.08).all()
    assert fine.n_spheres > CollisionSpheres.from_chain(mast.chain(), mast.home).n_spheres


def test_the_body_of_a_chain_is_made_once(mast):
    assert CollisionSpheres.from_chain(mast.chain(), mast.home) is CollisionSpheres.from_chain(
        mast.chain(), mast.home
    )


def test_by_hand_a_long_box_is_halved_until_its_spheres_are_small():
    trimesh = pytest.importorskip("trimesh")
    box = np.array(trimesh.creation.box(extents=(0.8, 0.1, 0.1)).triangles)
    balls = sorted(cover_with_spheres(box, 0.15, 8), key=lambda ball: ball[0][0])
    np.testing.assert_allclose([c[0] for c, _ in balls], [-0.3, -0.1, 0.1, 0.3], atol=1e-3)
    # half the diagonal of 0.2 x 0.1 x 0.1
    np.testing.assert_allclose([r for _, r in balls], 0.1225, atol=1e-3)


def test_spheres_follow_their_links(any_mount):
    chain = any_mount.chain()
    body = CollisionSpheres.from_chain(chain, any_mount.home)
    lower, upper = np.maximum(chain.lower, -3), np.minimum(chain.upper, 3)
    q = np.random.default_rng(1).uniform(lower, upper, (4, chain.n_joints))
    centers, radii, link = body.centers(q), body.radii, body.link
    assert centers.shape == (4, body.n_spheres, 3)
    assert radii.shape == link.shape
    R, t = chain.link_poses(q)
    for s in range(body.n_spheres):
        i = link[s]
        local = chain.link_rotations[i].T @ (body.local_centers[s] - chain.link_translations[i])
        np.testing.assert_allclose(centers[:, s], R[:, i] @ local + t[:, i], atol=1e-12)
    np.testing.assert_array_equal(body.centers(q[2]), centers[2])


def test_pairs_are_apart_at_home_and_hold_a_moving_sphere_first(any_mount):
    body = CollisionSpheres.from_chain(any_mount.chain(), any_mount.home)
    i, j = body.pairs.T
    centers = body.centers(any_mount.home)
    assert (np.linalg.norm(centers[i] - centers[j], axis=1) > body.radii[i] + body.radii[j]).all()
    assert (body.sphere_body_index[i] > 0).all()
    assert (body.sphere_body_index[i] != body.sphere_body_index[j]).all()
    is_static = body.sphere_body_index == 0
    ranges = zip(body.partner_ranges.start, body.partner_ranges.end, strict=True)
    static_first = [
        np.diff(is_static[body.partners[start:end]].astype(int)).max(initial=0)
        for start, end in ranges
    ]
    assert max(static_first) == 0


def test_the_static_ball_holds_the_static_spheres(any_mount):
    body = CollisionSpheres.from_chain(any_mount.chain(), any_mount.home)
    gaps = np.linalg.norm(body.centers(any_mount.home) - body.static_center, axis=1) + body.radii
    assert gaps[body.sphere_body_index == 0].max() <= body.static_radius + 1e-9


def test_settings_must_be_positive():
    with pytest.raises(
        ValueError, match=r"CollisionSphereSettings.radius must be a finite number > 0, got 0"
    ):
        CollisionSphereSettings(radius=0)
