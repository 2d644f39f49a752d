"""Fiducials in a depth image: tracking by region growing (Section 2.5).

The predicted pose of the camera says where a fiducial is expected: the seed is the measured point
nearest to the prediction. From there the region grows from pixel to pixel, up, down, left and
right, as long as the points stay in the fiducial's ball and the surface is continuous. Where balls
overlap, a pixel belongs to the one whose seed is nearest, before anything grows, so the order of
the fiducials does not matter.

The paper's image point (u, v) and scale k give a point k (u, v, f) whose last axis is the optical
one. Here the optical axis is x, f = 1 and a point is k (1, u, v), so u = y / x and v = z / x are
tangents to the left and upwards, and k is the depth.

Across a surface a region measures its position. Along a surface without edges it only repeats the
prediction, for the ball cuts out of a plane a disc around the seed. Mean points that serve as
measurements should be weighted by the regions' scatters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.arguments import check_array_shapes
from coopmap_env.core.elementary import tan
from coopmap_env.core.settings import Bounds, NonNegative, PositiveInt, Settings
from coopmap_env.sensing import DepthCamera, PointCloud, RangeNoise

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class TrackingSettings(Settings):
    """Where a fiducial is expected, and where its region ends."""

    min_pixels: PositiveInt = 4
    """Least pixels of a region: fewer may be edges of something else, with a mean hardly better
    than a single point."""
    gate_sigmas: NonNegative = 3.0
    """Standard deviations of the prediction, beyond the fiducial's radius, in which the seed may
    lie."""
    step_sigmas: NonNegative = 3.0
    """Standard deviations (Eq. 1) of the difference of two depths by which they may differ."""
    max_incidence_angle: Annotated[float, Bounds(at_least=0, below=math.pi / 2)] = math.radians(
        70.0
    )
    """Radians between the optical axis and the normal of a surface: from one pixel to the next its
    depth changes by the tangent of this times the pixels' distance. The ground 4 m ahead of a
    camera at a height of 1.5 m has 69 degrees."""


@dataclass(frozen=True, eq=False)
class FiducialTracks:
    """Regions of k fiducials in an image; zeros for a fiducial that was not found."""

    labels: NDArray[np.int32]
    """(n_pixels,) index of the fiducial in whose region a pixel is, or -1."""
    found: Mask
    """(k,)"""
    image_points: Array
    """(k, 2) (u_i, v_i) of Eq. 10: tangents to the left and upwards of the regions' mean points."""
    depths: Array
    """(k,) k_i of Eq. 10, metres along the optical axis."""
    points: Array
    """(k, 3) mean points k_i (1, u_i, v_i) of the regions, camera frame, metres."""
    scatters: Array
    """(k, 3, 3) covariances of a region's points about their mean, square metres: thin across a
    surface, where the mean is well known, wide along it, where it is not."""
    counts: NDArray[np.int64]
    """(k,) pixels of the regions."""

    def __post_init__(self) -> None:
        k, n = len(self.found), self.labels.size
        check_array_shapes(self, [(n,), (k,), (k, 2), (k,), (k, 3), (k, 3, 3), (k,)])


def track_fiducials(
    cloud: PointCloud,
    camera: DepthCamera,
    noise: RangeNoise,
    predictions: ArrayLike,
    radii: ArrayLike,
    deviations: ArrayLike,
    settings: TrackingSettings | None = None,
) -> FiducialTracks:
    """Find fiducials in a scan.

    A fiducial is not found if its prediction is out of the field of view, no point is measured
    within its radius and `gate_sigmas` deviations of it, or its region has too few pixels.

    Parameters
    ----------
    cloud : PointCloud
        n_pixels points of the camera frame (x along the optical axis), row by row.
    camera : DepthCamera
    noise : RangeNoise
        Eq. 1.
    predictions : array_like, shape (k, 3)
        Expected positions of the fiducials in the camera frame, metres.
    radii : array_like, shape (k,)
        Of their balls, metres.
    deviations : array_like, shape (k,)
        Standard deviations of the predictions, metres.
    settings : TrackingSettings, optional

    Raises
    ------
    ValueError
        If shapes do not fit, or a prediction, radius or deviation is not finite or negative.
    """
    from scipy.spatial.distance import cdist  # a third of a second, seldom needed

    settings = settings or TrackingSettings()
    predictions, radii, sigmas = _validated(cloud, camera, predictions, radii, deviations)
    owners = np.full(camera.n_pixels, -1)
    in_view, pixels = np.flatnonzero(_in_view(predictions, camera)), np.flatnonzero(cloud.hit)
    if len(in_view) and len(pixels):
        points = cloud.points[pixels]
        distances = cdist(predictions[in_view], points)
        nearest = distances.argmin(axis=1)
        max_distance = (radii + settings.gate_sigmas * sigmas)[in_view]
        near = distances[np.arange(len(nearest)), nearest] <= max_distance
        indices, seeds = in_view[near], nearest[near]
        owners[pixels] = _assign_owners(points, points[seeds], indices, radii)
        regions = _label_regions(owners, _connected(cloud, camera, noise, settings), camera)
        # one more for the pixels of owner -1
        grown_from = np.zeros(len(predictions) + 1, dtype=np.int32)
        grown_from[indices] = regions[pixels[seeds]]
        owners[regions != grown_from[owners]] = -1
    return _region_statistics(owners, cloud.points, len(predictions), settings.min_pixels)


