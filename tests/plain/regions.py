"""Region growing in a depth image, pixel by pixel, breadth first."""

import math
from collections import deque

import numpy as np


def grow_regions(cloud, camera, noise, predictions, radii, deviations, settings):
    """The pixels' labels (n_pixels,)."""
    w, h = camera.width, camera.height
    left = math.tan(camera.horizontal_field_of_view / 2)
    top = math.tan(camera.vertical_field_of_view / 2)
    points, hit = cloud.points, cloud.hit

    seeds = {}
    for i, (p, radius, sigma) in enumerate(zip(predictions, radii, deviations, strict=True)):
        if p[0] <= 0 or abs(p[1]) > left * p[0] or abs(p[2]) > top * p[0] or not hit.any():
            continue
        misses = np.where(hit, np.linalg.norm(points - p, axis=1), math.inf)
        if misses.min() <= radius + settings.gate_sigmas * sigma:
            seeds[i] = int(misses.argmin())

    owner = np.full(w * h, -1)
    for k in np.flatnonzero(hit):
        distances = {i: np.linalg.norm(points[k] - points[s]) for i, s in seeds.items()}
        inside = {i: d for i, d in distances.items() if d <= radii[i]}
        if inside:
            owner[k] = min(inside, key=inside.get)

    def is_connected(k, m):
        pitch = 2 * left / w if abs(k - m) == 1 else 2 * top / h
        allowed = math.tan(settings.max_incidence_angle) * pitch * min(points[k, 0], points[m, 0])
        sigmas = [
            noise.intrinsic * noise.depth * np.linalg.norm(points[j]) ** noise.exponent
            for j in (k, m)
        ]
        allowed += settings.step_sigmas * math.hypot(*sigmas)
        return abs(points[k, 0] - points[m, 0]) <= allowed

    labels = np.full(w * h, -1, dtype=np.int32)
    for i, seed in seeds.items():
        if owner[seed] != i:
            continue
        region, queue = {seed}, deque([seed])
        while queue:
            k = queue.popleft()
            row, column = divmod(k, w)
            for r, c in (
                (row, column - 1),
                (row, column + 1),
                (row - 1, column),
                (row + 1, column),
            ):
                m = r * w + c
                if 0 <= r < h and 0 <= c < w and m not in region:  # noqa: SIM102
                    if owner[m] == i and is_connected(k, m):
                        region.add(m)
                        queue.append(m)
        if len(region) >= settings.min_pixels:
            labels[list(region)] = i
    return labels
