"""Displacements of fiducials' patches from earlier scans, or from the known target.

The pixels of a patch sum up to the information matrix of its displacement (`association`): a face
determines one direction, an edge two, a corner all three.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.linear_algebra import eigh, product
from coopmap_env.localization.correction.settings import CorrectionSettings

Array = NDArray[np.float64]

TARGET_SOURCE = -1
"""The source of patches on the known target: its triangles."""
MIN_VARIANCE = 1e-8
"""Square metres: a camera without noise still has pixels."""


class PatchSums(NamedTuple):
    """Sums over the pixels of each of f labels, by s sources: the target first, then keyframes."""

    information: Array
    """Shape (f, s, 3, 3): information matrix of the displacement."""
    vector: Array
    """Shape (f, s, 3): information times displacement."""
    position: Array
    """Shape (f, s, 3): points, weighted."""
    weight: Array
    """Shape (f, s): weights of the pixels, which are their inverse variances."""
    normal_variance: Array
    """Shape (f, s): variances of the normals, weighted."""
    n_pixels: Array
    """Shape (f, s)."""

    @classmethod
    def zeros(cls, n_labels: int, n_sources: int) -> PatchSums:
        """Sums of nothing."""
        shape = n_labels, n_sources
        vectors, scalars = np.zeros((2, *shape, 3)), np.zeros((3, *shape))
        return cls(np.zeros((*shape, 3, 3)), *vectors, *scalars)


class Patches(NamedTuple):
    """Measured displacements of f patches from where they were measured before."""

    labels: NDArray[np.int64]
    """Shape (f,): the fiducial."""
    sources: NDArray[np.int64]
    """Shape (f,): the source it was compared with, or `TARGET_SOURCE`."""
    positions: Array
    """Shape (f, 3): centroid in the world frame, by the assumed pose of the camera, metres."""
    displacements: Array
    """Shape (f, 3): metres; 0 in directions that are not determined."""
    axes: Array
    """Shape (f, 3, 3): principal axes of the information, in the columns."""
    precisions: Array
    """Shape (f, 3): inverse variance along each axis; 0 where it is not determined."""

    @property
    def n_fiducials(self) -> int:
        """How many fiducials have a patch; each may have several, from different sources."""
        return len(set(self.labels.tolist()))

    @property
    def information(self) -> Array:
        """Inverse covariances (f, 3, 3) of the displacements; singular where not determined."""
        return product(self.axes * self.precisions[:, None, :], self.axes.transpose(0, 2, 1))

    def along_axes(self, vectors: Array) -> Array:
        """Components (f, 3) of vectors (f, 3) along each patch's axes."""
        return product(vectors[:, None, :], self.axes)[:, 0]


def patches_from_sums(sums: PatchSums, settings: CorrectionSettings) -> Patches:
    """Displacements by the sums that `association.accumulate_patches` fills.

    Noise in the normals gives a plane a little information in other directions. Directions with
    no more information than that are left out.
    """
    enough = sums.n_pixels >= settings.min_patch_pixels
    labels, sources = np.nonzero(enough)
    weight = sums.weight[enough]
    values, vectors = eigh(sums.information[enough])
    tilt = settings.tilt_noise_factor * sums.normal_variance[enough] / weight
    determined = values > np.maximum(tilt[:, None], 1e-9) * values[:, 2:]
    inverse = np.where(determined, 1.0 / np.maximum(values, 1e-12), 0.0)
    variance = inverse + settings.patch_model_std**2 + MIN_VARIANCE
    along = product(sums.vector[enough][:, None], vectors)[:, 0] * inverse
    return Patches(
        labels,
        sources + TARGET_SOURCE,
        sums.position[enough] / weight[:, None],
        product(vectors, along[:, :, None])[:, :, 0],
        vectors,
        np.where(determined, 1.0 / variance, 0.0),
    )
