"""The values of parameters, as viewers read and write them."""

from __future__ import annotations

from typing import Any

import pytest

from ropeway.errors import ValueMismatch
from ropeway.networks.foxglove.values import shown_parameter, wanted_value
from ropeway.networks.foxglove.wire import GivenParameter


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (None, {}),
        (True, {"value": True}),
        (5, {"value": 5}),
        (5.0, {"value": 5.0, "type": "float64"}),
        (float("inf"), {"value": None, "type": "float64"}),
        ("text", {"value": "text"}),
        (b"\x00\xff", {"value": "AP8=", "type": "byte_array"}),
        ([1.0, float("nan")], {"value": [1.0, None], "type": "float64_array"}),
        ([1, 2], {"value": [1, 2]}),
        ([], {"value": []}),
    ],
    ids=repr,
)
def test_shown(value: Any, shown: dict[str, Any]) -> None:
    """A value is shown as JSON with the type that JSON cannot tell; one that is not set has none."""
    assert shown_parameter("/n.a", value) == {"name": "/n.a", **shown}


@pytest.mark.parametrize(
    ("value", "type", "now", "wanted"),
    [
        (5, "", 1, 5),
        (5, "", 1.0, 5.0),
        (5, "float64", 1, 5.0),
        ([1, 2], "", [0.5], [1.0, 2.0]),
        ([1, 2], "float64_array", [], [1.0, 2.0]),
        ([1, 2.5], "", None, [1.0, 2.5]),
        ("AP8=", "byte_array", b"", b"\x00\xff"),
        ("text", "", None, "text"),
        (True, "", False, True),
    ],
    ids=repr,
)
def test_wanted(value: Any, type: str, now: Any, wanted: Any) -> None:
    """A value is set in the type that the viewer names, or that the parameter has."""
    found = wanted_value(GivenParameter("/n.a", value, type, True), now)
    assert found == wanted
    assert repr(found) == repr(wanted)


def test_unset() -> None:
    """A parameter that comes without a value is unset."""
    assert wanted_value(GivenParameter("/n.a", None, "", False), 7) is None


@pytest.mark.parametrize(
    ("value", "type"), [("AP8", "byte_array"), (7, "byte_array"), ("é", "byte_array"), ({"a": 1}, ""), ([1, "a"], "")]
)
def test_refused(value: Any, type: str) -> None:
    """A value that no parameter can have is refused."""
    with pytest.raises(ValueMismatch):
        wanted_value(GivenParameter("/n.a", value, type, True), None)
