"""Fiducials of a map, voxel by voxel in plain Python."""

import math

import numpy as np

from coopmap_env.geometry import traverse


def neighbours(grid, cell):
    """The up to 26 voxels around one, as flat indices."""
    index = np.array(np.unravel_index(cell, grid.shape))
    around = [index + np.array(d) - 1 for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)]
    return [int(grid.flat_index(i)) for i in around if grid.contains(i)]


def is_peak(map_, information, cell, strict=True):
    """Above all neighbours by log-odds, then by information, then by index."""
    key = (map_.log_odds_fixed[cell], information.get(cell, 0.0), -cell)
    for other in neighbours(map_.grid, cell):
        if map_.log_odds_fixed[other] > key[0]:
            return False
        if strict and (map_.log_odds_fixed[other], information.get(other, 0.0), -other) > key:
            return False
    return True


def ball_radius(map_, p, cell, largest, least_rise):
    """Metres to the nearest voxel with a larger probability than its neighbour towards the peak."""
    grid = map_.grid
    peak = np.array(np.unravel_index(cell, grid.shape))
    reach = int(largest / grid.resolution) + 1
    nearest = largest
    for d in np.ndindex(*(2 * reach + 1,) * 3):
        offset = np.array(d) - reach
        distance = np.linalg.norm(offset) * grid.resolution
        if not 0 < distance < nearest:
            continue
        longest = max(abs(offset))
        inner = [o - int(np.sign(o)) if 2 * abs(o) >= longest else o for o in offset]
        if not grid.contains(peak + offset) or (
            p[tuple(peak + offset)] - p[tuple(peak + inner)] > least_rise
        ):
            nearest = distance
    return nearest


def is_visible(map_, point, pose, camera, settings, border):
    """Whether a point is in the field of view, within range, and not occluded."""
    d = point - pose.translation
    x, y, z = pose.rotation.T @ d
    a = (1 - border) * math.tan(camera.horizontal_field_of_view / 2)
    b = (1 - border) * math.tan(camera.vertical_field_of_view / 2)
    distance = np.linalg.norm(d)
    far = min(camera.far, settings.max_distance)
    if x <= 0 or abs(y) > a * x or abs(z) > b * x or not camera.near <= distance <= far:
        return False
    grid = map_.grid
    length = (distance - settings.occlusion_tolerance) / grid.resolution
    if length <= 0:
        return True
    goal = tuple(grid.index(point))
    for cell in traverse(grid.to_cell_units(pose.translation), d, length, grid.shape).cells[1:]:
        if tuple(cell) == goal:
            break
        flat = grid.flat_index(cell)
        if map_.sampled_mask[flat] and map_.log_odds_fixed[flat] >= 0:
            return False
    return True


def select_fiducials(map_, pose, camera, settings, kept=()):
    """Selected voxels, with position, radius and score of each."""
    cells, means, _ = map_.surfaces()
    means = dict(zip(cells.tolist(), means, strict=True))
    weights = map_.hit_cell_sums()[1].precision
    information = {c: sum(np.diag(P)) for c, P in zip(means, weights, strict=True)}
    probability = map_.probability.ravel()
    least = round(
        math.log(settings.min_peak_probability / (1 - settings.min_peak_probability)) * 1024
    )

    def describe(cell):
        radius = ball_radius(map_, map_.probability, cell, settings.max_radius, settings.min_rise)
        distance = np.linalg.norm(means[cell] - pose.translation)
        return cell, means[cell], radius, radius * probability[cell] / distance

    chosen = [
        describe(cell)
        for cell in kept
        if cell in means
        and map_.log_odds_fixed[cell] >= least
        and is_peak(map_, information, cell, strict=False)
        if is_visible(map_, means[cell], pose, camera, settings, 0.0)
    ][: settings.max_fiducials]
    new = [
        describe(cell)
        for cell in means
        if map_.log_odds_fixed[cell] >= least and is_peak(map_, information, cell)
        if is_visible(map_, means[cell], pose, camera, settings, settings.border_fraction)
    ]
    for candidate in sorted(new, key=lambda c: -c[3]):
        apart = [
            candidate[0] != c[0] and np.linalg.norm(candidate[1] - c[1]) >= settings.min_spacing
            for c in chosen
        ]
        if len(chosen) < settings.max_fiducials and all(apart):
            chosen.append(candidate)
    return chosen
