"""Settings given values of every kind: accepted as they are documented, or refused by name."""

import importlib
import json
import pkgutil
import re
from dataclasses import MISSING, fields
from functools import cache

import numpy as np
import pytest
from plain.fuzz import cases
from plain.odd_values import odd_values

import coopmap_env
from coopmap_env.core.settings import Settings, settings_from_dict, settings_to_dict
from coopmap_env.envs.arguments import TaskArguments
from coopmap_env.mapping import VoxelGrid

WORD = re.compile(r"\w+")


@cache
def settings_classes():
    """All classes of settings, but for those of the commands, which the environment checks."""
    names = [module.name for module in pkgutil.walk_packages(coopmap_env.__path__, "coopmap_env.")]
    for name in (*names, "coopmap_agents.config", "coopmap_agents.map_config"):
        if not name.endswith("__main__"):
            importlib.import_module(name)
    found, checked = [Settings], []
    for kind in found:
        found += kind.__subclasses__()
        is_command = issubclass(kind, TaskArguments) or hasattr(kind, "run")
        if kind.__module__.startswith("coopmap_") and not is_command:
            checked.append(kind)
    return [kind for kind in checked if fields(kind) and not required(kind)]


def required(kind):
    return [f for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING]


def json_values():
    """Those of the odd values that a JSON file can hold, as it is read."""
    found = []
    for value in odd_values():
        try:
            found.append(json.loads(json.dumps(value)))
        except (TypeError, ValueError, RuntimeError):
            continue
    return found


def refusal(make, *arguments):
    """What is made and an empty text, or None and the message of the ValueError."""
    try:
        return make(*arguments), ""
    except ValueError as error:
        return None, str(error)


def accepts(kind, name, value):
    """Whether a field accepts a value; what is accepted survives JSON, the rest is named."""
    settings, message = refusal(lambda: kind(**{name: value}))
    if message:
        assert kind.__name__ in message
        assert any(field.name in message for field in fields(kind))
        assert len(message) < 1000
        return False
    written = json.dumps(settings_to_dict(settings), allow_nan=False)
    assert settings_from_dict(json.loads(written), kind) == settings
    return True


@cases(short=4_000, long=200_000)
def test_every_value_of_every_field_is_accepted_or_refused_by_name(n_cases):
    rng = np.random.default_rng(0)
    kinds, values, accepted = settings_classes(), odd_values(), set()
    assert len(kinds) > 20
    for _ in range(n_cases):
        kind = kinds[rng.integers(len(kinds))]
        field = fields(kind)[rng.integers(len(fields(kind)))]
        accepted.add(accepts(kind, field.name, values[rng.integers(len(values))]))
    assert accepted == {True, False}


@cases(short=2_000, long=200_000)
def test_settings_from_json_of_every_kind_are_accepted_or_refused_by_name(n_cases):
    rng = np.random.default_rng(0)
    values, kinds = json_values(), settings_classes()
    names = {kind.__name__ for kind in (*kinds, VoxelGrid)} | {"grid"}
    for _ in range(n_cases):
        kind = kinds[rng.integers(len(kinds))]
        given = settings_to_dict(kind())
        broken = place = given
        while isinstance(place, dict) and place:
            broken, name = place, list(place)[rng.integers(len(place))]
            place = place[name]
        broken[name] = values[rng.integers(len(values))]
        if rng.random() < 0.1:
            broken["gain"] = 1  # no name of a setting
        settings, message = refusal(settings_from_dict, given, kind)
        if message:
            assert {*WORD.findall(message)} & names
        else:
            json.dumps(settings_to_dict(settings), allow_nan=False)


@pytest.mark.parametrize("values", [None, 3, "depth", [["depth", 1.0]], ["depth"], b"", {1: 2}])
def test_what_is_no_mapping_of_settings_is_refused_by_the_name_of_the_class(values):
    from coopmap_env.sensing import RangeNoise

    with pytest.raises(ValueError, match="RangeNoise"):
        settings_from_dict(values, RangeNoise)
