"""A probabilistic map with a dictionary of cells, in plain Python loops."""

import math

import numpy as np
from plain.ray_cells import crossed_cells

RANGE_WINDOW, MAX_PATH_IN_CELL, MIN_RANGE_SIGMA, STEPS_PER_NAT = (
    4.0,
    1.75,
    0.01,
    1024,
)


def level(p, lowest, highest):
    if p <= 0:
        return lowest
    if p >= 1:
        return highest
    return min(max(math.floor(math.log(p / (1 - p)) * STEPS_PER_NAT + 0.5), lowest), highest)


def likelihood(entry, leave, z, sigma, surface):
    """Likelihood of the distance z if the beam ends in this cell, up to a constant."""
    if surface == "entry":
        return math.exp(-0.5 * ((z - entry) / sigma) ** 2)
    scale = sigma * math.sqrt(2)
    return (math.erf((leave - z) / scale) - math.erf((entry - z) / scale)) / (leave - entry) * sigma


def end_probabilities(intervals, z, sigma, surface):
    """w_k of each (entry, exit): prior (1/2)**k times likelihood, normalised."""
    w = [0.5**k * likelihood(a, b, z, sigma, surface) for k, (a, b) in enumerate(intervals)]
    if sum(w) == 0:  # all likelihoods vanish: the cell that contains z
        holder = next((k for k, (_, b) in enumerate(intervals) if z < b), len(intervals) - 1)
        return [float(k == holder) for k in range(len(intervals))]
    return [x / sum(w) for x in w]


def occupancies(intervals, z, sigma, surface, behind=0.5):
    """P_k = w_k + `behind` times the w before it."""
    w = end_probabilities(intervals, z, sigma, surface)
    return [w[k] + behind * sum(w[:k]) for k in range(len(w))]


def binary_entropy(level_):
    p = 1 / (1 + math.exp(-level_ / STEPS_PER_NAT))
    return -p * math.log(p) - (1 - p) * math.log(1 - p)


class PlainMap:
    """Reference of `OccupancyMap`: all values must be equal."""

    def __init__(self, grid, model, clamp):
        self.grid, self.model, self.clamp = grid, model, clamp
        self.bounds, self.surface = model.log_odds_bounds, model.surface
        self.log_odds_fixed = np.zeros(grid.shape, dtype=int)
        self.sampled = np.zeros(grid.shape, dtype=bool)
        self.observations = {}

    def integrate(self, scan):
        """Fuse one scan; return the number of new cells and the drop of entropy."""
        updates = {}
        for point, covariance, hit in zip(scan.points, scan.covariances, scan.hit, strict=True):
            for cell, value in self.beam(scan.origin, point, covariance, hit):
                updates[cell] = updates.get(cell, 0) + value or 1  # an observed cell is never zero
        drop, new = 0.0, 0
        for cell, value in updates.items():
            update = min(max(value, self.bounds[0]), self.bounds[1])
            after = min(max(int(self.log_odds_fixed[cell]) + update, -self.clamp), self.clamp)
            drop += binary_entropy(int(self.log_odds_fixed[cell])) - binary_entropy(after)
            new += not self.sampled[cell]
            self.log_odds_fixed[cell], self.sampled[cell] = after, True
        return new, drop

    def beam(self, origin, point, covariance, hit):
        """Updates (cell, log-odds) of one beam; stores the point in the cell of its end."""
        grid, (lowest, highest) = self.grid, self.bounds
        ray = (point - origin) / grid.resolution
        z = float(np.linalg.norm(ray))
        if z == 0:
            return []
        start = (origin - np.array(grid.origin)) / grid.resolution
        if not hit:
            return [(cell, lowest) for cell, _, _ in crossed_cells(start, ray, z, grid.shape)]
        u = ray / z
        sigma = max(math.sqrt(max(u @ covariance @ u, 0.0)) / grid.resolution, MIN_RANGE_SIGMA)
        crossed = crossed_cells(start, ray, 1e6, grid.shape)
        border = crossed[-1][2]
        clear = z - RANGE_WINDOW * sigma - MAX_PATH_IN_CELL
        updates = [(cell, lowest) for cell, entry, _ in crossed if entry < clear]
        ends = [c for c in crossed if clear <= c[1] < z + RANGE_WINDOW * sigma]
        intervals = [(entry, leave) for _, entry, leave in ends]
        if border < z:
            intervals.append((z, z + 1))
        w = end_probabilities(intervals, z, sigma, self.surface)
        fits = [likelihood(a, b, z, sigma, self.surface) for a, b in intervals]
        best = fits.index(max(fits)) if any(fits) else w.index(1.0)
        for k, (cell, _, _) in enumerate(ends):
            updates.append((cell, level(w[k] + self.model.behind * sum(w[:k]), lowest, highest)))
            if sum(w[: k + 1]) > self.model.posterior_cutoff and k >= best:
                break
        if best < len(ends):
            floor = (MIN_RANGE_SIGMA * grid.resolution) ** 2 * np.eye(len(point))
            self.observations.setdefault(ends[best][0], []).append((point, covariance + floor))
        return updates
