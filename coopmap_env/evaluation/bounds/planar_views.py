"""What planar cameras view in a true world, from all poses of their lattice.

A camera is never in an occupied cell: a motion that would end there is a collision, and it stays.
Between two scans it moves less far than the corner of its square of reach. So it is at its scan s
in a free cell to which at most s such jumps lead, from free cell to free cell, whatever lies
between them: a map that is wrong may take it through a wall.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from coopmap_env.core.arguments import check_count
from coopmap_env.core.kernels import PlainTuple, kernel
from coopmap_env.core.random_streams import stream_state
from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation.bounds._planar_choices import MAX_MOVE, FramedPoses, choose_views
from coopmap_env.evaluation.bounds._planar_frame import PlanarFrame
from coopmap_env.evaluation.bounds._planar_scores import STRIP, score_views
from coopmap_env.evaluation.bounds.certificate import PoseSets, ViewScores
from coopmap_env.sensing.beam_fan import FanArrays
from coopmap_env.simulation.shown_cells import list_planar_view

BLOCK = 4
"""Cells along the side of a block of neighbours."""
ROUNDING = 0.5 * math.sqrt(2.0) + 1e-6
"""Cells by which a requested pose is moved to the nearest one of the lattice, at most; coordinates
that are so large that their own rounding takes more are refused."""
MAX_COORDINATE = 1e8
"""Cells from the origin of the world to a corner of its grid: doubles then round to 1e-8."""


@dataclass(frozen=True, eq=False)
class PlanarViews:
    """Views in a planar world; see `Views`. A pose is its number in the lattice."""

    n_scans: int
    occupied: NDArray[np.bool_]
    """The true world (nx, ny)."""
    fan: FanArrays
    known: NDArray[np.bool_]
    cells: NDArray[np.int64]
    """Flat indices (k,) of the free cells that a robot can come to."""
    earliest: NDArray[np.int64]
    blocks: NDArray[np.int64]

    @classmethod
    def from_env(cls, env: PlanarEnv, n_scans: int | None = None) -> PlanarViews:
        """Those of an environment after a reset, before the first step.

        Parameters
        ----------
        env : PlanarEnv
        n_scans : int, optional
            Scans of each robot, by default those of an episode.

        Raises
        ------
        ValueError
            If it is no planar environment, robots have scanned already, there is no scan, or the
            world lies so far from its origin that coordinates are not exact.
        """
        if not isinstance(env, PlanarEnv):
            raise ValueError(f"planar views need a planar environment, got {env}")
        belief, occupied = env.belief(), env.truth.occupied
        if env.last_scans:
            raise ValueError("the environment has been stepped: reset it")
        n_scans = check_count("n_scans", env.max_scans if n_scans is None else n_scans)
        grid = belief.map.grid
        if np.abs(grid.origin).max() / grid.resolution + max(grid.shape) > MAX_COORDINATE:
            raise ValueError(f"the origin of the world is too far away for a bound: {grid}")
        fan, ny = belief.rating_function.fan, grid.shape[1]
        jump = math.sqrt(2.0) * belief.reach / grid.resolution + ROUNDING
        starts = [pose_id // fan.n_headings for pose_id in belief.pose_ids]
        earliest = np.array(
            [earliest_scans(occupied, start, jump, n_scans).ravel() for start in starts]
        )
        cells = np.flatnonzero((earliest <= n_scans).any(axis=0))
        return cls(
            n_scans,
            occupied,
            fan.arrays(ny),
            belief.map.sampled.ravel(),
            cells,
            np.ascontiguousarray(earliest[:, cells]),
            cells // ny // BLOCK * ny + cells % ny // BLOCK,
        )

    @property
    def n_headings(self) -> int:
        """Headings of the lattice."""
        return len(self.fan.start) - 1

    @cached_property
    def digest(self) -> str:
        """See `Views`."""
        sha = hashlib.sha256(b"planar views 1")
        for values, kind in (
            ([self.n_scans, self.n_headings, *self.occupied.shape, len(self.earliest)], "<i8"),
            (self.occupied, "?"),
            (self.known, "?"),
            (self.cells, "<i8"),
            (self.earliest, "<i8"),
            (self.fan.start, "<i8"),
            (self.fan.offsets, "<i8"),
            (self.fan.beams, "<u8"),
            (self.fan.all_beams, "<u8"),
        ):
            sha.update(np.ascontiguousarray(values, dtype=kind).tobytes())
        return sha.hexdigest()

    @cached_property
    def frame(self) -> PlanarFrame:
        """The frame in which kernels see the world."""
        return PlanarFrame(self.occupied.shape, max(self.fan.max_offset, MAX_MOVE))

    def best(self, weights: NDArray[np.int64]) -> ViewScores:
        """See `Views`."""
        scores, headings = np.empty((2, len(self.cells)), dtype=np.int64)
        marked = np.where(self.occupied.ravel(), -1 - weights, weights)
        framed = np.append(self.frame.around(marked, 0), np.zeros(STRIP, dtype=np.int64))
        cells, fan = self.frame.framed(self.cells), self.frame.fan(self.fan)
        score_views(framed, cells, tuple(fan), scores, headings)
        return ViewScores(scores, self.cells * self.n_headings + headings)

    def choose(self, n_scans: int, n_exchanges: int) -> NDArray[np.int64]:
        """See `Views`."""
        frame, scans = self.frame, np.arange(1, n_scans + 1)
        earliest = np.full((len(self.earliest), self.occupied.size), n_scans + 1)
        earliest[:, self.cells] = self.earliest
        poses = FramedPoses(
            frame.around(-self.occupied.ravel().astype(np.int8), 0),
            frame.width,
            frame.around(self.known, True),
            frame.around(earliest, n_scans + 1),
            frame.framed(self.cells)[np.argsort(self.earliest, axis=1, kind="stable")],
            np.array([np.searchsorted(np.sort(own), scans, "right") for own in self.earliest]).T,
        )
        chosen = np.empty((n_scans, len(self.earliest)), dtype=np.int64)
        stream = stream_state(np.random.SeedSequence(0))
        choose_views(tuple(poses), tuple(frame.fan(self.fan)), n_exchanges, stream, chosen)
        cells, headings = np.divmod(chosen, self.n_headings)
        return frame.unframed(cells) * self.n_headings + headings

    def pose_sets(self, poses: NDArray[np.int64]) -> PoseSets:
        """See `Views`."""
        nx, ny = self.occupied.shape
        start = np.zeros(len(poses) + 1, dtype=np.int64)
        cells = np.empty(len(poses) * self.fan.max_visible_cells, dtype=np.int32)
        _list_views(self.occupied.ravel(), (nx, ny), poses, tuple(self.fan), start, cells)
        return PoseSets(start, cells[: start[-1]].copy())

    def can_take(self, choice: NDArray[np.int64]) -> bool:
        """See `Views`."""
        places = np.minimum(self.place_of(choice), len(self.cells) - 1)
        if (self.cells[places] != choice // self.n_headings).any():
            return False
        scans = np.arange(1, len(choice) + 1)[:, None]
        return bool((self.earliest[np.arange(len(self.earliest)), places] <= scans).all())

    def place_of(self, poses: NDArray[np.int64]) -> NDArray[np.int64]:
        """See `Views`."""
        return np.searchsorted(self.cells, poses // self.n_headings)


def earliest_scans(
    occupied: NDArray[np.bool_], start: int, jump: float, n_scans: int
) -> NDArray[np.int64]:
    """First scan (nx, ny) that a robot can take in each cell; n_scans + 1 where it takes none.

    Parameters
    ----------
    occupied : ndarray, shape (nx, ny)
    start : int
        Flat index of the robot's cell.
    jump : float
        Cells, center to center: no motion between two scans is longer.
    n_scans : int
    """
    out = np.full(occupied.shape, n_scans + 1)
    reached = np.zeros(occupied.shape, dtype=np.bool_)
    reached.ravel()[start] = True
    for scan in range(1, n_scans + 1):
        near = (ndimage.distance_transform_edt(~reached) <= jump) & ~occupied
        out[near & (out > scan)] = scan
        if (near == reached).all():
            break
        reached = near
    return out


@kernel
def _list_views(
    occupied: NDArray[np.bool_],
    shape: tuple[int, int],
    poses: NDArray[np.int64],
    plain_fan: PlainTuple,
    start: NDArray[np.int64],
    cells: NDArray[np.int32],
) -> None:
    """Write the `PoseSets` of some poses; the first start is given."""
    fan = FanArrays(*plain_fan)
    alive, n_headings = np.empty(len(fan.all_beams), np.uint64), len(fan.start) - 1
    for p in range(len(poses)):
        cell, heading = poses[p] // n_headings, poses[p] % n_headings
        n = list_planar_view(occupied, shape, cell, heading, fan, alive, cells[start[p] :])
        start[p + 1] = start[p] + n
