"""Big-endian messages."""

from __future__ import annotations

import random

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ropeway.errors import DecodeError
from ropeway.types.layout import Planner
from ropeway.types.stores import NEWEST
from ropeway.types.swap import to_little_endian

from .messages import MATRIX, probe_registry, random_message, rosbags_object

REGISTRY = probe_registry()
STORE = get_typestore(Stores[f"ROS2_{NEWEST.upper()}"])
PROBES = [name for name, text in MATRIX.items() if text and "wstring" not in text and name != "probe/msg/Constants"]
for _name in PROBES:
    if "Empty" not in MATRIX[_name]:
        STORE.register(get_types_from_msg(MATRIX[_name], _name))
NAMES = sorted(name for name in STORE.fielddefs if REGISTRY.codec(name).fields)


@pytest.mark.parametrize("name", NAMES)
def test_big_endian_is_read(name: str) -> None:
    """A big-endian message decodes to what its little-endian twin does."""
    codec = REGISTRY.codec(name)
    rng = random.Random(name)
    for _ in range(2):
        message = random_message(REGISTRY, name, rng)
        big = bytes(STORE.serialize_cdr(rosbags_object(REGISTRY, STORE, name, message), name, little_endian=False))
        little = codec.encode(message)
        assert codec.encode(codec.decode(big)) == little
        assert codec.json(big) == codec.json(little)


def test_wide_strings() -> None:
    """The characters of a wstring are turned round too."""
    codec = REGISTRY.codec("example_interfaces/WString")
    assert codec.decode(bytes.fromhex("00000000 00000002 00000068 00006f22")) == {"data": "h漢"}
    plan = Planner(REGISTRY.definition).plan("example_interfaces/msg/WString")
    swapped = to_little_endian(plan, bytes.fromhex("00000000 00000001 00000068"))
    assert swapped == bytes.fromhex("00010000 01000000 68000000")


def test_truncated() -> None:
    """A big-endian message that ends too early is a DecodeError."""
    for name in ("sensor_msgs/PointCloud2", "tf2_msgs/TFMessage", "probe/Long"):
        codec = REGISTRY.codec(name)
        for size in (0, 1, 3, 4, 5, 20):
            with pytest.raises(DecodeError):
                codec.decode(bytes(2) + b"\xff" * size)
