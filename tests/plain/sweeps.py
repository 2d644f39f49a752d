"""Slow reference for sweeps: shapes sampled densely, moved in small steps."""

import numpy as np


def points_in_boxes(chain, boxes, names, per_axis=4):
    """Rigid bodies (p,) and points (p, 3) on a lattice in the boxes of links, bodies' frames."""
    of, points = [], []
    for name in names:
        link = chain.link_names.index(name)
        steps = np.linspace(0.0, 1.0, per_axis)
        lattice = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
        at = boxes[name][0] + lattice * np.diff(boxes[name], axis=0)
        points.append(at @ chain.link_rotations[link].T + chain.link_translations[link])
        of += [chain.link_body[link]] * len(at)
    return np.array(of), np.concatenate(points)


def collides_with_boxes(points, boxes):
    """Whether any of the points (..., p, 3) lies in one of the boxes (b, 2, 3)."""
    inside = (points[..., None, :] >= boxes[:, 0]) & (points[..., None, :] <= boxes[:, 1])
    return inside.all(axis=-1).any(axis=(-1, -2))
