"""The network that predicts the occupancy of unknown cells from the map around them.

A U-Net (Ronneberger et al. 2015) with three levels. Blocks of `stride` cells along each axis are
the pixels of its first level, so that most of its work is on a small image; the output is unfolded
again to single cells. Maps have two or three dimensions and any size: there is no layer that
depends on it. `coopmap_agents.map_prediction.graph` has the same layers for ONNX.
"""

from __future__ import annotations

import coopmap_agents._require_rl  # noqa: F401

# isort: split
import torch
from torch import nn

from coopmap_agents.architecture import BOTTOM_DILATIONS, block_layer_size
from coopmap_agents.map_config import MapNetworkSettings
from coopmap_agents.map_prediction.images import N_CHANNELS, cells_of, folded_images, unfold


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
            *(layers.convolution(third, dilation=dilation) for dilation in BOTTOM_DILATIONS),
        )
        self.up = layers.doubling(third, second)
        self.merge = layers.convolution(2 * second, second)
        self.leave = layers.doubling(second, first)
        self.finish = nn.Sequential(
            layers.convolution(2 * first, first), layers.block_layer(first, block)
        )

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Logits (n, nx, ny) or (n, nx, ny, nz) of images of bytes; see `map_image`."""
        stride = self.settings.stride
        blocks = torch.from_numpy(folded_images(images.cpu().numpy(), stride)).to(images.device)
        top = self.enter(blocks)
        middle = self.down(top)
        merged = self.merge(torch.cat([middle, self.up(self.bottom(middle))], dim=1))
        logits = self.finish(torch.cat([top, self.leave(merged)], dim=1))
        return cells_of(logits, stride, images.shape[1:])


class _Unfold(nn.Module):
    """`unfold` to twice as many pixels along each axis."""

    def forward(self, blocks: torch.Tensor) -> torch.Tensor:
        return unfold(blocks, 2)


class _Layers:
    """The layers of a network of some dimension."""

    def __init__(self, dimension: int) -> None:
        self._convolution = nn.Conv2d if dimension == 2 else nn.Conv3d
        self._block_size = block_layer_size(dimension)
        self._parts = 2**dimension

    def block_layer(self, n_in: int, n_out: int) -> nn.Module:
        """To or from channels that are the cells of blocks."""
        return self._convolution(n_in, n_out, self._block_size, padding=self._block_size // 2)

    def convolution(self, n_in: int, n_out: int | None = None, dilation: int = 1) -> nn.Sequential:
        layer = self._convolution(n_in, n_out or n_in, 3, padding=dilation, dilation=dilation)
        return nn.Sequential(layer, nn.ReLU())

    def halving(self, n_in: int, n_out: int) -> nn.Sequential:
        return nn.Sequential(self._convolution(n_in, n_out, 4, stride=2, padding=1), nn.ReLU())

    def doubling(self, n_in: int, n_out: int) -> nn.Sequential:
        return nn.Sequential(self._convolution(n_in, self._parts * n_out, 1), nn.ReLU(), _Unfold())
