"""Scans with extreme values: any direction, beyond the grid, singular or no uncertainty."""

import numpy as np

from coopmap_env.sensing import Scan


def random_scan(rng, grid, n_beams=24, largest_sigma=1.2):
    """One scan from inside the grid; the last two beams have no length and no uncertainty."""
    d, size = grid.dimension, np.array(grid.shape) * grid.resolution
    lower = np.array(grid.origin)
    origin = lower + rng.uniform(0.05, 0.95, d) * size
    points = lower + rng.uniform(-0.4, 1.4, (n_beams, d)) * size
    A = rng.normal(size=(n_beams, d, d))
    scale = rng.uniform(0, largest_sigma * grid.resolution, n_beams) ** 2 / d
    covariances = A @ A.transpose(0, 2, 1) * scale[:, None, None]
    points[-2] = origin
    covariances[-1] = 0
    return Scan(origin, points, covariances, rng.random(n_beams) < 0.7)
