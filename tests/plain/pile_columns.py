"""Slow reference for the columns of a block: a fine sampling of heights."""

import numpy as np


def vertical_extent(size, rotation, x, y, step=1e-3):
    """Lowest and highest z of a block about the origin over (x, y), to within a step."""
    reach = np.linalg.norm(size) / 2
    z = np.arange(-reach, reach, step)
    points = np.stack([np.full_like(z, x), np.full_like(z, y), z], axis=-1)
    inside = (np.abs(points @ rotation) <= np.asarray(size) / 2).all(axis=1)
    return (z[inside].min(), z[inside].max()) if inside.any() else (np.inf, -np.inf)
