"""How the surfaces in a fiducial's ball lie against those that were seen before, or are known.

A fiducial's patch is the pixels of the present look that were tracked as the fiducial, or that
should see the target. Each pixel is held against the surface that an earlier look saw in its place
(projective association, Blais & Levine 1995), along that surface's normal (Chen & Medioni 1992):

    e = n . (m - p),    sigma^2 = n^T (C_p + C_m) n

with the covariances of Eq. 1. Their sum over a patch is the information matrix of the patch's
displacement: a face tells one direction, an edge two, a corner all three.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from coopmap_env.localization.correction.settings import CorrectionSettings

TARGET_SOURCE = -1
"""The source of what is known of the target: its triangles."""
MIN_NORMAL_COSINE = 0.85
"""Least cosine between the normals of two surfaces that are held against each other."""
N_SUMS = 18
MIN_VARIANCE = 1e-8
"""Square metres: a camera without noise still has pixels."""


class Patches(NamedTuple):
    """Measured displacements: what would bring each patch to where it was seen before."""

    labels: NDArray[np.int64]
    """Shape (f,): which fiducial."""
    sources: NDArray[np.int64]
    """Shape (f,): which of the sources it was held against, or `TARGET_SOURCE`."""
    positions: NDArray[np.float64]
    """Shape (f, 3): the patch's middle in the world, by the camera's pose as it was assumed."""
    displacements: NDArray[np.float64]
    """Shape (f, 3): metres; 0 in directions of which nothing is told."""
    axes: NDArray[np.float64]
    """Shape (f, 3, 3): principal axes of what is told, in the columns."""
    precisions: NDArray[np.float64]
    """Shape (f, 3): inverse variance along each axis; 0 where nothing is told."""

    @property
    def n_fiducials(self) -> int:
        """How many fiducials have a patch; each may have several, against different sources."""
        return len(set(self.labels.tolist()))

    @property
    def information(self) -> NDArray[np.float64]:
        """Inverse covariances (f, 3, 3) of the displacements; singular where nothing is told."""
        return np.asarray((self.axes * self.precisions[:, None, :]) @ self.axes.transpose(0, 2, 1))

    def along_axes(self, vectors: NDArray[np.float64]) -> NDArray[np.float64]:
        """Components (f, 3) of vectors (f, 3) along each patch's axes."""
        return np.asarray((vectors[:, None, :] @ self.axes)[:, 0])


def patches_from_sums(sums: NDArray[np.float64], settings: CorrectionSettings) -> Patches:
    """Displacements by the sums over pixels that `accumulate_patches` fills, (labels, sources, 18).

    Noise in the normals makes a plane look like something that also has a little extent across:
    directions of which less is told than that are left out.
    """
    enough = sums[:, :, 17] >= settings.min_patch_pixels
    labels, sources = np.nonzero(enough)
    rows = sums[enough]
    weight = rows[:, 15]
    values, vectors = np.linalg.eigh(rows[:, :9].reshape(-1, 3, 3))
    tilt = settings.tilt_noise_factor * rows[:, 16] / weight
    observed = values > np.maximum(tilt[:, None], 1e-9) * values[:, 2:]
    inverse = np.where(observed, 1.0 / np.maximum(values, 1e-12), 0.0)
    precisions = np.where(
        observed, 1.0 / (inverse + settings.patch_model_std**2 + MIN_VARIANCE), 0.0
    )
    along = (rows[:, None, 9:12] @ vectors)[:, 0] * inverse
    return Patches(
        labels,
        sources + TARGET_SOURCE,
        rows[:, 12:15] / weight[:, None],
        (vectors @ along[:, :, None])[:, :, 0],
        vectors,
        precisions,
    )


@njit(cache=True, nogil=True)
def associate(p, normal, s, sources, intrinsics, gate):
    """Pixel of source s that saw the surface at p (3,), in the world frame; -1 if it saw none.

    `sources` are (points (s, n, 3), normals (s, n, 3), planar (s, n)) in the camera frames, and
    T_world_camera as R (s, 3, 3), t (s, 3). The surface has to lie within `gate` metres and to face
    the same way.
    """
    points, normals, planar, R, t = sources
    width, height, left, top = intrinsics
    dx, dy, dz = p[0] - t[s, 0], p[1] - t[s, 1], p[2] - t[s, 2]
    x = R[s, 0, 0] * dx + R[s, 1, 0] * dy + R[s, 2, 0] * dz
    if x < 0.1:
        return -1
    y = R[s, 0, 1] * dx + R[s, 1, 1] * dy + R[s, 2, 1] * dz
    z = R[s, 0, 2] * dx + R[s, 1, 2] * dy + R[s, 2, 2] * dz
    column = 0.5 * width * (1.0 - y / (x * left))
    row = 0.5 * height * (1.0 - z / (x * top))
    if column < 0.0 or row < 0.0 or column >= width or row >= height:
        return -1
    m = int(row) * width + int(column)
    if not planar[s, m]:
        return -1
    q = points[s, m]
    if (q[0] - x) ** 2 + (q[1] - y) ** 2 + (q[2] - z) ** 2 > gate * gate:
        return -1
    n = normals[s, m]
    cosine = 0.0
    for i in range(3):
        turned = R[s, 0, i] * normal[0] + R[s, 1, i] * normal[1] + R[s, 2, i] * normal[2]
        cosine += n[i] * turned
    return m if cosine >= MIN_NORMAL_COSINE else -1


