"""ropeway.networks.zenoh.hashed_layouts: each message has the layout of the hash in its key."""

from __future__ import annotations

import pytest

from ropeway.errors import TypesError
from ropeway.graph.layout_border import Border
from ropeway.networks.zenoh.hashed_layouts import HashedLayouts
from ropeway.networks.zenoh.tokens import NO_HASH
from ropeway.types import TypeRegistry
from tests.support.messages import STRING, text

_CHANGED = "sensor_msgs/msg/Range"  # has one field more since Iron


def test_own_hash() -> None:
    """The hash of a message or service is that of ROS 2; nobody's for a type that is not known."""
    layouts = HashedLayouts(Border(TypeRegistry()))
    assert layouts.own_hash(STRING) == "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    assert layouts.own_hash("example_interfaces/srv/AddTwoInts") == (
        "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
    )
    assert layouts.own_hash("no_such/msg/Type") == NO_HASH


def test_untouched() -> None:
    """A message whose type is the same everywhere is passed on as the object that it is."""
    layouts = HashedLayouts(Border(TypeRegistry()))
    payload = text("hello")
    assert layouts.read(STRING, payload, "RIHS01_whatever") is payload
    assert layouts.write(STRING, payload, NO_HASH) is payload


def test_other_distribution() -> None:
    """A message under the hash of another distribution is translated in both directions."""
    ours = TypeRegistry()
    layouts = HashedLayouts(Border(ours))
    assert ours.others is not None
    humble = ours.others.variant("humble")
    there, here = humble.codec(_CHANGED), ours.codec(_CHANGED)
    value = there.default() | {"range": 1.5}
    came = layouts.read(_CHANGED, there.encode(value), humble.hash(_CHANGED))
    assert here.decode(came)["range"] == 1.5
    assert layouts.write(_CHANGED, came, humble.hash(_CHANGED)) == there.encode(value)
    assert layouts.write(_CHANGED, came, ours.hash(_CHANGED)) == came


def test_without_hashes() -> None:
    """A message of a node without type hashes has the layout of Humble."""
    ours = TypeRegistry()
    assert ours.others is not None
    humble = ours.others.variant("humble").codec(_CHANGED)
    value = humble.default() | {"range": 1.5}
    came = HashedLayouts(Border(ours)).read(_CHANGED, humble.encode(value), NO_HASH)
    assert ours.codec(_CHANGED).decode(came)["range"] == 1.5


def test_big_endian() -> None:
    """A message of a big-endian machine comes in our byte order; one that cannot be read is refused."""
    layouts = HashedLayouts(Border(TypeRegistry()))
    assert layouts.read(STRING, b"\0\0\0\0\0\0\0\3hi\0", NO_HASH) == b"\0\1\0\0\3\0\0\0hi\0"
    with pytest.raises(TypesError):
        layouts.read(STRING, b"\0\0\0\0\xff\xff\xff\xff", NO_HASH)
