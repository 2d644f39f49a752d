"""Operations on 64-bit words that processors have and numba lacks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

_WIDE = ir.IntType(128)
_WORD = ir.IntType(64)


def _generator(build: Callable[..., Any]) -> Callable[..., Any]:
    """Code generator of an intrinsic whose arguments and result are 64-bit words."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return build(builder, *arguments)

    return generate


@intrinsic
def high_product(typing_context: Any, a: Any, b: Any) -> Any:
    """Upper 64 bits of the product of two words."""

    def build(builder: Any, a: Any, b: Any) -> Any:
        product = builder.mul(builder.zext(a, _WIDE), builder.zext(b, _WIDE))
        return builder.trunc(builder.lshr(product, ir.Constant(_WIDE, 64)), _WORD)

    return types.uint64(types.uint64, types.uint64), _generator(build)


@intrinsic
def count_bits(typing_context: Any, word: Any) -> Any:
    """How many bits of a word are set."""

    def build(builder: Any, word: Any) -> Any:
        return builder.ctpop(word)

    return types.int64(types.uint64), _generator(build)


@intrinsic
def lowest_bit(typing_context: Any, word: Any) -> Any:
    """Number of the lowest bit that is set in a word; 64 if none is."""

    def build(builder: Any, word: Any) -> Any:
        return builder.cttz(word, ir.Constant(ir.IntType(1), 0))

    return types.int64(types.uint64), _generator(build)
