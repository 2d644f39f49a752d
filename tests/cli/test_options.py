from dataclasses import dataclass, field
from typing import Literal

import pytest

from coopmap_env.cli.commands import find_commands
from coopmap_env.cli.options import field_docstrings, first_sentence, parse_options


@dataclass(frozen=True)
class Nested:
    """A group."""

    rate: float = 0.5
    """Rate of it. It has a reason."""


@dataclass(frozen=True, kw_only=True)
class Base:
    """What is shared."""

    size: int = 3
    """Size of it."""
    shape: Literal["round", "square"] | None = None
    """Shape of it. The default is round."""


@dataclass(frozen=True, kw_only=True)
class Command(Base):
    """Do something."""

    name: str
    """Name of
    it."""
    size: int = 4
    """Size here."""
    nested: Nested = field(default_factory=lambda: Nested(rate=0.25))


def parse(*arguments):
    return parse_options(Command, "coopmap do", arguments)


def test_arguments_become_the_command():
    assert parse("--name", "a") == Command(name="a")
    given = parse("--name", "a", "--size", "5", "--shape", "round", "--nested.rate", "1")
    assert given == Command(name="a", size=5, shape="round", nested=Nested(1.0))


def test_docstrings_are_those_under_the_fields_of_a_class_before_those_of_its_bases():
    assert field_docstrings(Command) == {
        "name": "Name of it.",
        "size": "Size here.",
        "shape": "Shape of it. The default is round.",
    }


def help_of(capsys, flag):
    with pytest.raises(SystemExit) as raised:
        parse(flag)
    assert raised.value.code == 0
    return capsys.readouterr().out


def test_help_has_the_first_sentence_and_the_options_of_the_command_first(capsys):
    text = help_of(capsys, "--help")
    assert "Rate of it (default: 0.25)" in text
    assert "reason" not in text
    assert "The default is round" not in text
    assert "None" not in text
    assert text.index("--name") < text.index("--shape")
    assert "coopmap do --help-all" in text


def test_all_of_the_help_is_one_option_away(capsys):
    text = help_of(capsys, "--help-all")
    assert "Rate of it. It has a reason. (default: 0.25)" in text
    assert "The default is round" in text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("One.", "One"),
        ("One. Two.", "One"),
        ("One; two.", "One"),
        ("Of 0.5 and more", "Of 0.5 and more"),
        ("", ""),
    ],
)
def test_a_sentence_ends_with_a_full_stop_or_a_semicolon_and_a_space(text, expected):
    assert first_sentence(text) == expected


@pytest.mark.parametrize("name", find_commands())
def test_the_help_of_an_option_is_one_line(name):
    command = find_commands()[name]()
    shown = {option: first_sentence(text) for option, text in field_docstrings(command).items()}
    assert {option: text for option, text in shown.items() if len(text) > 80} == {}
