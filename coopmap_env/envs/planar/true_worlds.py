"""The true worlds of a scene, which policies never see."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np

from coopmap_env.core.files import brief
from coopmap_env.core.pcg64 import SEED_WORDS
from coopmap_env.envs.step_data import SCENE, EpisodeSeeds
from coopmap_env.mapping import VoxelGrid
from coopmap_env.simulation.scenes.planar import Obstacles, PlanarScene, PlanarWorld


class TrueWorlds:
    """The cells of E worlds, and each of them as a `PlanarWorld`.

    Parameters
    ----------
    scene : PlanarScene
        Makes them.
    grid : VoxelGrid
        As the scene declares it.
    n_worlds : int
        E.
    """

    def __init__(self, scene: PlanarScene, grid: VoxelGrid, n_worlds: int) -> None:
        self._scene, self._grid = scene, grid
        self.occupied = np.zeros((n_worlds, grid.n_cells), dtype=np.bool_)
        """Shape (E, n_cells)."""
        self._made: list[PlanarWorld | None] = [None] * n_worlds

    def draw(
        self,
        which: Sequence[int],
        seeds: Sequence[EpisodeSeeds],
        context: Callable[[int], AbstractContextManager[Any]] = nullcontext,
    ) -> None:
        """Replace some worlds by new ones; all of them or, after an error, none.

        Parameters
        ----------
        which : sequence of int
        seeds : sequence of EpisodeSeeds
            One for each.
        context : callable
            What to enter while a world is made; gets its number.

        Raises
        ------
        ValueError
            If the scene makes a world of another shape, resolution or origin than it declares, or
            there is not one seed for each world.
        """
        if len(which) != len(seeds):
            raise ValueError(f"{len(which)} worlds need as many seeds, got {len(seeds)}")
        made: list[PlanarWorld | None] = [None] * len(which)
        if type(self._scene) is Obstacles:  # one derived from it may make other worlds
            states = EpisodeSeeds.states(seeds, SCENE, SEED_WORDS)
            self._scene.write_worlds(np.array(which, dtype=np.int64), states, self.occupied)
        else:
            for k, (number, own) in enumerate(zip(which, seeds, strict=True)):
                with context(number):
                    made[k] = self._make(own)
        for number, world in zip(which, made, strict=True):
            self._made[number] = world
            if world is not None:
                self.occupied[number] = world.occupied.ravel()

    def world(self, number: int) -> PlanarWorld:
        """One of the worlds that were drawn."""
        world = self._made[number]
        if world is None:
            scene, cells = self._scene, self.occupied[number].reshape(self._grid.shape)
            world = PlanarWorld(cells, scene.resolution, scene.origin, scene.name)
            self._made[number] = world
        return world

    def _make(self, seeds: EpisodeSeeds) -> PlanarWorld:
        """A world of the scene, which must be as the scene declares."""
        scene = self._scene
        world = scene.world(np.random.default_rng(seeds.scene))
        if not isinstance(world, PlanarWorld):
            raise ValueError(f"scene {scene.name!r} must make a PlanarWorld, not {brief(world)}")
        for name in ("shape", "resolution", "origin"):
            actual, expected = getattr(world, name), getattr(self._grid, name)
            if actual != expected:
                raise ValueError(
                    f"scene {scene.name!r} made a world of {name} {actual}, not {expected}"
                )
        return world
