from __future__ import annotations

import struct
import threading
from contextlib import suppress

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from ropeway.delivery.compression.arrays import BYTES, NUMBERS, RECORDS
from ropeway.delivery.compression.filters import decode, encode
from ropeway.errors import DecodeError, MessageTooBig
from ropeway.types import TypeRegistry

from .conftest import Recorded

IMAGE = "sensor_msgs/msg/Image"
CLOUD = "sensor_msgs/msg/PointCloud2"
ENCODINGS = {
    "rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "mono8": 1, "8UC1": 1, "8UC2": 2, "8UC3": 3, "8UC4": 4,
    "bayer_rggb8": 1, "yuv422": 2, "yuv422_yuy2": 2, "16UC1": 2, "mono16": 2, "32FC1": 4, "64FC1": 8, "nv12": 1,
}  # fmt: skip


def string(text: str) -> bytes:
    """A CDR string, padded."""
    data = text.encode() + b"\0"
    return struct.pack("<I", len(data)) + data + bytes(-len(data) % 4)


def image(
    encoding: str, width: int, height: int, step: int, data: bytes, big_endian: int = 0, frame: str = "f"
) -> bytes:
    """The CDR of a sensor_msgs/Image."""
    coded = encoding.encode() + b"\0"
    body = struct.pack("<iI", 1, 2) + string(frame) + struct.pack("<III", height, width, len(coded)) + coded
    body += bytes([big_endian])
    body += bytes(-len(body) % 4) + struct.pack("<II", step, len(data)) + data
    return b"\0\1\0\0" + body


