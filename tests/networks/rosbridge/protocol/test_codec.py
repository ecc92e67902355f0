from __future__ import annotations

import json
import math
import os
import struct
from contextlib import suppress
from typing import Any

import cbor2
import lz4.frame
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ropeway.errors import DecodeError, MessageTooBig, TypesError, ValueMismatch
from ropeway.networks.rosbridge.protocol import codec as wire_codec
from ropeway.networks.rosbridge.protocol import ops, png
from ropeway.networks.rosbridge.protocol.codec import (
    BINARY,
    ENCODING_NUMBERS,
    ENCODINGS,
    decode_msg,
    decode_publish_msg,
    decode_value,
    encode_msg,
    encode_op,
    encode_publish,
    encode_value,
    encoding_name,
    unpack_png,
)
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY, ROSBRIDGE, ROSGW, Dialect
from ropeway.networks.rosbridge.protocol.frames import loads
from ropeway.types import MessageCodec, TypeRegistry

from .conftest import Recorded

HELLO = bytes.fromhex("00010000 06000000 68656c6c6f00")
STAMP_NS = 1_000_000_002
TOPICS = {
    "/camera/color/image_raw": "sensor_msgs/msg/Image",
    "/camera/depth/image_rect_raw": "sensor_msgs/msg/Image",
    "/camera/color/image_raw/compressed": "sensor_msgs/msg/CompressedImage",
    "/lidar/points": "sensor_msgs/msg/PointCloud2",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/imu/data": "sensor_msgs/msg/Imu",
    "/odom": "nav_msgs/msg/Odometry",
}

# std_msgs/String "hello" on /t, stamp 1 s 2 ns: whole frames, as the original programs made them
ROSGW_FRAMES = {
    "none": b'{"op":"publish","topic":"/t","msg":{"data":"hello"}}',
    "cbor": bytes.fromhex(
        "a4 626f70 677075626c697368 65746f706963 622f74 636d7367 a1 6464617461 6568656c6c6f"
        "6b636f6d7072657373696f6e 6463626f72"
    ),
    "cbor-raw": bytes.fromhex(
        "a4 626f70 677075626c697368 65746f706963 622f74 636d7367"
        "a3 6473656373 01 656e73656373 02 656279746573 4e 00010000 06000000 68656c6c6f00"
        "6b636f6d7072657373696f6e 6863626f722d726177"
    ),
    "zip": bytes.fromhex(
        "a4 626f70 677075626c697368 65746f706963 622f74 636d7367 5823"
        "04224d18 68 40 0c00000000000000 5d 0c000080 a1 6464617461 6568656c6c6f 00000000"
        "6b636f6d7072657373696f6e 637a6970"
    ),
    "rawzip": bytes.fromhex(
        "a4 626f70 677075626c697368 65746f706963 622f74 636d7367 5825"
        "04224d18 68 40 0e00000000000000 c2 0e000080 00010000 06000000 68656c6c6f00 00000000"
        "6b636f6d7072657373696f6e 667261777a6970"
    ),
}
ROSBRIDGE_FRAMES = {
    "none": b'{"op":"publish","topic":"/a_topic","msg":{"data":"hello"}}',
    "nonsense": b'{"op":"publish","topic":"/a_topic","msg":{"data":"hello"}}',
    "cbor": bytes.fromhex("a3626f70677075626c69736865746f706963682f615f746f706963636d7367a164646174616568656c6c6f"),
    "cbor-raw": bytes.fromhex(
        "a3 626f70 677075626c697368 65746f706963 682f615f746f706963 636d7367"
        "a3 6473656373 1a6553f100 656e73656373 05 656279746573 4e 000100000600000068656c6c6f00"
    ),
}


@pytest.mark.parametrize("encoding", ROSGW_FRAMES)
def test_frames_are_those_of_rosgw(encoding: str, string: MessageCodec) -> None:
    """A publish in the rosgw dialect is the original's byte by byte, LZ4 frames included."""
    frame = encode_publish("/t", HELLO, string, encoding, dialect=ROSGW, stamp_ns=STAMP_NS)
    assert frame == (encoding not in BINARY, ROSGW_FRAMES[encoding])
    assert len(frame.data) == {"none": 52, "cbor": 54, "cbor-raw": 81, "zip": 78, "rawzip": 83}[encoding]


