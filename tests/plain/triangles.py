"""Distances of rays to triangles: Moeller and Trumbore, each ray with each triangle."""

import numpy as np


def ray_distances(origin, directions, triangles):
    """Distances (n,) along unit directions (n, 3) from one origin; inf without a hit."""
    nearest = np.full(len(directions), np.inf)
    for a, b, c in triangles:
        normal_u = np.cross(directions, c - a)
        determinant = normal_u @ (b - a)
        hits = determinant != 0
        inverse = 1 / np.where(hits, determinant, 1)
        u = normal_u @ (origin - a) * inverse
        normal_v = np.cross(origin - a, b - a)
        v = directions @ normal_v * inverse
        t = (c - a) @ normal_v * inverse
        hits &= (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0)
        nearest[hits] = np.minimum(nearest, t)[hits]
    return nearest


def box(center, half_size):
    """The 12 triangles (12, 3, 3) of a box along the axes."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    corners = signs * np.asarray(half_size, dtype=float) + center
    return np.array([corners[[a, *pair]] for a, b, c, d in faces for pair in ((b, c), (c, d))])
