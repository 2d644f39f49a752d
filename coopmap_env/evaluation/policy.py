"""The Policy protocol, and the registry of policies by name.

Distributions register policies under the entry-point group ``coopmap.policies``, as this one does
with its baselines. `coopmap evaluate` knows every registered policy.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from coopmap_env.core.choices import check_keywords, unknown
from coopmap_env.core.files import brief

if TYPE_CHECKING:  # what a policy sees takes longer to load than to say that its name is unknown
    from coopmap_env.envs import Belief, Observation

ENTRY_POINT_GROUP = "coopmap.policies"


@runtime_checkable
class Policy(Protocol):
    """Chooses the team's actions from the robots' belief; a planner or a learned policy."""

    def reset(self, rng: np.random.Generator) -> None:
        """Start a new episode; all its randomness comes from `rng`."""

    def act(self, belief: Belief, observations: Mapping[str, Observation]) -> dict[str, Any]:
        """One action for each robot."""


def policy_names() -> list[str]:
    """Names of all installed policies."""
    return sorted(_find_installed())


def _find_installed() -> dict[str, EntryPoint]:
    """Installed policies by name."""
    return {entry_point.name: entry_point for entry_point in entry_points(group=ENTRY_POINT_GROUP)}


_remembered = lru_cache(maxsize=1)(_find_installed)
"""The same without looking at all installed distributions again, which takes ten milliseconds."""


def make_policy(spec: str, **options: Any) -> Policy:
    """Make a policy from its spec: name and options, such as ``"rating_function:search=100"``.

    Several options are separated by ``+``: ``"rating_function:search=100+coordination=sequential"``
    (a comma separates policies on the command line).

    Parameters
    ----------
    spec : str
        One of `policy_names`, with or without options.
    **options
        More of them: ``make_policy("rating_function", search=100)``.

    Raises
    ------
    ValueError
        If the name or an option is unknown, or an option's value is not accepted.
    """
    entry_point, written = _parse(spec)
    if twice := sorted(options.keys() & written):
        raise ValueError(f"policy {brief(spec)}: the option {brief(twice[0])} is given twice")
    options = {**written, **options}
    constructor = entry_point.load()
    try:
        check_keywords(entry_point.name, options, constructor)
        policy = constructor(**options)
    except TypeError as error:
        raise ValueError(f"policy {brief(spec)}: {error!s:.300}") from error
    if not isinstance(policy, Policy):
        raise ValueError(f"policy {entry_point.name!r} has no reset and act: {policy!r}")
    return policy


def check_policy(spec: str) -> None:
    """Check the name of a policy and how its options are written, without loading it.

    Raises
    ------
    ValueError
        With the choices, if the name is unknown.
    """
    _parse(spec)


def _parse(spec: str) -> tuple[EntryPoint, dict[str, Any]]:
    """What loads the policy of a spec, and its options."""
    name, _, text = spec.partition(":")
    found = _remembered()
    if name not in found:
        _remembered.cache_clear()  # it may be new
        found = _remembered()
    if name not in found:
        raise ValueError(unknown("policy", name, sorted(found)))
    options: dict[str, Any] = {}
    for part in filter(None, text.split("+")):
        key, equals, value = part.partition("=")
        if not equals:
            raise ValueError(
                f"policy {brief(spec)}: an option is written key=value, got {brief(part)}"
            )
        if key in options:
            raise ValueError(f"policy {brief(spec)}: the option {brief(key)} is given twice")
        options[key] = _literal(value)
    return found[name], options


def _literal(text: str) -> Any:
    try:
        return ast.literal_eval(text)
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):  # all it may raise
        return text
