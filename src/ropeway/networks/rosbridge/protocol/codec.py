"""Bodies of messages in the encodings of rosbridge, of the original ROS Gateway (rosgw) and between Ropeway gateways.

==========  ======  =============================================================================================
name        frames  body
==========  ======  =============================================================================================
none        text    JSON
png         text    the whole JSON operation as the pixels of a PNG
cbor        binary  CBOR of the message; typed arrays tagged by RFC 8746 (rosbridge) or as plain bytes (rosgw)
cbor-raw    binary  the CDR as it is; in a ``publish`` with the time at which it passed, ``{secs, nsecs, bytes}``
zip         binary  LZ4 frame of the CBOR
rawzip      binary  LZ4 frame of the CDR
zstd        binary  ``ropeway.delivery.compression.filters``; between Ropeway gateways only
==========  ======  =============================================================================================

A *frame* is a whole operation as it goes through a WebSocket, a *body* is only the message, as records carry it.
Payloads are CDR with its 4-byte header. What reads raises ``DecodeError`` for bytes that are malformed,
``ValueMismatch`` for values that do not fit the type, ``MessageTooBig`` for what would be above ``limit_bytes``
once it is unpacked, and nothing else.
"""

from __future__ import annotations

import binascii
import functools
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import cbor2
import lz4.frame
import orjson

from ropeway.delivery.compression import filters
from ropeway.errors import DecodeError, InvalidFrame, MessageTooBig
from ropeway.networks.rosbridge.protocol.dialect import ROSBRIDGE, Dialect
from ropeway.networks.rosbridge.protocol.frames import JsonAssembler
from ropeway.networks.rosbridge.protocol.operations import Operation
from ropeway.networks.rosbridge.protocol.ops import dumps
from ropeway.types.cbor import dumps as cbor_dumps
from ropeway.types.untrusted import cbor_loads, json_loads

if TYPE_CHECKING:
    from ropeway.types import MessageCodec

__all__ = [
    "BINARY",
    "CBOR_RAW",
    "COPIED_BYTES",
    "ENCODINGS",
    "ENCODING_NUMBERS",
    "LIMIT_BYTES",
    "NEEDS_CODEC",
    "Frame",
    "JsonAssembler",
    "cbor_with_bytes",
    "decode_msg",
    "decode_publish_msg",
    "decode_value",
    "encode_msg",
    "encode_op",
    "encode_publish",
    "encode_value",
    "encoding_name",
    "unpack_png",
]

ENCODINGS: Final = ("none", "png", "cbor", "cbor-raw", "zip", "rawzip", "zstd")
"""All encodings; a record names one by its place here."""

BINARY: Final = frozenset(("cbor", "cbor-raw", "zip", "rawzip", "zstd"))
"""The encodings whose frames are binary."""

NEEDS_CODEC: Final = frozenset(("none", "png", "cbor", "zip"))
"""The encodings that need the definition of the type; the others take any CDR."""

ENCODING_NUMBERS: Final = {name: number for number, name in enumerate(ENCODINGS)}
CBOR_RAW: Final = ENCODING_NUMBERS["cbor-raw"]

COPIED_BYTES: Final = 4096
"""Shorter payloads are copied: that takes less time than to decide."""

LIMIT_BYTES: Final = 64 << 20
"""The largest message that is unpacked unless told otherwise."""

_CDR: Final = b"\0\1"  # the representations that begin so: plain CDR, little-endian
_LZ4: Final = b"\x04\x22\x4d\x18"
_GROWTH_BYTES: Final = 1 << 20

Data = bytes | bytearray | memoryview


class Frame(NamedTuple):
    """A WebSocket frame."""

    text: bool
    data: bytes


def encoding_name(number: int) -> str:
    """Return the encoding that a record names. Raises ``DecodeError``."""
    if 0 <= number < len(ENCODINGS):
        return ENCODINGS[number]
    raise DecodeError("message", f"encoding {number}", "there is no such encoding")


# --- writing ----------------------------------------------------------------------------------------------------


