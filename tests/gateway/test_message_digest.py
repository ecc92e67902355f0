"""Messages are made small for people."""

from __future__ import annotations

import base64
import io
from typing import Any

import numpy as np
import pytest
from PIL import Image

from ropeway.gateway.message_digest import digest
from ropeway.graph.base import SEQ_NONE, Sample, new_origin
from ropeway.limits import PICTURE_BYTES
from ropeway.types import TypeRegistry

REGISTRY = TypeRegistry()
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"


def digested(type: str, value: dict[str, Any]) -> dict[str, Any]:
    return digest(REGISTRY, Sample(REGISTRY.codec(type).encode(value), type, 1, new_origin(), SEQ_NONE))


def image(encoding: str, pixels: Any, **more: Any) -> dict[str, Any]:
    height, width = pixels.shape[:2]
    data = pixels.tobytes()
    step = len(data) // height if height else 0
    return {"height": height, "width": width, "encoding": encoding, "step": step, "data": data, **more}


def pixels_of(found: dict[str, Any]) -> Any:
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(found["picture"]["base64"]))))


def test_long_arrays_and_texts_are_cut() -> None:
    """A message of megabytes becomes one of kilobytes that says what was left out."""
    scan = digested("sensor_msgs/msg/LaserScan", {"ranges": np.arange(100_000, dtype=np.float32)})["value"]["ranges"]
    assert (len(scan), scan[1], scan[-1]) == (33, 1.0, "… 100000 in all")
    assert len(digested("std_msgs/msg/String", {"data": "x" * 1_000_000})["value"]["data"]) == 1_001
    path = digested("nav_msgs/msg/Path", {"poses": [{}] * 10_000})
    assert len(str(path)) < 50_000


def test_numbers_that_json_does_not_have() -> None:
    """What is not finite is told as a word."""
    found = digested("std_msgs/msg/Float64MultiArray", {"data": [float("nan"), float("inf"), 1.5]})
    assert found["value"]["data"] == ["nan", "inf", 1.5]


@pytest.mark.parametrize(("encoding", "expected"), [("rgb8", [1, 2, 3]), ("bgr8", [3, 2, 1])])
def test_a_picture_of_an_image(encoding: str, expected: list[int]) -> None:
    """An image becomes a PNG of its pixels, red first."""
    found = digested(IMAGE, image(encoding, np.full((4, 6, 3), [1, 2, 3], np.uint8)))
    assert pixels_of(found).shape == (4, 6, 3)
    assert pixels_of(found)[0, 0].tolist() == expected


@pytest.mark.parametrize(("encoding", "kind"), [("mono8", np.uint8), ("16UC1", np.uint16), ("32FC1", np.float32)])
def test_grey_and_depth(encoding: str, kind: Any) -> None:
    """A large image of one channel is thinned, and depths are shown up to the deepest."""
    depth = np.zeros((1080, 1920), kind)
    depth[:, :960] = 200
    found = pixels_of(digested(IMAGE, image(encoding, depth)))
    assert found.shape == (180, 320)
    assert found[0, 0] == (200 if encoding == "mono8" else 255)
    assert found[0, -1] == 0


@pytest.mark.parametrize(
    "change",
    [
        {"width": 1 << 31},
        {"height": 1 << 31},
        {"step": 1},
        {"width": 0, "height": 0, "step": 0},
        {"encoding": "yuv422"},
        {"encoding": "<b>"},
        {"data": b""},
    ],
)
def test_an_image_that_is_none(change: dict[str, Any]) -> None:
    """An image whose sizes do not fit its data, or of an encoding that is not known, has no picture."""
    found = digested(IMAGE, image("rgb8", np.zeros((4, 6, 3), np.uint8)) | change)
    assert "picture" not in found
    assert found["value"]["header"]["frame_id"] == ""


def test_compressed_images() -> None:
    """A JPEG or a PNG is passed on as it is; what is neither, or too long, is not."""
    jpeg = b"\xff\xd8\xff" + bytes(100)
    assert base64.b64decode(digested(COMPRESSED, {"format": "jpeg", "data": jpeg})["picture"]["base64"]) == jpeg
    for data in (b"<svg onload=alert(1)>", b"", jpeg + bytes(PICTURE_BYTES)):
        assert "picture" not in digested(COMPRESSED, {"format": "jpeg", "data": data})


def test_a_message_that_cannot_be_decoded() -> None:
    """Bytes that are no message of the type are an error with a sentence."""
    found = digest(REGISTRY, Sample(b"\0\1\0\0\xff", "std_msgs/msg/String", 1, new_origin(), SEQ_NONE))
    assert "std_msgs/msg/String" in found["error"]
