"""ropeway.networks.iort.server.answers."""

from __future__ import annotations

import pytest

from ropeway.iort import NodeError, Packet, Parser
from ropeway.networks.iort.server.answers import error_packet, no_value, plain_packet, value_packet
from ropeway.store import Entry

ENTRY = Entry("PEPPER", "pose", b"1.0", version=3, stamp_ns=7, origin="01@robot:PEPPER")
REQUEST = Packet("01", "PEPPER", "pose", "s")


def parsed(raw: bytes) -> Packet:
    """Return the one packet in ``raw``."""
    (packet,) = Parser(1 << 20).feed(raw)
    assert isinstance(packet, Packet)
    return packet


def test_values_tell_time_version_and_origin() -> None:
    """A value says when, in which version and by whom it was written, and whose answer it is."""
    packet = parsed(value_packet(ENTRY, b"text", latest=True, number="5"))
    assert (packet.op, packet.system, packet.topic, packet.data) == ("+val", "PEPPER", "pose", b"text")
    assert packet.head == {"n": "5", "t": "7", "v": "3", "o": "01@robot:PEPPER", "last": "1"}


def test_plain_answers_carry_the_identifier_of_the_writer() -> None:
    """A plain answer begins with the digits of whoever wrote the value, and refuses what it cannot hold."""
    assert parsed(plain_packet(REQUEST, ENTRY, b"1.0")).id == "01"
    with pytest.raises(NodeError, match="percent"):
        plain_packet(REQUEST, ENTRY, b"100 %")


def test_errors_have_a_code() -> None:
    """What is not there is told apart by what is not known of it, and an error names its request."""
    assert no_value(REQUEST, knows_system=False).code == "unknown-system"
    assert no_value(REQUEST, knows_system=True).code == "unknown-topic"
    assert parsed(error_packet("9", "full", "no place")).head == {"n": "9", "code": "full"}
    assert parsed(error_packet("", "full", "no place")).head == {"code": "full"}
