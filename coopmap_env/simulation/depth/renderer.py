"""Depth images of the truth: rays through a static scene and the moving bodies in it."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from coopmap_env.sensing import DepthCamera, PointCloud, RangeNoise
from coopmap_env.simulation.depth.culling import (
    bounding_cone,
    cull_rays,
    reduce_nearest,
    rotate_rays,
)
from coopmap_env.simulation.depth.traced_mesh import TracedMesh

MAX_RELATIVE_ERROR = 0.5
"""Of the depth: no error of a measurement is larger, so that a hit stays in front of the camera
whatever the noise. The default noise would need 40 standard deviations to get there."""
NO_ROTATIONS, NO_TRANSLATIONS = np.empty((0, 3, 3)), np.empty((0, 3))

RayBuffers = tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]]


class DepthRenderer:
    """Distances to the surfaces of a static scene, and of bodies that move in it.

    Parameters
    ----------
    triangles : array_like, shape (m, 3, 3), or TracedMesh
        The static scene in the world frame, metres.

    Raises
    ------
    ValueError, ImportError
        As `TracedMesh` does.
    """

    def __init__(self, triangles: ArrayLike | TracedMesh) -> None:
        self.scene = _mesh(triangles)
        self.bodies: list[TracedMesh] = []
        self._boxes = np.empty((0, 7))
        self._ray_buffers = _ray_buffers(0)

    def add_body(self, triangles: ArrayLike | TracedMesh) -> int:
        """Add a rigid body, its triangles (m, 3, 3) in a frame of its own; returns its number."""
        body = _mesh(triangles)
        self.bodies.append(body)
        box = [*body.center, *body.half_size, body.radius]
        self._boxes = np.vstack([self._boxes, box])
        return len(self.bodies) - 1

    def distances(
        self,
        rotation: ArrayLike,
        translation: ArrayLike,
        directions: ArrayLike,
        body_rotations: ArrayLike = NO_ROTATIONS,
        body_translations: ArrayLike = NO_TRANSLATIONS,
        hidden: Collection[int] = (),
    ) -> NDArray[np.float64]:
        """How far each ray of a camera goes until it meets a surface.

        Parameters
        ----------
        rotation, translation : array_like, shapes (3, 3) and (3,)
            T_world_camera.
        directions : array_like, shape (n, 3)
            Unit vectors in the camera frame.
        body_rotations, body_translations : array_like, shapes (b, 3, 3) and (b, 3)
            T_world_body of all bodies, in the order in which they were added.
        hidden : collection of int
            Bodies that this camera does not see, such as its own housing.

        Returns
        -------
        ndarray, shape (n,)
            Metres; inf where there is nothing.

        Raises
        ------
        ValueError
            If a shape is another one, or a value is not finite, or a direction not of length 1.
        """
        n_bodies = len(self.bodies)
        R, t = _finite("rotation", rotation, (3, 3)), _finite("translation", translation, (3,))
        rays = np.ascontiguousarray(directions, dtype=np.float64)
        Rs = _finite("body_rotations", body_rotations, (n_bodies, 3, 3))
        ts = _finite("body_translations", body_translations, (n_bodies, 3))
        if rays.ndim != 2 or rays.shape[1] != 3:
            raise ValueError(f"directions must be (n, 3), got {rays.shape}")
        axis = np.empty(3)
        cone_angle = bounding_cone(rays, axis)
        if np.isnan(cone_angle):
            raise ValueError("directions must be unit vectors: one is not of length 1")
        visible = np.ones(n_bodies, dtype=np.bool_)
        for body in hidden:
            if not 0 <= body < n_bodies:
                raise ValueError(f"hidden names body {body}, and there are {n_bodies}")
            visible[body] = False

        n = len(rays)
        if len(self._ray_buffers[0]) < n * (n_bodies + 1):
            self._ray_buffers = _ray_buffers(n * (n_bodies + 1))
        lengths, ray_indices, origins, rotated = self._ray_buffers
        lengths[:n] = np.inf
        rotate_rays(rays, R, t - self.scene.center, origins, rotated)
        self.scene.intersect(origins[:n], rotated[:n], lengths[:n])
        first = np.empty(n_bodies + 1, dtype=np.int64)
        cull_rays(
            rays, axis, cone_angle, R, t, Rs, ts, self._boxes, visible,
            first, ray_indices, origins, rotated, lengths,
        )  # fmt: skip
        ends = first.tolist()
        for mesh, i, j in zip(self.bodies, ends[:-1], ends[1:], strict=True):
            mesh.intersect(origins[i:j], rotated[i:j], lengths[i:j])
        out = np.empty(n)
        reduce_nearest(ends[-1], ray_indices, lengths, out)
        return out


def _mesh(triangles: ArrayLike | TracedMesh) -> TracedMesh:
    return triangles if isinstance(triangles, TracedMesh) else TracedMesh(triangles)


def _ray_buffers(n: int) -> RayBuffers:
    """Room for n rays: their lengths, what they are rays of, origins and directions."""
    return (
        np.empty(n, dtype=np.float32),
        np.empty(n, dtype=np.int32),
        np.empty((n, 3), dtype=np.float32),
        np.empty((n, 3), dtype=np.float32),
    )


def _finite(name: str, values: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} must be {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} has a value that is not finite: {array.tolist()}")
    return array


@njit(cache=True, nogil=True)
def add_range_noise(distances, directions, near, far, noise, draws, points, hit):
    """Fill the points of a cloud: Eq. 1 at the true distance, `noise` (S, T depth, T lateral, n).

    `draws` (n, 3) are standard normal numbers.
    """
    intrinsic, depth_factor, lateral_factor, exponent = noise
    for k in range(len(distances)):
        d = distances[k]
        hit[k] = near <= d <= far
        if not hit[k]:
            end = far if d > far else 0.0
            for i in range(3):
                points[k, i] = end * directions[k, i]
            continue
        scale = intrinsic * (d * d if exponent == 2.0 else d**exponent)
        largest = MAX_RELATIVE_ERROR * d * directions[k, 0]
        for i in range(3):
            error = scale * (lateral_factor if i else depth_factor) * draws[k, i]
            points[k, i] = d * directions[k, i] + min(max(error, -largest), largest)


def simulate_point_cloud(
    distances: ArrayLike, camera: DepthCamera, noise: RangeNoise, rng: np.random.Generator
) -> PointCloud:
    """What a camera measures of true distances: a point for each pixel, disturbed by Eq. 1.

    Errors are drawn at the true distance along the three axes of the camera. A surface between
    `near` and `far` is a hit, however it is disturbed. A beam that meets nothing until `far` is
    clear up to there; of a surface nearer than `near` nothing is said. All pixels take their
    draws, whatever they see: a different world leaves the rest of the random numbers as it was.

    Parameters
    ----------
    distances : array_like, shape (n_pixels,)
        Metres, inf where there is nothing: those of `DepthRenderer.distances`.
    camera : DepthCamera
        Which camera looks.
    noise : RangeNoise
        Eq. 1.
    rng : numpy.random.Generator
        Draws 3 numbers for each pixel.

    Raises
    ------
    ValueError
        If there is not one distance a pixel, or one is negative or NaN.
    """
    true_distances = np.ascontiguousarray(distances, dtype=np.float64)
    n = camera.n_pixels
    if true_distances.shape != (n,):
        raise ValueError(
            f"a camera of {n} pixels needs distances ({n},), got {true_distances.shape}"
        )
    if not (true_distances >= 0).all():
        raise ValueError(f"distances must be >= 0, got {true_distances[~(true_distances >= 0)][0]}")
    points, hit = np.empty((n, 3)), np.empty(n, dtype=np.bool_)
    add_range_noise(
        true_distances, camera.directions, float(camera.near), float(camera.far),
        (float(noise.intrinsic), float(noise.depth), float(noise.lateral), float(noise.exponent)),
        rng.standard_normal((n, 3), dtype=np.float32), points, hit,
    )  # fmt: skip
    return PointCloud(points, hit)
