"""The network that predicts the occupancy of unknown cells from the map around them.

A U-Net (Ronneberger et al. 2015) with three levels. Blocks of `stride` x `stride` cells are the
pixels of its first level, so that most of its work is on a small image; the output is unfolded
again to single cells. Maps may have any size: there is no layer that depends on it.
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
        area = settings.stride**2
        self.enter = nn.Sequential(_convolution(N_CHANNELS * area, first), _convolution(first))
        self.down = nn.Sequential(_halving(first, second), _convolution(second))
        self.bottom = nn.Sequential(
            _halving(second, third),
            *(_convolution(third, dilation=dilation) for dilation in (1, 2, 4, 1)),
        )
        self.up = _doubling(third, second)
        self.merge = _convolution(2 * second, second)
        self.leave = _doubling(second, first)
        self.finish = nn.Sequential(
            _convolution(2 * first, first), nn.Conv2d(first, area, kernel_size=3, padding=1)
        )

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Logits (n, nx, ny) of images (n, nx, ny) of bytes; see `map_image`."""
        nx, ny = images.shape[-2:]
        side = 4 * self.settings.stride
        cells = functional.pad(_channels(images), (0, -ny % side, 0, -nx % side))
        top = self.enter(functional.pixel_unshuffle(cells, self.settings.stride))
        middle = self.down(top)
        merged = self.merge(torch.cat([middle, self.up(self.bottom(middle))], dim=1))
        logits = self.finish(torch.cat([top, self.leave(merged)], dim=1))
        return functional.pixel_shuffle(logits, self.settings.stride)[:, 0, :nx, :ny]


def _channels(images: torch.Tensor) -> torch.Tensor:
    """Inside the map, unknown, P(occupied) if known, known to be occupied: (n, 4, nx, ny)."""
    unknown = images == UNKNOWN
    known = images.to(torch.float32).masked_fill(unknown, 0.0) / KNOWN_SCALE
    parts = torch.ones_like(known), unknown, known, known >= 0.5
    return torch.stack([part.to(torch.float32) for part in parts], dim=1)


def _convolution(n_in: int, n_out: int | None = None, dilation: int = 1) -> nn.Sequential:
    convolution = nn.Conv2d(n_in, n_out or n_in, 3, padding=dilation, dilation=dilation)
    return nn.Sequential(convolution, nn.ReLU())


def _halving(n_in: int, n_out: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(n_in, n_out, kernel_size=4, stride=2, padding=1), nn.ReLU())


def _doubling(n_in: int, n_out: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(n_in, 4 * n_out, kernel_size=1), nn.ReLU(), nn.PixelShuffle(2))
