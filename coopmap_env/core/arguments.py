"""Checks of constructor arguments: the message names the argument, the value and the choices."""

from dataclasses import fields
from typing import Any


def check_choice(name: str, value: Any, choices: tuple[Any, ...]) -> None:
    """ValueError unless the value is one of the choices."""
    if value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(map(repr, choices))}, got {value!r}")


def check_array_shapes(owner: Any, shapes: list[tuple[int, ...]]) -> None:
    """ValueError unless the arrays of a dataclass have these shapes, in the order of its fields."""
    found = [getattr(owner, field.name).shape for field in fields(owner)]
    if found != shapes:
        raise ValueError(f"{type(owner).__name__} needs arrays of shapes {shapes}, got {found}")
