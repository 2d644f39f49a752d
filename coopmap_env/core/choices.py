"""Messages for names that are none of the choices."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from difflib import get_close_matches
from inspect import Parameter, signature

from coopmap_env.core.files import brief

LONGEST_TYPED = 60
"""Characters of a name that is compared with the choices."""


def unknown(what: str, name: object, choices: Iterable[str]) -> str:
    """Message for an unknown name, with the nearest choice and all of them.

    Examples
    --------
    >>> unknown("family", "crowd", ["crowded", "narrow"])
    "unknown family 'crowd'; did you mean 'crowded'? Choose from crowded, narrow"
    """
    names = list(choices)
    return f"unknown {what} {brief(name)}; {_nearest(name, names, 'choose from')}"


def _nearest(name: object, names: list[str], verb: str) -> str:
    """All names after a verb, and before them the one that was perhaps meant."""
    is_short = isinstance(name, str) and len(name) < LONGEST_TYPED
    near = get_close_matches(str(name), names, 1) if is_short else []
    start = f"did you mean {near[0]!r}? {verb.capitalize()}" if near else verb
    return f"{start} {', '.join(names) or 'none'}"


def check_keywords(what: str, given: Iterable[str], function: Callable[..., object]) -> None:
    """Check the names of keyword arguments before a call.

    Parameters
    ----------
    what : str
        What has the arguments, for the message.
    given : iterable of str
        Names of the keyword arguments.
    function : callable
        What will be called; one that takes any keyword is not checked.

    Raises
    ------
    TypeError
        With the nearest name and all names, if the function does not take one.
    """
    parameters = signature(function).parameters.values()
    if any(parameter.kind is Parameter.VAR_KEYWORD for parameter in parameters):
        return
    names = [
        parameter.name for parameter in parameters if parameter.kind is not Parameter.VAR_POSITIONAL
    ]
    for name in given:
        if name not in names:
            raise TypeError(
                f"{what} has no argument {brief(name)}; {_nearest(name, names, 'it takes')}"
            )
