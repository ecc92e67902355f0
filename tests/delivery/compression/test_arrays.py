from __future__ import annotations

import pytest

from ropeway.delivery.compression.arrays import BYTES, NUMBERS, RECORDS, Array, find
from ropeway.types import TypeRegistry

IMAGE = "sensor_msgs/msg/Image"
CLOUD = "sensor_msgs/msg/PointCloud2"
CODECS = TypeRegistry()


@pytest.mark.parametrize("frame", ["", "a", "abc", "camera_optical_frame"])
@pytest.mark.parametrize(
    ("encoding", "step", "size", "expected"),
    [
        ("rgb8", 300, 30_000, Array(BYTES, 0, 10_000, 3, 100, True)),
        ("8UC3", 300, 30_000, Array(BYTES, 0, 10_000, 3, 100, True)),
        ("bgra8", 404, 30_000, Array(BYTES, 0, 7500, 4, 101, True)),
        ("mono8", 300, 30_000, Array(BYTES, 0, 30_000, 1, 300)),
        ("bayer_grbg8", 300, 30_000, Array(BYTES, 0, 15_000, 2, 150)),
        ("uyvy", 400, 30_000, Array(BYTES, 0, 7500, 4, 100)),
        ("16UC1", 200, 30_001, Array(NUMBERS, 0, 15_000, 1, 100)),
        ("32FC1", 400, 30_000, Array(RECORDS, 0, 7500, 1, 4)),
        ("rgb8", 300, 600, None),
        ("64FC1", 800, 30_000, None),
        ("", 300, 30_000, None),
    ],
)
def test_the_pixels_of_an_image_are_found(
    frame: str, encoding: str, step: int, size: int, expected: Array | None
) -> None:
    """Where the pixels are and what they are made of is read from the CDR, wherever alignment puts them."""
    data = bytes([0xA5]) * size
    payload = CODECS.codec(IMAGE).encode(
        {"header": {"frame_id": frame}, "encoding": encoding, "step": step, "width": 1, "height": 1, "data": data}
    )
    found = find(payload, IMAGE)
    if expected is None:
        assert found is None
    else:
        assert found is not None
        assert payload[found.start : found.start + found.length] == data[: found.length]
        assert payload[found.start - 1] != 0xA5
        assert found == Array(
            expected.filter, found.start, expected.count, expected.channels, expected.width, expected.green
        )


@pytest.mark.parametrize("names", [(), ("x",), ("x", "yy", "zzz", "intensity")])
def test_the_points_of_a_cloud_are_found(names: tuple[str, ...]) -> None:
    """The points lie behind any number of fields with names of any length."""
    data = bytes([0xA5]) * 16_003
    fields = [{"name": name, "offset": 4 * i, "datatype": 7, "count": 1} for i, name in enumerate(names)]
    payload = CODECS.codec(CLOUD).encode(
        {"header": {"frame_id": "lidar"}, "fields": fields, "point_step": 16, "row_step": 16_000, "data": data}
    )
    found = find(payload, CLOUD)
    assert found is not None
    assert found == Array(RECORDS, found.start, 1000, 1, 16)
    assert payload[found.start :].startswith(data)
    assert payload[found.start - 1] != 0xA5


def test_other_types_have_no_array() -> None:
    """A type that is not known to be large has nothing to filter."""
    payload = CODECS.codec(IMAGE).encode({"encoding": "rgb8", "step": 300, "data": bytes(30_000)})
    assert find(payload, "sensor_msgs/msg/CompressedImage") is None
    assert find(payload, "") is None
    assert find(b"", IMAGE) is None
