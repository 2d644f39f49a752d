import warnings

import pytest

from coopmap_env.cli.errors import errors_as_lines


def test_a_warning_is_one_line(capsys):
    with errors_as_lines("program"), warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.warn("mesh.stl: the surface\nis open", stacklevel=1)
    assert capsys.readouterr().err == "program: warning: mesh.stl: the surface is open\n"


def test_warnings_are_shown_as_before_afterwards():
    before = warnings.showwarning
    with pytest.raises(SystemExit, match="program: bad value"), errors_as_lines("program"):
        raise ValueError("bad\nvalue")
    assert warnings.showwarning is before


def test_a_study_answers_a_wrong_name_in_one_line(capsys):
    from coopmap_env.studies.families.__main__ import main

    with pytest.raises(SystemExit) as raised:
        main(["crowd", "--out", "nowhere"])
    assert raised.value.code == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert "unknown family 'crowd'; did you mean 'crowded'?" in last
