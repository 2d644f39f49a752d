"""Kernels over views as Python calls them, with plain tuples (see `coopmap_env.core.kernels`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, inlined_kernel, kernel
from coopmap_env.geometry import RigidTransform
from coopmap_env.information.field._depth_buffer import CameraArrays, SphereArrays
from coopmap_env.information.field.frustum import FrustumGeometry
from coopmap_env.information.field.views import (
    PoseArrays,
    evaluate_views,
    list_visible_cells,
    sequential_new_information,
    sum_views,
)
from coopmap_env.information.gray_levels import GrayBins
from coopmap_env.mapping import MapArrays
from coopmap_env.mapping.occluders import ViewedMap


def plain_map(viewed: ViewedMap) -> PlainTuple:
    """A map as the kernels below take it."""
    return tuple(viewed.arrays), viewed.occluders


def plain_camera(camera: CameraArrays) -> PlainTuple:
    """A camera as the kernels below take it."""
    return (tuple(camera.frustum), *camera[1:])


@inlined_kernel
def _viewed(map_tuple: PlainTuple) -> ViewedMap:
    return ViewedMap(MapArrays(*map_tuple[0]), map_tuple[1])


@inlined_kernel
def _camera(camera_tuple: PlainTuple) -> CameraArrays:
    frustum, directions, max_runs, max_row = camera_tuple
    return CameraArrays(FrustumGeometry(*frustum), directions, max_runs, max_row)


@kernel
def evaluate_poses(
    map_tuple: PlainTuple,
    reserved_mask: NDArray[np.uint8],
    poses: PlainTuple,
    spheres: PlainTuple,
    camera_tuple: PlainTuple,
    gray_tuple: PlainTuple,
    ni: NDArray[np.float64],
    unknown: NDArray[np.int64],
) -> None:
    """`evaluate_views`."""
    evaluate_views(
        _viewed(map_tuple), reserved_mask, PoseArrays(*poses), SphereArrays(*spheres),
        _camera(camera_tuple), GrayBins(*gray_tuple), ni, unknown,
    )  # fmt: skip


@kernel
def evaluate_team(
    map_tuple: PlainTuple,
    reserved_mask: NDArray[np.uint8],
    poses: PlainTuple,
    spheres: PlainTuple,
    ends: NDArray[np.int64],
    camera_tuple: PlainTuple,
    gray_tuple: PlainTuple,
    ni: NDArray[np.float64],
) -> None:
    """`sequential_new_information`."""
    sequential_new_information(
        _viewed(map_tuple), reserved_mask, PoseArrays(*poses), SphereArrays(*spheres), ends,
        _camera(camera_tuple), GrayBins(*gray_tuple), ni,
    )  # fmt: skip


@kernel
def sum_poses(
    map_tuple: PlainTuple,
    weights: NDArray[np.float32],
    poses: PlainTuple,
    spheres: PlainTuple,
    camera_tuple: PlainTuple,
    out: NDArray[np.float64],
) -> None:
    """`sum_views`."""
    sum_views(
        _viewed(map_tuple), weights, PoseArrays(*poses), SphereArrays(*spheres),
        _camera(camera_tuple), out,
    )  # fmt: skip


@kernel
def find_visible_cells(
    map_tuple: PlainTuple, poses: PlainTuple, spheres: PlainTuple, camera_tuple: PlainTuple
) -> NDArray[np.int32]:
    """`list_visible_cells` of one pose (1,)."""
    pose = RigidTransform(poses[0][0], poses[1][0])
    return list_visible_cells(
        _viewed(map_tuple), pose, SphereArrays(*spheres), _camera(camera_tuple)
    )
