"""Defines what the store keeps: the last value of a topic of a system, with its origin and version."""

from __future__ import annotations

import base64
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, Protocol

from ropeway.errors import ValueRefused
from ropeway.iort import kind_of

__all__ = [
    "CDR",
    "FOREIGN",
    "MAX_NAME_BYTES",
    "Backend",
    "Change",
    "Entry",
    "Key",
    "SharedBackend",
    "Versions",
    "as_json",
    "check_name",
    "whole",
]

CDR: Final = "cdr"
"""The form of an entry that is a message of ROS."""

FOREIGN: Final = "mongodb"
"""The origin of what another program put into the database."""

MAX_NAME_BYTES: Final = 200
"""The longest name of a system or a topic, in UTF-8: a file system takes 255 bytes."""

_LARGEST: Final = 1 << 63

Key = tuple[str, str]
"""System and topic."""


@dataclass(frozen=True, slots=True)
class Entry:
    """A stored value.

    ``version`` grows with every value of a topic (microseconds since 1970, unless clocks are wrong; see
    ``Versions``), ``origin`` names who wrote it and decides between equal versions. ``stamp_ns`` is when it was
    written, by the writer's clock. ``type`` is a ROS type name where there is one; ``form`` is ``CDR`` for the bytes
    of a ROS message and empty for the text (or whatever bytes) of a robot.
    """

    system: str
    topic: str
    data: bytes
    version: int
    stamp_ns: int
    origin: str = ""
    type: str = ""
    form: str = ""

    @property
    def key(self) -> Key:
        """The system and the topic under which the value is kept."""
        return self.system, self.topic

    @property
    def order(self) -> tuple[int, str]:
        """The greater one is the last."""
        return self.version, self.origin

    def age_s(self, now_ns: int | None = None) -> float:
        """Return the seconds since it was written; 0 if it comes from a clock in the future."""
        return max((time.time_ns() if now_ns is None else now_ns) - self.stamp_ns, 0) / 1e9

    @property
    def text(self) -> str | None:
        """The data as text, ``None`` if it is binary."""
        if self.form:
            return None
        try:
            return self.data.decode()
        except UnicodeDecodeError:
            return None

    def at(self, version: int) -> Entry:
        """Return the same value with another version."""
        return replace(self, version=version)


class Versions:
    """Makes versions: a clock that never goes back, whatever the clock of the machine does.

    A version is the time in microseconds, or one more than the greatest that was seen, if that is later. So who
    has seen a value writes a later one, even if its clock is years behind.
    """

    def __init__(self, clock_ns: Callable[[], int] = time.time_ns) -> None:
        self._clock_ns = clock_ns
        self.last = 0

    def next(self, after: int = 0) -> int:
        """Return a version later than all that were made here, and later than ``after``."""
        self.last = max(self._clock_ns() // 1000, self.last + 1, after + 1)
        return self.last


class Backend(Protocol):
    """Keeps values over a restart. All methods block, and are called from one thread at a time.

    Everything raises ``StoreUnavailable`` where it cannot be done now; what was done before stays done.
    """

    url: str

    def open(self) -> None:
        """Connect, or make the file."""

    def load(self) -> list[Entry]:
        """Return every last value."""

    def write(self, entries: list[Entry], depth: int) -> dict[Key, str]:
        """Keep entries; one that is older than what is kept becomes history.

        Several of one topic come oldest first. ``depth`` values before the last are kept as history. When this
        returns, they survive the end of this process, but for those of the topics that are returned, each with the
        reason why it can never be kept: one bad entry fails alone.
        """

    def remove(self, keys: list[Key]) -> None:
        """Forget topics, with their history."""

    def history(self, key: Key) -> list[Entry]:
        """Return the values before the last one, newest first."""

    def close(self) -> None:
        """Let go; harmless twice."""


def whole(value: object) -> int:
    """Return a version or a stamp as it stands in a file or a database. Raises ``ValueError`` for what is none."""
    if type(value) is not int or not -_LARGEST <= value < _LARGEST:
        raise ValueError(f"{value!r:.40} is not a whole number of 64 bits")
    return value


@dataclass(frozen=True, slots=True)
class Change:
    """Lists what other writers changed in a shared backend: values, and topics that are gone; ``read_ns`` is when
    reading began.
    """

    entries: list[Entry]
    gone: list[Key]
    read_ns: int


class SharedBackend(Backend, Protocol):
    """A backend that others write, too. ``find`` and ``changes`` are called from other threads than the rest.

    The entry of a document without a version has version 0, and as ``stamp_ns`` the time when it was seen.
    """

    @property
    def follows(self) -> str:
        """The way in which changes are followed, in a few words."""

    @property
    def pause_s(self) -> float:
        """The time to wait before asking for changes again."""

    def find(self, key: Key) -> tuple[Entry | None, bool]:
        """Return the last value of a topic, and whether its system is known."""

    def changes(self) -> Change:
        """Return what others changed since the last call; this may wait for a second."""


def check_name(system: str, topic: str) -> None:
    """Refuse a name that is empty, too long or has control characters."""
    for what, name in (("system", system), ("topic", topic)):
        if not name:
            raise ValueRefused(system, topic, "name", f"the name of the {what} is empty")
        if not name.isprintable():
            raise ValueRefused(system, topic, "name", f"the name of the {what} has characters that cannot be printed")
        if len(name.encode()) > MAX_NAME_BYTES:
            raise ValueRefused(
                system[:40], topic[:40], "name", f"the name of the {what} has more than {MAX_NAME_BYTES} bytes"
            )


def as_json(entry: Entry, **more: Any) -> dict[str, Any]:
    """Return an entry as JSON for people and programs; binary data is in base64 under ``base64``.

    ``kind`` is that of the node that wrote it: ``robot``, ``pc``, or empty.
    """
    text = entry.text
    value = {"data": text} if text is not None else {"base64": base64.b64encode(entry.data).decode()}
    return {
        "system": entry.system,
        "topic": entry.topic,
        **value,
        "type": entry.type,
        "form": entry.form,
        "version": entry.version,
        "stamp_ns": entry.stamp_ns,
        "origin": entry.origin,
        "kind": kind_of(entry.origin),
        **more,
    }