@njit(cache=True, nogil=True)
def count_overlap(points, normals, planar, step, slots, sources, intrinsics, gate, counts):
    """Fill how many of the pixels, one in `step`, each of the sources (k,) saw too."""
    for i in range(len(slots)):
        counts[i] = 0
        for k in range(0, len(points), step):
            if planar[k]:
                counts[i] += (
                    associate(points[k], normals[k], slots[i], sources, intrinsics, gate) >= 0
                )


@njit(cache=True, nogil=True)
def accumulate_patches(
    points, normals, planar, normal_variances, deviations, axis, lateral, labels, target_planes,
    slots, sources, source_normal_variances, source_deviations, intrinsics, gates, used_pixels, sums,
):  # fmt: skip
    """Add each labelled pixel to its patch: `sums` (labels, 1 + sources, 18), zeros at first.

    Parameters
    ----------
    points, normals : (n, 3)
        Of the present look, world frame.
    planar, tilts : (n,)
        See `SurfaceNormals`.
    deviations : (n,)
        S T_depth d^n of Eq. 1, metres.
    axis : (3,)
        The camera's optical axis in the world frame.
    lateral : float
        Of Eq. 1: error across the axis as a share of that along it.
    labels : (n,)
        Patch of each pixel; -1 for none.
    known : (n, 6)
        Normal and point of the target's surface that each pixel should see; normal 0 for none.
    slots : (k,)
        Earlier looks, as numbers of sources, the first to be asked first.
    sources, source_tilts, source_deviations
        See `associate`; tilts and deviations (s, n).
    gates : (2,)
        Metres within which surfaces are looked for, and what is added to each pixel's deviation
        (in squares) while they are still to be found.
    taken : (k, n)
        Zeros: marks pixels of sources, of which each serves once, or its error would count twice.
    sums
        Per patch and source (0 is what is known): information matrix (9), information times
        displacement (3), point times weight (3), weight, tilt variance times weight, count.
    """
    source_points, source_normals, _, R, t = sources
    n = np.empty(3)
    for k in range(len(points)):
        patch = labels[k]
        if patch < 0:
            continue
        p = points[k]
        source, column, m = -2, TARGET_SOURCE, -1
        if target_planes[k, 0] != 0.0 or target_planes[k, 1] != 0.0 or target_planes[k, 2] != 0.0:
            source = TARGET_SOURCE
        elif planar[k]:
            for i in range(len(slots)):
                m = associate(p, normals[k], slots[i], sources, intrinsics, gates[0])
                if m >= 0 and not used_pixels[i, m]:
                    source, column = slots[i], i
                    break
        if source == -2:
            continue
        e, across, length = 0.0, 0.0, 0.0
        if source == TARGET_SOURCE:
            for i in range(3):
                n[i] = target_planes[k, i]
                e += n[i] * (target_planes[k, 3 + i] - p[i])
        else:
            # both looks' normals are noisy: their mean is half as much so
            for i in range(3):
                n[i] = normals[k, i]
                for j in range(3):
                    n[i] += R[source, i, j] * source_normals[source, m, j]
                length += n[i] * n[i]
            length = math.sqrt(length)
            for i in range(3):
                n[i] /= length
                q = t[source, i]
                for j in range(3):
                    q += R[source, i, j] * source_points[source, m, j]
                e += n[i] * (q - p[i])
        for i in range(3):
            across += n[i] * axis[i]
        across *= across
        variance = deviations[k] ** 2 * (across + lateral * lateral * (1.0 - across))
        tilt = 0.0
        if source != TARGET_SOURCE:
            d = source_deviations[source, m]
            across = 0.0
            for i in range(3):
                across += n[i] * R[source, i, 0]
            across *= across
            variance += d * d * (across + lateral * lateral * (1.0 - across))
            tilt = 0.25 * (normal_variances[k] + source_normal_variances[source, m])
        variance = max(variance, MIN_VARIANCE) + gates[1] * gates[1]
        if abs(e) > 3.0 * math.sqrt(variance):
            continue
        if source != TARGET_SOURCE:
            used_pixels[column, m] = True
        w = 1.0 / variance
        total = sums[patch, column + 1]
        for i in range(3):
            for j in range(3):
                total[3 * i + j] += w * n[i] * n[j]
            total[9 + i] += w * e * n[i]
            total[12 + i] += w * p[i]
        total[15] += w
        total[16] += w * tilt
        total[17] += 1.0
