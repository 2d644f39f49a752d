"""Layers made for CPUs compute what those of torch do."""

import numpy as np
import pytest
import torch
from torch import nn

from coopmap_agents.networks.features import ByteConv2d
from coopmap_agents.networks.layers import Tanh, sum_and_max


def with_gradient(function, x):
    """A function's values, and the gradient of their squares' sum."""
    x = x.clone().requires_grad_()
    values = function(x)
    (gradient,) = torch.autograd.grad(sum((part**2).sum() for part in values), x)
    return (*values, gradient)


def test_tanh_is_that_of_torch_up_to_rounding():
    x = torch.cat([torch.linspace(-20, 20, 2001), torch.tensor([0.0, 1e-6, -100.0, 1e30, -1e30])])
    own, torchs = (with_gradient(lambda x, f=f: [f(x)], x) for f in (Tanh(), torch.tanh))
    torch.testing.assert_close(own, torchs, rtol=0, atol=1e-6)
    assert own[0].abs().max() == 1


def test_sum_and_max_have_the_gradient_of_torch_with_equal_entries_too():
    generator = torch.Generator().manual_seed(0)
    x = torch.randint(-3, 4, (5, 7, 11), generator=generator).float()
    assert (x == x.amax(dim=1, keepdim=True)).sum() > 5 * 11  # some maxima are met twice
    found = with_gradient(sum_and_max, x)
    expected = with_gradient(lambda x: (x.sum(dim=1), x.amax(dim=1)), x)
    torch.testing.assert_close(found, expected)


@pytest.mark.parametrize("channels_last", [False, True])
def test_a_convolution_of_bytes_is_that_of_images_from_0_to_1(channels_last):
    torch.manual_seed(0)
    of_bytes = ByteConv2d(4, 3, kernel_size=5, stride=4, padding=2)
    plain = nn.Conv2d(4, 3, kernel_size=5, stride=4, padding=2)
    plain.load_state_dict(of_bytes.state_dict())
    images = torch.from_numpy(np.random.default_rng(0).integers(256, size=(2, 4, 13, 9))).float()
    expected = plain(images / 255)
    if channels_last:
        images = images.contiguous(memory_format=torch.channels_last)
    found = of_bytes(images)
    torch.testing.assert_close(found, expected)
    found.square().sum().backward()
    expected.square().sum().backward()
    torch.testing.assert_close(of_bytes.weight.grad, plain.weight.grad)
