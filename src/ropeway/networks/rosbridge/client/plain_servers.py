"""Deals with servers that are not Ropeway gateways: which of them accept binary messages, and in which encoding.

A rosbridge server takes JSON; a binary frame ends its connection. rosgw takes what it calls ``compression``. Which
of the two a server is shows in the head of its answer, or, where that leaves it open, in what it does.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from typing import TYPE_CHECKING, Final

from ropeway.networks.rosbridge.protocol.codec import BINARY
from ropeway.networks.rosbridge.protocol.dialect import ROSBRIDGE, ROSGW, by_server

if TYPE_CHECKING:
    from ropeway.networks.rosbridge.link.channel import Channel
    from ropeway.networks.rosbridge.link.peer import Peer
    from ropeway.types import TypeRegistry
    from ropeway.types.definition import FieldType

__all__ = ["PlainServer", "rosgw_reads"]

log = logging.getLogger("ropeway.rosbridge")

_HANGS_UP_S: Final = 2.0  # a server that ends connections sooner, after a binary frame,
_HUNG_UP: Final = 2  # and so many times one after the other, gets JSON
_RAW: Final = {"none": "cbor-raw", "cbor": "cbor-raw", "zip": "rawzip"}


class PlainServer:
    """Remembers what is known of the server at the other end of a link, over all connections."""

    def __init__(self, name: str, registry: TypeRegistry) -> None:
        self._name, self._registry = name, registry
        self._json_only = self._hangs_up = False
        self._hung_up = 0
        self._said: set[str] = set()

    def greet(self, peer: Peer) -> None:
        """Learn from the answer of the server who it is."""
        known = by_server(peer.connection.server, dated=peer.connection.dated)
        self._json_only = self._hangs_up or known is ROSBRIDGE
        if known is ROSGW and not self._hangs_up:
            peer.speak(ROSGW)

    @property
    def is_rosbridge(self) -> bool:
        """Whether the server is known to be rosbridge, which takes JSON only."""
        return self._json_only

    def encoding(self, peer: Peer, topic: str, type: str, encoding: str) -> str:
        """Return the encoding in which a topic is published to the server, if ``encoding`` is configured.

        A server that may be either is taken for rosgw where a binary encoding is configured.
        """
        if self._json_only:
            if encoding in BINARY:
                self._say(f"{topic} goes there as JSON: a rosbridge server cannot take {encoding}")
            return "none"
        if encoding in ROSGW.publish and encoding != "none":
            peer.speak(ROSGW)
        if peer.dialect is not ROSGW:
            return "none"
        if encoding not in ROSGW.publish:
            return {"auto": "cbor-raw", "zstd": "rawzip"}.get(encoding, "none")
        if encoding in _RAW and self._registry.has(type) and not rosgw_reads(self._registry, type):
            raw = _RAW[encoding]
            self._say(f"{topic} goes there as {raw}: a rosgw gateway cannot take {type} as {encoding}")
            return raw
        return encoding

    def ended(self, peer: Peer, channels: Iterable[Channel], lasted_s: float) -> None:
        """Learn from the end of a connection: a server that hangs up whenever it gets a binary frame is rosbridge."""
        binary = any(channel.sent and channel.encoding in BINARY for channel in channels)
        if binary and peer.dialect is ROSGW and lasted_s < _HANGS_UP_S:
            self._hung_up += 1
            self._hangs_up = self._hung_up >= _HUNG_UP
        else:
            self._hung_up = 0

    def _say(self, sentence: str) -> None:
        if sentence not in self._said:
            self._said.add(sentence)
            log.warning("%s: %s", self._name, sentence)


def rosgw_reads(registry: TypeRegistry, type: str) -> bool:
    """Return whether rosgw can read messages of the type field by field; others end its connection, or
    arrive garbled.
    """
    names = (type, *registry.dependencies(type))
    return all(_reads(field.type) for name in names for field in registry.definition(name).fields)


def _reads(type: FieldType) -> bool:
    if type.kind == "array":
        return type.base == "float64"
    if type.kind == "sequence":
        return not type.size if type.is_message else type.base not in ("bool", "byte", "string", "wstring")
    return type.base != "byte"
