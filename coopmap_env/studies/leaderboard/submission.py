"""The file of a submission: what was played, all actions and scores, and what is reported.

JSON, packed with gzip if its name ends in ``.gz``. It has no seeds: a world has its number, and
what makes it is the family's definition, or the salt of private worlds. What
`coopmap_env.studies.leaderboard.replay` cannot verify stands under ``reported``.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from contextlib import closing
from typing import Any, Literal, TypedDict, get_type_hints

from coopmap_env import families
from coopmap_env.core.archives import gzipped, read_gzip
from coopmap_env.core.files import FileError, brief, read_bytes, write_atomically
from coopmap_env.core.json_types import has_type
from coopmap_env.envs import MappingEnv
from coopmap_env.families import Family
from coopmap_env.families.worlds import definition_hash

FORMAT = "coopmap submission 1"
SPLIT: Literal["test"] = "test"
FEWEST_WORLDS = 2
"""Intervals need two."""
MOST_CHARACTERS = 300
"""Of a text, such as the policy's spec."""


class SubmissionError(FileError):
    """A submission that cannot be read, or that a replay contradicts."""


class Options(TypedDict):
    """How the policy acts; see `coopmap_env.families.FREE_ARGUMENTS`."""

    action_mode: str
    n_candidates: int


class EpisodeRecord(TypedDict):
    """One episode."""

    world: int
    """Its number, from 0 on."""
    world_hash: str
    actions: list[list[int | list[float]]]
    """Of each step and robot: the number of a candidate, or the numbers of a pose action."""
    scores: dict[str, float | None]
    """Those of `Episode.row`, without the seed and the time of decisions; None if undefined."""
    map_hash: str
    """See `coopmap_env.studies.leaderboard.replay.map_hash`."""


class Reported(TypedDict):
    """What a replay cannot verify."""

    decision_ms: float
    """Mean time of a decision of one robot, milliseconds."""
    model_bytes: int | None
    n_parameters: int | None
    """Size of what was learned, if the policy says so."""
    machine: dict[str, str | int]
    """Processor, cores and system."""
    versions: dict[str, str]
    """Of coopmap, Python and libraries."""


class Submission(TypedDict):
    """A policy on the first worlds of a family."""

    format: str
    family: str
    definition: str
    """Hash of the family's definition."""
    split: str
    private: str | None
    """Hash of the salt, if the worlds are private."""
    policy: str
    """Spec; see `coopmap_env.evaluation.make_policy`."""
    fingerprint: str
    """Hash of what was learned, if the policy has one."""
    files: dict[str, str]
    """SHA-256 of the files that the spec names."""
    options: Options
    n_worlds: int
    episodes: list[EpisodeRecord]
    reported: Reported


def make_env(family: str, options: Options) -> MappingEnv[Any]:
    """The environment in which a submission is played and replayed.

    Raises
    ------
    ValueError
        If the family is unknown or does not accept the options.
    """
    return families.get(family).make(SPLIT, report_shown=True, **options)


def write_submission(path: str | os.PathLike[str], submission: Submission) -> None:
    """Write a submission, whole or not at all; an episode is one line.

    It is packed with gzip, to a quarter, if the name ends in ``.gz``.
    """
    rest = {name: value for name, value in submission.items() if name != "episodes"}
    head = json.dumps(rest, indent=1, allow_nan=False).removesuffix("\n}")
    episodes = ",\n".join(json.dumps(one, allow_nan=False) for one in submission["episodes"])
    content = f'{head},\n "episodes": [\n{episodes}\n ]\n}}\n'.encode()
    write_atomically(path, gzipped(content) if _is_packed(path) else content)


def _is_packed(path: str | os.PathLike[str]) -> bool:
    return os.fspath(path).endswith(".gz")


def read_submission(path: str | os.PathLike[str]) -> Submission:
    """Read a submission and check its form, not what it states.

    Raises
    ------
    SubmissionError
        With the file, if it is broken or of another form, its family is unknown or has another
        definition by now, or its worlds are not 0, 1, ... in this order.
    """
    try:
        text = (read_gzip if _is_packed(path) else read_bytes)(path, SubmissionError).decode()
    except UnicodeDecodeError as error:
        raise SubmissionError(f"{path}: expected UTF-8 text: {error}") from error
    try:
        value = json.loads(text, parse_constant=_reject_constant, object_pairs_hook=_distinct)
    except (ValueError, RecursionError) as error:
        raise SubmissionError(f"{path}: expected JSON: {error!s:.300}") from error
    if not isinstance(value, dict) or value.get("format") != FORMAT:
        given = value.get("format") if isinstance(value, dict) else value
        raise SubmissionError(f"{path}: expected the format {FORMAT!r}, got {brief(given)}")
    try:
        _check(value)
    except ValueError as error:
        raise SubmissionError(f"{path}: {error}") from error
    submission: Submission = value  # type: ignore[assignment]
    return submission


