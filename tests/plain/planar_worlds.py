"""Worlds drawn as text, and teams that stand where a test wants them."""

from dataclasses import replace

import numpy as np

from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.information.planar.cell_codes import write_codes
from coopmap_env.robots.planar.reachable_regions import find_regions
from coopmap_env.sensing import RangeNoise
from coopmap_env.simulation.scenes.planar import PlanarWorld, RecordedMap

NO_NOISE = RangeNoise(intrinsic=0.0)


def world_from_text(text, resolution=1.0, origin=(0.0, 0.0)):
    """A world from rows of '#' (occupied) and '.', as seen: x to the right, y up."""
    rows = [list(row.strip()) for row in text.strip().splitlines()]
    occupied = np.array(rows)[::-1].T == "#"
    return PlanarWorld(occupied, resolution, origin, "drawn")


def open_world(nx=40, ny=40, resolution=1.0, origin=(0.0, 0.0), walls=()):
    """A world without obstacles, but for the cells named."""
    occupied = np.zeros((nx, ny), dtype=bool)
    for cell in walls:
        occupied[cell] = True
    return PlanarWorld(occupied, resolution, origin, "drawn")


def env_with_world(world, **arguments):
    """An environment in this world, reset."""
    env = PlanarEnv(scene=RecordedMap(world), **arguments)
    env.reset(seed=0)
    return env


def pose_id(env, ix, iy, heading=0):
    """Lattice number of a cell and a heading."""
    lattice = env.belief().lattice
    return (ix * lattice.grid.shape[1] + iy) * lattice.n_headings + heading


def set_poses(env, *poses, known=None):
    """Stand the team at (ix, iy, heading), and make the map blank but for free cells.

    Without `known` (flat cells or a mask of the grid), only the robots' own cells are.
    """
    ids = [pose_id(env, *pose) for pose in poses]
    map_ = env.belief().map
    map_.clear()
    if known is not None:
        known = np.asarray(known)
        map_.mark_free(np.flatnonzero(known) if known.dtype == bool else known)
    map_.mark_free([i // env.belief().lattice.n_headings for i in ids])
    return place_team(env, ids)


def place_team(env, pose_ids):
    """Stand the team at lattice poses, on the map as it is, with new candidates."""
    worlds = env._worlds
    worlds.arrays.pose_ids[0] = pose_ids
    observe_again(worlds)
    env._belief = env._current_belief()
    # without regions, which are those of the map as it is now: tests go on changing it
    return replace(env.belief(), known_regions=None)


def observe_again(worlds):
    """Observations of the one world, after its map or its poses were changed from outside."""
    arrays, observations = worlds.arrays, worlds.empty_observations()
    codes = worlds.constants.code_of_log_odds
    write_codes(arrays.log_odds_fixed[0], arrays.sampled_mask[0], codes, arrays.codes[0])
    arrays.n_observed[0] = np.count_nonzero(arrays.sampled_mask[0])
    n_headings = worlds.lattice.n_headings
    find_regions(worlds.map(0).arrays, arrays.pose_ids[0], n_headings, worlds.regions(0))
    worlds.observe(np.zeros(1, dtype=np.int64), observations)
    return observations
