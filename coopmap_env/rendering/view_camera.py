"""The camera with which pictures of field episodes are taken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.geometry import Pose

Floats = NDArray[np.float32]

PANEL_SIZE = (600, 440)
"""Pixels."""
FIELD_OF_VIEW = np.radians(38.0)
ELEVATION = np.radians(40.0)


@dataclass(frozen=True)
class ViewCamera:
    """The camera of a picture; up is z.

    Raises
    ------
    ValueError
        If the view is vertical, or a value is outside of its range.
    """

    eye: tuple[float, float, float]
    look_at: tuple[float, float, float]
    field_of_view: float
    """Horizontal, radians."""
    width: int
    """Pixels."""
    height: int

    def __post_init__(self) -> None:
        away = np.subtract(self.eye, self.look_at)[:2]
        if not np.hypot(*away) > 1e-6:
            raise ValueError(f"ViewCamera must not view straight down: {self.eye}, {self.look_at}")
        if not 0 < self.field_of_view < np.pi:
            raise ValueError(
                f"ViewCamera.field_of_view must lie in (0, pi) radians, got {self.field_of_view}"
            )
        if not (self.width >= 1 and self.height >= 1):
            raise ValueError(f"ViewCamera must have pixels, got {self.width} x {self.height}")

    @cached_property
    def axes(self) -> NDArray[np.float64]:
        """Rows: right, up, and towards the viewer, in the world frame."""
        back = np.subtract(self.eye, self.look_at)
        back = back / np.linalg.norm(back)
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(back, right), back])

    @property
    def focal_length(self) -> float:
        """Pixels."""
        return self.width / 2 / float(np.tan(self.field_of_view / 2))

    @cached_property
    def centers(self) -> Floats:
        """Positions (n, 2) of all pixels, row by row: column, row."""
        rows, columns = np.indices((self.height, self.width), dtype=np.float32)
        return np.stack([columns.ravel(), rows.ravel()], axis=1) + np.float32(0.5)

    def rays(self, pixels: Floats) -> Floats:
        """Unit vectors (n, 3) through positions (n, 2) in the picture: column, row."""
        right, up, back = self.axes.astype(np.float32)
        column, row = pixels.T
        rays: Floats = column[:, None] * right - row[:, None] * up
        rays -= self.width / 2 * right - self.height / 2 * up + self.focal_length * back
        rays /= np.sqrt(dot_rows(rays, rays))[:, None]
        return rays

    def project(self, points: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Positions (..., 2) in the picture of points (..., 3), and their distances (...)."""
        away = np.asarray(points, dtype=np.float64) - self.eye
        local = away @ self.axes.T
        depth = np.maximum(-local[..., 2:], 1e-6)
        at = local[..., :2] * (1, -1) * self.focal_length / depth
        at += [self.width / 2, self.height / 2]
        return at, np.linalg.norm(away, axis=-1)


def overview_camera(target: ArrayLike, bases: Sequence[Pose]) -> ViewCamera:
    """View of a target's triangles (m, 3, 3) through the widest gap between the vehicles."""
    corners = np.asarray(target, dtype=np.float64).reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle = (low + high) / 2
    base_positions = np.array([base.translation for base in bases])
    around = np.sort(np.arctan2(*(base_positions - middle)[:, 1::-1].T))
    gaps = np.diff(around, append=around[0] + 2 * np.pi)
    azimuth = around[np.argmax(gaps)] + gaps.max() / 2
    box = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    corner = np.array([[x, y, z] for x in (-0.9, 0.9) for y in (-0.9, 0.9) for z in (0.0, 1.9)])
    shown = np.concatenate([box, *(base_position + corner for base_position in base_positions)])
    look_at = (shown.min(axis=0) + shown.max(axis=0)) / 2
    back = np.array([np.cos(azimuth), np.sin(azimuth), np.tan(ELEVATION)])
    view = ViewCamera(tuple(look_at + back), tuple(look_at), FIELD_OF_VIEW, *PANEL_SIZE)
    right, up, towards = view.axes @ (shown - look_at).T
    tangent = np.tan(FIELD_OF_VIEW / 2)
    needed = (
        np.maximum(np.abs(right), np.abs(up) * PANEL_SIZE[0] / PANEL_SIZE[1]) / tangent + towards
    )
    eye = look_at + back / np.linalg.norm(back) * max(float(needed.max()), 1.0)
    return ViewCamera(tuple(eye), tuple(look_at), FIELD_OF_VIEW, *PANEL_SIZE)


def dot_rows(a: Floats, b: Floats) -> Floats:
    """Scalar products (n,) of the rows of two arrays (n, 3)."""
    return np.einsum("nk,nk->n", a, b)
