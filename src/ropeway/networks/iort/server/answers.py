"""Makes the packets with which the server answers a node."""

from __future__ import annotations

from typing import Final

from ropeway.iort import NodeError, Packet, identifier_of, pack
from ropeway.networks.iort.space import MemberEndpoint
from ropeway.store import Entry

__all__ = ["OURS", "error_packet", "event_packet", "no_value", "plain_packet", "value_packet"]

OURS: Final = "00"
"""The identifier of the server."""


def error_packet(number: str, code: str, text: str) -> bytes:
    """Return an error, of the request ``number`` if there is one."""
    head = {"n": number, "code": code} if number else {"code": code}
    return pack(OURS, "-", "-", "+err", head, text.encode())


def value_packet(entry: Entry, text: bytes, *, latest: bool = False, number: str = "") -> bytes:
    """Return a value, written as ``text``; ``latest``: it was there before the node subscribed."""
    head: dict[str, object] = {"n": number} if number else {}
    head |= {"t": entry.stamp_ns, "v": entry.version, "o": entry.origin}
    if entry.type:
        head["k"] = entry.type
    if latest:
        head["last"] = 1
    return pack(OURS, entry.system, entry.topic, "+val", head, text)


def plain_packet(packet: Packet, entry: Entry, text: bytes) -> bytes:
    """Return a value as the answer to a plain request. Raises ``NodeError`` for what no plain packet can hold."""
    try:
        return pack(identifier_of(entry.origin), packet.system, packet.topic, "p", None, text, packet.system_type)
    except ValueError as error:
        raise NodeError("conversion", str(error)) from None


def event_packet(endpoint: MemberEndpoint, there: bool) -> bytes:
    """Return the news that a member began or ceased to publish or read."""
    head = {"kind": endpoint.kind, "here": int(there), "node": endpoint.node, "id": endpoint.id}
    if endpoint.type:
        head["k"] = endpoint.type
    if endpoint.qos:
        head["q"] = endpoint.qos
    return pack(OURS, endpoint.system, endpoint.topic, "+evt", head)


def no_value(packet: Packet, knows_system: bool) -> NodeError:
    """Return the error for a request for a value that nobody has."""
    if not knows_system:
        return NodeError("unknown-system", f"no value of the system {packet.system} is there")
    return NodeError("unknown-topic", f"no value of {packet.system}/{packet.topic} is there")
