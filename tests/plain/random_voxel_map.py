"""Random partly observed 3-D maps of boxes on a ground, and random camera poses."""

import numpy as np

from coopmap_env.mapping import OccupancyMap, VoxelGrid


def random_voxel_map(rng, shape, n_boxes, n_balls, resolution=0.1, origin=(0.0, 0.0, 0.0)):
    """Map of a ground and boxes, sampled only inside random balls."""
    map_ = OccupancyMap(VoxelGrid(shape, resolution, origin))
    clamp = map_.log_odds_range.clamp
    occupied = np.zeros(shape, dtype=bool)
    occupied[:, :, :2] = True
    for _ in range(n_boxes):
        size = rng.integers(2, np.maximum(np.array(shape) // 6, 3))
        corner = rng.integers(0, np.array(shape) - size)
        occupied[tuple(slice(c, c + s) for c, s in zip(corner, size, strict=True))] = True
    sampled = np.zeros(shape, dtype=bool)
    index = np.indices(shape).transpose(1, 2, 3, 0)
    for _ in range(n_balls):
        center, radius = rng.uniform(0, shape), rng.uniform(0.1, 0.3) * max(shape)
        sampled |= ((index - center) ** 2).sum(axis=-1) < radius**2
    free, hit = rng.integers(-clamp, -clamp // 2, shape), rng.integers(0, clamp + 1, shape)
    undecided = rng.random(shape) < 0.05
    free[undecided] = rng.integers(-clamp // 2, 0, undecided.sum())
    map_.log_odds_fixed[:] = np.where(sampled, np.where(occupied, hit, free), 0).ravel()
    map_.sampled_mask[:] = sampled.ravel()
    return map_


def rotation(yaw, pitch, roll):
    """R_world_camera; a positive pitch turns the camera down."""
    (cy, cp, cr), (sy, sp, sr) = np.cos([yaw, pitch, roll]), np.sin([yaw, pitch, roll])
    turn = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    nod = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    tilt = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    return turn @ nod @ tilt


def random_poses(rng, map_, k, any_orientation=False):
    """Rotations and translations of cameras in cells that are not occupied."""
    shape = np.array(map_.grid.shape)
    blocked = (map_.log_odds_fixed >= 0) & (map_.sampled_mask == 1)
    rotations, translations = [], []
    while len(rotations) < k:
        cells = rng.uniform(0.05, 0.95, 3) * shape
        if blocked[map_.grid.flat_index(cells.astype(int))]:
            continue
        spread = (np.pi, np.pi, np.pi) if any_orientation else (np.pi, 0.5, 0.2)
        rotations.append(rotation(*rng.uniform(-1, 1, 3) * spread))
        translations.append(cells * map_.grid.resolution + map_.grid.origin)
    return np.array(rotations), np.array(translations)
