"""Cells that a ray crosses, by clipping it with the box of every cell."""

import numpy as np

MIN_LENGTH = 1e-9
"""Cells: a ray through a corner touches the cells around it over the length of rounding errors."""


def crossed_cells(origin, direction, length, shape):
    """List (cell, entry, exit) in the order of the ray; positions and lengths in cells."""
    origin = np.asarray(origin, dtype=float)
    direction = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    boxes = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
    boxes = boxes.reshape(-1, len(shape))
    entry, leave = np.zeros(len(boxes)), np.full(len(boxes), float(length))
    for axis, u in enumerate(direction):
        near, far = boxes[:, axis] - origin[axis], boxes[:, axis] + 1 - origin[axis]
        if u == 0:
            leave[(near > 0) | (far <= 0)] = -np.inf
        else:
            entry = np.maximum(entry, np.minimum(near / u, far / u))
            leave = np.minimum(leave, np.maximum(near / u, far / u))
    crossed = np.flatnonzero(leave - entry > MIN_LENGTH)
    crossed = crossed[np.argsort(entry[crossed])]
    return [(tuple(boxes[k].tolist()), float(entry[k]), float(leave[k])) for k in crossed]
