"""Messages of the tests, and boxes they arrive in."""

from __future__ import annotations

import struct
import time
from collections.abc import Sequence

from ropeway.graph.base import SEQ_NONE, Sample

STRING = "std_msgs/msg/String"


def text(value: str) -> bytes:
    """A std_msgs/msg/String as CDR."""
    raw = value.encode() + b"\0"
    return b"\0\1\0\0" + struct.pack("<I", len(raw)) + raw


def sample(payload: bytes, type: str = STRING) -> Sample:
    return Sample(payload, type, time.time_ns(), bytes(16), SEQ_NONE)


class Box:
    """A callback that keeps what comes."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []

    def __call__(self, batch: Sequence[Sample]) -> None:
        self.samples.extend(batch)

    @property
    def payloads(self) -> list[bytes]:
        return [sample.payload for sample in self.samples]

    @property
    def texts(self) -> list[str]:
        return [payload[8:-1].decode() for payload in self.payloads]
