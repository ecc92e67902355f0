"""Guards a topic of commands: a lease, limits of fields, a lifespan, and one driver at a time. Sans-I/O.

Whoever drives a robot over a link renews a lease with every command. Once it is over, the guard gives the safe message.
This is no certified safety function: it runs on the robot's computer, behind its network and its operating system.
"""

from __future__ import annotations

import enum
import math
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal

from ropeway.errors import DecodeError, ValueMismatch
from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.types.codec import MessageCodec

__all__ = ["CommandGuard", "CommandRefusal", "Drivers", "UnknownField", "field_names"]

Drivers = Literal["any", "first", "newest"]
"""Drivers that may command: all at once, the first until its lease is over, or the one that began last."""

_MOST_DRIVERS: Final = 1000


class CommandRefusal(enum.Enum):
    """The reasons for which a command is refused."""

    LATE = "older than its lifespan"
    DRIVER = "another driver holds the lease"
    NUMBER = "a limited field is not a finite number"
    DECODE = "not decodable as its type"


class UnknownField(ValueError):
    """A path that leads to no number of the type; ``valid`` are those that do."""

    def __init__(self, path: str, valid: Sequence[str]) -> None:
        super().__init__(path)
        self.path, self.valid = path, valid


@dataclass
class _Drive:
    """The lease of who drives."""

    driver: str = ""
    until_s: float = -math.inf
    known: dict[str, float] = field(default_factory=dict)  # when each driver that was refused said something last


class CommandGuard:
    """Admits commands of one topic.

    ``lease_s``: how long a command counts; ``None`` for ever. ``on_expiry``: fields of the safe message, those left out
    are zero. ``most``: the largest magnitude of numbers, by their dotted path (``linear.x``); arrays count by element.
    ``lifespan_s``: older commands are refused. Raises ``UnknownField`` and ``ValueMismatch`` for what the type does not
    have.
    """

    def __init__(
        self,
        codec: MessageCodec,
        *,
        lease_s: float | None = None,
        on_expiry: Mapping[str, Any] | None = None,
        most: Mapping[str, float] | None = None,
        lifespan_s: float | None = None,
        drivers: Drivers = "any",
        clock: Callable[[], float] = time.monotonic,
        now_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._codec = codec
        self._lease_s, self._lifespan_ns = lease_s, None if lifespan_s is None else int(lifespan_s * 1e9)
        self._safe = dict(on_expiry or {})
        self._drivers, self._clock, self._now_ns = drivers, clock, now_ns
        self._most = {tuple(path.split(".")): abs(limit) for path, limit in (most or {}).items()}
        self._drive = _Drive()
        self._expired = True  # nobody has driven yet
        self.refused: Counter[CommandRefusal] = Counter()
        self.clamped = 0
        self.expiries = 0
        valid = field_names(codec)
        for path in most or {}:
            if path not in valid:
                raise UnknownField(path, valid)
        codec.from_json(self._safe)

    @property
    def driver(self) -> str:
        """The driver that holds the lease, ``""`` for nobody."""
        return self._drive.driver if self._clock() < self._drive.until_s else ""

    @property
    def due_s(self) -> float | None:
        """The time by the clock at which the lease is over, ``None`` where none runs."""
        return None if self._expired or self._lease_s is None else self._drive.until_s

    def admit(self, sample: Sample, driver: str) -> Sample | None:
        """Return the command within its limits, ``None`` if it is refused, which is counted."""
        admitted = self._judged(sample, driver)
        if isinstance(admitted, CommandRefusal):
            self.refused[admitted] += 1
            return None
        drive = self._drive
        drive.driver = driver
        drive.until_s = math.inf if self._lease_s is None else self._clock() + self._lease_s
        self._expired = False
        return admitted

    def _judged(self, sample: Sample, driver: str) -> Sample | CommandRefusal:
        sent_ns = sample.sent_ns or sample.stamp_ns
        if self._lifespan_ns is not None and sent_ns and self._now_ns() - sent_ns > self._lifespan_ns:
            return CommandRefusal.LATE
        if not self._may(driver):
            return CommandRefusal.DRIVER
        if not self._most:
            return sample
        try:
            limited = self._limited(sample.payload)
        except (DecodeError, ValueMismatch):
            return CommandRefusal.DECODE
        return CommandRefusal.NUMBER if limited is None else sample.carrying(limited)

    def safe(self) -> Sample:
        """Return the safe message, stamped now."""
        payload = self._codec.from_json(dict(self._safe), now_ns=self._now_ns)
        return Sample(payload, self._codec.type, self._now_ns(), b"", SEQ_NONE)

    def expire(self) -> bool:
        """End the lease if it is over; return whether it has just ended, so that the safe message is due."""
        due_s = self.due_s
        if due_s is None or self._clock() < due_s:
            return False
        self._expired = True
        self._drive = _Drive(known=self._drive.known)
        self.expiries += 1
        return True

    def status(self) -> dict[str, Any]:
        """Return the state as JSON."""
        return {
            "driver": self.driver,
            "expired": self._expired,
            "expiries": self.expiries,
            "clamped": self.clamped,
            "refused": {why.value: count for why, count in self.refused.items()},
        }

    def _may(self, driver: str) -> bool:
        """Return whether a driver may drive now; a newer one takes over where that is wanted."""
        drive, now_s = self._drive, self._clock()
        if self._drivers == "any" or driver == drive.driver or now_s >= drive.until_s:
            return True
        began = driver not in drive.known or (
            self._lease_s is not None and now_s - drive.known[driver] > self._lease_s  # it had stopped, and begins anew
        )
        if self._drivers == "newest" and began:
            drive.known[drive.driver] = now_s
            drive.known.pop(driver, None)
            return True
        if driver in drive.known or len(drive.known) < _MOST_DRIVERS:
            drive.known[driver] = now_s
        return False

    def _limited(self, payload: bytes) -> bytes | None:
        """Return the message with every limited number within its limit, ``None`` if one is no finite number."""
        message = self._codec.decode(payload)
        changed = False
        for path, limit in self._most.items():
            parent: Any = message
            for name in path[:-1]:
                parent = parent[name]
            value = parent[path[-1]]
            numbers = [value] if isinstance(value, int | float) else list(value)
            if not all(math.isfinite(number) for number in numbers):
                return None
            within = [min(max(number, -limit), limit) for number in numbers]
            if within != numbers:
                changed = True
                parent[path[-1]] = within[0] if isinstance(value, int | float) else within
        if not changed:
            return payload
        self.clamped += 1
        return self._codec.encode(message)


def field_names(codec: MessageCodec) -> list[str]:
    """Return the dotted paths of all numbers, and arrays of numbers, that a message of fixed structure has."""
    return _paths(codec.default(), "")


def _paths(message: Mapping[str, Any], prefix: str) -> list[str]:
    found: list[str] = []
    for name, value in message.items():
        path = f"{prefix}{name}"
        if isinstance(value, Mapping):
            found += _paths(value, f"{path}.")
        elif isinstance(value, bool | str | bytes) or (isinstance(value, list) and not _numbers(value)):
            continue
        else:
            found.append(path)
    return found


def _numbers(values: Sequence[Any]) -> bool:
    return bool(values) and all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
