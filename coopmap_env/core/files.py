"""Files: written whole or not at all; YAML read with errors that name the file."""

from __future__ import annotations

import math
import os
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from coopmap_env.core.extras import import_optional


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Temporary path beside `path`, with the same suffix; moved to `path` when the block ends.

    After an error the temporary file is removed and `path` is as it was.
    """
    target = Path(path)
    temporary = target.with_name(f".{target.stem}.{uuid.uuid4().hex}.tmp{target.suffix}")
    try:
        yield temporary
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def write_atomically(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write text (UTF-8) or bytes to a file; missing folders are made."""
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)


def read_yaml_mapping(path: Path, error_type: type[ValueError]) -> Mapping[str, Any]:
    """Fields of a YAML file.

    Raises
    ------
    error_type
        With the file, if it cannot be read or holds no mapping.
    ImportError
        With the pip command, if PyYAML is not installed.
    """
    yaml = import_optional("yaml", "maps")
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise error_type(f"{path}: cannot be read: {error}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: no such date
        raise error_type(f"{path}: expected YAML: {error}") from error
    if not isinstance(content, Mapping):
        raise error_type(f"{path}: expected a YAML mapping of fields, not {content!r:.80}")
    return content


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
