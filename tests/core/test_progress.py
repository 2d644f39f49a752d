"""Bars of progress."""

import io
import sys

import pytest

from coopmap_env.core.progress import progress_bar


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize("stream", [io.StringIO, Terminal])
def test_files_get_the_begin_and_the_end_of_a_bar(stream, monkeypatch):
    written = stream()
    monkeypatch.setattr(sys, "stderr", written)
    # a second passes at each look
    monkeypatch.setattr("tqdm.std.time", iter(range(10**6)).__next__)
    assert list(progress_bar(range(20), unit="job")) == list(range(20))
    states = [part for part in written.getvalue().split("\r") if part.strip()]
    assert "100%" in states[-1]
    assert (len(states) <= 3) == (stream is io.StringIO)


def test_no_bar_leaves_the_items():
    items = [1, 2]
    assert progress_bar(items, unit="job", show=False) is items
