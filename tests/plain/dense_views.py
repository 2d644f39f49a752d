"""Views of a depth camera: the depth buffer voxel by voxel, and rays without a buffer."""

import math

import numpy as np
from numba import njit
from plain.views import gray_level, histogram_entropy

from coopmap_env.geometry import traverse
from coopmap_env.information.field._depth_buffer import DEPTH_TOLERANCE


def all_cells(shape):
    """Indices of all voxels in the order of their flat indices."""
    return np.indices(shape).reshape(3, -1).T


def in_frustum(cells, position, R, frustum):
    """X, pixel and distance of voxels (n, 3), and which of them are in the frustum."""
    centers = cells + 0.5
    X, Y, Z = R.T @ (centers - position).T
    (a, b), (w, h) = frustum.tangents, frustum.pixels
    distance = np.linalg.norm(centers - position, axis=1)
    inside = (X > 0) & (np.abs(Y) <= a * X) & (np.abs(Z) <= b * X)
    inside &= (distance >= frustum.near) & (distance <= frustum.far)
    X = np.where(inside, X, 1.0)
    u = np.floor((Y / (a * X) + 1) * w / 2).astype(int)
    v = np.floor((Z / (b * X) + 1) * h / 2).astype(int)
    return X, np.clip(u, 0, w - 1), np.clip(v, 0, h - 1), distance, inside


def ray(u, v, R, frustum):
    """Unit vector through the middle of a pixel, in the world, and its component along the axis."""
    (a, b), (w, h) = frustum.tangents, frustum.pixels
    direction = np.array([1.0, a * (2 * (u + 0.5) / w - 1), b * (2 * (v + 0.5) / h - 1)])
    direction /= np.linalg.norm(direction)
    return R @ direction, direction[0]


def sphere_distance(position, direction, occluder_spheres):
    """Distance at which a ray enters the nearest sphere that does not contain its origin."""
    nearest = math.inf
    for center, radius in occluder_spheres:
        to_center = center - position
        along = float(direction @ to_center)
        aside2 = float(to_center @ to_center) - along**2
        if to_center @ to_center > radius**2 and along > 0 and aside2 <= radius**2:
            nearest = min(nearest, along - math.sqrt(radius**2 - aside2))
    return nearest


def visible_mask(blocked, position, R, frustum, occluder_spheres=()):
    """Flat mask of the visible voxels, and their distances; spheres are (center, radius)."""
    X, u, v, distance, inside = in_frustum(all_cells(blocked.shape), position, R, frustum)
    if (position < 0).any() or (position >= blocked.shape).any():
        return np.zeros_like(inside), distance
    limits = np.full(frustum.pixels, math.inf)
    for pixel in np.ndindex(*frustum.pixels):
        direction, forward = ray(*pixel, R, frustum)
        path = traverse(position, direction, frustum.far, blocked.shape)
        stops = np.flatnonzero(blocked[tuple(path.cells[1:].T)])
        first = path.entries[1:][stops[0]] if len(stops) else math.inf
        # a sphere beyond the far plane occludes nothing
        first = min(first, sphere_distance(position, direction, occluder_spheres))
        limits[pixel] = (first + DEPTH_TOLERANCE) * forward
    return inside & (limits[u, v] >= X), distance


def round_to_table(distance):
    """Distances as in the tables: squares rounded down to quarters of a cell."""
    return np.sqrt(np.floor(4 * distance**2)) / 2


def gray_histogram(map_, seen, distance, settings, depth, unit=1.0):
    """f_i of Eq. 7: how many of the voxels have each gray level."""
    counts = [0] * settings.n_gray_bins
    p = map_.probability.ravel()
    for cell in np.flatnonzero(seen):
        d = round_to_table(distance[cell]) * unit
        level = gray_level(p[cell], map_.sampled_mask[cell], d, depth, settings.interpretation)
        counts[min(int(level * settings.n_gray_bins / 2), settings.n_gray_bins - 1)] += 1
    return counts


def new_information(map_, seen, distance, settings, max_visible_cells, depth, unit=1.0):
    """NI of the visible voxels: entropy of the histogram of gray levels (Eqs. 6 to 8)."""
    counts = gray_histogram(map_, seen, distance, settings, depth, unit)
    return histogram_entropy(counts, max_visible_cells, settings.hidden)


def visibility_probabilities(
    p, position, direction, forward, frustum, unreachable, blocked=math.inf
):
    """v at every half cell of depth: product of 1 - p over the cells before, but for the first."""
    path = traverse(position, direction, 4 * max(p.shape), p.shape)
    before, passed = [], 1.0
    for k, cell in enumerate(map(tuple, path.cells)):
        before.append(passed if passed >= unreachable else 0.0)
        passed *= 1.0 - p[cell] if k else 1.0
    at = np.arange(int(2 * frustum.far) + 2) / 2 / forward
    v = np.array(before)[np.searchsorted(path.entries, at, side="right") - 1]
    return np.where(at < blocked, v, 0.0)


@njit
def _march(blocked, position, R, a, b, w, h, near, far, step, seen):
    for column in range(w):
        for row in range(h):
            y, z = a * (2 * (column + 0.5) / w - 1), b * (2 * (row + 0.5) / h - 1)
            length = math.sqrt(1 + y * y + z * z)
            dx = (R[0, 0] + R[0, 1] * y + R[0, 2] * z) / length
            dy = (R[1, 0] + R[1, 1] * y + R[1, 2] * z) / length
            dz = (R[2, 0] + R[2, 1] * y + R[2, 2] * z) / length
            t = 0.0
            while t <= far:
                i = math.floor(position[0] + t * dx)
                j = math.floor(position[1] + t * dy)
                k = math.floor(position[2] + t * dz)
                if min(i, j, k) < 0:
                    break
                if i >= blocked.shape[0] or j >= blocked.shape[1] or k >= blocked.shape[2]:
                    break
                seen[i, j, k] = True
                if blocked[i, j, k] and t > 0:
                    break
                t += step


def voxels_hit_by_rays(blocked, position, R, frustum, rays_per_cell=4, step=0.5):
    """Flat indices of the voxels of the frustum that any of many rays hits before it is blocked.

    `rays_per_cell` of them pass between the centers of neighbours at the far end.
    """
    (a, b), far = frustum.tangents, frustum.far
    w, h = (math.ceil(2 * tangent * far * rays_per_cell) for tangent in (a, b))
    seen = np.zeros(blocked.shape, dtype=np.bool_)
    _march(blocked, position, R, a, b, w, h, frustum.near, far, step, seen)
    hits = np.argwhere(seen)
    hits = hits[in_frustum(hits, position, R, frustum)[4]]
    return np.ravel_multi_index(tuple(hits.T), blocked.shape)
