"""From the arguments of a command to its dataclass, by tyro, with a line of help for each option.

The help of an option is the docstring under its field. ``--help`` has its first sentence,
``--help-all`` all of it.
"""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import MISSING, Field, fields, is_dataclass
from functools import partial
from itertools import pairwise
from typing import Annotated, Any, get_type_hints

import tyro
from tyro.constructors import (
    ConstructorRegistry,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

HELP_ALL = "--help-all"


def parse_options(command: type[Any], prog: str, arguments: Sequence[str]) -> Any:
    """Parse arguments into a command; help and errors are printed, and exit.

    Parameters
    ----------
    command : type
        A dataclass.
    prog : str
        Name of the program and of the command.
    arguments : sequence of str
    """
    is_full = HELP_ALL in arguments
    registry = ConstructorRegistry()
    registry.struct_rule(partial(_spec, is_full=is_full))
    description = inspect.cleandoc(command.__doc__ or "")
    if not is_full:
        description += f"\n\n{prog} {HELP_ALL} says more about each option."
    return tyro.cli(
        command,
        prog=prog,
        description=description,
        args=["--help" if argument == HELP_ALL else argument for argument in arguments],
        config=(tyro.conf.DisallowNone,),
        registry=registry,
    )


def _spec(info: StructTypeInfo, is_full: bool) -> StructConstructorSpec | None:
    """How tyro makes a dataclass: its own fields first, then those that it inherits."""
    made = info.type
    if not isinstance(made, type) or not is_dataclass(made):
        return None
    hints = get_type_hints(made, include_extras=True)
    texts = field_docstrings(made)
    options = [field for field in fields(made) if field.init]
    options.sort(key=lambda field: field.name not in inspect.get_annotations(made))
    return StructConstructorSpec(
        instantiate=made,
        fields=tuple(
            StructFieldSpec(
                field.name,
                _with_help(hints[field.name], texts.get(field.name, ""), is_full),
                _default(field, info.default),
            )
            for field in options
        ),
    )


def _with_help(hint: Any, text: str, is_full: bool) -> Any:
    """The type of an option with its help."""
    shown = text if is_full else first_sentence(text)
    return Annotated[hint, tyro.conf.arg(help=shown, help_behavior_hint=_default_text)]


def _default_text(default: str) -> str:
    """What the help says of a default; an option that may be left out has none."""
    return "" if default in ("None", "") else f"(default: {default})"


def _default(field: Field[Any], parent: Any) -> Any:
    """Default of a field, of the object that its class has as default, if there is one."""
    if is_dataclass(parent) and hasattr(parent, field.name):
        return getattr(parent, field.name)
    if field.default is not MISSING:
        return field.default
    return tyro.MISSING if field.default_factory is MISSING else field.default_factory()


def first_sentence(text: str) -> str:
    """A text up to the first full stop or semicolon that a space follows, without that."""
    return re.split(r"[.;] ", text, maxsplit=1)[0].removesuffix(".")


def field_docstrings(made: type[Any]) -> dict[str, str]:
    """Docstrings under the fields of a dataclass and of its bases, each on one line."""
    return {
        name: text
        for base in reversed(made.__mro__)
        if base is not object and is_dataclass(base)
        for name, text in _docstrings_in_class(base)
    }


def _docstrings_in_class(made: type[Any]) -> Iterator[tuple[str, str]]:
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(made)))
    except (OSError, SyntaxError):  # there is no source: the options have no help
        return
    body = tree.body[0].body  # type: ignore[attr-defined]  # a class
    for line, below in pairwise(body):
        if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name):
            value = below.value if isinstance(below, ast.Expr) else None
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                yield line.target.id, " ".join(value.value.split())
