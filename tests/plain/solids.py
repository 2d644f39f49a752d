"""Slow references for the geometry of solids: plain loops, with other formulas than the kernels."""

import numpy as np


def intersects_box(triangle, low, high):
    """Whether a triangle (3, 3) meets a box: it is not empty after clipping by the box's planes."""
    polygon = [np.asarray(corner, dtype=float) for corner in triangle]
    for axis in range(3):
        for sign, limit in ((1.0, low[axis]), (-1.0, -high[axis])):
            kept = []
            for k, corner in enumerate(polygon):
                before = polygon[k - 1]
                inside, was_inside = sign * corner[axis] >= limit, sign * before[axis] >= limit
                if inside != was_inside:
                    fraction = (limit / sign - before[axis]) / (corner[axis] - before[axis])
                    polygon_point = before + fraction * (corner - before)
                    polygon_point[axis] = limit / sign
                    kept.append(polygon_point)
                if inside:
                    kept.append(corner)
            polygon = kept
    return len(polygon) > 0


def surface_voxels(triangles, shape):
    """Cells (nx, ny, nz) that intersect triangles (m, 3, 3), in units of cells."""
    occupied = np.zeros(shape, dtype=bool)
    for cell in np.ndindex(*shape):
        low = np.array(cell, dtype=float)
        occupied[cell] = any(intersects_box(triangle, low, low + 1.0) for triangle in triangles)
    return occupied


def sample_triangles(triangles, n, rng):
    """Points (m * n, 3), n spread uniformly over each triangle."""
    u, v = rng.random((2, len(triangles), n, 1))
    u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
    a, b, c = (triangles[:, None, k] for k in range(3))
    return (a + u * (b - a) + v * (c - a)).reshape(-1, 3)


def ray_triangle_distance(eye, direction, triangle):
    """Distance along a ray to a triangle, by solving for three unknowns; inf if it misses."""
    a, b, c = triangle
    try:
        u, v, distance = np.linalg.solve(np.stack([b - a, c - a, -direction], axis=1), eye - a)
    except np.linalg.LinAlgError:
        return np.inf
    return distance if u >= 0 and v >= 0 and u + v <= 1 and distance > 0 else np.inf


def first_hit(eye, points, solids):
    """Index of the solid that each ray hits first, -1 if none; without bounding spheres."""
    hits = []
    for point in points:
        direction = (point - eye) / np.linalg.norm(point - eye)
        nearest = [
            min(ray_triangle_distance(eye, direction, t) for t in s.triangles) for s in solids
        ]
        hits.append(int(np.argmin(nearest)) if np.isfinite(min(nearest)) else -1)
    return np.array(hits)


def planar_distance(point, triangles):
    """Distance from a point (2,) to triangles (m, 3, 2), from points along their edges."""
    fraction = np.linspace(0.0, 1.0, 2001)[:, None]
    nearest = np.inf
    for a, b, c in triangles:
        for start, end in ((a, b), (b, c), (c, a)):
            along = start + fraction * (end - start)
            nearest = min(nearest, np.linalg.norm(along - point, axis=1).min())
        matrix = np.stack([b - a, c - a], axis=1)
        if abs(np.linalg.det(matrix)) > 1e-9:
            u, v = np.linalg.solve(matrix, point - a)
            if u > 0 and v > 0 and u + v < 1:
                return 0.0
    return nearest
