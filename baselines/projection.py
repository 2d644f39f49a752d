"""Projection: frontiers as ellipsoids, whose projections into a view are its gain; no rays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_baselines.frontier_clusters import frontier_clusters
from coopmap_baselines.planner import Coordination, GainPlanner, Search
from coopmap_env.core.settings import PositiveInt, checked_value
from coopmap_env.envs import Belief, CameraFrames, Poses
from coopmap_env.information import ReservedMask

BLOCK = 6
"""Cells along an edge of the blocks whose cells become one ellipsoid: within a block, a frontier is
nearly straight."""
MAX_ELLIPSOIDS = 300
"""The largest ones, of frontiers and of surfaces each: their pairs take the time."""
POSES_AT_ONCE = 16
"""Poses whose pairs of ellipsoids are in memory at once."""


class Ellipsoids(NamedTuple):
    """Means (n, D), metres, and covariances (n, D, D) of some cells each."""

    means: NDArray[np.float64]
    covariances: NDArray[np.float64]


class ProjectionPolicy(GainPlanner):
    """The view into which most frontier projects, minus motion.

    Frontier cells, and those that are known to be occupied, are gathered in blocks, and each block
    of a cluster becomes an ellipsoid: the mean and the covariance of its cells. The gain of a view
    is the part of its image that the projections of the frontiers cover, each weighted with the
    part of the measuring range that is left behind it. A frontier is hidden if its middle lies
    behind that of a surface, inside of the surface's projection. After the idea of Gao et al. 2024,
    "Projection-based fast and safe next best view planning", in a plain form.

    Parameters
    ----------
    search, coordination
        See `Planner`.
    motion_weight : float
        Gain that is worth one unit of d (Eq. 5).
    min_cells : int
        Cells of the smallest cluster of frontier cells.

    Raises
    ------
    ValueError
        When it decides, if a planar camera's field of view is pi radians or more.
    """

    def __init__(
        self,
        search: Search = 300,
        coordination: Coordination = "independent",
        motion_weight: float = 0.001,
        min_cells: int = 3,
    ) -> None:
        super().__init__(search, coordination, motion_weight)
        self.min_cells: int = checked_value("min_cells", min_cells, PositiveInt)

    def gain(
        self, belief: Belief, robot: int, poses: Poses, reserved_mask: ReservedMask | None
    ) -> NDArray[np.float64]:
        """Part of the image that frontiers cover, weighted."""
        frames, grid = belief.planning.camera_frames(belief, robot, poses), belief.map.grid
        clusters = frontier_clusters(belief, robot, self.min_cells)
        if reserved_mask is not None:
            clusters = np.where(reserved_mask.reshape(clusters.shape) == 0, clusters, 0)
        surfaces = belief.planning.occupied_mask(belief, robot).astype(np.int32)
        frontiers, occupied = (
            ellipsoids(grid.center(np.argwhere(cells > 0)), cells[cells > 0], grid.resolution)
            for cells in (clusters, surfaces)
        )
        gain = np.zeros(len(poses))
        for first in range(0, len(poses), POSES_AT_ONCE):
            some = slice(first, first + POSES_AT_ONCE)
            part = frames._replace(
                rotations=frames.rotations[some], translations=frames.translations[some]
            )
            gain[some] = projected_fraction(part, frontiers, occupied)
        return gain


def ellipsoids(
    points: NDArray[np.float64], groups: NDArray[np.int32], resolution: float
) -> Ellipsoids:
    """One ellipsoid of the cells of each group in each block.

    Parameters
    ----------
    points : ndarray, shape (n, D)
        Centers of cells, metres.
    groups : ndarray, shape (n,)
        Cells of different groups do not share an ellipsoid.
    resolution : float
        Edge of a cell, metres: a cell alone is an ellipsoid too.
    """
    dimension = points.shape[1]
    blocks = np.floor(points / (BLOCK * resolution)).astype(np.int64)
    _, number, counts = np.unique(
        np.column_stack([groups, blocks]), axis=0, return_inverse=True, return_counts=True
    )
    number = number.ravel()
    means, covariances = np.empty((len(counts), dimension)), np.empty((len(counts), dimension**2))
    for axis in range(dimension):
        means[:, axis] = np.bincount(number, points[:, axis], len(counts)) / counts
    off = points - means[number]
    for k, (a, b) in enumerate(np.ndindex(dimension, dimension)):
        covariances[:, k] = np.bincount(number, off[:, a] * off[:, b], len(counts)) / counts
    matrices = covariances.reshape(-1, dimension, dimension)
    matrices += np.eye(dimension) * resolution**2 / 12.0
    largest = np.argsort(-counts, kind="stable")[:MAX_ELLIPSOIDS]
    return Ellipsoids(means[largest], matrices[largest])


class Projections(NamedTuple):
    """Ellipsoids in the images of some views: shapes (k, n, ...), D - 1 numbers to a point."""

    depth: NDArray[np.float64]
    """Metres along the optical axis."""
    distance: NDArray[np.float64]
    """Metres."""
    center: NDArray[np.float64]
    """Tangents of the angles to the optical axis."""
    covariance: NDArray[np.float64]


def project(frames: CameraFrames, solids: Ellipsoids) -> Projections:
    """Project ellipsoids, linearized at their means."""
    off = solids.means - frames.translations[:, None]
    local = np.einsum("kdi,knd->kni", frames.rotations, off)
    depth = np.maximum(local[..., 0], 1e-9)
    center = local[..., 1:] / depth[..., None]
    # rows of the derivative of the center by the point: (-u, 1) / depth
    jacobian = np.zeros((*center.shape, local.shape[-1]))
    jacobian[..., 0] = -center
    for axis in range(center.shape[-1]):
        jacobian[..., axis, axis + 1] = 1.0
    jacobian /= depth[..., None, None]
    inside = np.einsum("kdi,nde,kej->knij", frames.rotations, solids.covariances, frames.rotations)
    covariance = np.einsum("knai,knij,knbj->knab", jacobian, inside, jacobian)
    return Projections(local[..., 0], np.sqrt((local**2).sum(axis=-1)), center, covariance)


def projected_fraction(
    frames: CameraFrames, frontiers: Ellipsoids, occupied: Ellipsoids
) -> NDArray[np.float64]:
    """Weighted part of each image (k,) that visible frontiers cover, at most 1."""
    if not len(frontiers.means):
        return np.zeros(len(frames.rotations))
    seen = project(frames, frontiers)
    in_view = (seen.depth > 0) & (frames.near <= seen.distance) & (seen.distance < frames.far)
    in_view &= (np.abs(seen.center) <= frames.tangents).all(axis=-1)
    if len(occupied.means):
        in_view &= ~_hidden(seen, project(frames, occupied))
    fraction = np.minimum(_size(seen.covariance) / np.prod(2.0 * frames.tangents), 1.0)
    left = 1.0 - np.minimum(seen.distance / frames.far, 1.0)
    covered: NDArray[np.float64] = (fraction * left * in_view).sum(axis=1)
    return np.minimum(covered, 1.0)


def _size(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Length of an evenly filled segment, or area of such an ellipse, with these covariances."""
    if covariance.shape[-1] == 1:
        length: NDArray[np.float64] = np.sqrt(12.0 * covariance[..., 0, 0])
        return length
    a, b = covariance[..., 0, 0], covariance[..., 1, 1]
    squared = np.maximum(a * b - covariance[..., 0, 1] * covariance[..., 1, 0], 0.0)
    area: NDArray[np.float64] = 4.0 * np.pi * np.sqrt(squared)
    return area


def _hidden(seen: Projections, before: Projections) -> NDArray[np.bool_]:
    """Which ellipsoids (k, n) have their middle behind another one."""
    off = seen.center[:, :, None] - before.center[:, None]
    c = before.covariance[:, None]
    if off.shape[-1] == 1:
        squared = off[..., 0] ** 2 / c[..., 0, 0]
        edge = 3.0  # an evenly filled segment ends at sqrt(3) standard deviations
    else:
        determinant = np.maximum(c[..., 0, 0] * c[..., 1, 1] - c[..., 0, 1] * c[..., 1, 0], 1e-30)
        u, v = off[..., 0], off[..., 1]
        squared = c[..., 1, 1] * u**2 - 2.0 * c[..., 0, 1] * u * v + c[..., 0, 0] * v**2
        squared /= determinant
        edge = 4.0  # an evenly filled ellipse, at 2
    nearer = (before.depth > 0)[:, None] & (before.distance[:, None] < seen.distance[:, :, None])
    return np.asarray((nearer & (squared < edge)).any(axis=-1))