def encode_publish(
    topic: str,
    payload: bytes,
    codec: MessageCodec | None,
    encoding: str,
    *,
    dialect: Dialect = ROSBRIDGE,
    stamp_ns: int,
) -> Frame:
    """Return the ``publish`` frame of a message.

    ``codec`` may be ``None`` for what is not in ``NEEDS_CODEC``; ``stamp_ns`` goes into cbor-raw. An encoding that
    nobody knows is none, as rosbridge has it. Raises ``DecodeError`` for a payload that is not of its type.
    """
    text_start, binary_edges = _SHORT if len(topic) < 256 else _LONG
    if encoding not in BINARY:
        text = b"".join((text_start(topic), _need(codec, encoding).json(payload), b"}"))
        return Frame(True, _png_frame(text) if encoding == "png" else text)
    named = dialect.names_compression or encoding not in ROSBRIDGE.subscribe
    start, end = binary_edges(topic, encoding if named else "")
    if encoding == "cbor-raw":
        payload = payload if codec is None else codec.raw(payload)
        seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
        times = cbor2.dumps(seconds), b"\x65nsecs", cbor2.dumps(nanoseconds)
        return Frame(False, b"".join((start, b"\xa3\x64secs", *times, b"\x65bytes", *_bytes(payload), end)))
    if encoding == "cbor":
        return Frame(False, b"".join((start, _cbor(payload, codec, dialect.tagged), end)))
    body = encode_msg(encoding, payload, codec, tagged=False, stamp_ns=stamp_ns)
    return Frame(False, b"".join((start, *_bytes(body), end)))


def _text_start(topic: str) -> bytes:
    return dumps({"op": "publish", "topic": topic, "msg": 0})[:-2]


def _binary_edges(topic: str, compression: str) -> tuple[bytes, bytes]:
    """Return what comes before and after the message in a CBOR frame."""
    start = cbor2.dumps({"op": "publish", "topic": topic, "msg": None})[1:-1]
    if not compression:
        return b"\xa3" + start, b""
    return b"\xa4" + start, cbor2.dumps("compression") + cbor2.dumps(compression)


_LONG: Final = (_text_start, _binary_edges)
_SHORT: Final = (functools.lru_cache(4096)(_text_start), functools.lru_cache(4096)(_binary_edges))


def _bytes(data: bytes) -> tuple[bytes, bytes]:
    """Return a CBOR byte string, in two parts so that it is copied only once."""
    size = len(data)
    if size < 24:
        return bytes((0x40 + size,)), data
    for lead, width in ((0x58, 1), (0x59, 2), (0x5A, 4)):
        if size < 1 << 8 * width:
            return bytes((lead,)) + size.to_bytes(width, "big"), data
    return b"\x5b" + size.to_bytes(8, "big"), data


def _png_frame(text: bytes) -> bytes:
    return b'{"op":"png","data":"' + binascii.b2a_base64(_to_png(text), newline=False) + b'"}'


def _to_png(text: bytes) -> bytes:
    from ropeway.networks.rosbridge.protocol import png  # loads numpy, which the other encodings do without

    return png.pack(text)


def _of_png(image: bytes | memoryview, limit_bytes: int) -> bytes:
    from ropeway.networks.rosbridge.protocol import png

    return png.unpack(image, limit_bytes=limit_bytes)


def encode_msg(
    encoding: str,
    payload: bytes,
    codec: MessageCodec | None,
    *,
    stamp_ns: int = 0,
    type: str = "",
    tagged: bool = True,
) -> bytes:
    """Return the body of a message for a record.

    ``codec`` may be ``None`` for what is not in ``NEEDS_CODEC``; zstd then takes the name of the type from ``type``,
    and does without filters where there is neither. ``tagged`` tells how typed arrays stand in CBOR; ``stamp_ns``
    has no place in bodies. Raises ``DecodeError`` for a payload that is not of its type, ``ValueError`` for an
    encoding that does not exist.
    """
    if encoding == "cbor-raw":
        return payload
    if encoding == "zstd":
        return filters.encode(payload, codec.type if codec is not None else type)
    if encoding == "rawzip":
        return _lz4(payload)
    if encoding == "none":
        return _need(codec, encoding).json(payload)
    if encoding == "cbor":
        return _cbor(payload, codec, tagged)
    if encoding == "zip":
        return _lz4(_cbor(payload, codec, tagged))
    if encoding == "png":
        return _to_png(_need(codec, encoding).json(payload))
    raise ValueError(f"{encoding!r} is not an encoding; there are {', '.join(ENCODINGS)}")


