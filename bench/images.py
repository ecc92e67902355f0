"""Made camera frames that compress about as the recorded ones do, for machines without the recordings."""

from __future__ import annotations

import numpy as np

from ropeway.types import TypeRegistry

__all__ = ["frames", "matrix"]

IMAGE = "sensor_msgs/msg/Image"
HEIGHT, WIDTH, COUNT = 240, 424, 15
_MATRIX_IMAGES = 67
# of the picture, nothing to see: what LZ4 gains; of the rest, noise: what filters and entropy coding leave
_PLAIN_COLOUR, _NOISE_COLOUR = 0.21, 1.1
_PLAIN_DEPTH, _NOISE_DEPTH = 0.515, 55.0


def frames(kind: str) -> list[bytes]:
    """Return a second of ``rgb`` (rgb8) or ``depth`` (16UC1) images of 424x240 as CDR."""
    random = np.random.default_rng(1)
    codec = TypeRegistry().codec(IMAGE)
    encoding, samples, bytes_each = ("rgb8", 3, 1) if kind == "rgb" else ("16UC1", 1, 2)
    made = []
    for number in range(COUNT):
        pixels = _colour(random, number) if kind == "rgb" else _depth(random, number)
        made.append(
            codec.encode(
                {
                    "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "camera"},
                    "height": HEIGHT,
                    "width": WIDTH,
                    "encoding": encoding,
                    "is_bigendian": 0,
                    "step": WIDTH * samples * bytes_each,
                    "data": np.frombuffer(pixels.tobytes(), np.uint8),
                }
            )
        )
    return made


def matrix() -> bytes:
    """Return a depth matrix of more than 13 MB, of 67 made depth images one below the other, as an Image in CDR."""
    random = np.random.default_rng(1)
    pixels = np.concatenate([_depth(random, number) for number in range(_MATRIX_IMAGES)])
    return (
        TypeRegistry()
        .codec(IMAGE)
        .encode(
            {
                "header": {"frame_id": "camera"},
                "height": HEIGHT * _MATRIX_IMAGES,
                "width": WIDTH,
                "encoding": "16UC1",
                "step": 2 * WIDTH,
                "data": np.frombuffer(pixels.tobytes(), np.uint8),
            }
        )
    )


def _slope(number: int) -> np.ndarray:
    """Return a smooth field between -1 and 1 that moves from frame to frame."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    field: np.ndarray = np.sin((x + 3 * number) / 60) * np.cos((y - number) / 45)
    return field


def _colour(random: np.random.Generator, number: int) -> np.ndarray:
    grey = 128 + 80 * _slope(number)[:, :, None] * np.array([1.0, 0.9, 0.8])
    noisy: np.ndarray = np.clip(grey + random.normal(0, _NOISE_COLOUR, grey.shape), 0, 255).astype(np.uint8)
    noisy[: int(HEIGHT * _PLAIN_COLOUR)] = 0
    return noisy


def _depth(random: np.random.Generator, number: int) -> np.ndarray:
    noisy: np.ndarray = (2500 + 1000 * _slope(number) + random.normal(0, _NOISE_DEPTH, (HEIGHT, WIDTH))).astype("<u2")
    noisy[: int(HEIGHT * _PLAIN_DEPTH)] = 0  # out of reach
    return noisy
