"""Parameters as text."""

from __future__ import annotations

import pytest
import yaml

from ropeway.cli.param.common import value_text
from ropeway.cli.param.describe import description_text
from ropeway.cli.param.dump import nested
from ropeway.graph.parameters import ParameterDescription, ParameterType, ParameterValue


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (True, "Boolean value is: True"),
        (3, "Integer value is: 3"),
        (2.5, "Double value is: 2.5"),
        ("map", "String value is: map"),
        (b"\x01\x02", "Byte values are: [1, 2]"),
        ([True], "Boolean values are: [True]"),
        ([1, 2], "Integer values are: [1, 2]"),
        ([0.5], "Double values are: [0.5]"),
        (["a"], "String values are: ['a']"),
        (None, "Parameter not set."),
    ],
)
def test_value_text(value: ParameterValue, text: str) -> None:
    """A value is shown as ``ros2 param get`` shows it."""
    assert value_text(value) == text


def test_hide_type() -> None:
    """The value can stand alone."""
    assert value_text([1, 2], hide_type=True) == "[1, 2]"


def test_description() -> None:
    """A description has type, meaning and limits."""
    found = ParameterDescription(
        "rate", ParameterType.DOUBLE, "how often", "a prime", read_only=True, range=(0.0, 9.0, 0.5)
    )
    assert description_text(found) == (
        "Parameter name: rate\n  Type: double\n  Description: how often\n  Constraints:\n    Read only: true\n"
        "    Min value: 0.0\n    Max value: 9.0\n    Step: 0.5\n    Additional constraints: a prime"
    )
    assert description_text(ParameterDescription("x", ParameterType.BOOL)) == (
        "Parameter name: x\n  Type: boolean\n  Constraints:"
    )


def test_nested() -> None:
    """Names with dots become mappings, and what cannot be nested keeps its dots."""
    values: dict[str, ParameterValue] = {"a.b.c": 1, "a.b.d": b"\x01", "e": "x", "e.f": 2, "e.f.g": 3}
    assert nested(values) == {"a": {"b": {"c": 1, "d": [1]}}, "e": "x", "e.f": 2, "e.f.g": 3}
    assert yaml.safe_load(yaml.safe_dump(nested(values))) == nested(values)
