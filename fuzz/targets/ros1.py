"""What ROS 1 peers send: XML-RPC bodies, headers and streams of TCPROS, and the messages of actions."""

from __future__ import annotations

import xmlrpc.client
from collections.abc import Sequence
from typing import Final, cast

from fuzz.target import Target
from ropeway.errors import DecodeError, InvalidFrame
from ropeway.networks.ros1 import action_wire, tcpros
from ropeway.networks.ros1 import xmlrpc as ours

__all__ = ["TARGETS"]


def _xml(data: bytes) -> None:
    ours._loads(data)


def _header(data: bytes) -> None:
    fields = tcpros.parse_header(data)
    assert sum(map(len, fields)) <= len(data) * 3


class _Transport:
    """Takes what a connection says, and notices that it closes."""

    def __init__(self) -> None:
        self.closing = False

    def is_closing(self) -> bool:
        return self.closing

    def close(self) -> None:
        self.closing = True

    abort = close

    def set_write_buffer_limits(self, high: int) -> None:
        pass

    def writelines(self, pieces: object) -> None:
        pass


class _Frames:
    """A receiver that keeps what comes."""

    def __init__(self) -> None:
        self.fields: dict[str, str] | None = None
        self.found: list[bytes] = []

    def made(self, connection: tcpros.TcprosConnection) -> None:
        pass

    def header(self, connection: tcpros.TcprosConnection, fields: dict[str, str]) -> None:
        self.fields = fields

    def frames(self, connection: tcpros.TcprosConnection, frames: Sequence[bytes]) -> None:
        self.found += frames

    def lost(self, connection: tcpros.TcprosConnection) -> None:
        pass

    writable = lost


def _read(pieces: Sequence[bytes]) -> tuple[dict[str, str] | None, list[bytes], bool]:
    receiver, transport = _Frames(), _Transport()
    connection = tcpros.TcprosConnection(receiver)
    connection.connection_made(cast("object", transport))  # type: ignore[arg-type]
    for piece in pieces:
        if not transport.closing:
            connection.data_received(piece)
    return receiver.fields, receiver.found, transport.closing


def _stream(data: bytes) -> None:
    """However a stream is cut, the same frames come of it."""
    step = 1 + data[0] % 7 if data else 1
    stream = data[1:]
    whole = _read([stream] if stream else [])
    cut = _read([stream[at : at + step] for at in range(0, len(stream), step)])
    assert (whole[0], whole[2]) == (cut[0], cut[2])
    assert whole[1] == cut[1] or whole[2]  # what came along with bytes that end a connection is lost with it


def _actions(data: bytes) -> None:
    for read in (action_wire.read_goal, action_wire.read_cancel, action_wire.read_report, action_wire.read_statuses):
        try:
            read(data)
        except DecodeError:
            continue


def _streams() -> list[bytes]:
    header = tcpros.encode_header({"topic": "/a", "md5sum": "*", "type": "std_msgs/String", "callerid": "/b"})
    return [b"\0" + header + b"\3\0\0\0abc\0\0\0\0"]


def _calls() -> list[bytes]:
    values = (("/a", {"x": [1, 2.5, True, None, b"\0", "t"]}),)
    call = xmlrpc.client.dumps(values, "publisherUpdate", allow_none=True)
    return [call.encode(), xmlrpc.client.dumps((1,), methodresponse=True).encode()]


TARGETS: Final = {
    "xml-rpc": Target(
        _xml,
        (ours._Malformed, ours.Fault),
        _calls,
        (
            b"<value>",
            b"<int>",
            b"<array><data>",
            b"<struct><member><name>",
            b"<base64>",
            b"<dateTime.iso8601>",
            b"<nil/>",
            b"<!DOCTYPE",
            b"&#x41;",
            b"<fault>",
            b"<methodResponse>",
            b"<bigdecimal>",
            b'encoding="utf-16"',
        ),
    ),
    "tcpros-headers": Target(_header, (InvalidFrame,), lambda: [_streams()[0][5:-11]], (b"\5\0\0\0", b"=")),
    "tcpros-streams": Target(_stream, (), _streams, (b"\5\0\0\0", b"=", b"\xff\xff\xff\xff")),
    "ros1-actions": Target(_actions, (), lambda: [bytes(64), bytes(12) + b"\1\0\0\0a" + bytes(40)], (b"\1\0\0\0",)),
}
