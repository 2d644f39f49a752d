"""Belief: what the robots of a team know, which is all that a policy sees besides observations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from coopmap_env.envs.budget import Budget
from coopmap_env.envs.reasons import RejectedReason
from coopmap_env.information import Ratings, RatingSettings, ReservedMask
from coopmap_env.mapping import OccupancyMap

Observation = dict[str, NDArray[Any]]
"""What one robot observes; the entries are documented by each environment's `observations`."""
Observations = Mapping[str, Observation]
Poses = NDArray[Any]
"""Camera poses of one robot, one a row: lattice ids (k,) in the planar environment, mount joints
(k, n) in the field environment. Planners pass them on and do not interpret them."""


class Decoded(NamedTuple):
    """What an action means."""

    pose: Any
    """The requested pose."""
    rejected_reason: RejectedReason
    """Why the pose is infeasible, so that the camera stays; `NONE` if it is feasible."""

    @property
    def target(self) -> Any:
        """The pose to go to; None if it is rejected."""
        return None if self.rejected_reason else self.pose


class ActionMode(Protocol):
    """How the actions of one robot are encoded and decoded."""

    def space(self, robot: int) -> spaces.Space[Any]:
        """Make a new space for one robot."""

    def decode(self, agent: str, action: Any, belief: Any) -> Decoded:
        """Pose that the action requests, and why it is rejected if it is infeasible.

        Raises
        ------
        InvalidActionError
            Naming the robot and the value.
        """

    def encode(self, robot: int, pose: Any, belief: Any) -> Any:
        """Action that leads a robot to a pose.

        Raises
        ------
        InvalidActionError
            If no single action does.
        """


class CameraFrames(NamedTuple):
    """Cameras of some poses as pinholes: x along the optical axis."""

    rotations: NDArray[np.float64]
    """Shape (k, D, D): columns are the camera's axes in the frame of the map."""
    translations: NDArray[np.float64]
    """Shape (k, D), metres."""
    tangents: NDArray[np.float64]
    """Tangents of half the fields of view, (D - 1,)."""
    near: float
    """Metres."""
    far: float
    """Metres."""


class Foresight(Protocol):
    """What the map may be after the next scans of a team, for planners that look ahead."""

    def copy(self) -> Self:
        """The same future; what is taken from now on changes one of the two."""

    def gain(self, robot: int, poses: Poses) -> NDArray[np.float64]:
        """What each pose is expected to show, as a fraction of a full view, (k,).

        New cells; in the field, with predictions, those of them that are occupied.
        """

    def take(self, robot: int, pose: Any) -> None:
        """Scan from a pose: its cells are no longer new, and may be entered."""

    def random_poses(self, robot: int, pose: Any, m: int, rng: np.random.Generator) -> Poses:
        """Up to m different poses that will probably be feasible from a pose."""

    def distance(self, robot: int, poses: Poses, pose: Any) -> NDArray[np.float64]:
        """Distance d of Eq. 5 from a pose to each of some poses, shape (k,)."""