@pytest.mark.parametrize("encoding", ROSBRIDGE_FRAMES)
def test_frames_are_those_of_rosbridge(encoding: str, string: MessageCodec) -> None:
    """A publish in the rosbridge dialect is its server's byte by byte; an unknown encoding is none."""
    stamp_ns = 0x6553F100 * 10**9 + 5
    frame = encode_publish("/a_topic", HELLO, string, encoding, dialect=ROSBRIDGE, stamp_ns=stamp_ns)
    assert frame == (encoding not in BINARY, ROSBRIDGE_FRAMES[encoding])


def test_a_png_frame_holds_the_whole_operation(string: MessageCodec) -> None:
    """A png operation is a text frame whose pixels are the publish operation."""
    frame = encode_publish("/t", HELLO, string, "png", stamp_ns=0)
    assert frame.text
    (message,) = loads(frame.data, text=True)
    assert list(message) == ["op", "data"]
    assert unpack_png(message["data"]) == ROSGW_FRAMES["none"]
    for wrong in ("", "a", "é", "AAAA"):
        with pytest.raises(DecodeError):
            unpack_png(wrong)
    with pytest.raises(MessageTooBig):
        unpack_png(message["data"], limit_bytes=10)


def test_typed_arrays_are_tagged_for_rosbridge_and_bare_for_rosgw(registry: TypeRegistry) -> None:
    """Arrays of numbers carry RFC 8746 tags for rosbridge and are byte strings for rosgw."""
    codec = registry.codec("std_msgs/msg/Float32MultiArray")
    payload = codec.encode({"data": [1.0, math.nan]})
    raw = struct.pack("<ff", 1.0, math.nan)
    for encoding, dialect, expected in (
        ("cbor", ROSBRIDGE, cbor2.CBORTag(85, raw)),
        ("cbor", ROPEWAY, cbor2.CBORTag(85, raw)),
        ("cbor", ROSGW, raw),
        ("zip", ROSGW, raw),
    ):
        (message,) = loads(encode_publish("/t", payload, codec, encoding, dialect=dialect, stamp_ns=0).data, text=False)
        msg = message["msg"] if encoding == "cbor" else cbor2.loads(lz4.frame.decompress(message["msg"]))
        assert msg["data"] == expected


def test_long_names_are_no_problem(string: MessageCodec) -> None:
    """A topic's name may have any length."""
    topic = "/" + "x" * 100_000
    for encoding in ("none", "cbor-raw"):
        frame = encode_publish(topic, HELLO, string, encoding, stamp_ns=0)
        assert loads(frame.data, text=frame.text)[0]["topic"] == topic


def test_lz4_frames_have_the_parameters_of_rosgw() -> None:
    """Content size, blocks of 64 KiB, linked if there are several, no checksums."""
    payload = HELLO[:4] + os.urandom(100) * 2000
    body = encode_msg("rawzip", payload, None)
    assert body[:6] == bytes.fromhex("04224d18 4840")
    assert struct.unpack_from("<Q", body, 6) == (len(payload),)
    assert body == lz4.frame.compress(payload)


