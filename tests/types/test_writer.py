"""What generated writers take."""

from __future__ import annotations

from collections import OrderedDict
from types import MappingProxyType

import pytest

from ropeway.types.layout import Planner
from ropeway.types.values import Misfit
from ropeway.types.writer import FAILURES, make_writer

from .messages import probe_registry

REGISTRY = probe_registry()
WRITE = make_writer(Planner(REGISTRY.definition).plan("geometry_msgs/msg/TwistStamped"))


def write(value: object) -> bytes:
    """What a writer makes of a value."""
    out: list[bytes] = []
    assert WRITE(value, out, 0) == sum(map(len, out))
    return b"".join(out)


def test_any_mapping_is_a_message() -> None:
    """Messages may be any kind of mapping."""
    plain = write({"header": {"frame_id": "f"}, "twist": {"linear": {"x": 1.0}}})
    assert write(OrderedDict(header=MappingProxyType({"frame_id": "f"}), twist={"linear": OrderedDict(x=1)})) == plain


def test_missing_fields_are_zero() -> None:
    """An empty dict is the message with all fields at their defaults."""
    assert write({}) == write({"header": {}, "twist": {"linear": {}, "angular": {}}})


@pytest.mark.parametrize(
    "value",
    [
        None,
        5,
        {"header": None},
        {"twist": []},
        {"more": 1},
        {"header": {"stamp": {"sec": "1"}}},
        {"header": {"frame_id": b"f"}},
        {"twist": {"linear": {"x": "1"}}},
        {"header": {"stamp": {"nanosec": -1}}},
        {"twist": {"linear": {"x": 10**400}}},
    ],
)
def test_misfits_fail(value: object) -> None:
    """A value that does not fit makes a writer fail, never write something else."""
    with pytest.raises(FAILURES):
        write(value)


def test_lengths_and_order_of_loops() -> None:
    """Sequences are written with their number of elements, tuples as well as lists."""
    codec = REGISTRY.codec("probe/msg/Sequences")
    assert codec.encode({"inners": ({"a": 1}, {"a": 2}), "string_values": ("x", "y")}) == codec.encode(
        {"inners": [{"a": 1}, {"a": 2}], "string_values": ["x", "y"]}
    )
    with pytest.raises(Misfit):
        make_writer(Planner(REGISTRY.definition).plan("probe/msg/Sequences"))({"inners": "ab"}, [], 0)
