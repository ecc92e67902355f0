"""Defines what every kind of recording offers, and what its readers raise."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Protocol

import apsw
import yaml
import zstandard
from mcap.exceptions import McapError
from rosbags.rosbag1 import ReaderError as Rosbag1Error

from ropeway.qos import DEFAULT, LATCHED, QoS, common_qos

if TYPE_CHECKING:
    from typing_extensions import Self


__all__ = ["DAMAGED", "DEFINITIONS", "RecordedChannel", "Recording", "profiles_in", "reason_of", "recorded_qos"]

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


def profiles_in(text: Any) -> list[dict[str, Any]]:
    """Return the QoS profiles that a recording states, as YAML or already parsed; empty if they cannot be read."""
    try:
        found = yaml.safe_load(text) if isinstance(text, str) else text
    except (yaml.YAMLError, ValueError):
        return []
    return [profile for profile in found if isinstance(profile, dict)] if isinstance(found, list) else []


def recorded_qos(topic: str, profiles: list[dict[str, Any]], *, latched: bool = False) -> QoS:
    """Return what the publishers of a recorded topic offered."""
    if latched or topic.rpartition("/")[2] == "tf_static":
        return LATCHED
    return common_qos(
        QoS(
            reliability=_policy(profile.get("reliability"), ("reliable", "best_effort"), "reliable"),
            durability=_policy(profile.get("durability"), ("transient_local", "volatile"), "volatile"),
            history=_policy(profile.get("history"), ("keep_last", "keep_all"), "keep_last"),
            depth=depth if isinstance(depth := profile.get("depth"), int) and 0 < depth < 10_000 else DEFAULT.depth,
        )
        for profile in profiles
    )


def _policy(value: Any, choices: tuple[str, ...], default: str) -> str:
    """Return a policy from its number in ``rmw`` or its name."""
    if isinstance(value, int):
        return choices[value - 1] if 1 <= value <= len(choices) else default
    return str(value).lower() if str(value).lower() in choices else default
