"""A user's scene: always the same solids, and base poses that are given or drawn."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.files import brief
from coopmap_env.core.linear_algebra import length
from coopmap_env.mapping import VoxelGrid
from coopmap_env.simulation.scenes.field._solid_queries import distance_to_axis
from coopmap_env.simulation.scenes.field.base_poses import (
    DEFAULT_PLACEMENT,
    BasePlacement,
    check_vehicles,
    ground_pose,
    sample_base_poses,
)
from coopmap_env.simulation.scenes.field.solid import Solid
from coopmap_env.simulation.scenes.field.world import (
    BASE_CLEARANCE,
    FIELD_GRID,
    FieldWorld,
    check_field_grid,
)


def _is_pose(base: object) -> bool:
    """Whether something is three finite numbers."""
    try:
        numbers = np.array(base, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return False
    return numbers.shape == (3,) and bool(np.isfinite(numbers).all())


@dataclass(frozen=True, eq=False)
class UserScene:
    """The scene of one set of solids; read one with `read_user_scene`.

    Attributes
    ----------
    name : str
        What the scene is called in reports.
    solids : tuple of Solid
        At least one is a target.
    grid : VoxelGrid
        The voxels that the robots map.
    bases : tuple of (float, float, float)
        Base poses: x, y in metres and yaw in radians. Empty: drawn for each world.

    Raises
    ------
    ValueError
        With the value, if a field is not as described.
    """

    name: str
    solids: tuple[Solid, ...]
    grid: VoxelGrid = FIELD_GRID
    bases: tuple[tuple[float, float, float], ...] = ()

    def __post_init__(self) -> None:
        check_field_grid(self.grid)
        low, high = self._target_bounds()
        origin = np.array(self.grid.origin)
        end = origin + np.array(self.grid.shape) * self.grid.resolution
        if (high < origin).any() or (low > end).any():
            raise ValueError(
                f"the target must reach into the grid, {origin} to {end} m, not lie from {low} to "
                f"{high} m"
            )
        for k, base in enumerate(self.bases):
            if not _is_pose(base):
                raise ValueError(
                    f"base {k} must be three finite numbers x, y, yaw, not {brief(base)}"
                )
            if (base[:2] < origin[:2]).any() or (base[:2] > end[:2]).any():
                raise ValueError(
                    f"base {k} must stand in the grid, {origin[:2]} to {end[:2]} m, not at "
                    f"{base[:2]}"
                )

    def world(
        self, rng: np.random.Generator, n_robots: int, footprint: float = BASE_CLEARANCE
    ) -> FieldWorld:
        """The solids with the first of the given base poses, or with drawn ones.

        Raises
        ------
        ValueError
            If there are too few bases, if one is not clear, or if no free base pose is found.
        """
        check_vehicles(n_robots, footprint)
        if self.bases:
            self._check_bases(n_robots, footprint)
            poses = tuple(ground_pose(*base) for base in self.bases[:n_robots])
        else:
            low, high = self._target_bounds()
            reach = length(high[:2] - low[:2]) / 2
            base_placement = BasePlacement(
                DEFAULT_PLACEMENT.min_distance,
                max(DEFAULT_PLACEMENT.max_distance, reach + DEFAULT_PLACEMENT.min_distance),
            )
            middle = (low + high) / 2
            poses = sample_base_poses(
                rng, n_robots, base_placement, footprint, self.grid, self.solids, middle
            )
        target = next(solid.name for solid in self.solids if solid.is_target)
        return FieldWorld(self.name, self.solids, target, self.grid, poses)

    def _target_bounds(self) -> NDArray[np.float64]:
        """Lower and upper corner (2, 3) of the box around the target."""
        bounds = np.array([solid.bounds for solid in self.solids if solid.is_target])
        if len(bounds) == 0:
            raise ValueError("one of the solids must be a target, not none of them")
        return np.stack([bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)])

    def _check_bases(self, n_robots: int, footprint: float) -> None:
        if n_robots > len(self.bases):
            raise ValueError(
                f"{self.name} names {len(self.bases)} bases, too few for {n_robots} robots: name "
                f"more, or none to have them drawn"
            )
        for k, base in enumerate(self.bases[:n_robots]):
            distance = distance_to_axis(base[:2], self.solids)
            if distance < footprint:
                raise ValueError(
                    f"base {k} of {self.name} must keep {footprint:g} m clear of the solids, not "
                    f"{distance:.2f} m"
                )
            for other, other_base in enumerate(self.bases[:k]):
                apart = length(np.subtract(base[:2], other_base[:2]))
                if apart < footprint:
                    raise ValueError(
                        f"bases {other} and {k} of {self.name} must stand {footprint:g} m apart, "
                        f"not {apart:.2f} m"
                    )
