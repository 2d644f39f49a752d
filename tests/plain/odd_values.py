"""Values of every kind that no argument, setting or action expects, and some that one might."""

import datetime
import math
from collections import UserList
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np


class Hostile:
    """Whatever is asked of it raises."""

    def _refuse(self, *args, **kwargs):
        raise RuntimeError("asked")

    __array__ = __bool__ = __call__ = __contains__ = __eq__ = __float__ = __getitem__ = _refuse
    __index__ = __int__ = __iter__ = __len__ = __lt__ = __ne__ = __repr__ = __str__ = _refuse
    __hash__ = object.__hash__


class HostileInt(int):
    """An integer that refuses to be compared and printed."""

    def _refuse(self, *args):
        raise RuntimeError("asked")

    __eq__ = __ge__ = __gt__ = __le__ = __lt__ = __repr__ = __str__ = _refuse
    __hash__ = int.__hash__


class Real32:
    """A tensor-like value with `__array__`."""

    def __array__(self, dtype=None, copy=None):
        return np.zeros(3, dtype=dtype)


def odd_values():
    """New values; none of them is an action, and few are a setting."""
    cyclic: list = []
    cyclic.append(cyclic)
    return [
        None, Ellipsis, NotImplemented, object(), object, int, Hostile(), Hostile, HostileInt(3),
        True, False, np.True_, np.False_, 1j, np.complex64(1), math.nan, math.inf, -math.inf,
        10**30, -(10**30), 10**400, -(10**400), 10**5000, Fraction(10**400), Fraction(1, 3),
        Decimal("0.1"), Decimal("nan"), 2**63, 2**63 - 1, -(2**63), 1e308, -1e308, 5e-324,
        np.float16(0.5), np.float32(0.25), np.longdouble("1e4000"), np.longdouble(0.5),
        np.int8(1), np.uint64(2**64 - 1), np.datetime64("2024-01-01"), np.timedelta64(1, "s"),
        datetime.timedelta(1), datetime.date(2024, 1, 1), "", "0", "3", "0.5", "nan", "\x00",
        "a" * 100_000, b"1", bytearray(b"1"), np.str_("1"), np.bytes_(b"1"), Path("0"),
        [], (), {}, set(), frozenset({1}), range(3), iter([1.0]), [[]], [None], [cyclic], {0: 1},
        (0.0, (0.0, 1.0)), [[0.0], [0.0, 1.0]], np.array([]), np.array(0.5), np.array(1),
        np.zeros((3, 3)), np.zeros(10_000), np.array("1"), np.array([None, 1, 2]),
        np.array([1j, 0, 0]), np.array(["0", "0", "0"]), np.array([True, False, True]),
        np.zeros(3, "m8[s]"), np.zeros(3, "M8[s]"), np.zeros(3, [("a", "f4")]),
        np.ma.masked_array([0.0, 0.0, 0.0], [False, True, False]), np.ma.masked, memoryview(b"123"),
        memoryview(bytes(3)), bytearray(3), [np.array(True), 0.0, 0.0], UserList([True, 0.0, 0.0]),
        lambda: 0, math, {"robot_0": {}}, slice(3), type("Empty", (), {})(),
    ]  # fmt: skip