def _lz4(data: bytes) -> bytes:
    # what rosgw's receivers were seen to get: blocks of 64 KiB, linked if several, content size, no checksums
    return lz4.frame.compress(  # type: ignore[no-any-return]
        data,
        compression_level=0,
        block_size=lz4.frame.BLOCKSIZE_MAX64KB,
        block_linked=True,
        content_checksum=False,
        block_checksum=False,
        store_size=True,
    )


def _cbor(payload: bytes, codec: MessageCodec | None, tagged: bool) -> bytes:
    codec = _need(codec, "cbor")
    return cbor_dumps(codec.cbor(payload) if tagged else codec.rosgw(payload))


def _need(codec: MessageCodec | None, encoding: str) -> MessageCodec:
    if codec is None:
        raise DecodeError("message", encoding, "the definition of its type is not known")
    return codec


def encode_value(
    payload: bytes,
    codec: MessageCodec | None,
    encoding: str = "none",
    *,
    dialect: Dialect = ROSBRIDGE,
    stamp_ns: int = 0,
) -> Any:
    """Return a message as the ``args``, ``values`` or ``msg`` of an operation that ``encode_op`` writes.

    Raises as ``encode_msg`` does; png has no values.
    """
    if encoding == "none":
        return orjson.Fragment(_need(codec, encoding).json(payload))
    if encoding == "cbor":
        return _need(codec, encoding).cbor(payload) if dialect.tagged else _need(codec, encoding).rosgw(payload)
    if encoding == "cbor-raw":
        seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
        return {"secs": seconds, "nsecs": nanoseconds, "bytes": payload if codec is None else codec.raw(payload)}
    if encoding == "png":
        raise ValueError("png is an encoding of whole operations")
    return encode_msg(encoding, payload, codec, tagged=dialect.tagged)


def encode_op(op: Operation | Mapping[str, Any], encoding: str = "none") -> Frame:
    """Return the frame of an operation whose body, if it has one, is in this encoding."""
    message = op.to_dict() if isinstance(op, Operation) else op
    if encoding in BINARY:
        return Frame(False, cbor_dumps(message))
    text = dumps(message)
    return Frame(True, _png_frame(text) if encoding == "png" else text)


def cbor_with_bytes(message: Mapping[str, Any], key: str, data: bytes) -> bytes:
    """Return the CBOR of a map with one more entry, a byte string, which is copied only once. At most 22
    other entries.
    """
    if len(data) < COPIED_BYTES:
        return cbor_dumps({**message, key: data})
    coded = cbor_dumps(message)
    return b"".join((bytes((coded[0] + 1,)), coded[1:], cbor2.dumps(key), *_bytes(data)))


# --- reading ----------------------------------------------------------------------------------------------------


def decode_msg(encoding: str, body: Data, codec: MessageCodec | None, *, limit_bytes: int = LIMIT_BYTES) -> bytes:
    """Return the payload of a body that ``encode_msg`` made; see the module for what it raises."""
    if len(body) > limit_bytes:
        raise MessageTooBig(len(body), limit_bytes)
    if encoding == "cbor-raw":
        return _cdr(bytes(body))
    if encoding == "zstd":
        return _cdr(filters.decode(body, limit_bytes))
    if encoding == "rawzip":
        return _cdr(_unlz4(body, limit_bytes))
    codec = _need(codec, encoding)
    try:
        if encoding == "none":
            return codec.from_json(json_loads(body))
        if encoding == "cbor":
            return codec.from_cbor(cbor_loads(body))
        if encoding == "zip":
            return codec.from_cbor(cbor_loads(_unlz4(body, limit_bytes)))
        if encoding == "png":
            return codec.from_json(json_loads(_of_png(memoryview(body), limit_bytes)))
    except InvalidFrame as error:
        raise DecodeError(codec.type, encoding, error.reason) from None
    raise DecodeError(codec.type, encoding, "there is no such encoding")


