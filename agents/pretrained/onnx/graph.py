"""The graph of a policy for acting: what `coopmap_agents.networks` computes, without the critic.

Inputs are the entries of the observations of n robots, all of type float32, under their names. The
numbers of robots, candidates and teammates are free; teammates may be none.

==============  ===============  =================================================================
output          shape            content
==============  ===============  =================================================================
logits          (n, candidates)  of a policy among candidates; -1e8 where the action mask is 0
action_mean     (n, size)        of a policy among poses, before it is clipped to -1 ... 1
action_log_std  (size,)          of a policy among poses
==============  ===============  =================================================================
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import prod

import numpy as np

from coopmap_agents.architecture import (
    IMAGE_CONVOLUTIONS,
    MASKED_LOGIT,
    MIN_STANDARD_DEVIATION,
    RATING_FEATURE_INDEX,
    RATING_GAIN,
    TEAMMATE_FEATURES,
    n_image_values,
)
from coopmap_agents.observations import SPECIAL_KEYS
from coopmap_agents.onnx.graph import BOOL, FLOAT, Graph
from coopmap_agents.pretrained.metadata import PolicyMetadata

N_ROBOTS, N_CANDIDATES, N_TEAMMATES = "robots", "candidates", "teammates"
"""Names of the free dimensions."""
DIMENSIONS = {
    "candidates": (N_CANDIDATES,),
    "action_mask": (N_CANDIDATES,),
    "teammates": (N_TEAMMATES,),
    "located": (f"1 + {N_TEAMMATES}",),
}
"""Names of the first dimensions of entries whose length is free."""
RANKS = {"candidates": 2, "action_mask": 1, "teammates": 2, "located": 1}
RESERVED_NAMES = ("logits", "action_mean", "action_log_std", "log_std")
"""Names of outputs and weights, which no observation can have."""


def policy_graph(metadata: PolicyMetadata) -> Graph:
    """The graph of the policy that metadata describe.

    Raises
    ------
    ValueError
        With the field, if there is no network of these observations.
    """
    graph, settings = Graph(), metadata.settings()
    shapes = _checked_shapes(metadata)
    if metadata.action_size is not None:
        log_std = graph.weight("log_std", metadata.action_size)
        context, n_context = _features(graph, shapes, settings.image_features)
        widths = [n_context, *settings.hidden]
        latent = graph.mlp(context, "mlp_extractor.policy_net", widths)
        mean = graph.linear(latent, "action_net", widths[-1], metadata.action_size)
        graph.add_output("action_mean", mean, (N_ROBOTS, metadata.action_size))
        graph.add_output("action_log_std", log_std, (metadata.action_size,))
    else:
        context, n_context = _features(graph, shapes, settings.image_features)
        logits = _logits(graph, shapes, context, n_context, settings.hidden)
        graph.add_output("logits", logits, (N_ROBOTS, N_CANDIDATES))
    for key in sorted(shapes):
        free = DIMENSIONS.get(key, ())
        graph.inputs[key] = (N_ROBOTS, *free, *shapes[key][len(free) :])
    return graph


def _checked_shapes(metadata: PolicyMetadata) -> dict[str, tuple[int, ...]]:
    """Shapes of the entries that acting uses."""
    among_candidates = ("candidates", "action_mask")
    shapes = {
        key: shape
        for key, shape in metadata.shapes().items()
        if key != "state" and (metadata.n_candidates or key not in among_candidates)
    }
    for key, shape in shapes.items():
        if not key or "." in key or "/" in key:
            raise ValueError(f"observations.{key:.80} must have a name without . and /")
        if key in RESERVED_NAMES:
            raise ValueError(f"observations.{key} has the name of an output or weight of graphs")
        if len(shape) != RANKS.get(key, len(shape)):
            raise ValueError(f"observations.{key} must have {RANKS[key]} sizes, got {list(shape)}")
    if "candidates" in shapes and shapes["candidates"][-1] < -RATING_FEATURE_INDEX:
        raise ValueError("observations.candidates must have at least two features, the rating too")
    if not set(shapes) - set(SPECIAL_KEYS):
        raise ValueError("observations must have entries of the robot itself, such as map or pose")
    return shapes


def _features(
    graph: Graph, shapes: Mapping[str, tuple[int, ...]], image_features: int
) -> tuple[str, int]:
    """Features of the observation, and their number; see `ObservationFeatures`."""
    own = [key for key in sorted(shapes) if key not in SPECIAL_KEYS]
    images = [key for key in own if len(shapes[key]) == 3]
    parts = [_image_features(graph, key, shapes[key], image_features) for key in images]
    flat = [key for key in own if key not in images]
    parts += [graph.add("Flatten", key, axis=1) for key in flat]
    n_features = image_features * len(images) + sum(prod(shapes[key]) for key in flat)
    include_located = "located" in shapes
    if include_located:  # the flag of the robot, then one for each teammate
        parts.append(graph.part("located", axis=1, start=0, stop=1))
    if "teammates" in shapes:
        n_inputs = shapes["teammates"][-1] + include_located
        parts += _teammate_features(graph, n_inputs, include_located)
        n_features += 2 * TEAMMATE_FEATURES
    return graph.add("Concat", *parts, axis=1), n_features + include_located


def _image_features(graph: Graph, key: str, shape: tuple[int, ...], n_features: int) -> str:
    name, x = f"features_extractor.robot.{key}", key
    n_channels, height, width = shape
    for layer, convolution in zip((1, 3), IMAGE_CONVOLUTIONS, strict=True):
        n_out, size = convolution.channels, convolution.kernel_size
        weight = graph.weight(f"{name}.{layer}.weight", n_out, n_channels, size, size)
        bias = graph.weight(f"{name}.{layer}.bias", n_out)
        if layer == 1:  # images of bytes, from 0 to 255
            weight = graph.add("Div", weight, graph.constant(255.0))
        x = graph.add(
            "Conv", x, weight, bias,
            kernel_shape=(size, size),
            strides=(convolution.stride,) * 2,
            pads=(convolution.padding,) * 4,
        )  # fmt: skip
        x, n_channels = graph.add("Relu", x), n_out
    x = graph.add("Flatten", x, axis=1)
    x = graph.linear(x, f"{name}.6", n_image_values(height, width), n_features)
    return graph.add("Relu", x)


def _teammate_features(graph: Graph, n_inputs: int, include_located: bool) -> list[str]:
    """Mean and maximum over teammates; zeros without any, by one more row of zeros.

    The features are at least 0, so that the row changes neither the sum nor the maximum.
    """
    teammates = "teammates"
    if include_located:
        flags = graph.part("located", axis=1, start=1, stop=np.iinfo(np.int64).max)
        flags = graph.add("Unsqueeze", flags, graph.constant([2]))
        teammates = graph.add("Concat", teammates, flags, axis=2)
    each = graph.linear(teammates, "features_extractor.teammate.0", n_inputs, TEAMMATE_FEATURES)
    padded = graph.add("Pad", graph.add("Relu", each), graph.constant([0, 0, 0, 0, 1, 0]))
    n_teammates = graph.add("Shape", "teammates", start=1, end=2)
    at_least_1 = graph.add("Max", n_teammates, graph.constant([1]))
    count = graph.add("Cast", at_least_1, to=FLOAT)
    mean = graph.add("Div", graph.sum_over(padded, axis=1), count)
    return [mean, graph.max_over(padded, axis=1)]


def _logits(
    graph: Graph,
    shapes: Mapping[str, tuple[int, ...]],
    context: str,
    n_context: int,
    hidden: Sequence[int],
) -> str:
    """Masked logits of the candidates; see `ScoringNetwork`."""
    candidates, n_features, width = "candidates", shapes["candidates"][-1], hidden[0]
    rating_weight = graph.weight("network.rating_weight")
    mask = graph.add("Cast", "action_mask", to=BOOL)
    weights = graph.add("Unsqueeze", graph.add("Cast", mask, to=FLOAT), graph.constant([2]))
    n_feasible = graph.add("Max", graph.sum_over(weights, axis=1), graph.constant(1.0))
    standardized = _standardized(graph, candidates, weights, n_feasible)
    inputs = graph.add("Concat", candidates, standardized, axis=2)
    each = graph.add("Relu", graph.linear(inputs, "network.encoder.0", 2 * n_features, width))
    encoded = graph.add("Mul", each, weights)
    mean = graph.add("Div", graph.sum_over(encoded, axis=1), n_feasible)
    summary = graph.add("Concat", context, mean, graph.max_over(encoded, axis=1), axis=1)
    own = graph.linear(encoded, "network.from_candidate", width, width)
    shared = graph.linear(summary, "network.from_summary", n_context + 2 * width, width, bias=False)
    shared = graph.add("Unsqueeze", shared, graph.constant([1]))
    mixed = graph.add("Tanh", graph.add("Add", own, shared))
    mixed = graph.mlp(mixed, "network.mixed.1", hidden)
    score = graph.linear(mixed, "network.score", hidden[-1], 1, bias=False)
    gain = graph.add("Mul", rating_weight, graph.constant(RATING_GAIN))
    index = n_features + RATING_FEATURE_INDEX
    rating = graph.part(candidates, axis=2, start=index, stop=index + 1)
    logits = graph.add("Add", score, graph.add("Mul", rating, gain))
    logits = graph.add("Squeeze", logits, graph.constant([2]))
    return graph.add("Where", mask, logits, graph.constant(MASKED_LOGIT))


def _standardized(graph: Graph, candidates: str, weights: str, n_feasible: str) -> str:
    """Features less their mean over the feasible candidates, in standard deviations."""
    count = graph.add("Unsqueeze", n_feasible, graph.constant([1]))
    total = graph.sum_over(graph.add("Mul", candidates, weights), axis=1, keepdims=True)
    centered = graph.add("Sub", candidates, graph.add("Div", total, count))
    square = graph.add("Mul", graph.add("Mul", centered, centered), weights)
    variance = graph.add("Div", graph.sum_over(square, axis=1, keepdims=True), count)
    floor = graph.constant(MIN_STANDARD_DEVIATION**2)
    return graph.add("Div", centered, graph.add("Sqrt", graph.add("Add", variance, floor)))
