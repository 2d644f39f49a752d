"""Fiducials in a depth image: tracking by region growing (section 2.5).

A fiducial is looked for where the believed pose of the camera says: the seed is the measured point
nearest to the prediction. From there the region grows from pixel to pixel, up, down, left and
right, as long as the points stay in the fiducial's ball and the surface is continuous. Of balls
that overlap, a pixel belongs to the one whose seed is nearest, before anything grows, so that no
order of the fiducials matters.

The paper's image point (u, v) and scale k give a point k (u, v, f) whose last axis is the optical
one. Here the optical axis is x, f = 1 and a point is k (1, u, v), so u = y / x and v = z / x are
tangents to the left and upwards, and k is the depth.

Across a surface a region shows where it is; along one without edges it only repeats the prediction,
for the middle of what the ball cuts out of a plane is the seed. Whoever takes the mean points for
measurements should weigh them by the regions' spreads.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import label
from scipy.spatial.distance import cdist

from coopmap_env.sensing.depth_camera import DepthCamera
from coopmap_env.sensing.noise import RangeNoise
from coopmap_env.sensing.point_cloud import PointCloud

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class TrackingSettings:
    """Where a fiducial is looked for, and where its region ends.

    Raises
    ------
    ValueError
        With the value, if one is out of range.
    """

    min_pixels: int = 4
    """Of a region: fewer may be edges of something else, and their mean is hardly better than a
    single point."""
    gate_sigmas: float = 3.0
    """Standard deviations of the prediction, beyond the fiducial's radius, in which the seed may
    lie."""
    step_sigmas: float = 3.0
    """Standard deviations (Eq. 1) of the difference of two depths by which they may differ."""
    max_incidence_angle: float = math.radians(70.0)
    """Radians between the optical axis and the normal of a surface: from one pixel to the next its
    depth changes by the tangent of this times the pixels' distance. The ground 4 m ahead of a
    camera at a height of 1.5 m has 69 degrees."""

    def __post_init__(self) -> None:
        if not (isinstance(self.min_pixels, int | np.integer) and self.min_pixels >= 1):
            raise ValueError(
                "TrackingSettings.min_pixels must be a whole number of at least 1: "
                f"{self.min_pixels}"
            )
        for name in ("gate_sigmas", "step_sigmas"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"TrackingSettings.{name} must be finite and >= 0, got {value}")
        if not 0 <= self.max_incidence_angle < math.pi / 2:
            raise ValueError(
                f"TrackingSettings.max_incidence_angle must lie in [0, pi/2) radians, got {self.max_incidence_angle}"
            )


@dataclass(frozen=True, eq=False)
class FiducialTracks:
    """What was found of k fiducials; zeros where one was not."""

    labels: NDArray[np.int32]
    """(n_pixels,) number of the fiducial in whose region a pixel is, or -1."""
    found: NDArray[np.bool_]
    """(k,)"""
    image_points: NDArray[np.float64]
    """(k, 2) (u_i, v_i) of Eq. 10: tangents to the left and upwards of the regions' mean points."""
    depths: NDArray[np.float64]
    """(k,) k_i of Eq. 10, metres along the optical axis."""
    points: NDArray[np.float64]
    """(k, 3) mean points k_i (1, u_i, v_i) of the regions, camera frame, metres."""
    scatters: NDArray[np.float64]
    """(k, 3, 3) covariances of a region's points about their mean, square metres: thin across a
    surface, where the mean is sure, wide along it, where it is not."""
    counts: NDArray[np.int64]
    """(k,) pixels of the regions."""

    def __post_init__(self) -> None:
        k = len(self.found)
        shapes = [getattr(self, entry.name).shape for entry in fields(self)[1:]]
        if self.labels.ndim != 1 or shapes != [(k,), (k, 2), (k,), (k, 3), (k, 3, 3), (k,)]:
            raise ValueError(f"arrays of {k} tracks cannot have the shapes {shapes}")


