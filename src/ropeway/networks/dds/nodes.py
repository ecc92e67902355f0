"""``ros_discovery_info``: by which participants of ROS 2 tell their nodes, and which endpoints are whose.

One message per participant: its gid, and for each node namespace, name, gids of readers and gids of writers.
A gid has 16 bytes from ROS 2 Iron on and 24 before, so ``parse`` tells which one it met.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

__all__ = ["GID_BYTES", "OLD_GID_BYTES", "NodeEntities", "ParticipantEntities", "encode", "full_name", "parse"]

GID_BYTES: Final = 16
OLD_GID_BYTES: Final = 24
_GUID_BYTES: Final = 16
_MAX_NAME_BYTES: Final = 256
_MAX_PADDING: Final = 3


@dataclass(frozen=True, slots=True)
class NodeEntities:
    """A node: its full name, and the GUIDs of its readers and writers."""

    name: str
    readers: tuple[bytes, ...] = ()
    writers: tuple[bytes, ...] = ()


@dataclass(frozen=True, slots=True)
class ParticipantEntities:
    """The nodes of one participant; ``gid_bytes`` is the size of the gids on the wire."""

    guid: bytes
    nodes: tuple[NodeEntities, ...]
    gid_bytes: int = GID_BYTES


def full_name(namespace: str, name: str) -> str:
    """Return the absolute name of a node."""
    return f"{namespace.rstrip('/')}/{name}"


def parse(payload: bytes) -> ParticipantEntities | None:
    """Parse a message (CDR with its header); ``None`` for other bytes."""
    for gid_bytes in (GID_BYTES, OLD_GID_BYTES):
        try:
            return _Reader(payload, gid_bytes).message()
        except (ValueError, struct.error):
            continue
    return None


def encode(entities: ParticipantEntities) -> bytes:
    """Return the message as CDR with its header."""
    size = entities.gid_bytes
    parts = [b"\0\1\0\0", entities.guid.ljust(size, b"\0"), struct.pack("<I", len(entities.nodes))]
    for node in entities.nodes:
        namespace, _, name = node.name.rpartition("/")
        parts += [_string(namespace or "/"), _string(name), _gids(node.readers, size), _gids(node.writers, size)]
    return b"".join(parts)


def _string(text: str) -> bytes:
    raw = text.encode() + b"\0"
    return struct.pack("<I", len(raw)) + raw + bytes(-len(raw) % 4)


def _gids(guids: Iterable[bytes], size: int) -> bytes:
    padded = [guid.ljust(size, b"\0") for guid in guids]
    return struct.pack("<I", len(padded)) + b"".join(padded)


class _Reader:
    """Reads a message with gids of one size, once; raises ``ValueError`` if it does not fit."""

    def __init__(self, payload: bytes, gid_bytes: int) -> None:
        if payload[:2] not in (b"\0\1", b"\0\0"):
            raise ValueError("no CDR")
        self._data = memoryview(payload)[4:]
        self._order = "<" if payload[1] == 1 else ">"
        self._gid_bytes = gid_bytes
        self._at = 0

    def message(self) -> ParticipantEntities:
        guid = self._gid()
        # Two empty strings and two empty sequences make the smallest node.
        nodes = tuple(self._node() for _ in range(self._count(24)))
        if len(self._data) - self._at > _MAX_PADDING:
            raise ValueError("bytes left over")
        return ParticipantEntities(guid, nodes, self._gid_bytes)

    def _node(self) -> NodeEntities:
        namespace, name = self._string(), self._string()
        readers = tuple(self._gid() for _ in range(self._count(self._gid_bytes)))
        writers = tuple(self._gid() for _ in range(self._count(self._gid_bytes)))
        return NodeEntities(full_name(namespace, name), readers, writers)

    def _take(self, size: int) -> memoryview:
        end = self._at + size
        if end > len(self._data):
            raise ValueError("too short")
        taken = self._data[self._at : end]
        self._at = end
        return taken

    def _count(self, item_bytes: int) -> int:
        self._at += -self._at % 4
        (count,) = struct.unpack(self._order + "I", self._take(4))
        if count * item_bytes > len(self._data) - self._at + item_bytes:
            raise ValueError("count beyond the message")
        return int(count)

    def _gid(self) -> bytes:
        return bytes(self._take(self._gid_bytes)[:_GUID_BYTES])

    def _string(self) -> str:
        size = self._count(1)
        raw = bytes(self._take(size))
        if not 1 <= size <= _MAX_NAME_BYTES + 1 or raw[-1] != 0 or 0 in raw[:-1]:
            raise ValueError("no text")
        return raw[:-1].decode("utf-8")
