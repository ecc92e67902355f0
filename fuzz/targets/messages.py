"""Messages as DDS and ROS 1 carry them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import cbor2
import orjson

from fuzz.target import Target
from fuzz.targets.types import CODECS, chosen
from ropeway.errors import DecodeError
from ropeway.types.cbor import dumps

__all__ = ["TARGETS"]


def _cdr(data: bytes) -> None:
    """A codec by the first byte, then the message; what is read is written again to the same bytes."""
    codec, _, payload = chosen(data)
    codec.header_stamp_ns(payload)
    message = codec.decode(payload)
    orjson.loads(codec.json(payload))
    cbor2.loads(dumps(codec.cbor(payload)))
    codec.rosgw(payload)
    written = codec.encode(message)
    assert codec.encode(codec.decode(written)) == written
    codec.from_ros1(codec.ros1(payload))


def _ros1(data: bytes) -> None:
    codec, _, payload = chosen(data)
    written = codec.from_ros1(payload)
    assert codec.from_ros1(codec.ros1(written)) == written


def _full(index: int) -> bytes:
    codec = CODECS[index]
    message = codec.default()
    for name, value in message.items():
        if isinstance(value, str):
            message[name] = "abc"
        elif isinstance(value, bytes) and not value:
            message[name] = b"\1\2\3"
    return codec.encode(message)


def _cdr_seeds() -> Iterator[bytes]:
    for index in range(len(CODECS)):
        yield bytes((index, 0)) + _full(index)
        yield bytes((index, 0, 0, 0)) + _full(index)[2:]


def _ros1_seeds() -> Iterator[bytes]:
    for index, codec in enumerate(CODECS):
        yield bytes((index, 0)) + codec.ros1(_full(index))


TARGETS: Final = {
    "cdr": Target(_cdr, (DecodeError,), _cdr_seeds, (b"\0\0\0\1", b"\1\0\0\0", b"\xff\xff\xff\xff")),
    "ros1-messages": Target(
        _ros1,
        (DecodeError,),
        _ros1_seeds,
        (b"\1\0\0\0", b"\xff\xff\xff\xff", b"\xff\xff\0\0"),
        memory_bytes=24 << 20,  # messages without fields, which take no bytes, may be 65,536
    ),
}
