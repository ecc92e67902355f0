"""ropeway.recording.condition: what triggers a clip."""

from __future__ import annotations

import contextlib
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.recording.condition import Condition


@pytest.mark.parametrize(
    ("text", "message", "holds"),
    [
        ("/battery.percentage < 0.2", {"percentage": 0.1}, True),
        ("battery.percentage<0.2", {"percentage": 0.2}, False),
        ("/a.data == stop", {"data": "stop"}, True),
        ("/a.data != 'stop'", {"data": "go"}, True),
        ("/a.on == true", {"on": True}, True),
        ("/a.b.c[1] >= 3", {"b": {"c": [1, 3]}}, True),
        ("/a.b.c[7] >= 3", {"b": {"c": [1, 3]}}, False),
        ("/a.missing > 1", {}, False),
        ("/a.data > 1", {"data": "text"}, False),
    ],
)
def test_values(text: str, message: dict[str, Any], holds: bool) -> None:
    """A field is compared with a value; one that is not there, or cannot be compared, holds nothing."""
    assert Condition(text).becomes_true(message) is holds


def test_becoming_true() -> None:
    """It holds anew when it becomes true, not as long as it is."""
    condition = Condition("/a.x > 1")
    assert [condition.becomes_true({"x": x}) for x in (0, 2, 3, 1, 2)] == [False, True, False, False, True]


@pytest.mark.parametrize("text", ["", "/a", "/a.x", "/a.x ~ 1", "a b.x < 1", "/a//b.x < 1", "/a.x < [1", "/a.x <"])
def test_what_is_none(text: str) -> None:
    """A text that is no condition is refused with a sentence."""
    with pytest.raises(ValueError, match=r"condition|part|value|name"):
        Condition(text)


@given(st.text())
def test_any_text(text: str) -> None:
    """Any text is a condition or is refused."""
    with contextlib.suppress(ValueError):
        Condition(text)