def _region_statistics(
    owners: NDArray[np.int64], points: Array, k: int, min_pixels: int
) -> FiducialTracks:
    """Statistics of k regions, by the pixels' owners (n_pixels,); small ones are dropped."""
    found = np.bincount(owners + 1, minlength=k + 1)[1:] >= min_pixels
    labels = np.where(found[owners] & (owners >= 0), owners, -1) if k else owners
    pixels = np.flatnonzero(labels >= 0)
    region, inside = labels[pixels], points[pixels]
    counts = np.bincount(region, minlength=k)
    sizes = np.maximum(counts, 1)
    means, scatters = np.empty((k, 3)), np.empty((k, 3, 3))
    for i in range(3):
        means[:, i] = np.bincount(region, inside[:, i], minlength=k) / sizes
    offsets = inside - means[region]
    for i in range(3):
        for j in range(i + 1):
            scatters[:, i, j] = (
                np.bincount(region, offsets[:, i] * offsets[:, j], minlength=k) / sizes
            )
            scatters[:, j, i] = scatters[:, i, j]
    image_points = means[:, 1:] / np.where(found, means[:, 0], 1.0)[:, None]
    return FiducialTracks(
        labels.astype(np.int32), found, image_points, means[:, 0].copy(), means, scatters, counts
    )


def _validated(
    cloud: PointCloud,
    camera: DepthCamera,
    predictions: ArrayLike,
    radii: ArrayLike,
    deviations: ArrayLike,
) -> tuple[Array, Array, Array]:
    """Predictions, radii and deviations as arrays of matching shapes."""
    points = np.asarray(predictions, dtype=np.float64)
    lengths = [np.asarray(a, dtype=np.float64) for a in (radii, deviations)]
    if len(cloud.hit) != camera.n_pixels:
        raise ValueError(f"a camera of {camera.n_pixels} pixels measured {len(cloud.hit)} points")
    if (
        points.ndim != 2
        or points.shape[1] != 3
        or any(a.shape != points.shape[:1] for a in lengths)
    ):
        raise ValueError(
            "predictions (k, 3) need radii (k,) and deviations (k,), got "
            f"{points.shape}, {lengths[0].shape} and {lengths[1].shape}"
        )
    if not np.isfinite(points).all():
        raise ValueError(f"predictions must be finite, got {points}")
    for name, values in zip(("radii", "deviations"), lengths, strict=True):
        if not (np.isfinite(values).all() and (values >= 0).all()):
            raise ValueError(f"{name} must be finite and >= 0 metres, got {values}")
    return points, lengths[0], lengths[1]


def _in_view(points: Array, camera: DepthCamera) -> Mask:
    """Which points (k, 3) of the camera frame fall on a pixel."""
    x, y, z = points.T
    _, _, tan_x, tan_y = camera.intrinsics
    return np.asarray((x > 0) & (np.abs(y) <= tan_x * x) & (np.abs(z) <= tan_y * x))


def _assign_owners(
    points: Array, seeds: Array, indices: NDArray[np.int64], radii: Array
) -> NDArray[np.int64]:
    """The fiducial with the seed nearest to each point, if the point is in its ball; else -1."""
    from scipy.spatial.distance import cdist

    if not len(seeds):
        return np.full(len(points), -1)
    distances = cdist(seeds, points)
    distances[distances > radii[indices][:, None]] = np.inf
    nearest = distances.argmin(axis=0)
    inside = np.isfinite(distances[nearest, np.arange(len(points))])
    return np.where(inside, indices[nearest], -1)


def _connected(
    cloud: PointCloud, camera: DepthCamera, noise: RangeNoise, settings: TrackingSettings
) -> tuple[Mask, Mask]:
    """Whether the surface is continuous from a pixel to the next of its row, and of its column.

    Shapes (height, width - 1) and (height - 1, width). Pixels without return do not matter.
    """
    shape = camera.height, camera.width
    depths = cloud.points[:, 0].reshape(shape)
    ranges = np.linalg.norm(cloud.points, axis=1).reshape(shape)
    variances = noise.standard_deviations(ranges, 1)[..., 0] ** 2
    slope = tan(settings.max_incidence_angle)
    width, height, tan_x, tan_y = camera.intrinsics
    row_slope, column_slope = slope * 2 * tan_x / width, slope * 2 * tan_y / height

    def is_continuous(
        first: tuple[slice, slice], second: tuple[slice, slice], slope_limit: float
    ) -> Mask:
        a, b = depths[first], depths[second]
        deviation = np.sqrt(variances[first] + variances[second])
        return np.asarray(
            np.abs(a - b) <= slope_limit * np.minimum(a, b) + settings.step_sigmas * deviation
        )

    in_rows = is_continuous(np.s_[:, :-1], np.s_[:, 1:], row_slope)
    return in_rows, is_continuous(np.s_[:-1, :], np.s_[1:, :], column_slope)


def _label_regions(
    owners: NDArray[np.int64], connected: tuple[Mask, Mask], camera: DepthCamera
) -> NDArray[np.int32]:
    """Labels (n,) of the connected regions of pixels of one owner; 0 for pixels of none.

    Pixels are labelled in an image of twice the size, which has a pixel between two neighbours that
    is set if they are connected: the library joins pixels, not edges.
    """
    from scipy.ndimage import label  # a third of a second, seldom needed

    image = owners.reshape(camera.height, camera.width)
    doubled = np.zeros((2 * camera.height - 1, 2 * camera.width - 1), dtype=np.bool_)
    doubled[::2, ::2] = image >= 0
    doubled[::2, 1::2] = connected[0] & (image[:, :-1] == image[:, 1:])
    doubled[1::2, ::2] = connected[1] & (image[:-1] == image[1:])
    regions, _ = label(doubled)
    return np.asarray(regions[::2, ::2].reshape(-1), dtype=np.int32)