def track_fiducials(
    cloud: PointCloud,
    camera: DepthCamera,
    noise: RangeNoise,
    predictions: ArrayLike,
    radii: ArrayLike,
    deviations: ArrayLike,
    settings: TrackingSettings | None = None,
) -> FiducialTracks:
    """Find fiducials in what a camera measured.

    A fiducial is not found if its prediction is out of the field of view, no point is measured
    within its radius and `gate_sigmas` deviations of it, or its region has too few pixels.

    Parameters
    ----------
    cloud : PointCloud
        n_pixels points of the camera frame (x along the optical axis), row by row.
    camera : DepthCamera
    noise : RangeNoise
        Eq. 1, by which depths of one surface may differ.
    predictions : array_like, shape (k, 3)
        Where the fiducials are expected in the camera frame, metres.
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
        numbers, seeds = in_view[near], nearest[near]
        owners[pixels] = _assign_owners(points, points[seeds], numbers, radii)
        regions = _label_regions(owners, _connected(cloud, camera, noise, settings), camera)
        # one more for the pixels of owner -1
        grown_from = np.zeros(len(predictions) + 1, dtype=np.int32)
        grown_from[numbers] = regions[pixels[seeds]]
        owners[regions != grown_from[owners]] = -1
    return _region_statistics(owners, cloud.points, len(predictions), settings.min_pixels)


def _region_statistics(
    owners: NDArray[np.int64], points: NDArray[np.float64], k: int, min_pixels: int
) -> FiducialTracks:
    """What k regions amount to, of the pixels' owners (n_pixels,); small ones are dropped."""
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
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """The predictions as arrays that fit together."""
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


def _in_view(points: NDArray[np.float64], camera: DepthCamera) -> NDArray[np.bool_]:
    """Which points (k, 3) of the camera frame fall on a pixel."""
    x, y, z = points.T
    left = math.tan(camera.horizontal_field_of_view / 2)
    top = math.tan(camera.vertical_field_of_view / 2)
    return np.asarray((x > 0) & (np.abs(y) <= left * x) & (np.abs(z) <= top * x))


def _assign_owners(
    points: NDArray[np.float64],
    seeds: NDArray[np.float64],
    numbers: NDArray[np.int64],
    radii: NDArray[np.float64],
) -> NDArray[np.int64]:
    """Number of the fiducial whose seed is nearest to each point in whose ball it lies, or -1."""
    if not len(seeds):
        return np.full(len(points), -1)
    distances = cdist(seeds, points)
    distances[distances > radii[numbers][:, None]] = np.inf
    nearest = distances.argmin(axis=0)
    inside = np.isfinite(distances[nearest, np.arange(len(points))])
    return np.where(inside, numbers[nearest], -1)


def _connected(
    cloud: PointCloud, camera: DepthCamera, noise: RangeNoise, settings: TrackingSettings
) -> tuple[Mask, Mask]:
    """Whether the surface goes on from a pixel to the next of its row, and of its column.

    Shapes (height, width - 1) and (height - 1, width). Pixels without return do not matter.
    """
    shape = camera.height, camera.width
    depths = cloud.points[:, 0].reshape(shape)
    ranges = np.sqrt(np.einsum("ni,ni->n", cloud.points, cloud.points)).reshape(shape)
    variances = noise.standard_deviations(ranges, 1)[..., 0] ** 2
    slope = math.tan(settings.max_incidence_angle)
    row_slope = slope * 2 * math.tan(camera.horizontal_field_of_view / 2) / camera.width
    column_slope = slope * 2 * math.tan(camera.vertical_field_of_view / 2) / camera.height

    def is_continuous(
        first: tuple[slice, slice], second: tuple[slice, slice], slope_limit: float
    ) -> Mask:
        a, b = depths[first], depths[second]
        deviation = np.sqrt(variances[first] + variances[second])
        return np.asarray(
            np.abs(a - b) <= slope_limit * np.minimum(a, b) + settings.step_sigmas * deviation
        )

    return is_continuous(np.s_[:, :-1], np.s_[:, 1:], row_slope), is_continuous(
        np.s_[:-1, :], np.s_[1:, :], column_slope
    )


def _label_regions(
    owners: NDArray[np.int64],
    connected: tuple[Mask, Mask],
    camera: DepthCamera,
) -> NDArray[np.int32]:
    """Numbers (n,) of the connected regions of pixels of one owner; 0 for pixels of none.

    Pixels are labelled in an image of twice the size, where between two of them stands whether they
    are joined: the library knows pixels, not edges.
    """
    image = owners.reshape(camera.height, camera.width)
    doubled = np.zeros((2 * camera.height - 1, 2 * camera.width - 1), dtype=np.bool_)
    doubled[::2, ::2] = image >= 0
    doubled[::2, 1::2] = connected[0] & (image[:, :-1] == image[:, 1:])
    doubled[1::2, ::2] = connected[1] & (image[:-1] == image[1:])
    regions, _ = label(doubled)
    return np.asarray(regions[::2, ::2].reshape(-1), dtype=np.int32)
