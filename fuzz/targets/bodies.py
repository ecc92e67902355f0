"""Bodies of messages in every encoding, and values of JSON and CBOR for every kind of field."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import cbor2
import orjson

from fuzz.target import Target
from fuzz.targets.nested import NESTED_CBOR, NESTED_JSON
from fuzz.targets.types import CODECS, chosen
from ropeway.errors import DecodeError, InvalidFrame, MessageTooBig, ValueMismatch
from ropeway.networks.rosbridge.protocol import codec as wire
from ropeway.types.untrusted import cbor_loads, json_loads

__all__ = ["TARGETS"]

_LIMIT_BYTES: Final = 1 << 20


def _bodies(data: bytes) -> None:
    """Codec and encoding by the first two bytes, then the body."""
    codec, number, body = chosen(data)
    encoding = wire.ENCODINGS[number % len(wire.ENCODINGS)]
    payload = wire.decode_msg(encoding, body, codec, limit_bytes=_LIMIT_BYTES)
    assert len(payload) <= max(_LIMIT_BYTES, 64 * len(data))


def _values(data: bytes) -> None:
    """A codec by the first byte, JSON or CBOR by the second, then the value of a publication or an argument."""
    codec, number, text = chosen(data)
    value = json_loads(text) if number & 1 else cbor_loads(text)
    compression = (None, "none", "cbor", "zip", "rawzip", "zstd", "cbor-raw", "x")[number >> 1 & 7]
    payload = wire.decode_value(value, compression, codec, limit_bytes=_LIMIT_BYTES)
    if payload[2:4] == b"\0\0" and isinstance(value, dict) and not (isinstance(value.get("bytes"), bytes)):
        codec.json(payload)  # what we wrote ourselves can be read


def _body_seeds() -> Iterator[bytes]:
    for index, codec in enumerate(CODECS):
        payload = codec.encode({})
        for number, encoding in enumerate(wire.ENCODINGS):
            yield bytes((index, number)) + wire.encode_msg(encoding, payload, codec)


def _value_seeds() -> Iterator[bytes]:
    yield from (b"\0\1" + value for value in NESTED_JSON)
    yield from (b"\0\0" + value for value in NESTED_CBOR)
    for index, codec in enumerate(CODECS):
        text = codec.json(codec.encode({}))
        yield bytes((index, 1)) + text
        yield bytes((index, 0)) + cbor2.dumps(codec.cbor(codec.encode({})))
        yield bytes((index, 2)) + cbor2.dumps(codec.rosgw(codec.encode({})))
        yield bytes((index, 8)) + cbor2.dumps(wire.encode_msg("rawzip", codec.encode({}), codec))
        yield bytes((index, 3)) + orjson.dumps(list(orjson.loads(text).values()))


TARGETS: Final = {
    "bodies": Target(_bodies, (DecodeError, ValueMismatch, MessageTooBig), _body_seeds),
    "values": Target(
        _values,
        (InvalidFrame, DecodeError, ValueMismatch, MessageTooBig),
        _value_seeds,
        (b"null", b"NaN", b"1e400", b'"now"', b"[]", b"{}", b'"\\ud83d"', b"AAEC", b'"secs"', b"\xd8\x55", b"\xf6"),
    ),
}
