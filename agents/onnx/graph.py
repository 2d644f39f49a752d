"""Graphs of ONNX operations, as networks of ours need them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

FLOAT, BOOL = 1, 9
"""ONNX's numbers of types."""

Shape = tuple[int | str, ...]


@dataclass(frozen=True)
class Node:
    """An operation; its attributes are integers or tuples of integers."""

    operation: str
    inputs: tuple[str, ...]
    output: str
    attributes: Mapping[str, int | tuple[int, ...]]


@dataclass
class Graph:
    """Operations in the order of their computation, and the shapes of what they need.

    Weights have the names and the order of the parameters in torch: by them files are compared,
    and the fingerprint of a network is the same.
    """

    nodes: list[Node] = field(default_factory=list)
    inputs: dict[str, Shape] = field(default_factory=dict)
    outputs: dict[str, Shape] = field(default_factory=dict)
    weights: dict[str, tuple[int, ...]] = field(default_factory=dict)
    constants: dict[str, NDArray[Any]] = field(default_factory=dict)

    def add(self, operation: str, *inputs: str, **attributes: int | tuple[int, ...]) -> str:
        """Name of the result of one more operation."""
        output = f"/{len(self.nodes)}"
        self.nodes.append(Node(operation, inputs, output, attributes))
        return output

    def add_output(self, name: str, value: str, shape: Shape) -> None:
        """Give a result a name of its own outside of the graph."""
        self.nodes.append(Node("Identity", (value,), name, {}))
        self.outputs[name] = shape

    def weight(self, name: str, *shape: int) -> str:
        """Name of a weight of this shape."""
        self.weights[name] = shape
        return name

    def constant(self, value: float | Sequence[int]) -> str:
        """Name of a float32 number, or of a vector of integers."""
        kind = np.float32 if isinstance(value, float) else np.int64
        name = f"/constant {value}"
        self.constants[name] = np.array(value, kind)
        return name

    def linear(self, x: str, name: str, n_in: int, n_out: int, bias: bool = True) -> str:
        """A linear layer on the last axis, which its inputs of any rank have."""
        weight = self.add("Transpose", self.weight(f"{name}.weight", n_out, n_in), perm=(1, 0))
        product = self.add("MatMul", x, weight)
        return self.add("Add", product, self.weight(f"{name}.bias", n_out)) if bias else product

    def mlp(self, x: str, name: str, widths: Sequence[int]) -> str:
        """Linear layers from each width to the next, each followed by tanh."""
        for k, (n_in, n_out) in enumerate(pairwise(widths)):
            x = self.add("Tanh", self.linear(x, f"{name}.{2 * k}", n_in, n_out))
        return x

    def sum_over(self, x: str, axis: int, keepdims: bool = False) -> str:
        """Sum over an axis."""
        return self.add("ReduceSum", x, self.constant([axis]), keepdims=int(keepdims))

    def max_over(self, x: str, axis: int) -> str:
        """Maximum over an axis."""
        return self.add("ReduceMax", x, self.constant([axis]), keepdims=0)

    def part(self, x: str, axis: int, start: int, stop: int) -> str:
        """Entries along an axis."""
        return self.add("Slice", x, *(self.constant([k]) for k in (start, stop, axis)))
