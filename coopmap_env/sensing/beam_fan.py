"""Which cells a camera pose would see: a beam fan prepared once per heading.

A camera at the center of a cell sends the same beams whatever the cell. So the traversal of all
beams is done once for each heading: every crossed cell is listed with the set of beams that cross
it, as bits. A view of the known map is then one pass over the list, nearest cell first: a cell is
visible if any of its beams is still alive, and an occupied cell ends its beams. The result is that
of walking every beam, but faster: near the camera many beams share a cell. Sorting by distance
keeps the order along every beam: each step of a traversal leads away from the camera along x or y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import sin_cos, sin_cos_array
from coopmap_env.core.limits import check_cells
from coopmap_env.geometry import traverse
from coopmap_env.sensing.cameras import PlanarCamera

BEAMS_PER_WORD = 64


class FanArrays(NamedTuple):
    """A `BeamFan` as kernels take it."""

    start: NDArray[np.int64]
    offsets: NDArray[np.int16]
    flat_offsets: NDArray[np.int32]
    """Shape (k,): offsets in the flat indices of a map's cells."""
    beams: NDArray[np.uint64]
    all_beams: NDArray[np.uint64]
    max_offset: int
    max_visible_cells: int


@dataclass(frozen=True)
class BeamFan:
    """The cells of an unobstructed view, for every heading of a lattice.

    The cells of heading h are entries `start[h]` to `start[h + 1]` of the arrays.
    """

    start: NDArray[np.int64]
    """Shape (n_headings + 1,)."""
    offsets: NDArray[np.int16]
    """Shape (k, 2): cell offsets (dx, dy) from the camera's cell, nearest first."""
    beams: NDArray[np.uint64]
    """Shape (words, k): bit b of word w is set if beam 64 w + b crosses the cell."""
    distance: NDArray[np.float64]
    """Shape (k,): center to center, cells."""
    all_beams: NDArray[np.uint64]
    """Shape (words,): the bits of all beams of the camera."""
    depth: float
    """Depth of field, cells."""

    @property
    def n_headings(self) -> int:
        """Headings of the lattice."""
        return len(self.start) - 1

    @cached_property
    def max_offset(self) -> int:
        """Largest offset along an axis, cells."""
        return int(np.abs(self.offsets).max())

    @cached_property
    def max_visible_cells(self) -> int:
        """N of Eq. 7: the most cells that the camera can see, in empty space; a constant."""
        return int(np.diff(self.start).max())

    def arrays(self, ny: int) -> FanArrays:
        """The fan as kernels take it, for maps with `ny` cells along y."""
        offsets = self.offsets.astype(np.int64)
        return FanArrays(
            self.start,
            self.offsets,
            (offsets[:, 0] * ny + offsets[:, 1]).astype(np.int32),
            self.beams,
            self.all_beams,
            self.max_offset,
            self.max_visible_cells,
        )

    @classmethod
    def from_camera(cls, camera: PlanarCamera, resolution: float, n_headings: int) -> BeamFan:
        """Prepare the fan of a camera on cells of `resolution` metres.

        Raises
        ------
        ValueError
            If it has more cells than `coopmap_env.core.limits` allows.
        """
        depth = camera.depth_of_field / resolution
        words = -(-camera.n_beams // BEAMS_PER_WORD)
        side = _window_side(depth)
        what = "the view of a camera for all headings (depth_of_field, n_beams, n_headings)"
        check_cells((n_headings, side, side, words), what)
        check_cells((n_headings, side, camera.n_beams), what)
        sines, cosines = sin_cos_array(camera.bearings)
        lists = []
        for h in range(n_headings):
            # rotated like the beams of a scan, so that both cross the same cells to the last bit
            s, c = sin_cos((h if 2 * h < n_headings else h - n_headings) * (2 * np.pi / n_headings))
            directions = np.stack([c * cosines - s * sines, s * cosines + c * sines], axis=1)
            lists.append(_beams_by_cell(directions, depth, words))
        offsets = np.concatenate([offsets for offsets, _ in lists])
        return cls(
            start=np.cumsum([0, *(len(offsets) for offsets, _ in lists)]),
            offsets=offsets.astype(np.int16),
            beams=np.concatenate([bits for _, bits in lists]).T.copy(),
            distance=np.sqrt(np.square(offsets).sum(axis=1).astype(np.float64)),
            all_beams=_beam_mask(range(camera.n_beams), words),
            depth=depth,
        )


def _beam_mask(beams: range, words: int) -> NDArray[np.uint64]:
    value = sum(1 << beam for beam in beams)
    mask = (1 << BEAMS_PER_WORD) - 1
    return np.array([value >> (BEAMS_PER_WORD * w) & mask for w in range(words)], dtype=np.uint64)


def _window_side(depth: float) -> int:
    """Side of a square of cells around the camera that holds a view."""
    return 2 * (math.ceil(depth) + 2) + 1


def _beams_by_cell(
    directions: NDArray[np.float64], depth: float, words: int
) -> tuple[NDArray[np.int64], NDArray[np.uint64]]:
    """Cell offsets crossed by beams (n_beams, 2), nearest first, and the bits of the beams."""
    size = _window_side(depth)
    half = size // 2
    beams = np.zeros((size, size, words), dtype=np.uint64)
    for beam, direction in enumerate(directions):
        cells = traverse([half + 0.5] * 2, direction, depth, (size, size)).cells
        word, bit = divmod(beam, BEAMS_PER_WORD)
        beams[cells[:, 0], cells[:, 1], word] |= np.uint64(1 << bit)
    offsets = np.argwhere(beams.any(axis=2)) - half
    order = np.lexsort((offsets[:, 1], offsets[:, 0], np.square(offsets).sum(axis=1)))
    offsets = offsets[order]
    return offsets, beams[offsets[:, 0] + half, offsets[:, 1] + half]