def decode_publish_msg(
    msg: Any, compression: str | None, codec: MessageCodec | None, *, limit_bytes: int = LIMIT_BYTES
) -> bytes:
    """Return the payload in the ``msg`` of a received ``publish``, as parsed from JSON or CBOR.

    What ``msg`` looks like decides, ``compression`` only where that leaves a choice; senders may leave it out.
    Raw bytes are taken apart once where ``codec`` is there, so that nothing is passed on that is not of its type.
    See the module for what it raises.
    """
    if isinstance(msg, Mapping):
        raw = msg.get("bytes")
        if (
            isinstance(raw, bytes)
            and "secs" in msg
            and "nsecs" in msg
            and len(msg) == 3
            and not _has_fields(codec, msg)
        ):
            return _from_raw(raw, codec)
        return _need(codec, compression or "none").from_json(msg)  # takes CBOR's arrays too, tagged or not
    if not isinstance(msg, (bytes, bytearray, memoryview)):
        raise DecodeError(codec.type if codec else "message", compression or "none", "neither an object nor bytes")
    if compression == "zstd":
        return decode_msg("zstd", msg, codec, limit_bytes=limit_bytes)
    if bytes(msg[:4]) == _LZ4:
        content = _unlz4(msg, limit_bytes)
        if compression == "zip" or (compression != "rawzip" and content[:2] != _CDR):
            return decode_msg("cbor", content, codec, limit_bytes=limit_bytes)
        return _from_raw(content, codec)
    if len(msg) > limit_bytes:
        raise MessageTooBig(len(msg), limit_bytes)
    return _from_raw(bytes(msg), codec)


def _has_fields(codec: MessageCodec | None, msg: Mapping[Any, Any]) -> bool:
    return codec is not None and set(codec.fields) == set(msg)


def decode_value(
    value: Any, compression: str | None, codec: MessageCodec | None, *, limit_bytes: int = LIMIT_BYTES
) -> bytes:
    """Return the payload in the ``args`` or ``values`` of a received operation.

    As ``decode_publish_msg``; besides, a list gives the fields in order, superfluous ones ignored, and nothing
    stands for an empty message.
    """
    if (
        value.__class__ is bytes
        and value[:2] == _CDR
        and compression != "zstd"
        and codec is not None
        and codec.variant == "ros2"
        and len(value) <= limit_bytes
    ):
        return codec.fitting(value)
    if value is None:
        value = {}
    elif isinstance(value, (list, tuple)):
        value = dict(zip(_need(codec, compression or "none").fields, value, strict=False))
    return decode_publish_msg(value, compression, codec, limit_bytes=limit_bytes)


def unpack_png(data: str, *, limit_bytes: int = LIMIT_BYTES) -> bytes:
    """Return the JSON text in the ``data`` of a ``png`` operation. Raises ``DecodeError``, ``MessageTooBig``."""
    try:
        image = binascii.a2b_base64(data)
    except ValueError as error:
        raise DecodeError("message", "png", str(error)) from None
    return _of_png(image, limit_bytes)


def _from_raw(raw: bytes, codec: MessageCodec | None) -> bytes:
    """Return the payload in raw bytes that came with an operation."""
    if codec is None:
        return _cdr(raw)
    return codec.from_raw(raw if codec.variant != "ros2" else _cdr(raw))


def _cdr(payload: bytes) -> bytes:
    if len(payload) < 4 or payload[:2] != _CDR:
        raise DecodeError("message", "CDR", "it does not begin with the header 00 01 of little-endian CDR")
    return payload


def _unlz4(data: Data, limit_bytes: int) -> bytes:
    try:
        stated = lz4.frame.get_frame_info(data)["content_size"]
        if stated > limit_bytes:
            raise MessageTooBig(stated, limit_bytes)
        decompressor = lz4.frame.LZ4FrameDecompressor()
        content: bytes = decompressor.decompress(data, max_length=stated or _GROWTH_BYTES)
        if not decompressor.eof:
            content = _unlz4_on(decompressor, content, limit_bytes)
    except (RuntimeError, ValueError, EOFError) as error:
        raise DecodeError("message", "LZ4", str(error)) from None
    if decompressor.unused_data:
        raise DecodeError("message", "LZ4", f"{len(decompressor.unused_data)} bytes follow its end")
    return content


def _unlz4_on(decompressor: lz4.frame.LZ4FrameDecompressor, content: bytes, limit_bytes: int) -> bytes:
    """Return the rest of a frame that does not state its size."""
    parts = [content]
    size = len(content)
    while not decompressor.eof:
        part: bytes = b"" if decompressor.needs_input else decompressor.decompress(b"", max_length=_GROWTH_BYTES)
        if not part and not decompressor.eof:
            raise DecodeError("message", "LZ4", "it is cut off")
        parts.append(part)
        size += len(part)
        if size > limit_bytes:
            raise MessageTooBig(size, limit_bytes)
    return b"".join(parts)
