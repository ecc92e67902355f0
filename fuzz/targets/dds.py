"""What other participants of DDS send that Ropeway reads itself."""

from __future__ import annotations

from typing import Final

from fuzz.target import Target
from ropeway.networks.dds import nodes, rpc
from ropeway.networks.dds.fastdds import identity

__all__ = ["TARGETS"]


def _participants(data: bytes) -> None:
    found = nodes.parse(data)
    if found is not None and not any("//" in node.name for node in found.nodes):
        assert nodes.parse(nodes.encode(found)) == found


def _rtps(data: bytes) -> None:
    identity.parse(data[:20], data[20:])


def _request(data: bytes) -> None:
    found = rpc.split(data)
    if found is not None:
        rpc.join(found.header, found.payload)


def _nodes() -> list[bytes]:
    guid = bytes(range(16))
    node = nodes.NodeEntities("/ns/name", (guid,), (guid, guid))
    return [nodes.encode(nodes.ParticipantEntities(guid, (node, node), size)) for size in (16, 24)]


def _submessages() -> list[bytes]:
    header = b"RTPS\2\3\1\x0f" + bytes(12)
    related = b"\x1d\x80\x18\x00" + bytes(24) + b"\1\0\0\0"
    return [header + b"\x15\7\0\0\0\0\x10\0" + bytes(16) + related + b"\0\1\0\0", header + b"\x16\1" + bytes(40)]


TARGETS: Final = {
    "participants": Target(_participants, (), _nodes, (b"\1\0\0\0", b"\xff\xff\xff\xff")),
    "rtps": Target(_rtps, (), _submessages, (b"\x1d\x80\x18\x00", b"\x0f\x80")),
    "requests": Target(_request, (), lambda: [b"\0\1\0\0" + bytes(7) + b"\1" + bytes(12), b"\0\0\0\0" + bytes(24)]),
}