def _reject_constant(name: str) -> float:
    raise ValueError(f"{name} is no number")


def _distinct(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object whose names are all different: readers disagree on which one counts."""
    values = dict(pairs)
    if len(values) < len(pairs):
        raise ValueError(f"a name stands twice among {brief([name for name, _ in pairs])}")
    return values


def _check(value: dict[str, Any]) -> None:
    """ValueError unless it has the form of a submission to a family of this version."""
    check_head(value)
    _check_worlds(value["n_worlds"], [episode["world"] for episode in value["episodes"]])


def check_head(value: Mapping[str, Any]) -> None:
    """Check the form of a submission, and what it states beside its episodes.

    Raises
    ------
    ValueError
        If an entry is missing or not of its type, a text is too long or not printable, or the
        family is unknown, has another definition or does not accept the options.
    """
    _check_types(value)
    _check_texts({name: one for name, one in value.items() if name != "episodes"})
    _check_reported(value["reported"])
    family = families.get(value["family"])
    _check_definition(family, value["definition"])
    if value["split"] != SPLIT:
        raise ValueError(f"split must be {SPLIT!r}, got {brief(value['split'])}")
    try:
        with closing(make_env(family.name, value["options"])):
            pass
    except ValueError as error:
        raise ValueError(f"options {brief(value['options'])}: {error}") from error


def _check_types(value: Mapping[str, Any]) -> None:
    """Entry by entry, so that the message says which one is wrong."""
    hints = get_type_hints(Submission)
    for name in (*hints, *value):
        if name not in value or name not in hints:
            raise ValueError(f"the entries must be {', '.join(hints)}; one is {brief(name)}")
    for name in hints:
        if name == "episodes":
            _check_episodes(value[name])
        elif not has_type(value[name], hints[name]):
            raise ValueError(f"{name} is not of its type: {brief(value[name])}")


def _check_episodes(episodes: Any) -> None:
    if not isinstance(episodes, list):
        raise ValueError(f"episodes must be a list, got {brief(episodes)}")
    for k, episode in enumerate(episodes):
        if not has_type(episode, EpisodeRecord):
            raise ValueError(f"episodes[{k}] is not of its type: {brief(episode)}")


def _check_texts(value: Any) -> None:
    """Texts are shown in terminals: no control characters, and not too many."""
    if isinstance(value, dict):
        for parts in value.items():
            for part in parts:
                _check_texts(part)
    if isinstance(value, str) and not (value.isprintable() and len(value) <= MOST_CHARACTERS):
        raise ValueError(
            f"texts must be printable and of at most {MOST_CHARACTERS} characters, "
            f"got {brief(value)}"
        )


def _check_reported(reported: dict[str, Any]) -> None:
    for name in ("decision_ms", "model_bytes", "n_parameters"):
        if reported[name] is not None and reported[name] < 0:
            raise ValueError(f"{name} must be at least 0, got {brief(reported[name])}")


def _check_definition(family: Family, stated: str) -> None:
    found = definition_hash(family)
    if stated != found:
        raise ValueError(
            f"it belongs to another definition of the family {family.name!r}, with the hash "
            f"{brief(stated)}; this version of coopmap has {found}"
        )


def _check_worlds(n_worlds: int, worlds: list[int]) -> None:
    """ValueError unless these are the worlds 0, 1, ... in this order."""
    if n_worlds < FEWEST_WORLDS:
        raise ValueError(f"n_worlds must be at least {FEWEST_WORLDS}, got {n_worlds}")
    for k, world in enumerate(worlds):
        if world != k:
            what = "stands twice or too late" if world < k else f"stands where {k} is expected"
            raise ValueError(f"the worlds must be 0 ... {n_worlds - 1} in order: {world} {what}")
    if len(worlds) != n_worlds:
        raise ValueError(f"n_worlds is {n_worlds}, and there are {len(worlds)} episodes")
