"""View of a pose and its information: every beam traversed, every voxel counted."""

import math

from coopmap_env.core.elementary import sin_cos
from coopmap_env.geometry import traverse


def visible_cells(map_, camera, lattice, pose_id, see_through=()):
    """Set of cells (ix, iy) crossed by any beam up to and with the first one with P >= 1/2.

    Cells of `see_through` end no beam.
    """
    x, y, heading = lattice.pose(pose_id)
    start = lattice.grid.to_cell_units([x, y])
    depth = camera.depth_of_field / lattice.grid.resolution
    blocked = map_.sampled & (map_.probability >= 0.5)
    for cell in see_through:
        blocked[cell] = False
    seen = set()
    for bearing in camera.bearings:
        # the beam rotated by the heading: both sides must round alike where beams pass corners
        (sine, cosine), (s, c) = sin_cos(bearing), sin_cos(heading)
        direction = [c * cosine - s * sine, s * cosine + c * sine]
        for cell in map(tuple, traverse(start, direction, depth, blocked.shape).cells.tolist()):
            seen.add(cell)
            if blocked[cell]:
                break
    return seen


def gray_level(p, sampled, d, depth, interpretation):
    """Eqs. 8a and 8b of one voxel at d voxels."""
    if not sampled:
        return 1 + min(d / depth, 1)
    d = 1.0 if interpretation == "distance_free" else max(d, 1.0)
    if p < 0.5:
        return min(max((1 / ((1 - p) * d) - 1) / 2, 0.0), 0.5)
    return min(max(1 - (1 / (p * d) - 1) / 2, 0.5), 1.0)


def histogram_entropy(counts, max_visible_cells, hidden):
    """Eqs. 6 and 7: what is missing to the most that a camera can see is empty, or left out."""
    if hidden == "empty":
        counts = [max(counts[0] + max_visible_cells - sum(counts), 0), *counts[1:]]
    q = [min(f / max_visible_cells, 1) for f in counts if f]
    return -sum(x * math.log(x) for x in q)


def gray_histogram(map_, camera, lattice, pose_id, settings, cells):
    """f_i of Eq. 7: how many of the cells have each gray level."""
    ix, iy = divmod(pose_id // lattice.n_headings, lattice.grid.shape[1])
    depth = camera.depth_of_field / lattice.grid.resolution
    counts = [0] * settings.n_gray_bins
    for cell in cells:
        d = math.hypot(cell[0] - ix, cell[1] - iy)
        level = gray_level(
            map_.probability[cell], map_.sampled[cell], d, depth, settings.interpretation
        )
        counts[min(int(level * settings.n_gray_bins / 2), settings.n_gray_bins - 1)] += 1
    return counts


def new_information(map_, camera, lattice, pose_id, settings, max_visible_cells, reserved_mask=()):
    """NI: entropy of the histogram of gray levels over what is visible (Eqs. 6 to 8)."""
    visible = visible_cells(map_, camera, lattice, pose_id) - set(reserved_mask)
    counts = gray_histogram(map_, camera, lattice, pose_id, settings, visible)
    return histogram_entropy(counts, max_visible_cells, settings.hidden)
