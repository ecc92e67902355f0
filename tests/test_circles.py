"""The search for files that import each other in a circle."""

from __future__ import annotations

from tests.circles import circles, complaints

LINE = {"a": {"b"}, "b": {"c"}, "c": set[str]()}
RING = {"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}


def test_circles() -> None:
    """Files that reach each other are one circle; what only leads to it is none of it."""
    assert circles(LINE) == []
    assert circles(RING) == [["a", "b", "c"]]
    assert circles({"a": {"b"}, "b": {"a"}, "c": {"d"}, "d": {"c", "a"}}) == [["a", "b"], ["c", "d"]]


def test_new_circle() -> None:
    """A circle that is not on the list is told with all its files."""
    assert complaints(RING, {}) == ["these files import each other in a circle: a, b, c"]
    assert complaints(LINE, {}) == []


def test_list_may_only_shrink() -> None:
    """What stands on the list passes, and has to leave it once it is in no circle."""
    assert complaints(RING, {"c": "a"}) == []
    assert complaints(LINE, {"b": "c"}) == ["b and c are in no circle any more: shorten STANDING in tests/circles.py"]
