"""Caches that no two users can disturb each other through.

What a cache of the whole process returns is shared by all environments, in all threads. So it is
either read-only (`freeze`), or each thread has its own (`thread_cache`; by JSON values, such as
those of jobs, `json_cache`).
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import lru_cache, wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


def freeze(value: Result) -> Result:
    """Make the arrays in a value read-only: in tuples, lists, dictionaries and dataclasses too."""
    if isinstance(value, np.ndarray):
        value.setflags(write=False)
    elif isinstance(value, tuple | list):
        for part in value:
            freeze(part)
    elif isinstance(value, dict):
        for part in value.values():
            freeze(part)
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            freeze(getattr(value, field.name))
    return value


def thread_cache(
    maxsize: int,
) -> Callable[[Callable[Parameters, Result]], Callable[Parameters, Result]]:
    """`functools.lru_cache` with a cache for each thread: for what has a state, as environments."""

    def decorate(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
        local = threading.local()

        @wraps(function)
        def cached(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
            if not hasattr(local, "cache"):
                local.cache = lru_cache(maxsize)(function)
            result: Result = local.cache(*args, **kwargs)
            return result

        return cached

    return decorate


def json_cache(maxsize: int) -> Callable[[Callable[..., Result]], Callable[..., Result]]:
    """`thread_cache` of a function of JSON values: by their text, so they need not be hashable.

    The function gets copies by its positions, with lists in place of tuples.
    """

    def decorate(function: Callable[..., Result]) -> Callable[..., Result]:
        @thread_cache(maxsize)
        def of_text(text: str) -> Result:
            return function(*json.loads(text))

        @wraps(function)
        def cached(*values: Any) -> Result:
            return of_text(json.dumps(values, sort_keys=True))

        return cached

    return decorate