def cloud(step: int, data: bytes, names: tuple[str, ...] = ("x", "y", "z")) -> bytes:
    """The CDR of a sensor_msgs/PointCloud2."""
    body = struct.pack("<iI", 1, 2) + string("lidar") + struct.pack("<III", 1, len(data) // step, len(names))
    for index, name in enumerate(names):
        body += string(name) + struct.pack("<IB3xI", 4 * index, 7, 1)
    body += struct.pack("<B3xIII", 0, step, len(data), len(data)) + data + b"\1"
    return b"\0\1\0\0" + body


def scene(width: int, height: int, size: int) -> bytes:
    """Something smooth with noise."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:height, :width]
    plane = (x // 3 + y // 2)[..., np.newaxis] * np.arange(1, size + 1) + rng.integers(0, 3, (height, width, size))
    return bytes(plane.astype(np.uint8).tobytes())


def there_and_back(payload: bytes, type: str) -> bytes:
    """The body, seen to come back."""
    body = encode(payload, type)
    assert decode(body, len(payload)) == payload
    assert len(body) <= len(payload) + 1
    return body


def test_our_cdr_is_that_of_the_registry() -> None:
    """The hand-made messages of these tests are real ones."""
    registry = TypeRegistry()
    pixels = registry.codec(IMAGE).decode(image("rgb8", 2, 1, 6, b"abcdef"))
    assert (pixels["encoding"], pixels["step"], bytes(pixels["data"])) == ("rgb8", 6, b"abcdef")
    points = registry.codec(CLOUD).decode(cloud(12, bytes(24)))
    assert ([f["name"] for f in points["fields"]], points["point_step"], points["is_dense"]) == (
        ["x", "y", "z"],
        12,
        True,
    )


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(("width", "height"), [(64, 48), (101, 37), (7, 300), (1, 999), (600, 1)])
def test_images_come_back(encoding: str, width: int, height: int) -> None:
    """Every pixel format, whatever its size, comes back, and what is known is smaller than without filter."""
    size = ENCODINGS[encoding]
    payload = image(encoding, width, height, width * size, scene(width, height, size))
    body = there_and_back(payload, IMAGE)
    if encoding in ("64FC1", "nv12"):
        assert body[0] < BYTES
    elif width == 64:
        assert body[0] == (RECORDS if encoding == "32FC1" else NUMBERS if "16" in encoding else BYTES)
        plain = encode(payload, "other/msg/Type")
        assert plain[0] < BYTES
        if encoding in ("rgb8", "bgra8", "mono8"):
            assert len(body) < 0.8 * len(plain)


@pytest.mark.parametrize("step", [4, 5, 12, 16, 18, 22, 32, 48, 255, 256])
def test_clouds_come_back(step: int) -> None:
    """Points of any size, aligned or not, come back."""
    rng = np.random.default_rng(step)
    points = np.cumsum(rng.integers(-3, 4, (600, step)), axis=0).astype(np.uint8)
    points[:, 2:4] = 7
    assert there_and_back(cloud(step, points.tobytes()), CLOUD)[0] == RECORDS


@pytest.mark.parametrize(
    "payload",
    [
        image("rgb8", 640, 480, 1920, b""),
        image("rgb8", 0, 0, 0, b"x" * 1000),
        image("rgb8", 10, 10, 30, scene(10, 10, 3)[:-1]),
        image("rgb8", 30, 30, 100, scene(100, 30, 1)),
        image("rgb8", 2**32 - 1, 2**32 - 1, 2**32 - 1, scene(100, 30, 1)),
        image("rgb8", 100, 3, 1200, scene(300, 4, 1)),
        image("mono16", 30, 30, 61, scene(61, 30, 1), big_endian=1),
        image("mono16", 30, 30, 61, scene(61, 30, 1)),
        image("\0" * 40, 30, 30, 90, scene(30, 30, 3)),
        image("rgb8", 100, 50, 300, scene(100, 50, 3), frame="x" * 1000),
        image("rgb8", 100, 50, 300, scene(100, 50, 3))[:-1],
        image("rgb8", 100, 50, 300, scene(100, 50, 3)) + b"more behind",
        image("rgb8", 100, 50, 300, scene(100, 50, 3))[:60],
        b"\0\1\0\0",
        b"",
        b"\xff" * 1000,
        bytes(1000),
    ],
    ids=range(17),
)
def test_odd_images_come_back(payload: bytes) -> None:
    """Fields that contradict each other, missing and superfluous bytes do no harm."""
    there_and_back(payload, IMAGE)
    there_and_back(payload, CLOUD)
    assert decode(encode(memoryview(payload), IMAGE)) == payload


def test_odd_clouds_come_back() -> None:
    """Points that do not fill the data, no points, huge fields and steps do no harm."""
    data = scene(100, 50, 3)
    good = cloud(16, data)
    for payload in (cloud(16, data[:-3]), cloud(300, data), cloud(1, data), good[:-1], good[:70], cloud(4, b"")):
        there_and_back(payload, CLOUD)
    for at in range(0, 160, 4):
        for value in (0, 1, 2**31, 2**32 - 1):
            there_and_back(good[:at] + struct.pack("<I", value) + good[at + 4 :], CLOUD)


def test_what_cannot_shrink_is_stored() -> None:
    """Noise costs one byte."""
    noise = np.random.default_rng(0).bytes(30_000)
    assert encode(noise, "std_msgs/msg/String") == b"\0" + noise
    payload = image("rgb8", 100, 100, 300, noise)
    assert encode(payload, IMAGE) == b"\0" + payload
    assert decode(encode(b"", "x/msg/Y")) == b""


@pytest.mark.data
@pytest.mark.parametrize(
    ("topic", "type", "least"),
    [
        ("/camera/color/image_raw", IMAGE, 2.0),
        ("/camera/depth/image_rect_raw", IMAGE, 1.25),
        ("/lidar/points", CLOUD, 1.35),
        ("/ouster/points", CLOUD, 1.3),
        ("/os1_cloud_node/points", CLOUD, 1.6),
        ("/scan", "sensor_msgs/msg/LaserScan", 1.0),
        ("/camera/color/image_raw/compressed", "sensor_msgs/msg/CompressedImage", 1.0),
    ],
)
def test_recordings_shrink_and_come_back(recorded: Recorded, topic: str, type: str, least: float) -> None:
    """Recorded messages come back bit by bit, at least so much smaller than plain zstandard makes them."""
    payloads = recorded(topic, 10)
    size = sum(len(there_and_back(payload, type)) for payload in payloads)
    plain = sum(len(zstandard.compress(payload, 1)) for payload in payloads)
    assert size * least <= plain + 10


def test_threads_do_not_disturb_each_other() -> None:
    """Every thread has working memory of its own."""
    payloads = [image("rgb8", 200, 100, 600, scene(200, 100, 3)[i:] + bytes(i)) for i in range(4)]
    results: list[bool] = []

    def work(payload: bytes) -> None:
        results.append(all(decode(encode(payload, IMAGE)) == payload for _ in range(30)))

    threads = [threading.Thread(target=work, args=(payload,)) for payload in payloads]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == [True] * 4


def test_the_limit_holds_before_anything_is_unpacked() -> None:
    """A payload above the limit raises MessageTooBig for every filter."""
    zeros = bytes(30_000)
    for body in (
        b"\0" + zeros,
        encode(zeros, ""),
        encode(image("rgb8", 100, 100, 300, zeros), IMAGE),
        encode(image("mono16", 100, 150, 200, zeros), IMAGE),
        encode(cloud(16, zeros), CLOUD),
    ):
        with pytest.raises(MessageTooBig):
            decode(body, 29_999)
        assert len(decode(body, 31_000)) >= 30_000


def header(filter: int, channels: int, flags: int, head: int, tail: int, width: int, count: int) -> bytes:
    """The start of a filtered body."""
    return struct.pack("<BBBxIIII", filter, channels, flags, head, tail, width, count)


def frame(data: bytes) -> bytes:
    """A plane."""
    packed = zstandard.compress(data)
    return struct.pack("<I", len(packed)) + packed


PLANE = bytes(300)
UNSIZED = zstandard.ZstdCompressor(write_content_size=False).compress(PLANE)
BAD = {
    "nothing": b"",
    "an unknown filter": b"\5" + bytes(100),
    "no header": b"\2",
    "half a header": header(BYTES, 1, 0, 0, 0, 0, 300)[:-1],
    "no frame": b"\1",
    "no zstandard": b"\1garbage",
    "a frame without size": b"\1" + UNSIZED,
    "a cut frame": b"\1" + zstandard.compress(PLANE)[:-1],
    "two frames": b"\1" + zstandard.compress(PLANE) * 2,
    "no planes": header(BYTES, 1, 0, 0, 0, 0, 300),
    "no channels": header(BYTES, 0, 0, 0, 0, 0, 300),
    "five channels": header(BYTES, 5, 0, 0, 0, 0, 300) + frame(PLANE) * 5,
    "no elements": header(BYTES, 1, 0, 0, 0, 0, 0) + frame(b""),
    "an unknown flag": header(BYTES, 3, 4, 0, 0, 0, 300) + frame(PLANE) * 3,
    "green alone": header(BYTES, 1, 1, 0, 0, 0, 300) + frame(PLANE),
    "narrow rows": header(BYTES, 1, 2, 0, 0, 1, 300) + frame(PLANE),
    "rows beyond the data": header(BYTES, 1, 2, 0, 0, 301, 300) + frame(PLANE),
    "a short plane": header(BYTES, 1, 0, 0, 0, 0, 300) + frame(PLANE[1:]),
    "a long plane": header(BYTES, 1, 0, 0, 0, 0, 300) + frame(PLANE + b"x"),
    "a plane too many": header(BYTES, 1, 0, 0, 0, 0, 300) + frame(PLANE) * 2,
    "a plane too few": header(NUMBERS, 1, 0, 0, 0, 0, 300) + frame(PLANE),
    "a head beyond the end": header(BYTES, 1, 0, 1000, 0, 0, 300) + frame(PLANE),
    "an unsized plane": header(BYTES, 1, 0, 0, 0, 0, 300) + struct.pack("<I", len(UNSIZED)) + UNSIZED,
    "tiny records": header(RECORDS, 1, 0, 0, 0, 3, 300) + frame(PLANE) * 3,
    "huge records": header(RECORDS, 1, 0, 0, 0, 257, 300) + bytes(64) + frame(PLANE) * 257,
    "an unknown mode": header(RECORDS, 1, 0, 0, 0, 4, 300) + b"\3" + frame(PLANE) * 4,
    "no constant": header(RECORDS, 1, 0, 0, 0, 4, 300) + b"\2abc",
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_bodies_raise_decode_error(name: str) -> None:
    """What encode does not make raises DecodeError."""
    with pytest.raises(DecodeError):
        decode(BAD[name])


def test_hand_made_bodies_are_decoded() -> None:
    """The format is as documented."""
    ones = bytes([1]) * 300
    assert (
        decode(header(BYTES, 1, 0, 2, 3, 0, 300) + b"heend" + frame(ones))
        == b"he" + bytes(i & 255 for i in range(1, 301)) + b"end"
    )
    twos = bytes([2]) * 300
    numbers = np.arange(1, 301, dtype="<u2").tobytes()
    assert decode(header(NUMBERS, 1, 0, 0, 0, 0, 300) + frame(twos) + frame(PLANE)) == numbers
    assert decode(header(RECORDS, 1, 0, 0, 0, 4, 300) + b"\2abcd") == b"abcd" * 300
    assert decode(header(RECORDS, 1, 0, 0, 0, 5, 300) + b"\2abcd" + frame(ones)) == b"abcd\1" * 300


@settings(deadline=None, max_examples=200)
@given(
    st.sampled_from(sorted(ENCODINGS)),
    st.integers(0, 90),
    st.integers(0, 40),
    st.integers(-2, 2),
    st.sampled_from([0, 1]),
    st.integers(0, 255),
    st.integers(0, 40),
)
def test_any_image_comes_back(
    encoding: str, width: int, height: int, slack: int, endian: int, noise: int, cut: int
) -> None:
    """Whatever the fields of an image say, it comes back."""
    step = max(0, width * ENCODINGS[encoding] + slack)
    rng = np.random.default_rng(width)
    data = rng.integers(0, noise + 1, step * height, dtype=np.uint8).tobytes()
    payload = image(encoding, width, height, step, data, endian)
    there_and_back(payload[: len(payload) - cut], IMAGE)


@settings(deadline=None, max_examples=200)
@given(st.binary(max_size=200), st.sampled_from([IMAGE, CLOUD, ""]), st.integers(0, 200))
def test_any_bytes_come_back(data: bytes, type: str, zeros: int) -> None:
    """Whatever bytes are given as a message, they come back."""
    there_and_back(data + bytes(zeros) + data, type)


BODIES = [
    encode(image("rgb8", 70, 40, 210, scene(70, 40, 3)), IMAGE),
    encode(image("mono16", 70, 40, 140, scene(70, 40, 2)), IMAGE),
    encode(cloud(16, scene(100, 100, 1)), CLOUD),
    encode(bytes(1000), ""),
]


@settings(deadline=None, max_examples=400)
@given(
    st.sampled_from(BODIES),
    st.lists(st.tuples(st.integers(0, 400), st.integers(0, 255)), max_size=3),
    st.integers(0, 99),
)
def test_damaged_bodies_raise_only_documented_errors(body: bytes, changes: list[tuple[int, int]], cut: int) -> None:
    """A damaged body raises DecodeError or MessageTooBig, or gives bytes within the limit."""
    data = bytearray(body)
    for at, value in changes:
        data[at % len(data)] = value
    with suppress(DecodeError, MessageTooBig):
        assert len(decode(data[: len(data) - cut], 100_000)) <= 100_000


@settings(deadline=None)
@given(st.binary(max_size=80), st.integers(0, 6))
def test_random_bodies_raise_only_documented_errors(data: bytes, filter: int) -> None:
    """Random bytes raise DecodeError or MessageTooBig, or are a body."""
    with suppress(DecodeError, MessageTooBig):
        decode(bytes([filter]) + data, 100_000)


@settings(max_examples=400, deadline=None)
@given(
    filter=st.sampled_from((BYTES, NUMBERS, RECORDS)),
    channels=st.integers(0, 5),
    flags=st.integers(0, 7),
    width=st.one_of(st.integers(0, 400), st.integers(0, 2**32 - 1)),
    count=st.integers(0, 300),
    planes=st.integers(0, 5),
    modes=st.binary(max_size=8),
)
def test_any_header(filter: int, channels: int, flags: int, width: int, count: int, planes: int, modes: bytes) -> None:
    """Whatever numbers stand in a header before planes that fit them, only ``DecodeError`` comes out."""
    plane = zstandard.ZstdCompressor().compress(bytes(count))
    header = struct.pack("<BBBxIIII", filter, channels, flags, 0, 0, width, count)
    body = header + (modes if filter == RECORDS else b"") + (struct.pack("<I", len(plane)) + plane) * planes
    with suppress(DecodeError, MessageTooBig):
        decode(body)


def test_rows_longer_than_the_array() -> None:
    """Numbers with more channels than one, which would make rows longer than the array, are refused."""
    plane = zstandard.ZstdCompressor().compress(bytes(300))
    body = struct.pack("<BBBxIIII", NUMBERS, 4, 2, 0, 0, 1200, 300) + (struct.pack("<I", len(plane)) + plane) * 2
    with pytest.raises(DecodeError):
        decode(body)
