"""Keeps the last seconds of messages, so that a clip can begin before what it is about."""

from __future__ import annotations

from collections import deque
from typing import Final

from ropeway.limits import RECORDED_MESSAGE_BYTES
from ropeway.recording.channel import Recorded, RecordingChannel

__all__ = ["MOST_LATCHED", "Ring"]

MOST_LATCHED: Final = 100
"""Messages of a latched topic that are kept for a beginning in the middle, however deep its publishers are."""


class Ring:
    """Keeps the messages of the last ``seconds``, as far as ``most_bytes`` go; the oldest go first.

    Of a latched topic the last messages stay, however old they are, so that a clip is complete: the transforms of what
    is mounted, the description of the robot, the map. They may take as many bytes again.
    """

    def __init__(self, seconds: float, most_bytes: int) -> None:
        self.seconds = seconds
        self.bytes = 0
        self.cut = 0
        """How many messages went before their time, as there was no room."""
        self._span_ns, self._most = int(seconds * 1e9), most_bytes
        self._messages: deque[Recorded] = deque()
        self._latched: dict[RecordingChannel, deque[Recorded]] = {}
        self.latched_bytes = 0

    def __len__(self) -> int:
        return len(self._messages)

    def add(self, message: Recorded) -> None:
        """Take a message, and let go of those that are too old."""
        messages = self._messages
        messages.append(message)
        self.bytes += _weight(message)
        oldest_ns = message.time_ns - self._span_ns
        while messages and messages[0].time_ns < oldest_ns:
            self._drop()
        while self.bytes > self._most and len(messages) > 1:
            self.cut += 1
            self._drop()

    def snapshot(self) -> list[Recorded]:
        """Return what is in it in the order in which it came, latched messages of before first."""
        found = [one for kept in self._latched.values() for one in kept]
        found.sort(key=lambda one: one.time_ns)
        found += self._messages
        return found

    def _drop(self) -> None:
        message = self._messages.popleft()
        self.bytes -= _weight(message)
        channel = message.channel
        if channel.latched:
            self._keep(message, self._latched.setdefault(channel, deque()))

    def _keep(self, message: Recorded, kept: deque[Recorded]) -> None:
        """Keep a message of a latched topic in the place of older ones, as far as there is room."""
        kept.append(message)
        self.latched_bytes += _weight(message)
        while kept and (len(kept) > min(message.channel.latched, MOST_LATCHED) or self.latched_bytes > self._most):
            self.latched_bytes -= _weight(kept.popleft())


def _weight(message: Recorded) -> int:
    return len(message.payload) + RECORDED_MESSAGE_BYTES