@pytest.mark.parametrize("dialect", [ROSBRIDGE, ROSGW, ROPEWAY], ids=str)
@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("size", [0, 5, 23, 24, 255, 256, 65_535, 65_536, 300_000])
def test_messages_of_every_size_come_back(string: MessageCodec, dialect: Dialect, encoding: str, size: int) -> None:
    """A publish of any size, in any encoding and dialect, gives the payload back, whether named or not."""
    payload = string.encode({"data": "é" * (size // 2)})
    frame = encode_publish("/é", payload, string, encoding, dialect=dialect, stamp_ns=STAMP_NS)
    (message,) = loads(frame.data, text=frame.text)
    if encoding == "png":
        (message,) = loads(unpack_png(message["data"]), text=True)
    op = ops.parse(message)
    assert isinstance(op, ops.Publish)
    assert op.topic == "/é"
    assert op.compression in (None, encoding)
    assert decode_publish_msg(op.msg, encoding, string) == payload
    if encoding != "zstd":
        assert decode_publish_msg(op.msg, None, string) == payload
    if encoding in BINARY:
        length = len(encode_msg(encoding, payload, string, tagged=dialect.tagged))
        assert len(frame.data) - length <= 100
        assert frame.data == cbor2.dumps(message)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_bodies_of_records_come_back(string: MessageCodec, encoding: str) -> None:
    """encode_msg and decode_msg are each other's inverse; what needs no definition works without."""
    body = encode_msg(encoding, HELLO, string, stamp_ns=STAMP_NS)
    assert decode_msg(encoding, body, string) == HELLO
    assert decode_msg(encoding, memoryview(body), string) == HELLO
    if encoding in wire_codec.NEEDS_CODEC:
        for call in (encode_msg, decode_msg):
            with pytest.raises(DecodeError, match="definition"):
                call(encoding, body, None)
    else:
        assert encode_msg(encoding, HELLO, None) == body
        assert decode_msg(encoding, body, None) == HELLO


@pytest.mark.data
@pytest.mark.parametrize("topic", TOPICS)
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_recordings_come_back_bit_by_bit(recorded: Recorded, registry: TypeRegistry, topic: str, encoding: str) -> None:
    """Every recorded message survives every encoding unchanged; JSON only loses what is not finite."""
    codec = registry.codec(TOPICS[topic])
    payloads = recorded(topic, 3)
    assert payloads
    for payload in payloads:
        result = decode_msg(encoding, encode_msg(encoding, payload, codec), codec)
        if topic == "/scan" and encoding in ("none", "png"):
            before, after = (np.array(codec.decode(x)["ranges"]) for x in (payload, result))
            assert np.array_equal(np.where(np.isfinite(before), before, np.nan), after, equal_nan=True)
        else:
            assert result == payload


def test_an_image_is_filtered_by_the_name_of_its_type(registry: TypeRegistry) -> None:
    """Zstd needs no definition, only the name of the type."""
    codec = registry.codec("sensor_msgs/msg/Image")
    pixels = np.arange(90_000, dtype=np.uint32).astype(np.uint8).tobytes()
    payload = codec.encode({"height": 100, "width": 300, "encoding": "rgb8", "step": 900, "data": pixels})
    body = encode_msg("zstd", payload, codec)
    assert encode_msg("zstd", payload, None, type="sensor_msgs/msg/Image") == body
    assert encode_msg("zstd", payload, None) != body


def test_encodings_have_numbers() -> None:
    """A record names an encoding by a number; unknown ones raise DecodeError."""
    assert [encoding_name(ENCODING_NUMBERS[name]) for name in ENCODINGS] == list(ENCODINGS)
    assert encoding_name(wire_codec.CBOR_RAW) == "cbor-raw"
    for number in (-1, len(ENCODINGS), 255):
        with pytest.raises(DecodeError):
            encoding_name(number)
    with pytest.raises(ValueError, match="nonsense"):
        encode_msg("nonsense", HELLO, None)


def test_messages_are_told_by_their_shape(string: MessageCodec, registry: TypeRegistry) -> None:
    """What a publish holds is recognised whatever its compression says, or does not say."""
    msg = {"data": "hello"}
    raw = {"secs": 1, "nsecs": 2, "bytes": HELLO}
    for compression in (None, "none", "cbor", "cbor-raw", "zip", "png", "nonsense"):
        assert decode_publish_msg(msg, compression, string) == HELLO
        assert decode_publish_msg(raw, compression, string) == HELLO
        assert decode_publish_msg(HELLO, compression, string) == HELLO
    assert decode_publish_msg(raw, "cbor-raw", None) == HELLO
    for compression in (None, "rawzip", "zip"):
        assert decode_publish_msg(lz4.frame.compress(cbor2.dumps(msg)), "zip", string) == HELLO
        if compression != "zip":
            assert decode_publish_msg(lz4.frame.compress(HELLO), compression, None) == HELLO
    array = registry.codec("std_msgs/msg/Int16MultiArray")
    expected = array.encode({"data": [1, -2]})
    packed = struct.pack("<hh", 1, -2)
    for data in ([1, -2], packed, cbor2.CBORTag(77, packed)):
        for compression in (None, "cbor"):
            assert decode_publish_msg({"data": data}, compression, array) == expected


def test_arguments_may_be_a_list_or_nothing(registry: TypeRegistry) -> None:
    """Args of a service may be an object, the values of the fields in order, or nothing."""
    codec = registry.codec("example_interfaces/srv/AddTwoInts_Request")
    expected = codec.encode({"a": 1, "b": 2})
    assert decode_value({"a": 1, "b": 2}, None, codec) == expected
    assert decode_value([1, 2, 3], None, codec) == expected
    assert decode_value([1], None, codec) == codec.encode({"a": 1})
    assert decode_value(None, None, codec) == decode_value([], None, codec) == codec.encode({})
    with pytest.raises(ValueMismatch):
        decode_value(["x"], None, codec)


@pytest.mark.parametrize("dialect", [ROSBRIDGE, ROSGW], ids=str)
@pytest.mark.parametrize("encoding", [name for name in ENCODINGS if name != "png"])
def test_values_of_services_come_back(registry: TypeRegistry, dialect: Dialect, encoding: str) -> None:
    """Values go into an operation in every encoding and come back out of its frame."""
    codec = registry.codec("example_interfaces/srv/AddTwoInts_Response")
    payload = codec.encode({"sum": -3})
    value = encode_value(payload, codec, encoding, dialect=dialect, stamp_ns=STAMP_NS)
    frame = encode_op(
        ops.ServiceResponse(service="/s", values=value, result=True, id="1", compression=encoding), encoding
    )
    assert frame.text == (encoding not in BINARY)
    (message,) = loads(frame.data, text=frame.text)
    op = ops.parse(message)
    assert isinstance(op, ops.ServiceResponse)
    assert decode_value(op.values, op.compression, codec) == payload


def test_operations_go_out_as_json_or_png(string: MessageCodec) -> None:
    """encode_op writes JSON by default; png wraps it, and is no encoding of values."""
    op = ops.Unsubscribe(topic="/é")
    assert encode_op(op) == (True, b'{"op":"unsubscribe","topic":"/\\u00e9"}')
    assert encode_op(op.to_dict()) == encode_op(op)
    text, data = encode_op(op, "png")
    assert text
    assert unpack_png(json.loads(data)["data"]) == encode_op(op).data
    with pytest.raises(ValueError, match="png"):
        encode_value(HELLO, string, "png")


def lz4_of(size: int, **options: Any) -> bytes:
    """An LZ4 frame of zeros."""
    return bytes(lz4.frame.compress(bytes(size), **options))


def test_bombs_are_refused_before_they_unfold(string: MessageCodec) -> None:
    """What would be larger than the limit raises MessageTooBig, whether it states its size or not."""
    big = b"\0\1\0\0" + bytes(3_000_000)
    for encoding, body in {
        "cbor-raw": big,
        "rawzip": lz4.frame.compress(big),
        "zip": lz4_of(3_000_000),
        "zstd": encode_msg("zstd", big, None),
        "png": png.pack(b" " * 3_000_000),
        "none": b'{"data":"' + b" " * 3_000_000 + b'"}',
    }.items():
        with pytest.raises(MessageTooBig):
            decode_msg(encoding, body, string, limit_bytes=1_000_000)
    with pytest.raises(MessageTooBig):
        decode_msg("rawzip", lz4_of(3_000_000, store_size=False), None, limit_bytes=1_000_000)
    with pytest.raises(MessageTooBig):
        decode_publish_msg(lz4_of(3_000_000), None, string, limit_bytes=1_000_000)
    payload = b"\0\1\0\0" + bytes(2_500_000)
    body = lz4.frame.compress(payload, store_size=False)
    assert decode_msg("rawzip", body, None, limit_bytes=len(payload)) == payload


BAD_BODIES = [
    ("none", b""),
    ("none", b"{"),
    ("none", b'{"data":"\xff"}'),
    ("none", b'{"data":5}'),
    ("none", b'{"data":"x","more":1}'),
    ("none", b"[" * 10_000),
    ("none", b"5"),
    ("png", b""),
    ("png", b"\x89PNG\r\n\x1a\n"),
    ("cbor", b""),
    ("cbor", b"\xa1"),
    ("cbor", b"\x81" * 10_000),
    ("cbor", b"\xbb\x7f\xff\xff\xff\xff\xff\xff\xff"),
    ("cbor", cbor2.dumps({"data": 5})),
    ("cbor", cbor2.dumps([])),
    ("cbor-raw", b""),
    ("cbor-raw", b"\0\1\0"),
    ("cbor-raw", b"\0\0\0\0\0\0\0\0"),
    ("cbor-raw", b"\1\1\0\0"),
    ("zip", b""),
    ("zip", b"\x04\x22\x4d\x18"),
    ("zip", lz4.frame.compress(cbor2.dumps({"data": "x"}))[:-1]),
    ("zip", lz4.frame.compress(cbor2.dumps({"data": "x"})) + b"x"),
    ("zip", lz4.frame.compress(b"\xff")),
    ("zip", lz4.frame.compress(b"")),
    ("rawzip", b"garbage and more garbage"),
    ("rawzip", lz4.frame.compress(HELLO)[:-5]),
    ("rawzip", lz4.frame.compress(HELLO, store_size=False)[:-5]),
    ("rawzip", lz4.frame.compress(b"abc")),
    ("rawzip", lz4.frame.compress(b"")),
    ("rawzip", bytes.fromhex("502a4d1804000000aabbccdd")),
    ("zstd", b""),
    ("zstd", b"\0"),
    ("zstd", b"\1"),
    ("zstd", b"\xff"),
    ("nonsense", HELLO),
]


@pytest.mark.parametrize(("encoding", "body"), BAD_BODIES, ids=range(len(BAD_BODIES)))
def test_bad_bodies_raise_types_errors(string: MessageCodec, encoding: str, body: bytes) -> None:
    """Malformed bytes raise DecodeError, values that do not fit ValueMismatch."""
    with pytest.raises((DecodeError, ValueMismatch)):
        decode_msg(encoding, body, string)


def test_bad_messages_raise_types_errors(string: MessageCodec) -> None:
    """A msg that is neither object nor bytes, or the wrong ones, raises DecodeError or ValueMismatch."""
    for msg in (None, 5, "x", [], [HELLO], {"bytes": HELLO}, {"secs": 1, "nsecs": 2, "bytes": b"x"}, b"", b"xyz"):
        for compression in (None, "none", "cbor", "cbor-raw", "zip", "rawzip", "zstd"):
            with pytest.raises(TypesError):
                decode_publish_msg(msg, compression, string)
            with pytest.raises(TypesError):
                decode_publish_msg(msg, compression, None)


def mutated(bodies: list[bytes]) -> st.SearchStrategy[bytes]:
    """Good bodies with some bytes changed, cut or added."""

    def apply(body: bytes, changes: list[tuple[int, int]], cut: int, tail: bytes) -> bytes:
        data = bytearray(body)
        for at, value in changes:
            if data:
                data[at % len(data)] = value
        return bytes(data[: len(data) - cut % (len(data) + 1) if cut else None]) + tail

    return st.builds(
        apply,
        st.sampled_from(bodies),
        st.lists(st.tuples(st.integers(0, 10_000), st.integers(0, 255)), max_size=4),
        st.just(0) | st.integers(0, 100),
        st.just(b"") | st.binary(max_size=8),
    )


GOOD_BODIES = [encode_msg(name, HELLO + bytes(500), None) for name in ("cbor-raw", "rawzip", "zstd")] + [
    b'{"data":"hello"}',
    cbor2.dumps({"data": "hello", "x": cbor2.CBORTag(85, bytes(8))}),
    lz4.frame.compress(cbor2.dumps({"data": "hello"})),
    lz4.frame.compress(HELLO * 20, store_size=False),
    png.pack(b'{"data":"hello"}'),
]


@settings(deadline=None, max_examples=400)
@given(st.sampled_from(ENCODINGS), mutated(GOOD_BODIES) | st.binary(max_size=60))
def test_whatever_comes_only_the_documented_errors_are_raised(encoding: str, body: bytes) -> None:
    """decode_msg and decode_publish_msg give CDR or raise DecodeError, ValueMismatch or MessageTooBig."""
    codec = CODEC
    documented = (DecodeError, ValueMismatch, MessageTooBig)
    with suppress(*documented):
        assert decode_msg(encoding, body, codec, limit_bytes=100_000)[:2] == b"\0\1"
    with suppress(*documented):
        assert decode_publish_msg(body, encoding, codec, limit_bytes=100_000)[:2] == b"\0\1"


CODEC = TypeRegistry().codec("std_msgs/msg/String")
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.binary(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["data", "secs", "nsecs", "bytes", "x"]), inner, max_size=3)
        | st.builds(cbor2.CBORTag, st.integers(64, 90), inner)
    ),
    max_leaves=5,
)


@settings(deadline=None)
@given(VALUES, st.none() | st.sampled_from(ENCODINGS))
def test_whatever_value_comes_only_the_documented_errors_are_raised(value: Any, compression: str | None) -> None:
    """Any parsed JSON or CBOR value gives CDR or raises DecodeError, ValueMismatch or MessageTooBig."""
    with suppress(DecodeError, ValueMismatch, MessageTooBig):
        assert decode_publish_msg(value, compression, CODEC, limit_bytes=1000)[:2] == b"\0\1"
    with suppress(DecodeError, ValueMismatch, MessageTooBig):
        assert decode_value(value, compression, CODEC, limit_bytes=1000)[:2] == b"\0\1"
