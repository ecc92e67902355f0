"""Big-endian writers."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from ropeway.graph.base import Undelivered
from ropeway.networks.dds.byteorder import ByteOrder
from ropeway.qos import QoS
from ropeway.types import TypeRegistry
from tests.support.inbox import Inbox
from tests.support.messages import STRING, text
from tests.support.until import until

from .conftest import Join
from .helpers import DDS_STRING

REGISTRY = TypeRegistry()


def big(value: str) -> bytes:
    """A String as a big-endian machine sends it, relabelled as Cyclone DDS does."""
    raw = value.encode() + b"\0"
    return b"\0\1\0\0" + struct.pack(">I", len(raw)) + raw


def make(type: str = STRING) -> Any:
    """What gives the codec."""
    return lambda: REGISTRY.codec(type)


def test_little_endian_passes(caplog: pytest.LogCaptureFixture) -> None:
    """Messages of ordinary writers pass untouched, even later ones that make no sense."""
    order = ByteOrder("/t", make())
    payload = text("hello")
    assert order.native(b"w", payload) is payload
    assert order.native(b"w", b"\0\1\0\0nonsense") == b"\0\1\0\0nonsense"
    assert not caplog.records


def test_big_endian_is_turned_round(caplog: pytest.LogCaptureFixture) -> None:
    """All messages of a writer whose first one makes sense only big-endian are rewritten; others' are not."""
    order = ByteOrder("/t", make())
    assert order.native(b"w", big("hello")) == text("hello")
    assert order.native(b"w", big("again")) == text("again")
    assert order.native(b"v", text("hello")) == text("hello")
    assert len(caplog.records) == 1
    assert order.native(b"w", b"\0\1\0\0\xff\xff\xff\xff") is None


@pytest.mark.parametrize("type", ["no_such_pkg/msg/Thing", "geometry_msgs/msg/Twist"])
def test_what_cannot_be_told(type: str) -> None:
    """Types without lengths, and types that nobody defined, pass as they are."""
    payload = b"\0\1\0\0" + bytes(48)
    assert ByteOrder("/t", make(type)).native(b"w", payload) is payload


async def test_on_the_network(join: Join) -> None:
    """A graph with type definitions delivers a big-endian writer's messages readable."""
    near, far = await join("near"), await join("far", registry=REGISTRY)
    inbox = Inbox()
    await far.create_subscription("/t", STRING, QoS(), inbox)
    counts: list[int] = []
    writer = near.participant.create_writer(("rt/t", DDS_STRING), QoS(), b"", print, counts.append)
    await until(lambda: counts and counts[-1] == 1)
    raw = bytearray(big("hello"))
    raw[1] = 0  # Cyclone DDS relabels it
    writer.write(bytes(raw))
    await inbox.wait(1)
    assert inbox.payloads == [text("hello")]
    raw[4:8] = b"\xff\xff\xff\xff"
    writer.write(bytes(raw))
    writer.write(bytes([0, 0, 0, 0]) + big("again")[4:])
    await inbox.wait(2)
    await until(lambda: far.drops == {("/t", Undelivered.DECODE): 1})
