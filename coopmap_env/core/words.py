"""Operations on 64-bit words that processors have and numba lacks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic

_WIDE = ir.IntType(128)
_WORD = ir.IntType(64)


def _generator(build: Callable[..., Any]) -> Callable[..., Any]:
    """Code generator of an intrinsic whose arguments and result are 64-bit words."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return build(builder, *arguments)

    return generate


def _high_product(typing_context: Any, a: Any, b: Any) -> Any:
    def build(builder: Any, a: Any, b: Any) -> Any:
        product = builder.mul(builder.zext(a, _WIDE), builder.zext(b, _WIDE))
        return builder.trunc(builder.lshr(product, ir.Constant(_WIDE, 64)), _WORD)

    return types.uint64(types.uint64, types.uint64), _generator(build)


def _count_bits(typing_context: Any, word: Any) -> Any:
    def build(builder: Any, word: Any) -> Any:
        return builder.ctpop(word)

    return types.int64(types.uint64), _generator(build)


def _lowest_bit(typing_context: Any, word: Any) -> Any:
    def build(builder: Any, word: Any) -> Any:
        return builder.cttz(word, ir.Constant(ir.IntType(1), 0))

    return types.int64(types.uint64), _generator(build)


high_product = cast("Callable[[np.uint64, np.uint64], np.uint64]", intrinsic(_high_product))
"""Upper 64 bits of the product of two words."""
count_bits = cast("Callable[[np.uint64], int]", intrinsic(_count_bits))
"""How many bits of a word are set."""
lowest_bit = cast("Callable[[np.uint64], int]", intrinsic(_lowest_bit))
"""Number of the lowest bit that is set in a word; 64 if none is."""