class Planning(Protocol):
    """Operations that only one or two of the baselines need, such as the order of a raster.

    Each kind of environment implements them, so that planners need not ask in which one they are.
    Beliefs carry the object of their environment (`Belief.planning`); it belongs to no particular
    belief, so each method takes one.
    """

    unknown_prior: float
    """Occupancy expected of a cell that was never sampled: the mean of training worlds."""

    def mutual_information_fraction(
        self,
        belief: Any,
        robot: int,
        poses: Poses,
        prior: float,
        reserved_mask: ReservedMask | None,
    ) -> NDArray[np.float64]:
        """Mutual information of the beams with the map, shape (k,).

        As a fraction of that of a wholly unknown, unobstructed view. `prior` is the occupancy
        expected of never-sampled cells.
        """

    def nearest_frontier_mask(
        self, belief: Any, robot: int, poses: Poses, shows_unknown: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Which poses belong to the nearest frontier, among those that `shows_unknown` marks."""

    def expected_unknown_fraction(
        self, belief: Any, robot: int, poses: Poses, reserved_mask: ReservedMask | None
    ) -> NDArray[np.float64]:
        """New cells that a view is expected to show, shape (k,).

        As a fraction of the most that a camera can see.
        """

    def foresight(
        self, belief: Any, unknown_occupancy: NDArray[np.float32] | None = None
    ) -> Foresight:
        """The map as it is, to look ahead from.

        Parameters
        ----------
        belief : Belief
        unknown_occupancy : ndarray of float32, shape (n_cells,), optional
            Predicted probability that a beam that reaches a cell ends there, or in the field that a
            voxel is surface; those of sampled cells are not used.

        Raises
        ------
        ValueError
            If the predictions are no probabilities of all cells.
        """

    def frontier_mask(self, belief: Any, robot: int) -> NDArray[np.bool_]:
        """Frontier cells of the map that a robot plans on, in the shape of its grid."""

    def frontier_poses(
        self, belief: Any, robot: int, clusters: NDArray[np.int32]
    ) -> tuple[Poses, NDArray[np.int32]]:
        """Poses at clusters of the cells of `frontier_mask`, and the cluster of each, shape (k,).

        Poses that a single action does not reach are among them. `clusters`, in the shape of the
        grid, are the numbers of the clusters from 1 on, 0 for none.
        """

    def clusters_of_poses(
        self, belief: Any, robot: int, poses: Poses, clusters: NDArray[np.int32]
    ) -> NDArray[np.int32]:
        """The cluster to which each of some poses belongs, shape (k,), 0 for none."""

    def occupied_mask(self, belief: Any, robot: int) -> NDArray[np.bool_]:
        """Cells that are probably occupied, of the map that a robot plans on, in its shape."""

    def camera_frames(self, belief: Any, robot: int, poses: Poses) -> CameraFrames:
        """The cameras at some poses.

        Raises
        ------
        ValueError
            If no pinhole camera has its field of view.
        """

    def n_actions(self, belief: Any, robot: int, poses: Poses) -> NDArray[np.int64]:
        """Actions that it takes to reach each pose, about, shape (k,)."""

    def raster_offset(self, belief: Any, robot: int, poses: Poses) -> NDArray[np.int64]:
        """Steps from the robot's pose to each pose in the cyclic raster sequence, shape (k,)."""

    def prescreen(
        self, belief: Any, poses: Poses, score: Callable[[Any, Poses], NDArray[np.float64]]
    ) -> Poses:
        """The poses that are worth scoring at full resolution.

        `score` maps a belief and poses to their scores, higher is better.
        """

    def rate_all(
        self, belief: Any, robot: int, poses: Poses, reserved_mask: ReservedMask | None
    ) -> Ratings:
        """`Belief.rate`, for planners that rate the whole configuration space at every step.

        It may remember the ratings that the last scans did not change.
        """


class Observer(Protocol):
    """Declares the spaces of observations. Each environment makes its own."""

    def space(self, robot: int) -> spaces.Dict:
        """Make a new observation space of one robot."""

    def state_space(self) -> spaces.Box:
        """Make a new space of `state`."""

    def state(self, belief: Any) -> NDArray[np.float32]:
        """What a centralised critic may see, as one vector."""


@dataclass(frozen=True)
class Belief(ABC):
    """The team's map, its own poses and its own limits; never the truth.

    Planners are written against this class, so that they run in every environment. `map` is the
    environment's own and not a copy: read it, do not change it.
    """

    agents: tuple[str, ...]
    """Names of the robots; `robot` in every method is an index into it."""
    map: OccupancyMap
    """The fused map of the whole team."""
    actions: ActionMode
    """How actions are encoded."""
    planning: Planning
    """Operations that only some baselines need, for this kind of environment."""
    candidates: tuple[Poses, ...] | None
    """Candidate poses of each robot, in "candidates" mode."""
    budget: Budget
    """What is left of the episode."""
    scan_time: float
    """Seconds that a scan takes."""

    @property
    @abstractmethod
    def positions(self) -> NDArray[np.float64]:
        """Estimated camera positions, shape (n_robots, D), metres; NaN if unknown."""

    @property
    @abstractmethod
    def rating_settings(self) -> RatingSettings:
        """Constants of the ratings (Eqs. 6 to 9)."""

    @abstractmethod
    def feasible_poses(self, robot: int) -> Poses:
        """All poses of the discrete configuration space that are reached without a collision."""

    @abstractmethod
    def random_poses(self, robot: int, m: int, rng: np.random.Generator) -> Poses:
        """Up to m different feasible poses, uniformly at random."""

    @abstractmethod
    def rate(self, robot: int, poses: Poses, reserved_mask: ReservedMask | None = None) -> Ratings:
        """Eqs. 5 to 9 of each pose."""

    @abstractmethod
    def rate_team(self, poses: Any) -> Ratings:
        """Eqs. 5 to 9 of one pose for each robot, scanned at once: an overlap counts once."""

    @abstractmethod
    def distance(self, robot: int, poses: Poses) -> NDArray[np.float64]:
        """Distance d of Eq. 5 from the robot's pose, shape (k,)."""

    @abstractmethod
    def motion_time(self, robot: int, poses: Poses) -> NDArray[np.float64]:
        """Seconds that the robot takes to each pose, shape (k,)."""

    @abstractmethod
    def unknown_fraction(
        self, robot: int, poses: Poses, reserved_mask: ReservedMask | None = None
    ) -> NDArray[np.float64]:
        """Never-sampled cells in view, as a fraction of the most a camera can see, shape (k,)."""

    @abstractmethod
    def visible_cells(self, robot: int, pose: Any) -> NDArray[np.int64]:
        """Flat indices of the cells that a pose would see on the known map."""

    @abstractmethod
    def with_poses(self, poses: Any) -> Self:
        """The same belief with the robots at other poses, and without candidates."""

    @abstractmethod
    def with_candidates(self, candidates: Sequence[Poses]) -> Self:
        """The same belief with candidates."""

    def action_for(self, robot: int, pose: Any) -> Any:
        """Action that leads the robot to a pose.

        Raises
        ------
        InvalidActionError
            If no single action does.
        """
        return self.actions.encode(robot, pose, self)
