"""The search for files that import each other in a circle."""

from __future__ import annotations

from tests.circles import circles, imports_of

LINE = {"a": {"b"}, "b": {"c"}, "c": set[str]()}
RING = {"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}


def test_circles() -> None:
    """Files that reach each other are one circle; what only leads to it is none of it."""
    assert circles(LINE) == []
    assert circles(RING) == [["a", "b", "c"]]
    assert circles({"a": {"b"}, "b": {"a"}, "c": {"d"}, "d": {"c", "a"}}) == [["a", "b"], ["c", "d"]]


def test_package() -> None:
    """No files of the package import each other in a circle, also not for type checkers."""
    assert circles(imports_of("ropeway")) == []
