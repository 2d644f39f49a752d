"""How many never-sampled cells a view is expected to show, where unknown cells may end its beams.

A beam that reaches an unknown cell ends there with a small probability, the *hazard*. Far from
known surfaces it is lower than the occupancy of a cell, as occupied cells lie behind each other.
Beside a known surface it is high: surfaces go on. So what lies deep in the unknown, or behind the
gap between two pieces of a wall, counts little. A cell counts with the probability that a beam gets
there, of the beam that most probably does. Where something predicts the occupancy of unknown cells,
that is their hazard.

A planner that looks ahead uses the same cells as a map of the future: what a view will probably
have shown counts less for the next one, and free cells that it will probably have shown can be
entered.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, kernel
from coopmap_env.information._mutual_information import MIN_REACH_PROBABILITY
from coopmap_env.information.near_surface import near_surface_hazards
from coopmap_env.information.planar.mutual_information import BeamEntries
from coopmap_env.information.planar.rating import PlanarRatingFunction
from coopmap_env.information.predictions import checked_probabilities
from coopmap_env.information.ratings import ReservedMask
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots import free_mask
from coopmap_env.sensing.beam_fan import FanArrays


class ExpectedCells(NamedTuple):
    """What the next views are expected to meet in the cells of a map, each (n_cells,)."""

    passing: NDArray[np.float32]
    """Probability that a beam that reaches the cell passes it."""
    unknown: NDArray[np.bool_]
    """Which cells were never sampled."""
    weight: NDArray[np.float32]
    """Probability that the cell is still to be seen: 1 if unknown, 0 if sampled or reserved."""
    free: NDArray[np.float32]
    """Probability that the cell is known to be free: 1 if it is, 0 if not; views raise it."""

    def copy(self) -> ExpectedCells:
        """The same future, which other views may change."""
        return ExpectedCells(self.passing, self.unknown, self.weight.copy(), self.free.copy())


class PlanarExpectedViews:
    """Expected views of lattice poses.

    Parameters
    ----------
    rating : PlanarRatingFunction
        Holds the lattice and the camera's fan.
    """

    def __init__(self, rating: PlanarRatingFunction) -> None:
        self.rating = rating
        self._shape = rating.lattice.grid.shape
        self._fan = tuple(rating.fan.arrays(self._shape[1]))
        self._beams = tuple(BeamEntries.from_fan(rating.fan))

    def cells(
        self,
        map_: OccupancyMap,
        reserved_mask: ReservedMask | None = None,
        unknown_occupancy: NDArray[np.float32] | None = None,
    ) -> ExpectedCells:
        """What views are expected to meet; sampled cells end beams with their occupancy.

        Parameters
        ----------
        map_ : OccupancyMap
        reserved_mask : ndarray of uint8, shape (n_cells,), optional
            1 at the cells that do not count.
        unknown_occupancy : ndarray of float32, shape (n_cells,), optional
            Predicted hazard of each cell, in place of `near_surface_hazards`. Only those of
            never-sampled cells are used.

        Raises
        ------
        ValueError
            If the map is of another shape or clamp than those of the rating function, or the
            predictions are not one probability for each cell.
        """
        self.rating.validate_map(map_)
        clamp = map_.log_odds_range.clamp
        pass_of_log_odds = (1.0 - map_.log_odds_range.probability).astype(np.float32)
        passing = pass_of_log_odds[map_.log_odds_fixed + clamp]
        unknown = map_.sampled_mask == 0
        if unknown_occupancy is None:
            unknown_occupancy = near_surface_hazards(map_)
        else:
            unknown_occupancy = checked_probabilities(unknown_occupancy, len(unknown))
        passing[unknown] = np.float32(1.0) - unknown_occupancy[unknown]
        counts = unknown if reserved_mask is None else unknown & (reserved_mask == 0)
        free = free_mask(map_).astype(np.float32)
        return ExpectedCells(passing, unknown, counts.astype(np.float32), free)

    def count(self, cells: ExpectedCells, pose_ids: ArrayLike) -> NDArray[np.float64]:
        """Expected number of new cells that each pose (k,) shows, shape (k,).

        Raises
        ------
        ValueError
            If an id is no pose of the lattice.
        """
        ids = self.rating.lattice.checked_ids(pose_ids)
        out = np.empty(len(ids))
        write_expected_counts(tuple(cells), self._shape, ids, self._fan, self._beams, out)
        return out

    def view(
        self, cells: ExpectedCells, pose_id: int
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """The unknown cells (k,), flat, that a pose may show, and with which probabilities (k,).

        Raises
        ------
        ValueError
            If the id is no pose of the lattice.
        """
        (pose,) = self.rating.lattice.checked_ids([pose_id])
        n = self.rating.max_visible_cells
        seen, probability = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.float32)
        count = write_unknown_view(
            tuple(cells), self._shape, int(pose), self._fan, self._beams, seen, probability
        )
        return seen[:count], probability[:count]

    def take(self, cells: ExpectedCells, pose_id: int, probability: float = 1.0) -> None:
        """Change `cells` as the view of a pose is expected to, if it is taken.

        `probability` is that with which it will be possible to take it.
        """
        seen, reached = self.view(cells, pose_id)
        reached *= np.float32(probability)
        cells.weight[seen] *= 1 - reached
        cells.free[seen] = np.maximum(cells.free[seen], reached * cells.passing[seen])


@borrowing_kernel
def find_reach(
    passing: NDArray[np.float32],
    shape: tuple[int, ...],
    pose: int,
    fan: FanArrays,
    beams: BeamEntries,
    reached: NDArray[np.float32],
) -> None:
    """Write the probabilities with which the view of a pose reaches the entries of its fan.

    `reached` are those of the likeliest beam, counted from the heading's first entry, and 0 outside
    of the map.
    """
    (nx, ny), start, entries = shape, beams.start, beams.entries
    offsets, flat_offsets, margin = fan.offsets, fan.flat_offsets, fan.max_offset
    n_headings, n_beams = start.shape[0], start.shape[1] - 1
    cell, heading = pose // n_headings, pose % n_headings
    x, y, first = cell // ny, cell % ny, fan.start[heading]
    is_inner = margin <= x < nx - margin and margin <= y < ny - margin
    reached[: fan.start[heading + 1] - first] = 0
    least = np.float32(MIN_REACH_PROBABILITY)
    for beam in range(n_beams):
        probability = np.float32(1)
        for e in range(np.uint64(start[heading, beam]), np.uint64(start[heading, beam + 1])):
            k = np.uint64(entries[e])
            if not is_inner:
                i, j = x + offsets[k, 0], y + offsets[k, 1]
                if i < 0 or i >= nx or j < 0 or j >= ny:
                    break
            at = np.uint64(k - np.uint64(first))
            reached[at] = max(reached[at], probability)
            probability *= passing[np.uint64(cell + flat_offsets[k])]
            if probability < least:
                break


@kernel
def write_expected_counts(
    cells_tuple: PlainTuple,
    shape: tuple[int, ...],
    poses: NDArray[np.int64],
    fan_tuple: PlainTuple,
    beams_tuple: PlainTuple,
    out: NDArray[np.float64],
) -> None:
    """Write the expected sum of the weights that each pose shows; tuples are plain ones."""
    cells, fan = ExpectedCells(*cells_tuple), FanArrays(*fan_tuple)
    reached = np.empty(fan.max_visible_cells, np.float32)
    _sum_weights(cells, shape, poses, fan, BeamEntries(*beams_tuple), reached, out)


@borrowing_kernel
def _sum_weights(
    cells: ExpectedCells,
    shape: tuple[int, ...],
    poses: NDArray[np.int64],
    fan: FanArrays,
    beams: BeamEntries,
    reached: NDArray[np.float32],
    out: NDArray[np.float64],
) -> None:
    weight, flat_offsets, n_headings = cells.weight, fan.flat_offsets, len(fan.start) - 1
    for p in range(len(poses)):
        cell, heading = poses[p] // n_headings, poses[p] % n_headings
        find_reach(cells.passing, shape, poses[p], fan, beams, reached)
        first, total = fan.start[heading], 0.0
        for e in range(fan.start[heading + 1] - first):
            if reached[e] > 0:
                total += reached[e] * weight[np.uint64(cell + flat_offsets[first + e])]
        out[p] = total


@kernel
def write_unknown_view(
    cells_tuple: PlainTuple,
    shape: tuple[int, ...],
    pose: int,
    fan_tuple: PlainTuple,
    beams_tuple: PlainTuple,
    seen: NDArray[np.int64],
    probability: NDArray[np.float32],
) -> int:
    """Write the unknown cells that a pose may show and their probabilities; return their number."""
    cells, fan = ExpectedCells(*cells_tuple), FanArrays(*fan_tuple)
    n_headings, reached = len(fan.start) - 1, np.empty(fan.max_visible_cells, np.float32)
    find_reach(cells.passing, shape, pose, fan, BeamEntries(*beams_tuple), reached)
    cell, first, count = pose // n_headings, fan.start[pose % n_headings], 0
    for e in range(fan.start[pose % n_headings + 1] - first):
        if reached[e] > 0:
            at = np.uint64(cell + fan.flat_offsets[first + e])
            if cells.unknown[at]:
                seen[count], probability[count] = np.int64(at), reached[e]
                count += 1
    return count
