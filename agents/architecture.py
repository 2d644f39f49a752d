"""The numbers of the networks' architecture; needs no torch.

`coopmap_agents.networks` makes the networks of them for training, `coopmap_agents.pretrained.onnx`
their graphs for acting without torch; `coopmap_agents.map_prediction` does both for map networks.
"""

from __future__ import annotations

from typing import NamedTuple

MASKED_LOGIT = -1e8
"""Its probability is exactly 0 in float32, and 0 times it is 0: no NaN in the entropy."""
RATING_FEATURE_INDEX = -2
"""Index of the rating (Eq. 9) in a candidate's features, planar and field."""
RATING_GAIN = 30.0
"""Logits per unit of the rating feature: on planar training worlds the best-rated of 32 candidates
then has a probability of 0.77 on average, which leaves room to explore."""
MIN_STANDARD_DEVIATION = 1e-3
"""Of a feature over the feasible candidates; smaller differences are suppressed."""

TEAMMATE_FEATURES = 16
"""Width of the layer for teammates."""


class Convolution(NamedTuple):
    """A padded convolution of images."""

    channels: int
    """Of the result."""
    kernel_size: int
    stride: int

    @property
    def padding(self) -> int:
        """On each side; an image's side is divided by the stride, and rounded up."""
        return self.kernel_size // 2


IMAGE_CONVOLUTIONS = (Convolution(16, 5, 4), Convolution(32, 3, 2))
"""Stable-Baselines3's NatureCNN fails below 36 pixels. Three convolutions with smaller strides take
twice the time, and the updates, not the simulation, dominate the time of a training."""


def n_image_values(height: int, width: int) -> int:
    """Numbers that are left of an image after the convolutions."""
    for convolution in IMAGE_CONVOLUTIONS:
        height, width = -(-height // convolution.stride), -(-width // convolution.stride)
    return IMAGE_CONVOLUTIONS[-1].channels * height * width


BOTTOM_DILATIONS = (1, 2, 4, 1)
"""Of the convolutions in the lowest level of a map network."""


def block_layer_size(dimension: int) -> int:
    """Cells along the side of the convolutions of a map network to and from the cells of blocks.

    In 3-D 1 x 1 x 1: larger kernels on so many channels would take most of the time.
    """
    return 3 if dimension == 2 else 1
