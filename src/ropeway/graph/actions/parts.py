"""Defines the parts of an action: the names and types of its services and topics, and their payloads."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any, Final

from ropeway.errors import DecodeError, UnknownType, ValueMismatch
from ropeway.graph.base import resolve_name
from ropeway.graph.calls import ActionInfo, GoalStatus, ServiceInfo
from ropeway.qos import LATCHED, QoS
from ropeway.types import TypeRegistry

__all__ = [
    "CANCEL_TYPE",
    "ERROR_GOAL_TERMINATED",
    "ERROR_NONE",
    "ERROR_REJECTED",
    "ERROR_UNKNOWN_GOAL_ID",
    "FEEDBACK_QOS",
    "NO_GOAL",
    "STATUS_QOS",
    "STATUS_TYPE",
    "ActionParts",
    "action_of_service",
    "actions_of",
    "parts_of_action",
    "service_of_action",
    "status_array",
    "status_entry",
]

CANCEL_TYPE: Final = "action_msgs/srv/CancelGoal"
STATUS_TYPE: Final = "action_msgs/msg/GoalStatusArray"
FEEDBACK_QOS: Final = QoS(depth=10)
STATUS_QOS: Final = LATCHED
NO_GOAL: Final = bytes(16)

ERROR_NONE: Final = 0
ERROR_REJECTED: Final = 1
ERROR_UNKNOWN_GOAL_ID: Final = 2
ERROR_GOAL_TERMINATED: Final = 3

_HEADER_BYTES: Final = 4
_ID_BYTES: Final = 16
_SEND_GOAL: Final = "/_action/send_goal"
_SECOND_NS: Final = 1_000_000_000
_HEADER: Final = b"\0\1\0\0"
_COUNT: Final = struct.Struct("<I")
_ACCEPTED: Final = struct.Struct("<4s?3xiI")
_STATUS: Final = struct.Struct("<16s3xiIb")  # begins one byte after a multiple of four, for a status is a byte
_STATUS_PADDING: Final = slice(16, 19)  # which the first of a message has not


def parts_of_action(action: str, type: str) -> list[tuple[str, str, str]]:
    """Return the kind (``service``, ``topic``), name and type of all that an action is made of, sending goals first."""
    return [
        ("service", action + _SEND_GOAL, f"{type}_SendGoal"),
        ("service", f"{action}/_action/cancel_goal", CANCEL_TYPE),
        ("service", f"{action}/_action/get_result", f"{type}_GetResult"),
        ("topic", f"{action}/_action/feedback", f"{type}_FeedbackMessage"),
        ("topic", f"{action}/_action/status", STATUS_TYPE),
    ]


class ActionParts:
    """Provides the names, types and payloads of one action.

    Raises ``UnknownType`` if ``registry`` does not know the action, ``InvalidName``, ``InvalidTypeName``. A goal id
    is 16 bytes, which keep the alignment of what follows; so goals and feedback are cut out of the messages that
    carry them and set in, and never decoded.
    """

    def __init__(self, action: str, type: str, registry: TypeRegistry) -> None:
        self.action = resolve_name(action)
        self.type = registry.canonical(type, "action")
        self.send_goal = self.action + _SEND_GOAL
        self.cancel_goal = f"{self.action}/_action/cancel_goal"
        self.get_result = f"{self.action}/_action/get_result"
        self.feedback = f"{self.action}/_action/feedback"
        self.status = f"{self.action}/_action/status"
        self.send_goal_type = f"{self.type}_SendGoal"
        self.get_result_type = f"{self.type}_GetResult"
        self.feedback_type = f"{self.type}_FeedbackMessage"
        try:
            self._result = registry.codec(f"{self.type}_Result")
            self._get_result_response = registry.codec(f"{self.type}_GetResult_Response")
        except UnknownType as error:
            if error.name.startswith(self.type):
                raise UnknownType(self.type, needed_by=f"action {self.action}", nearest=error.nearest) from None
            raise
        self._accepted = registry.codec(f"{self.type}_SendGoal_Response")
        self._cancel_request = registry.codec(f"{CANCEL_TYPE}_Request")
        self._cancel_response = registry.codec(f"{CANCEL_TYPE}_Response")

    def join(self, id: bytes, payload: bytes) -> bytes:
        """Return the CDR of ``…_SendGoal_Request`` or ``…_FeedbackMessage`` around a goal or a feedback."""
        return payload[:_HEADER_BYTES] + id + payload[_HEADER_BYTES:]

    def split(self, message: bytes) -> tuple[bytes, bytes]:
        """Return the goal id and the CDR of the goal or feedback in such a message. Raises ``DecodeError``."""
        body = _HEADER_BYTES + _ID_BYTES
        if len(message) < body:
            raise DecodeError(self.type, "CDR", f"{len(message)} bytes are too few for a goal id")
        return bytes(message[_HEADER_BYTES:body]), bytes(message[:_HEADER_BYTES] + message[body:])

    def accepted(self, accepted: bool, stamp_ns: int) -> bytes:
        """Return the CDR of ``…_SendGoal_Response``."""
        return _ACCEPTED.pack(_HEADER, accepted, *divmod(stamp_ns, _SECOND_NS))

    def is_accepted(self, response: bytes) -> bool:
        """Return whether a ``…_SendGoal_Response`` accepts the goal. Raises ``DecodeError``."""
        return bool(self._accepted.decode(response)["accepted"])

    def result_request(self, id: bytes) -> bytes:
        """Return the CDR of ``…_GetResult_Request``."""
        return _HEADER + id

    def result(self, status: GoalStatus, payload: bytes | None) -> bytes:
        """Return the CDR of ``…_GetResult_Response``; without a payload it holds the default values.

        Raises ``DecodeError``.
        """
        result = self._result.decode(payload) if payload is not None else {}
        return self._get_result_response.encode({"status": int(status), "result": result})

    def outcome(self, response: bytes) -> tuple[int, bytes]:
        """Return the status and the CDR of the result in a ``…_GetResult_Response``. Raises ``DecodeError``."""
        message = self._get_result_response.decode(response)
        try:
            return message["status"], self._result.encode(message["result"])
        except ValueMismatch as error:
            raise DecodeError(self.type, "CDR", error.reason) from None

    def cancel_request(self, id: bytes = NO_GOAL, stamp_ns: int = 0) -> bytes:
        """Return the CDR of ``CancelGoal_Request``."""
        return self._cancel_request.encode({"goal_info": _info(id, stamp_ns)})

    def cancel_wish(self, request: bytes) -> tuple[bytes, int]:
        """Return the goal id and the time (ns) in a ``CancelGoal_Request``. Raises ``DecodeError``."""
        info = self._cancel_request.decode(request)["goal_info"]
        return bytes(info["goal_id"]["uuid"]), _nanoseconds(info["stamp"])

    def cancelling(self, code: int, goals: list[tuple[bytes, int]]) -> bytes:
        """Return the CDR of ``CancelGoal_Response``: the code, and id and acceptance time (ns) of the goals
        that end.
        """
        return self._cancel_response.encode({"return_code": code, "goals_canceling": [_info(*goal) for goal in goals]})

    def cancel_answer(self, response: bytes) -> tuple[int, list[bytes]]:
        """Return the code and the goal ids in a ``CancelGoal_Response``. Raises ``DecodeError``."""
        message = self._cancel_response.decode(response)
        return message["return_code"], [bytes(info["goal_id"]["uuid"]) for info in message["goals_canceling"]]


def status_entry(id: bytes, stamp_ns: int, status: GoalStatus) -> bytes:
    """Return id, acceptance time and status of one goal, for ``status_array``."""
    return _STATUS.pack(id, *divmod(stamp_ns, _SECOND_NS), status)


def status_array(entries: Sequence[bytes]) -> bytes:
    """Return the CDR of ``GoalStatusArray``. Entries are joined as they are: a server tells of hundreds of goals at
    each step of one.
    """
    message = bytearray(_HEADER + _COUNT.pack(len(entries)))
    begins = len(message)
    message += b"".join(entries)
    if entries:
        del message[begins + _STATUS_PADDING.start : begins + _STATUS_PADDING.stop]
    return bytes(message)


def _time(stamp_ns: int) -> dict[str, int]:
    seconds, nanoseconds = divmod(stamp_ns, _SECOND_NS)
    return {"sec": seconds, "nanosec": nanoseconds}


def _nanoseconds(time: Mapping[str, Any]) -> int:
    return int(time["sec"]) * _SECOND_NS + int(time["nanosec"])


def _info(id: bytes, stamp_ns: int) -> dict[str, Any]:
    return {"goal_id": {"uuid": id}, "stamp": _time(stamp_ns)}


def action_of_service(service: str, type: str = "") -> tuple[str, str] | None:
    """Return the action, and its type, whose goals the service ``service`` takes, ``None`` for other services."""
    name = service.removesuffix(_SEND_GOAL)
    if not name or name == service:
        return None
    return name, type.removesuffix("_SendGoal")


def service_of_action(action: str) -> str:
    """Return the name of the service that takes the goals of an action."""
    return action + _SEND_GOAL


def actions_of(services: Mapping[str, ServiceInfo]) -> dict[str, ActionInfo]:
    """Return the actions that the listed services belong to, by name."""
    found: dict[str, ActionInfo] = {}
    for info in services.values():
        action = action_of_service(info.name)
        if action is not None:
            types = tuple(type.removesuffix("_SendGoal") for type in info.types)
            found[action[0]] = ActionInfo(action[0], types, info.servers, info.clients)
    return found
