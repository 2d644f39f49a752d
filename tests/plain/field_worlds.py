"""Small worlds for vehicles: flat ground and obstacles."""

import numpy as np

from coopmap_env.geometry import Z_AXIS, Pose, rotation_about_axis
from coopmap_env.mapping import VoxelGrid
from coopmap_env.simulation.scenes.field import FieldWorld
from coopmap_env.simulation.scenes.field.solid import (
    box_corners,
    ground_slab,
    solid_from_boxes,
    solid_from_hull,
)

GRID = VoxelGrid((128, 128, 40), 0.1, (-6.4, -6.4, -0.35))


def base_pose(x, y, heading=0.0):
    return Pose(np.array([x, y, 0.0]), rotation_about_axis(Z_AXIS, heading))


def crate(name, x, y, z, size):
    return solid_from_boxes(
        name, [box_corners(np.broadcast_to(size, 3), (x, y, z))], is_target=True
    )


CENTRED_BASE = (base_pose(0.0, 0.0),)


def flat_world(*solids, bases=CENTRED_BASE):
    """Ground, a target out of reach of all robots, and further solids."""
    far_away = crate("far_away", 5.5, 5.5, 0.25, 0.5)
    solids = (ground_slab((-6.4, -6.4), (6.4, 6.4)), *solids, far_away)
    return FieldWorld("yard", solids, "crates", GRID, tuple(bases))


def cluttered_world(seed, bases, n=25, nearest=0.8):
    """Random boulders, some of them in the air and in reach."""
    rng = np.random.default_rng(seed)
    boulders = []
    while len(boulders) < n:
        at = rng.uniform([-3, -3, 0.2], [3, 3, 2.5])
        if min(np.hypot(*(at - b.translation)[:2]) for b in bases) > nearest:
            points = at + 0.2 * rng.normal(size=(14, 3))
            boulders.append(solid_from_hull(f"boulder_{len(boulders)}", points))
    return flat_world(*boulders, bases=bases)
