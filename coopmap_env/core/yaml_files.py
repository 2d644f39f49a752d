"""YAML files of fields, read strictly and with limits."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from typing import Any

from coopmap_env.core.extras import import_optional
from coopmap_env.core.files import FileError, brief, read_text

MAX_YAML, MAX_YAML_VALUES, MAX_YAML_DEPTH = 1 << 21, 250_000, 50
"""Characters of a YAML file, values in it, and levels of values in values: PyYAML reads some ten
thousand values a second, and looks at each character once for every bracket around it."""


def read_yaml_mapping(
    path: str | os.PathLike[str], error_type: type[FileError] = FileError
) -> Mapping[str, Any]:
    """Fields of a YAML file; see `read_text`.

    Aliases (``*name``) are refused: a few of them can stand for gigabytes.

    Raises
    ------
    error_type
        Also if it is not YAML, has an alias or a field twice, or holds no mapping.
    ImportError
        With the pip command, if PyYAML is not installed.
    """
    yaml = import_optional("yaml", "maps")
    text = read_text(path, error_type)
    if len(text) > MAX_YAML:
        raise error_type(f"{path} has {len(text):,} characters, expected {MAX_YAML:,} at most")
    try:
        content = yaml.load(text, _strict_loader(yaml, path, error_type))
    except error_type:
        raise
    except Exception as error:  # PyYAML's constructors raise what Python raises for their values
        raise error_type(f"{path}: expected YAML: {error!s:.500}") from error
    if not isinstance(content, Mapping):
        raise error_type(f"{path}: expected a YAML mapping of fields, not {brief(content)}")
    return content


def _strict_loader(yaml: Any, path: str | os.PathLike[str], error_type: type[FileError]) -> Any:
    """A loader of PyYAML that refuses aliases, repeated fields, and too many or nested values."""

    class StrictLoader(yaml.SafeLoader):
        n_values, depth = 0, 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            event = self.peek_event()
            where = f"{path}, line {event.start_mark.line + 1}"
            if isinstance(event, yaml.events.AliasEvent):
                raise error_type(
                    f"{where}: the alias *{event.anchor:.40} cannot be read: write its value in "
                    "full"
                )
            self.n_values += 1
            if self.n_values > MAX_YAML_VALUES or self.depth > MAX_YAML_DEPTH:
                raise error_type(
                    f"{where}: expected {MAX_YAML_VALUES:,} values at most, and {MAX_YAML_DEPTH} "
                    "inside of each other"
                )
            self.depth += 1
            node = super().compose_node(parent, index)
            self.depth -= 1
            return node

        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            names: set[str] = set()
            for key, _ in node.value if isinstance(node, yaml.MappingNode) else ():
                if isinstance(key, yaml.ScalarNode) and key.value in names:
                    raise error_type(
                        f"{path}, line {key.start_mark.line + 1}: {brief(key.value)} is there "
                        "twice: YAML does not say which one counts"
                    )
                names.add(str(key.value))
            return super().construct_mapping(node, deep)

    return StrictLoader


def read_yaml_number(value: object) -> float:
    """A YAML scalar as a number, NaN if it is none.

    ``5e-2`` is a string to PyYAML (YAML 1.1 wants ``5.0e-2``) and a number to most other readers.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return math.nan
    try:
        return float(value)
    except (ValueError, OverflowError):
        return math.nan
