"""Defines what every kind of recording offers, and what its readers raise."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Final, Protocol

import apsw
import yaml
import zstandard
from mcap.exceptions import McapError
from rosbags.rosbag1 import ReaderError as Rosbag1Error

from ropeway.qos import QoS

if TYPE_CHECKING:
    from typing_extensions import Self


__all__ = ["DAMAGED", "DEFINITIONS", "RecordedChannel", "Recording", "reason_of"]

DAMAGED: Final = (
    McapError,
    Rosbag1Error,
    AssertionError,
    ArithmeticError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    apsw.Error,
    struct.error,
    yaml.YAMLError,
    zstandard.ZstdError,
)
"""The errors that readers raise for a damaged file: they check little, so a wrong length shows as any of these."""

DEFINITIONS: Final = ("ros2msg", "ros2idl", "ros1msg")
"""The formats of definitions that are read."""


@dataclass(frozen=True, slots=True)
class RecordedChannel:
    """Describes one stream of messages in a file."""

    id: int
    topic: str
    type: str
    definition: str | None  # None where the file has none; "" defines a message without fields
    encoding: str  # "cdr", "ros1", or something else
    count: int
    qos: QoS


class Recording(Protocol):
    """An open recording. ``notes`` say what of it is not whole or does not agree."""

    channels: list[RecordedChannel]
    start_ns: int
    end_ns: int
    notes: list[str]

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None, /
    ) -> None: ...

    def messages(self, ids: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        """Yield ``(channel, time_ns, raw)`` in the order of time, as far as the file can tell it."""


def reason_of(error: BaseException) -> str:
    """Return the text for an error of a reader."""
    if isinstance(error, AssertionError) or not str(error):
        return f"the file is damaged ({error.__class__.__name__})"
    if isinstance(error, UnicodeDecodeError):
        return "the file is damaged (a text in it is not valid)"
    return " ".join(str(error).split())
