"""Depth images of the truth: rays through a static scene and the moving bodies in it."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.elementary import power
from coopmap_env.core.kernels import PlainTuple, kernel
from coopmap_env.geometry import RigidTransform
from coopmap_env.sensing import DepthCamera, PointCloud, RangeNoise
from coopmap_env.simulation.depth._culling import (
    BodyBoxes,
    Rays,
    ViewCone,
    bounding_cone,
    cull_rays,
    nearest_hits,
    rotate_rays,
)
from coopmap_env.simulation.depth.traced_mesh import TracedMesh

MAX_RELATIVE_ERROR = 0.5
"""Fraction of the depth: no error of a measurement is larger, so that a hit stays in front of the
camera whatever the noise. The default noise would need 40 standard deviations to get there."""
NO_ROTATIONS, NO_TRANSLATIONS = np.empty((0, 3, 3)), np.empty((0, 3))


class CameraRays(NamedTuple):
    """The rays of a camera; see `from_directions`."""

    directions: NDArray[np.float64]
    """Shape (n, 3), of length 1, camera frame."""
    cone: ViewCone
    """Around them."""

    @classmethod
    def from_directions(cls, directions: ArrayLike) -> CameraRays:
        """Rays along unit vectors (n, 3) of the camera frame.

        Raises
        ------
        ValueError
            If the shape is another one, or a direction is not of length 1.
        """
        unit = np.ascontiguousarray(directions, dtype=np.float64)
        if unit.ndim != 2 or unit.shape[1] != 3:
            raise ValueError(f"directions must be (n, 3), got {unit.shape}")
        axis = np.empty(3)
        angle = bounding_cone(unit, axis)
        if math.isnan(angle):
            raise ValueError("directions must be unit vectors: one is not of length 1")
        return cls(unit, ViewCone(axis, angle))


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
        self.scene = _to_mesh(triangles)
        self.bodies: list[TracedMesh] = []
        self._boxes = _boxes_of(self.bodies)
        self._rays = _allocate_rays(0)

    def add_body(self, triangles: ArrayLike | TracedMesh) -> int:
        """Add a rigid body, its triangles (m, 3, 3) in a frame of its own; returns its number."""
        self.bodies.append(_to_mesh(triangles))
        self._boxes = _boxes_of(self.bodies)
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
        T_world_camera = RigidTransform(
            _check_array("rotation", rotation, (3, 3)),
            _check_array("translation", translation, (3,)),
        )
        T_world_bodies = RigidTransform(
            _check_array("body_rotations", body_rotations, (n_bodies, 3, 3)),
            _check_array("body_translations", body_translations, (n_bodies, 3)),
        )
        rays = CameraRays.from_directions(directions)
        return self.trace(rays, T_world_camera, T_world_bodies, self.visible_bodies(hidden))

    def visible_bodies(self, hidden: Collection[int]) -> NDArray[np.bool_]:
        """Which bodies (b,) a camera sees: all but those that are hidden from it.

        Raises
        ------
        ValueError
            If there is no such body.
        """
        n_bodies = len(self.bodies)
        visible = np.ones(n_bodies, dtype=np.bool_)
        for body in hidden:
            if not 0 <= body < n_bodies:
                raise ValueError(f"hidden names body {body}, and there are {n_bodies}")
            visible[body] = False
        return visible

    def trace(
        self,
        camera_rays: CameraRays,
        T_world_camera: RigidTransform,
        T_world_bodies: RigidTransform,
        visible: NDArray[np.bool_],
    ) -> NDArray[np.float64]:
        """As `distances`, of contiguous arrays that are known to be as described there."""
        directions, cone = camera_rays
        n, n_bodies = len(directions), len(self.bodies)
        if len(self._rays.lengths) < n * (n_bodies + 1):
            self._rays = _allocate_rays(n * (n_bodies + 1))
        origins, rotated, lengths, pixels = self._rays
        camera_pose = tuple(T_world_camera)
        rotate_rays(directions, camera_pose, self.scene.center, origins, rotated, lengths)
        self.scene.intersect(origins[:n], rotated[:n], lengths[:n])
        starts = np.empty(n_bodies + 1, dtype=np.int64)
        cull_rays(
            directions,
            tuple(cone),
            camera_pose,
            tuple(T_world_bodies),
            tuple(self._boxes),
            visible,
            starts,
            tuple(self._rays),
        )
        ends = starts.tolist()
        for mesh, i, j in zip(self.bodies, ends[:-1], ends[1:], strict=True):
            if i < j:  # few bodies are in view
                mesh.intersect(origins[i:j], rotated[i:j], lengths[i:j])
        out = np.empty(n)
        nearest_hits(ends[-1], lengths, pixels, out)
        return out


def _to_mesh(triangles: ArrayLike | TracedMesh) -> TracedMesh:
    return triangles if isinstance(triangles, TracedMesh) else TracedMesh(triangles)


def _boxes_of(bodies: list[TracedMesh]) -> BodyBoxes:
    return BodyBoxes(
        np.array([body.center for body in bodies]).reshape(-1, 3),
        np.array([body.half_size for body in bodies]).reshape(-1, 3),
        np.array([body.radius for body in bodies]),
    )


def _allocate_rays(n: int) -> Rays:
    return Rays(
        origins=np.empty((n, 3), dtype=np.float32),
        directions=np.empty((n, 3), dtype=np.float32),
        lengths=np.empty(n, dtype=np.float32),
        pixels=np.empty(n, dtype=np.int32),
    )


def _check_array(name: str, values: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} must be {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} has a value that is not finite: {array.tolist()}")
    return array


@kernel
def add_range_noise(
    distances: NDArray[np.float64],
    directions: NDArray[np.float64],
    near: float,
    far: float,
    noise: PlainTuple,
    draws: NDArray[np.float32],
    points: NDArray[np.float64],
    hit: NDArray[np.bool_],
) -> bool:
    """Fill the points (n, 3) of a cloud and `hit` (n,): Eq. 1 at the true distances (n,).

    `draws` (n, 3) are standard normal numbers; `noise` is a plain `NoiseParameters`. Returns
    whether all distances are >= 0.
    """
    valid = True
    intrinsic, depth_factor, lateral_factor, exponent = noise
    for k in range(len(distances)):
        d = distances[k]
        valid &= d >= 0.0
        hit[k] = near <= d <= far
        if not hit[k]:
            end = far if d > far else 0.0
            for i in range(3):
                points[k, i] = end * directions[k, i]
            continue
        scale = intrinsic * power(d, exponent)
        largest = MAX_RELATIVE_ERROR * d * directions[k, 0]
        for i in range(3):
            error = scale * (lateral_factor if i else depth_factor) * draws[k, i]
            points[k, i] = d * directions[k, i] + min(max(error, -largest), largest)
    return valid


def simulate_point_cloud(
    distances: ArrayLike, camera: DepthCamera, noise: RangeNoise, rng: np.random.Generator
) -> PointCloud:
    """What a camera measures of true distances: a point for each pixel, with noise (Eq. 1).

    Errors are drawn at the true distance along the three axes of the camera. A surface between
    `near` and `far` is a hit, whatever its noise. A beam without a surface up to `far` is free up
    to there. A surface nearer than `near` gives a point at the camera, which says nothing. All
    pixels take their draws, whatever they see: the random numbers that follow do not depend on
    the world.

    Parameters
    ----------
    distances : array_like, shape (n_pixels,)
        Metres, inf where there is nothing: those of `DepthRenderer.distances`.
    camera : DepthCamera
    noise : RangeNoise
        Eq. 1.
    rng : numpy.random.Generator
        Draws 3 numbers for each pixel.

    Returns
    -------
    PointCloud
        In the camera frame.

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
    points, hit = np.empty((n, 3)), np.empty(n, dtype=np.bool_)
    valid = add_range_noise(
        true_distances,
        camera.directions,
        float(camera.near),
        float(camera.far),
        tuple(noise.parameters),
        rng.standard_normal((n, 3), dtype=np.float32),
        points,
        hit,
    )
    if not valid:
        wrong = true_distances[~(true_distances >= 0)][0]
        raise ValueError(f"distances must be >= 0, got {wrong}")
    return PointCloud(points, hit)
