"""Paths to fields of JSON values."""

from __future__ import annotations

from typing import Any

import pytest

from ropeway.gateway.config.field_path import parse_field_path
from ropeway.limits import FIELD_PATH_CHARACTERS, FIELD_PATH_STEPS


@pytest.mark.parametrize(
    ("path", "found"),
    [("", {"a": [{"b": 1}]}), ("#value", {"a": [{"b": 1}]}), ("a[0].b", 1), ("a/[0]/b", 1), ("/a", [{"b": 1}])],
)
def test_reads(path: str, found: Any) -> None:
    """A path leads over names and places of lists, with slashes or dots between."""
    assert parse_field_path(path).read({"a": [{"b": 1}]}) == found


@pytest.mark.parametrize("path", ["x", "a.b", "a[1]", "a[0].b.c", "a[]"])
def test_there_is_nothing(path: str) -> None:
    """Where nothing stands the error has the path."""
    with pytest.raises(LookupError, match="there is no"):
        parse_field_path(path).read({"a": [{"b": 1}]} if path != "a[]" else {"a": []})


def test_writes() -> None:
    """Objects and lists are made on the way, and lists grow at their end."""
    value: Any = None
    for path, item in [("a/b", 1), ("a.c[]", 2), ("a.c[1]", 3), ("a.c[0]", 4), ("list[].x", 5)]:
        value = parse_field_path(path).write(item, value)
    assert value == {"a": {"b": 1, "c": [4, 3]}, "list": [{"x": 5}]}
    assert parse_field_path("").write(7, value) == 7


@pytest.mark.parametrize("path", ["a.b.c", "a[0]", "b[9]"])
def test_something_is_in_the_way(path: str) -> None:
    """What cannot be written is an error that has the path."""
    with pytest.raises(LookupError, match="has no place"):
        parse_field_path(path).write(1, {"a": {"b": 2}, "b": []})


@pytest.mark.parametrize(
    "path", ["a..b", "a[", "a[x]", "[99999]", "a b", "x" * (FIELD_PATH_CHARACTERS + 1), "[0]" * (FIELD_PATH_STEPS + 1)]
)
def test_what_is_no_path(path: str) -> None:
    """What is no path, or too long a one, is refused."""
    with pytest.raises(ValueError, match="expected a path"):
        parse_field_path(path)
