"""What a map network gets of a map, and what its output means; the same by torch and ONNX Runtime.

The network computes with blocks of cells. Its input are folded images (n, 4 s**d, *blocks) for
blocks of s cells along each of the d axes, and its output are the logits of the cells of all
blocks (n, s**d, *blocks).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from coopmap_env.mapping import OccupancyMap

if TYPE_CHECKING:
    import torch

UNKNOWN = 255
"""Value of never-sampled cells in the image of a map; others are `KNOWN_SCALE` times P(occupied),
rounded."""
KNOWN_SCALE = 254
LEVEL_BLOCKS = 4
"""The three levels of a network need this many blocks along each axis, or a multiple."""


def _channels() -> NDArray[np.float32]:
    """What the network gets of each value (4, 256) of an image.

    Inside the map; unknown; P(occupied) if known; known to be occupied.
    """
    values = np.arange(256)
    unknown = values == UNKNOWN
    known = np.where(unknown, 0, values).astype(np.float32) / np.float32(KNOWN_SCALE)
    parts = np.ones_like(known), unknown, known, known >= 0.5
    return np.stack([part.astype(np.float32) for part in parts])


CHANNELS = _channels()
N_CHANNELS = len(CHANNELS)

ArrayT = TypeVar("ArrayT", NDArray[Any], "torch.Tensor")


def map_image(map_: OccupancyMap) -> NDArray[np.uint8]:
    """The map as bytes, in the shape of its grid: 255 if never sampled, else 254 P, rounded."""
    p_by_log_odds = np.round(KNOWN_SCALE * map_.log_odds_range.probability).astype(np.uint8)
    image = p_by_log_odds[map_.log_odds_fixed + map_.log_odds_range.clamp]
    image[map_.sampled_mask == 0] = UNKNOWN
    return image.reshape(map_.grid.shape)


def folded_images(images: NDArray[np.uint8], stride: int) -> NDArray[np.float32]:
    """Input of a network, of the images (n, *shape) of maps; what is missing in a block is 0."""
    n, *shape = images.shape
    side = LEVEL_BLOCKS * stride
    cells = np.zeros((n, N_CHANNELS, *(size + -size % side for size in shape)), np.float32)
    inside = (slice(None), *(slice(size) for size in shape))
    for channel, values in enumerate(CHANNELS):
        cells[:, channel][inside] = values[images]
    return fold(cells, stride)


def cells_of(blocks: ArrayT, stride: int, shape: tuple[int, ...]) -> ArrayT:
    """Values (n, *shape) of the cells of maps, of the output of a network."""
    cells = unfold(blocks, stride)[:, 0]
    return cells[(slice(None), *(slice(size) for size in shape))]


def fold(cells: NDArray[np.float32], side: int) -> NDArray[np.float32]:
    """Blocks of cells as channels: (n, c, *shape) to (n, c * side**d, *(shape / side)).

    In two dimensions, `torch.nn.functional.pixel_unshuffle`.
    """
    n, channels, *shape = cells.shape
    d = len(shape)
    split = [part for size in shape for part in (size // side, side)]
    inner, outer = range(3, 3 + 2 * d, 2), range(2, 2 + 2 * d, 2)
    parts = cells.reshape(n, channels, *split).transpose(0, 1, *inner, *outer)
    return parts.reshape(n, channels * side**d, *(size // side for size in shape))


def unfold(blocks: ArrayT, side: int) -> ArrayT:
    """The inverse of `fold`, of arrays and tensors; in 2-D, `torch.nn.functional.pixel_shuffle`."""
    n, channels, *shape = blocks.shape
    d = len(shape)
    parts = blocks.reshape(n, channels // side**d, *[side] * d, *shape)
    axes = unfolding_axes(d)
    cells = parts.transpose(*axes) if isinstance(parts, np.ndarray) else parts.permute(*axes)
    return cells.reshape(n, channels // side**d, *(side * size for size in shape))


def unfolding_axes(dimension: int) -> tuple[int, ...]:
    """Order of the axes with which `unfold` puts each cell of a block beside its block."""
    pairs = [axis for k in range(dimension) for axis in (2 + dimension + k, 2 + k)]
    return 0, 1, *pairs
