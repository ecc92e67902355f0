"""Defines what the gateway and its helper process say to each other: binary frames on a stream.

A frame is a length, what it is about (``Op``), the number of an endpoint, a number of the gateway's or the helper's
choice, and a body. Both sides write whole frames and read with a ``Splitter``.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Iterator
from typing import Final, NamedTuple

__all__ = ["HEAD_BYTES", "MAX_BODY_BYTES", "BadFrame", "HelperFrame", "Op", "Spec", "Splitter", "encode"]

MAX_BODY_BYTES: Final = 128 << 20
"""The largest body: far above what anybody sends through a service."""

_head = struct.Struct("<IBIQ")  # bytes of the body, op, endpoint, number
HEAD_BYTES: Final = _head.size
_COMPACT_BYTES: Final = 1 << 20


class Op(enum.IntEnum):
    """The subject of a frame: first what the gateway says, then what the helper does."""

    CONFIGURE = 1  # body: JSON
    OPEN_CLIENT = 2  # body: a ``Spec``
    OPEN_SERVICE = 3
    CLOSE = 4
    CALL = 5  # number: the call; body: CDR of the request
    REPLY = 6  # number: the request; body: CDR of the response
    FORGET = 7  # number: the call or request that needs no answer any more
    PING = 8
    EXPECT = 9  # body: GUIDs of endpoints that are to be found before services are opened

    READY = 16  # body: GUID of the participant
    UNFIT = 17  # body: why this machine cannot do it
    REFUSED = 18  # body: why the endpoint cannot be made
    MATCHED = 19  # number: how many serve what a client calls, or call what a service serves
    RESPONSE = 20  # number: the call; body: CDR of the response
    FAILED = 21  # number: the call; body: why it cannot be sent
    LOST = 22  # number: the call; body: why nobody will answer it
    REQUEST = 23  # number: the request; body: GUID of the caller's endpoint, sequence number (i64), CDR of the request
    DROPPED = 24  # number: how many; body: the name of an ``Undelivered``
    FAULTS = 25  # number: how many; body: what the hook could not do
    PONG = 26


class Spec(NamedTuple):
    """Describes an endpoint. The hashes are those of the messages, ``""`` where nobody knows them."""

    service: str
    type: str
    request_hash: str = ""
    response_hash: str = ""

    def encode(self) -> bytes:
        """Return the description as a body."""
        return "\0".join(self).encode()

    @classmethod
    def decode(cls, body: bytes) -> Spec:
        """Read the description from a body. Raises ``BadFrame``."""
        try:
            return cls(*body.decode().split("\0"))
        except (TypeError, UnicodeDecodeError):
            raise BadFrame(f"{len(body)} bytes do not describe an endpoint") from None


class HelperFrame(NamedTuple):
    """A frame. ``op`` is a number that may be no ``Op``."""

    op: int
    endpoint: int = 0
    number: int = 0
    body: bytes = b""


class BadFrame(Exception):
    """The stream is not made of frames."""


def encode(frame: HelperFrame) -> bytes:
    """Return the frame as bytes. Raises ``BadFrame`` for a body that is too long."""
    if len(frame.body) > MAX_BODY_BYTES:
        raise BadFrame(f"a body of {len(frame.body)} bytes; the limit is {MAX_BODY_BYTES}")
    return _head.pack(len(frame.body), frame.op, frame.endpoint, frame.number) + frame.body


class Splitter:
    """Cuts a stream into frames, however it arrives in pieces."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._at = 0

    def feed(self, data: bytes) -> Iterator[HelperFrame]:
        """Yield the frames that ``data`` completes. Raises ``BadFrame``."""
        self._data += data
        while len(self._data) - self._at >= HEAD_BYTES:
            length, op, endpoint, number = _head.unpack_from(self._data, self._at)
            if length > MAX_BODY_BYTES:
                raise BadFrame(f"a body of {length} bytes; the limit is {MAX_BODY_BYTES}")
            end = self._at + HEAD_BYTES + length
            if end > len(self._data):
                break
            body = bytes(self._data[self._at + HEAD_BYTES : end])
            self._at = end
            yield HelperFrame(op, endpoint, number, body)
        if self._at == len(self._data) or self._at >= _COMPACT_BYTES:
            del self._data[: self._at]
            self._at = 0
