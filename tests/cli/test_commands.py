import pytest

from coopmap_env.cli import commands, parse_command
from coopmap_env.cli.commands import PURPOSES, find_commands, first_screen
from coopmap_env.core.version import __version__


def first(capsys, *arguments):
    with pytest.raises(SystemExit) as raised:
        parse_command(arguments)
    return raised.value.code, capsys.readouterr()


@pytest.mark.parametrize("arguments", [(), ("-h",), ("--help",)])
def test_the_first_screen_lists_the_commands_by_purpose(arguments, capsys):
    code, printed = first(capsys, *arguments)
    assert code == 0
    places = [printed.out.index(f"{purpose}:") for purpose in PURPOSES]
    assert places == sorted(places)
    for name in find_commands():
        assert f"\n  {name} " in printed.out
    assert commands.OTHER not in printed.out
    assert len(printed.out.splitlines()) < 40


def test_the_version_is_printed(capsys):
    code, printed = first(capsys, "--version")
    assert (code, printed.out) == (0, f"coopmap {__version__}\n")


def test_an_unknown_command_is_one_line_with_the_nearest(capsys):
    code, printed = first(capsys, "evalute", "--episodes", "3")
    assert (code, printed.out) == (2, "")
    (line,) = printed.err.splitlines()
    assert line.startswith("coopmap: unknown command 'evalute'; did you mean 'evaluate'?")


class Own:
    """A command of somebody else.

    With more about it.
    """


def test_commands_of_other_packages_are_listed_too_also_if_they_are_broken():
    def broken():
        raise ImportError("no module named nothing")

    text = first_screen({**find_commands(), "own": lambda: Own, "broken": broken})
    last = text.partition("other packages:\n")[2]
    assert "own" in last
    assert "A command of somebody else.\n" in last
    assert "(cannot be loaded: no module named nothing)" in last
