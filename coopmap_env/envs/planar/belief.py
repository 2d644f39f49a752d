"""Belief of a planar team: lattice poses, reached over the known free cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.random_streams import draw_stream
from coopmap_env.envs.belief import Belief
from coopmap_env.envs.reasons import RejectedReason
from coopmap_env.information import (
    PlanarRatingFunction,
    Ratings,
    RatingSettings,
    ReservedMask,
    ViewContext,
)
from coopmap_env.robots import PoseLattice
from coopmap_env.robots.planar.feasible_poses import (
    PoseSampling,
    picked_size,
    sample_feasible_poses,
    write_feasible_cells,
)
from coopmap_env.robots.planar.motion_time import LatticeSpeeds, write_motion_times
from coopmap_env.robots.planar.reachable_regions import (
    RegionArrays,
    feasibility,
    find_regions,
)


@dataclass(frozen=True)
class PlanarBelief(Belief):
    """What a planar team knows. A pose is an id of the `PoseLattice`."""

    pose_ids: tuple[int, ...]
    """Pose id of each camera."""
    rating_function: PlanarRatingFunction
    """Rates poses with the constants of the environment; has the pose lattice."""
    reach: float
    """Metres; see `PlanarSettings.reach`."""
    speeds: LatticeSpeeds
    """How fast the cameras move."""
    known_regions: RegionArrays | None = None
    """The environment's own of this map and these poses; None: they are searched when needed."""

    @property
    def lattice(self) -> PoseLattice:
        """The configuration space."""
        return self.rating_function.lattice

    @cached_property
    def camera_poses(self) -> NDArray[np.float64]:
        """Camera poses (n_robots, 3) [x, y, heading], metres and radians."""
        return self.lattice.poses(self.pose_ids)

    @property
    def rating_settings(self) -> RatingSettings:
        """Constants of the environment's rating function."""
        return self.rating_function.settings

    @property
    def positions(self) -> NDArray[np.float64]:
        """Camera positions, shape (n_robots, 2), metres."""
        return self.camera_poses[:, :2]

    @property
    def regions(self) -> RegionArrays:
        """The regions of known free space that the robots reach."""
        if self.known_regions is not None:
            return self.known_regions
        regions = RegionArrays.empty(self.map.grid.n_cells, len(self.pose_ids))
        find_regions(self.map.arrays, np.array(self.pose_ids), self.lattice.n_headings, regions)
        return regions

    @property
    def sampling(self) -> PoseSampling:
        """What one action can reach."""
        return PoseSampling(self.lattice.geometry, self.map.grid.shape_3d, float(self.reach))

    def feasible_cells(self, robot: int) -> NDArray[np.int64]:
        """Cells within reach that a collision-free path leads to, the nearest first.

        So of poses that a planner finds equally good, the nearest one is the first.
        """
        found = np.empty(self.map.grid.n_cells, dtype=np.int32)
        n = write_feasible_cells(self.pose_ids[robot], robot, self.sampling, self.regions, found)
        cells, ny = found[:n].astype(np.int64), self.map.grid.shape[1]
        x, y = divmod(self.cell(robot), ny)
        squares = (cells // ny - x) ** 2 + (cells % ny - y) ** 2
        nearest_first: NDArray[np.int64] = cells[np.argsort(squares, kind="stable")]
        return nearest_first

    def feasible_poses(self, robot: int) -> NDArray[np.int64]:
        """Pose ids (k,) of all headings in all feasible cells, in the order of the cells."""
        cells, n = self.feasible_cells(robot), self.lattice.n_headings
        return (cells[:, None] * n + np.arange(n)).ravel()

    def random_poses(self, robot: int, m: int, rng: np.random.Generator) -> NDArray[np.int64]:
        """Pose ids of up to m different feasible poses, uniformly at random."""
        # Threads may plan for many worlds, whose regions share one queue.
        regions = self.regions._replace(queue=np.empty(self.map.grid.n_cells, dtype=np.int32))
        poses, picked = np.empty((m,), dtype=np.int64), np.empty(picked_size(m), dtype=np.int64)
        n = sample_feasible_poses(
            self.pose_ids[robot], robot, self.sampling, regions, draw_stream(rng), picked, poses,
        )  # fmt: skip
        return poses[:n]

    def cell(self, robot: int) -> int:
        """Flat index of the cell in which the robot's camera is."""
        return self.pose_ids[robot] // self.lattice.n_headings

    def rate(
        self, robot: int, pose_ids: ArrayLike, reserved_mask: ReservedMask | None = None
    ) -> Ratings:
        """See `PlanarRatingFunction.rate`."""
        distance = self.distance(robot, pose_ids)
        return self.rating_function.rate(self.map, pose_ids, distance, ViewContext(reserved_mask))

    def rate_team(self, pose_ids: ArrayLike) -> Ratings:
        """See `PlanarRatingFunction.rate_team`."""
        ids = np.array(pose_ids)
        return self.rating_function.rate_team(
            self.map, ids, self.rating_function.distance(ids, self.pose_ids)
        )

    def distance(self, robot: int, pose_ids: ArrayLike) -> NDArray[np.float64]:
        """See `PlanarRatingFunction.distance`."""
        return self.rating_function.distance(pose_ids, self.pose_ids[robot])

    def motion_time(self, robot: int, pose_ids: ArrayLike) -> NDArray[np.float64]:
        """See `lattice_motion_time`."""
        ids = np.ascontiguousarray(self.lattice.checked_ids(pose_ids))
        seconds, start = np.empty(len(ids)), self.pose_ids[robot]
        n_headings, ny = self.lattice.n_headings, self.map.grid.shape[1]
        write_motion_times(start, ids, n_headings, ny, (*self.speeds,), seconds)
        return seconds

    def unknown_fraction(
        self, robot: int, pose_ids: ArrayLike, reserved_mask: ReservedMask | None = None
    ) -> NDArray[np.float64]:
        """See `PlanarRatingFunction.count_unknown_cells`."""
        context = ViewContext(reserved_mask)
        unknown = self.rating_function.count_unknown_cells(self.map, pose_ids, context)
        return unknown / self.rating_function.max_visible_cells

    def visible_cells(self, robot: int, pose_id: int) -> NDArray[np.int64]:
        """See `PlanarRatingFunction.visible_cells`."""
        return self.rating_function.visible_cells(self.map, pose_id)

    def infeasibility_reason(self, robot: int, pose_id: int) -> str:
        """Why this pose is infeasible; empty if it is feasible."""
        return self.rejected_reason(robot, pose_id).words

    def rejected_reason(self, robot: int, pose_id: int) -> RejectedReason:
        """The same as a code."""
        if not 0 <= pose_id < self.lattice.n_poses:
            return RejectedReason.OUTSIDE_WORLD
        goal = pose_id // self.lattice.n_headings
        arrays, start = self.map.arrays, self.cell(robot)
        return RejectedReason(feasibility(arrays, self.regions, robot, start, goal))

    def with_poses(self, pose_ids: tuple[int, ...]) -> PlanarBelief:
        """The same belief with the cameras at other poses, and without candidates.

        Raises
        ------
        ValueError
            If an id is no pose of the lattice, or there is not one for each robot.
        """
        if self.lattice.checked_ids(pose_ids).shape != (len(self.agents),):
            raise ValueError(f"{len(self.agents)} robots need a pose id each, got {pose_ids}")
        return replace(self, pose_ids=pose_ids, candidates=None, known_regions=None)

    def with_candidates(self, candidates: Sequence[NDArray[np.int64]]) -> PlanarBelief:
        """The same belief with candidates."""
        return replace(self, candidates=tuple(candidates))
