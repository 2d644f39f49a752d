"""The network that predicts the occupancy of unknown cells from the map around them.

A U-Net (Ronneberger et al. 2015) with three levels. Blocks of `stride` cells along each axis are
the pixels of its first level, so that most of its work is on a small image; the output is unfolded
again to single cells. Maps have two or three dimensions and any size: there is no layer that
depends on it.
"""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional

from coopmap_agents.map_config import MapNetworkSettings

UNKNOWN = 255
"""Value of never-sampled cells in the image of a map; others are `KNOWN_SCALE` times P(occupied),
rounded."""
KNOWN_SCALE = 254
N_CHANNELS = 4


class MapNetwork(nn.Module):
    """Logits of the occupancy of all cells, from the image of a map.

    Parameters
    ----------
    settings : MapNetworkSettings
    """

    def __init__(self, settings: MapNetworkSettings) -> None:
        super().__init__()
        self.settings = settings
        first, second, third = settings.widths
        layers = _Layers(settings.dimension)
        block = settings.stride**settings.dimension
        self.enter = nn.Sequential(
            nn.Sequential(layers.block_layer(N_CHANNELS * block, first), nn.ReLU()),
            layers.convolution(first),
        )
        self.down = nn.Sequential(layers.halving(first, second), layers.convolution(second))
        self.bottom = nn.Sequential(
            layers.halving(second, third),
            *(layers.convolution(third, dilation=dilation) for dilation in (1, 2, 4, 1)),
        )
        self.up = layers.doubling(third, second)
        self.merge = layers.convolution(2 * second, second)
        self.leave = layers.doubling(second, first)
        self.finish = nn.Sequential(
            layers.convolution(2 * first, first), layers.block_layer(first, block)
        )

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Logits (n, nx, ny) or (n, nx, ny, nz) of images of bytes; see `map_image`."""
        shape, side = images.shape[1:], 4 * self.settings.stride
        missing = [part for size in reversed(shape) for part in (0, -size % side)]
        cells = functional.pad(_channels(images), missing)
        top = self.enter(fold(cells, self.settings.stride))
        middle = self.down(top)
        merged = self.merge(torch.cat([middle, self.up(self.bottom(middle))], dim=1))
        logits = unfold(
            self.finish(torch.cat([top, self.leave(merged)], dim=1)), self.settings.stride
        )
        return logits[:, 0][(slice(None), *(slice(size) for size in shape))]


def _channels(images: torch.Tensor) -> torch.Tensor:
    """Inside the map, unknown, P(occupied) if known, known to be occupied: (n, 4, *shape)."""
    unknown = images == UNKNOWN
    known = images.to(torch.float32).masked_fill(unknown, 0.0) / KNOWN_SCALE
    parts = torch.ones_like(known), unknown, known, known >= 0.5
    return torch.stack([part.to(torch.float32) for part in parts], dim=1)


def fold(cells: torch.Tensor, side: int) -> torch.Tensor:
    """Blocks of cells as channels: (n, c, *shape) to (n, c * side**d, *(shape / side)).

    In two dimensions, `torch.nn.functional.pixel_unshuffle`.
    """
    n, channels, *shape = cells.shape
    d = len(shape)
    split = [part for size in shape for part in (size // side, side)]
    inner, outer = range(3, 3 + 2 * d, 2), range(2, 2 + 2 * d, 2)
    parts = cells.reshape(n, channels, *split).permute(0, 1, *inner, *outer)
    return parts.reshape(n, channels * side**d, *(size // side for size in shape))


def unfold(blocks: torch.Tensor, side: int) -> torch.Tensor:
    """The inverse of `fold`; in two dimensions, `torch.nn.functional.pixel_shuffle`."""
    n, channels, *shape = blocks.shape
    d = len(shape)
    parts = blocks.reshape(n, channels // side**d, *[side] * d, *shape)
    pairs = [axis for k in range(d) for axis in (2 + d + k, 2 + k)]
    cells = parts.permute(0, 1, *pairs)
    return cells.reshape(n, channels // side**d, *(side * size for size in shape))


class _Unfold(nn.Module):
    """`unfold` to twice as many pixels along each axis."""

    def forward(self, blocks: torch.Tensor) -> torch.Tensor:
        return unfold(blocks, 2)


class _Layers:
    """The layers of a network of some dimension."""

    def __init__(self, dimension: int) -> None:
        self._convolution = nn.Conv2d if dimension == 2 else nn.Conv3d
        self._block_size = 3 if dimension == 2 else 1
        self._parts = 2**dimension

    def block_layer(self, n_in: int, n_out: int) -> nn.Module:
        """To or from channels that are the cells of blocks.

        In 3-D 1 x 1 x 1: larger kernels on so many channels would take most of the time.
        """
        return self._convolution(n_in, n_out, self._block_size, padding=self._block_size // 2)

    def convolution(self, n_in: int, n_out: int | None = None, dilation: int = 1) -> nn.Sequential:
        layer = self._convolution(n_in, n_out or n_in, 3, padding=dilation, dilation=dilation)
        return nn.Sequential(layer, nn.ReLU())

    def halving(self, n_in: int, n_out: int) -> nn.Sequential:
        return nn.Sequential(self._convolution(n_in, n_out, 4, stride=2, padding=1), nn.ReLU())

    def doubling(self, n_in: int, n_out: int) -> nn.Sequential:
        return nn.Sequential(self._convolution(n_in, self._parts * n_out, 1), nn.ReLU(), _Unfold())
