"""The messages of actionlib around a goal, a result and a feedback, as ROS 1 serialises them.

``NameActionGoal`` is a header, a GoalID and the goal; ``NameActionResult`` and ``NameActionFeedback`` are a header, a
GoalStatus and the result or feedback. Here the inner message stays bytes.
"""

from __future__ import annotations

import enum
import hashlib
import struct
import time
import uuid
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from ropeway.errors import DecodeError
from ropeway.graph.calls import GoalStatus
from ropeway.qos import QoS

__all__ = [
    "CANCEL_TYPE",
    "EVENT_QOS",
    "STATUS_QOS",
    "STATUS_TYPE",
    "Code",
    "GoalId",
    "Ros1GoalStatus",
    "cancel_message",
    "goal_bytes",
    "goal_message",
    "goal_text",
    "read_cancel",
    "read_goal",
    "read_report",
    "read_statuses",
    "report_message",
    "statuses_message",
]

CANCEL_TYPE: Final = "actionlib_msgs/msg/GoalID"
STATUS_TYPE: Final = "actionlib_msgs/msg/GoalStatusArray"
STATUS_QOS: Final = QoS(durability="transient_local", depth=1)
EVENT_QOS: Final = QoS(history="keep_all")
_GOALS_LIMIT: Final = 100_000


class Code(enum.IntEnum):
    """actionlib_msgs/GoalStatus."""

    PENDING = 0
    ACTIVE = 1
    PREEMPTED = 2
    SUCCEEDED = 3
    ABORTED = 4
    REJECTED = 5
    PREEMPTING = 6
    RECALLING = 7
    RECALLED = 8
    LOST = 9

    @property
    def final(self) -> bool:
        """Whether the goal has ended."""
        return self in _ENDS

    @property
    def cancelled(self) -> bool:
        """Whether the cancellation of the goal was accepted."""
        return self in (Code.PREEMPTING, Code.PREEMPTED, Code.RECALLING, Code.RECALLED)

    @property
    def outcome(self) -> GoalStatus:
        """The ROS 2 name for the end of a goal."""
        return _ENDS.get(self, GoalStatus.ABORTED)

    @classmethod
    def of(cls, status: GoalStatus) -> Code:
        """Return the code for a goal that was accepted and ended with ``status``."""
        return {GoalStatus.SUCCEEDED: cls.SUCCEEDED, GoalStatus.CANCELED: cls.PREEMPTED}.get(status, cls.ABORTED)


_ENDS: Final = {
    Code.PREEMPTED: GoalStatus.CANCELED,
    Code.SUCCEEDED: GoalStatus.SUCCEEDED,
    Code.ABORTED: GoalStatus.ABORTED,
    Code.REJECTED: GoalStatus.ABORTED,
    Code.RECALLED: GoalStatus.CANCELED,
    Code.LOST: GoalStatus.ABORTED,
}


@dataclass(frozen=True, slots=True)
class GoalId:
    """actionlib_msgs/GoalID: ``text`` may be any text, ``stamp_ns`` is when the goal was sent."""

    text: str
    stamp_ns: int = 0


@dataclass(frozen=True, slots=True)
class Ros1GoalStatus:
    """actionlib_msgs/GoalStatus."""

    goal: GoalId
    code: Code
    text: str = ""


def goal_text(id: bytes) -> str:
    """Return the id that a goal of Ropeway has in ROS 1."""
    return str(uuid.UUID(bytes=id))


def goal_bytes(text: str) -> bytes:
    """Return the 16 bytes for a goal id of ROS 1: those it was made of, or a digest."""
    try:
        return uuid.UUID(text).bytes
    except ValueError:
        return hashlib.md5(text.encode(), usedforsecurity=False).digest()


# ── writing ────────────────────────────────────────────────────────────────────────────────────────────────────


def _time(ns: int) -> bytes:
    seconds, rest = divmod(ns, 1_000_000_000)
    return struct.pack("<II", seconds & 0xFFFFFFFF, rest)


def _text(text: str) -> bytes:
    raw = text.encode("utf-8", "replace")
    return struct.pack("<I", len(raw)) + raw


def _header() -> bytes:
    return b"\0\0\0\0" + _time(time.time_ns()) + b"\0\0\0\0"


def _id(goal: GoalId) -> bytes:
    return _time(goal.stamp_ns) + _text(goal.text)


def _status(status: Ros1GoalStatus) -> bytes:
    return _id(status.goal) + bytes((status.code,)) + _text(status.text)


def goal_message(goal: GoalId, body: bytes) -> bytes:
    """Return a NameActionGoal."""
    return _header() + _id(goal) + body


def cancel_message(text: str) -> bytes:
    """Return the GoalID that cancels one goal."""
    return _id(GoalId(text))


def report_message(status: Ros1GoalStatus, body: bytes) -> bytes:
    """Return a NameActionResult or NameActionFeedback."""
    return _header() + _status(status) + body


def statuses_message(statuses: Iterable[Ros1GoalStatus]) -> bytes:
    """Return a GoalStatusArray."""
    listed = [_status(status) for status in statuses]
    return _header() + struct.pack("<I", len(listed)) + b"".join(listed)


# ── reading ────────────────────────────────────────────────────────────────────────────────────────────────────


class _Cursor:
    def __init__(self, raw: bytes, type: str) -> None:
        self.raw, self.position, self._type = raw, 0, type

    def take(self, size: int) -> bytes:
        end = self.position + size
        if end > len(self.raw):
            raise DecodeError(self._type, "ROS 1", "the bytes end too early")
        piece, self.position = self.raw[self.position : end], end
        return piece

    def number(self) -> int:
        return int.from_bytes(self.take(4), "little")

    def text(self) -> str:
        return self.take(self.number()).decode("utf-8", "replace")

    def time(self) -> int:
        return self.number() * 1_000_000_000 + self.number()

    def header(self) -> None:
        self.take(12)
        self.text()

    def id(self) -> GoalId:
        stamp_ns = self.time()
        return GoalId(self.text(), stamp_ns)

    def status(self) -> Ros1GoalStatus:
        goal = self.id()
        code = self.take(1)[0]
        if code > Code.LOST:
            raise DecodeError(self._type, "ROS 1", f"{code} is not a status of a goal")
        return Ros1GoalStatus(goal, Code(code), self.text())

    def rest(self) -> bytes:
        return self.raw[self.position :]


def read_goal(raw: bytes) -> tuple[GoalId, bytes]:
    """Read id and goal of a NameActionGoal. Raises ``DecodeError``."""
    cursor = _Cursor(raw, "action goal")
    cursor.header()
    return cursor.id(), cursor.rest()


def read_cancel(raw: bytes) -> GoalId:
    """Read the GoalID of a request to cancel. Raises ``DecodeError``."""
    return _Cursor(raw, CANCEL_TYPE).id()


def read_report(raw: bytes) -> tuple[Ros1GoalStatus, bytes]:
    """Read status and result, or feedback. Raises ``DecodeError``."""
    cursor = _Cursor(raw, "action result")
    cursor.header()
    return cursor.status(), cursor.rest()


def read_statuses(raw: bytes) -> list[Ros1GoalStatus]:
    """Read the goals of a GoalStatusArray. Raises ``DecodeError``."""
    cursor = _Cursor(raw, STATUS_TYPE)
    cursor.header()
    count = cursor.number()
    if count > _GOALS_LIMIT:
        raise DecodeError(STATUS_TYPE, "ROS 1", f"{count} goals are too many")
    return [cursor.status() for _ in range(count)]
