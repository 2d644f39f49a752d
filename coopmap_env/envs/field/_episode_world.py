"""The world of an episode, as its scene makes it, and checks of it."""

from __future__ import annotations

import numpy as np

from coopmap_env.localization import SearchSettings
from coopmap_env.simulation.scenes.field import FieldScene, FieldWorld, UserScene


def has_fixed_bases(scene: FieldScene) -> bool:
    """Whether a scene's file names the poses of the bases."""
    return isinstance(scene, UserScene) and bool(scene.bases)


def make_world(scene: FieldScene, rng: np.random.Generator, n_robots: int) -> FieldWorld:
    """A world of a scene.

    Raises
    ------
    ValueError
        If its grid or its number of robots is not the declared one.
    """
    world = scene.world(rng, n_robots)
    if world.grid != scene.grid:
        raise ValueError(f"scene {scene.name!r} made a world of {world.grid}, not {scene.grid}")
    if world.n_robots != n_robots:
        raise ValueError(
            f"scene {scene.name!r} made room for {world.n_robots} robots, not {n_robots}"
        )
    return world


def check_bases_in_search_range(world: FieldWorld, search: SearchSettings) -> None:
    """Raise ValueError if a vehicle stands where registration does not search."""
    low, high = world.target_triangles.min(axis=(0, 1)), world.target_triangles.max(axis=(0, 1))
    for robot, base in enumerate(world.base_poses):
        distance = float(np.linalg.norm((base.translation - 0.5 * (low + high))[:2]))
        if not search.min_distance <= distance <= search.max_distance:
            raise ValueError(
                f"robot_{robot} stands {distance:.2f} m from the middle of the target, outside of "
                f"the searched {search.min_distance:g} to {search.max_distance:g} m: set "
                "min_distance or max_distance of FieldSettings.registration.search, or use "
                "initialization='located'"
            )
