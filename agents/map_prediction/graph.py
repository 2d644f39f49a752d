"""The graph of a map network: what `MapNetwork` computes with blocks, in ONNX's operations.

The numbers of maps and of blocks along each axis are free; those of blocks are multiples of 4. See
`coopmap_agents.map_prediction.images` for what input and output mean.

======  =======================  ===================================================================
name    shape                    content
======  =======================  ===================================================================
blocks  (n, 4 s**d, *blocks)     input: folded images, in blocks of s cells along d axes
logits  (n, s**d, *blocks)       output: logits of the cells of all blocks
======  =======================  ===================================================================
"""

from __future__ import annotations

from coopmap_agents.architecture import BOTTOM_DILATIONS, block_layer_size
from coopmap_agents.map_config import MapNetworkSettings
from coopmap_agents.map_prediction.images import N_CHANNELS, unfolding_axes
from coopmap_agents.onnx.graph import Graph

INPUT, OUTPUT = "blocks", "logits"


def map_graph(settings: MapNetworkSettings) -> Graph:
    """The graph of the network of some settings; weights have the names of `MapNetwork`."""
    layers, (first, second, third) = _Layers(settings.dimension), settings.widths
    block = settings.stride**settings.dimension
    top = layers.block_layer(INPUT, "enter.0.0", N_CHANNELS * block, first)
    top = layers.convolution(layers.relu(top), "enter.1", first, first)
    middle = layers.halving(top, "down.0", first, second)
    middle = layers.convolution(middle, "down.1", second, second)
    bottom = layers.halving(middle, "bottom.0", second, third)
    for k, dilation in enumerate(BOTTOM_DILATIONS, start=1):
        bottom = layers.convolution(bottom, f"bottom.{k}", third, third, dilation)
    both = layers.concat(middle, layers.doubling(bottom, "up", third, second))
    merged = layers.convolution(both, "merge", 2 * second, second)
    both = layers.concat(top, layers.doubling(merged, "leave", second, first))
    last = layers.convolution(both, "finish.0", 2 * first, first)
    logits = layers.block_layer(last, "finish.1", first, block)
    graph, blocks = layers.graph, tuple(f"blocks along {axis}" for axis in "xyz"[: layers.d])
    graph.inputs[INPUT] = ("maps", N_CHANNELS * block, *blocks)
    graph.add_output(OUTPUT, logits, ("maps", block, *blocks))
    return graph


class _Layers:
    """The layers of `coopmap_agents.map_prediction.network`, added to a graph."""

    def __init__(self, dimension: int) -> None:
        self.graph = Graph()
        self.d = dimension
        self._block_size = block_layer_size(dimension)

    def relu(self, x: str) -> str:
        return self.graph.add("Relu", x)

    def concat(self, *parts: str) -> str:
        return self.graph.add("Concat", *parts, axis=1)

    def block_layer(self, x: str, name: str, n_in: int, n_out: int) -> str:
        size = self._block_size
        return self._convolve(x, name, n_in, n_out, size, padding=size // 2)

    def convolution(self, x: str, name: str, n_in: int, n_out: int, dilation: int = 1) -> str:
        convolved = self._convolve(
            x, f"{name}.0", n_in, n_out, 3, padding=dilation, dilation=dilation
        )
        return self.relu(convolved)

    def halving(self, x: str, name: str, n_in: int, n_out: int) -> str:
        return self.relu(self._convolve(x, f"{name}.0", n_in, n_out, 4, padding=1, stride=2))

    def doubling(self, x: str, name: str, n_in: int, n_out: int) -> str:
        parts = self.relu(self._convolve(x, f"{name}.0", n_in, 2**self.d * n_out, 1))
        return self._unfold_by_two(parts, n_out)

    def _convolve(
        self,
        x: str,
        name: str,
        n_in: int,
        n_out: int,
        size: int,
        padding: int = 0,
        stride: int = 1,
        dilation: int = 1,
    ) -> str:
        weight = self.graph.weight(f"{name}.weight", n_out, n_in, *(size,) * self.d)
        bias = self.graph.weight(f"{name}.bias", n_out)
        return self.graph.add(
            "Conv", x, weight, bias,
            kernel_shape=(size,) * self.d,
            strides=(stride,) * self.d,
            pads=(padding,) * (2 * self.d),
            dilations=(dilation,) * self.d,
        )  # fmt: skip

    def _unfold_by_two(self, x: str, n_channels: int) -> str:
        """`unfold` to twice as many pixels along each axis; a size of 0 is that of the input."""
        graph = self.graph
        shape = graph.add("Shape", x, start=2)
        split = graph.add("Concat", graph.constant([0, n_channels, *[2] * self.d]), shape, axis=0)
        parts = graph.add("Transpose", graph.add("Reshape", x, split), perm=unfolding_axes(self.d))
        doubled = graph.add("Mul", shape, graph.constant([2]))
        joined = graph.add("Concat", graph.constant([0, n_channels]), doubled, axis=0)
        return graph.add("Reshape", parts, joined)
