"""Caches that no two users can disturb each other through."""

import threading

from coopmap_env.core.caches import json_cache


def test_json_values_are_found_again_by_their_text_in_the_same_thread():
    made = []

    @json_cache(maxsize=2)
    def make(name, options):
        """Make it."""
        made.append((name, options))
        return object()

    first = make("a", {"x": 1, "y": [2, 3]})
    assert make("a", {"y": (2, 3), "x": 1}) is first
    assert make("b", {}) is not first
    assert made == [("a", {"x": 1, "y": [2, 3]}), ("b", {})]
    elsewhere = []
    thread = threading.Thread(target=lambda: elsewhere.append(make("b", {})))
    thread.start()
    thread.join()
    assert elsewhere[0] is not make("b", {})
    make("c", {})
    assert make("a", {"x": 1, "y": [2, 3]}) is not first
    assert make.__doc__ == "Make it."


def test_what_the_function_gets_is_its_own():
    @json_cache(maxsize=1)
    def grow(values):
        values.append(0)
        return values

    given = [1]
    assert grow(given) == [1, 0]
    assert given == [1]
