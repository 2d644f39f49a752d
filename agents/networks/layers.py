"""Hidden layers of the networks, made for CPUs."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import torch
from torch import nn


class _Tanh(torch.autograd.Function):
    generate_vmap_rule = True  # TorchRL's estimators of advantages map over critics

    @staticmethod
    def forward(x: torch.Tensor) -> torch.Tensor:
        return torch.sigmoid(x + x).mul_(2).sub_(1)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[torch.Tensor], output: torch.Tensor) -> None:
        ctx.save_for_backward(output)

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> torch.Tensor:
        (y,) = ctx.saved_tensors
        return torch.ops.aten.tanh_backward(gradient, y)


class Tanh(nn.Module):
    """tanh(x) = 2 sigmoid(2 x) - 1: a third of the time of torch's on CPUs.

    Values differ from torch's by rounding of numbers near 1, 1e-7.
    """

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """The hyperbolic tangent of each entry."""
        y: torch.Tensor = _Tanh.apply(x)
        return y


class _SumAndMax(torch.autograd.Function):
    generate_vmap_rule = True

    @staticmethod
    def forward(x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return x.sum(dim=1), x.amax(dim=1)

    @staticmethod
    def setup_context(
        ctx: Any, inputs: tuple[torch.Tensor], output: tuple[torch.Tensor, torch.Tensor]
    ) -> None:
        ctx.save_for_backward(*inputs, output[1])

    @staticmethod
    def backward(ctx: Any, of_sum: torch.Tensor, of_max: torch.Tensor) -> torch.Tensor:
        x, largest = ctx.saved_tensors
        is_largest = torch.eq(x, largest.unsqueeze(1), out=torch.empty_like(x))
        each = of_max / is_largest.sum(dim=1)  # equal ones share the gradient, as in torch
        return is_largest.mul_(each.unsqueeze(1)).add_(of_sum.unsqueeze(1))


def sum_and_max(x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Sum and maximum (n, k) over the second axis of x (n, m, k).

    One gradient of both, in place, takes half the time of torch's two.
    """
    result: tuple[torch.Tensor, torch.Tensor] = _SumAndMax.apply(x)
    return result


def mlp(widths: list[int]) -> nn.Sequential:
    """Linear layers from each width to the next, each followed by tanh."""
    parts: list[nn.Module] = []
    for n_in, n_out in pairwise(widths):
        parts += [nn.Linear(n_in, n_out), Tanh()]
    return nn.Sequential(*parts)
