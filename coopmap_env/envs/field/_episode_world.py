"""The world of an episode, as its scene makes it, and checks of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from coopmap_env.core.files import brief
from coopmap_env.core.linear_algebra import length
from coopmap_env.localization import SearchSettings
from coopmap_env.mapping import VoxelGrid
from coopmap_env.robots import Vehicle
from coopmap_env.simulation.scenes.field import FieldScene, FieldWorld, UserScene


def has_fixed_bases(scene: FieldScene) -> bool:
    """Whether a scene's file names the poses of the bases."""
    return isinstance(scene, UserScene) and bool(scene.bases)


def make_world(scene: FieldScene, rng: np.random.Generator, n_robots: int) -> FieldWorld:
    """A world of a scene.

    Raises
    ------
    ValueError
        If it is no world, or its grid or its number of robots is not the declared one.
    """
    world = scene.world(rng, n_robots)
    if not isinstance(world, FieldWorld):
        raise ValueError(f"scene {scene.name!r} must make a FieldWorld, not {brief(world)}")
    if world.grid != scene.grid:
        raise ValueError(f"scene {scene.name!r} made a world of {world.grid}, not {scene.grid}")
    if world.n_robots != n_robots:
        raise ValueError(
            f"scene {scene.name!r} made room for {world.n_robots} robots, not {n_robots}"
        )
    return world


def check_cameras_in_map(
    scene: str, vehicles: Sequence[Vehicle], grid: VoxelGrid, margin: float = 0.5
) -> None:
    """Raise ValueError unless every camera is in the map while its mount is at home.

    `margin` cells inside: encoders and suspension move a camera by some millimetres.
    """
    for robot, vehicle in enumerate(vehicles):
        camera = vehicle.camera_pose(np.array(vehicle.mount.home)).translation
        in_cells = grid.to_cell_units(camera)
        if (in_cells < margin).any() or (in_cells > np.array(grid.shape) - margin).any():
            x, y, _ = vehicle.T_world_base.translation.tolist()
            end = np.array(grid.origin) + np.array(grid.shape) * grid.resolution
            raise ValueError(
                f"base {robot} of scene {scene!r}, at ({x:.2f}, {y:.2f}) m, must stand so that the "
                f"camera of robot_{robot} at home, at {_metres(camera)} m, is inside of the map, "
                f"{_metres(grid.origin)} to {_metres(end)} m: move the base or enlarge the grid"
            )


def _metres(position: ArrayLike) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in np.asarray(position)) + ")"


def check_bases_in_search_range(world: FieldWorld, search: SearchSettings) -> None:
    """Raise ValueError if a vehicle stands where registration does not search."""
    low, high = world.target_triangles.min(axis=(0, 1)), world.target_triangles.max(axis=(0, 1))
    for robot, base in enumerate(world.base_poses):
        distance = length((base.translation - 0.5 * (low + high))[:2])
        if not search.min_distance <= distance <= search.max_distance:
            raise ValueError(
                f"robot_{robot} stands {distance:.2f} m from the middle of the target, outside of "
                f"the searched {search.min_distance:g} to {search.max_distance:g} m: set "
                "min_distance or max_distance of FieldSettings.registration.search, or use "
                "initialization='located'"
            )
