"""Reading and writing the operations of the rosbridge protocol.

``parse`` checks as rosbridge does, with its texts, and tolerates what clients are known to send besides: ``null``
for a number that has a default, fractions, a missing ``status``. The classes are those of
``ropeway.networks.rosbridge.protocol.operations``.
"""

from __future__ import annotations

import codecs
import json
import math
from collections.abc import Callable, Mapping
from typing import Any, Final

import orjson

from ropeway.errors import InvalidOperation
from ropeway.limits import ID_CHARACTERS, NAME_CHARACTERS
from ropeway.networks.rosbridge.protocol.operations import (
    ABSENT,
    ActionFeedback,
    ActionResult,
    Advertise,
    AdvertiseAction,
    AdvertiseService,
    CallService,
    CancelActionGoal,
    Fragment,
    Op,
    Operation,
    Png,
    Publish,
    SendActionGoal,
    ServiceResponse,
    Status,
    Subscribe,
    Unadvertise,
    UnadvertiseAction,
    UnadvertiseService,
    Unsubscribe,
    present,
)
from ropeway.networks.rosbridge.protocol.plain_calls import plain_call, plain_response

__all__ = [
    "ABSENT",
    "ALLOWED",
    "ActionFeedback",
    "ActionResult",
    "Advertise",
    "AdvertiseAction",
    "AdvertiseService",
    "CallService",
    "CancelActionGoal",
    "Fragment",
    "Op",
    "Operation",
    "Png",
    "Publish",
    "SendActionGoal",
    "ServiceResponse",
    "Status",
    "Subscribe",
    "Unadvertise",
    "UnadvertiseAction",
    "UnadvertiseService",
    "Unsubscribe",
    "dumps",
    "parse",
    "present",
]


# --- writing ----------------------------------------------------------------------------------------------------


def dumps(message: Mapping[str, Any]) -> bytes:
    """Return a JSON object in pure ASCII, as rosbridge clients expect it; ``orjson.Fragment`` values go in unchanged.

    Raises ``TypeError`` for what JSON cannot say (bytes).
    """
    try:
        data = orjson.dumps(message)
    except orjson.JSONEncodeError:  # an id may be a number beyond 64 bits
        return json.dumps(message, separators=(",", ":")).encode("ascii")
    return data if data.isascii() else data.decode().encode("ascii", "ropeway-json")


def _escape(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeEncodeError)
    units = error.object[error.start : error.end].encode("utf-16-be").hex()
    return "".join(f"\\u{units[i : i + 4]}" for i in range(0, len(units), 4)), error.end


codecs.register_error("ropeway-json", _escape)


# --- reading ----------------------------------------------------------------------------------------------------


def parse(message: Mapping[Any, Any]) -> Op:
    """Parse an operation from a JSON object or CBOR map. Raises ``InvalidOperation``."""
    op = message.get("op", ABSENT)
    if op == "call_service":
        if (call := plain_call(message)) is not None:
            return call
    elif op == "service_response" and (response := plain_response(message)) is not None:
        return response
    read = _READERS.get(op) if isinstance(op, str) else None
    if read is not None:
        return read(_Fields(message, op))
    id = _id_of(message)
    if op is ABSENT:
        reason = "Received a message without an op.  All messages require 'op' field with value one of: "
        raise InvalidOperation("", f"{reason}{list(ALLOWED)}", id=id)
    raise InvalidOperation("", f"Unknown operation: {_show(op)}.  Allowed operations: {list(ALLOWED)}", id=id)


_NAMED_CHARACTERS: Final = NAME_CHARACTERS + ID_CHARACTERS  # an old client's id stands behind the name
_SCALARS: Final = frozenset((str, int, float, bool, type(None)))


def _show(value: object) -> str:
    """Return a value for an error's text, short however big it is."""
    if isinstance(value, str):
        return value[:100]
    return str(value)[:100] if type(value) in _SCALARS else f"<{type(value).__name__}>"


def _id_of(message: Mapping[Any, Any]) -> Any:
    """Return the id, whatever it is; ``null`` counts as none, as in rosbridge: it is not repeated in answers."""
    id = message.get("id")
    return ABSENT if id is None else id


def _id_characters(id: Any) -> float:
    """Return how long an id is in JSON; infinity for one that only CBOR can say."""
    if isinstance(id, str):
        return len(id)
    if type(id) in _SCALARS and not isinstance(id, int):
        return 0
    if isinstance(id, int):
        return id.bit_length() / 3
    try:
        return len(orjson.dumps(id))
    except orjson.JSONEncodeError:
        return math.inf


class _Fields:
    """The fields of one operation, checked as they are asked for."""

    __slots__ = ("_message", "_op", "id")

    def __init__(self, message: Mapping[Any, Any], op: str) -> None:
        self._message, self._op = message, op
        self.id = _id_of(message)
        if self.id is not ABSENT and _id_characters(self.id) > ID_CHARACTERS:
            wrong, self.id = self.id, ABSENT  # it is kept, and repeated in answers: in JSON, and each time
            raise self._wrong("id", wrong, f"str of at most {ID_CHARACTERS} characters")

    def invalid(self, reason: str) -> InvalidOperation:
        return InvalidOperation(self._op, reason, id=self.id)

    def _wrong(self, key: str, value: object, *types: str) -> InvalidOperation:
        classes = ", ".join(f"<class '{name}'>" for name in types) + ("," if len(types) == 1 else "")
        return self.invalid(f"Expected field {key} to be one of ({classes}). Invalid value: {_show(value)}")

    def raw(self, key: str, default: Any = None) -> Any:
        return self._message.get(key, default)

    def text(self, key: str) -> str:
        value = self._message.get(key, ABSENT)
        if isinstance(value, str):
            return value
        if value is ABSENT:
            raise self.invalid(f"Expected a {key} field but none was found.")
        raise self._wrong(key, value, "str")

    def name(self, key: str) -> str:
        """Return a text that is looked up and kept; what is longer than any name is refused before it costs more."""
        value = self.text(key)
        if len(value) > _NAMED_CHARACTERS:
            raise self._too_long(key, value)
        return value

    def optional_name(self, key: str) -> str | None:
        """Return a name, if there is one."""
        value = self.optional_text(key)
        if value is not None and len(value) > _NAMED_CHARACTERS:
            raise self._too_long(key, value)
        return value

    def _too_long(self, key: str, value: str) -> InvalidOperation:
        return self.invalid(f"The {key} has {len(value)} characters; at most {_NAMED_CHARACTERS} are taken.")

    def optional_text(self, key: str) -> str | None:
        value = self._message.get(key)
        if value is None or isinstance(value, str):
            return value
        raise self._wrong(key, value, "str")

    def object(self, key: str) -> dict[str, Any] | None:
        value = self._message.get(key)
        if value is None or isinstance(value, dict):
            return value
        raise self._wrong(key, value, "dict")

    def truth(self, key: str) -> bool:
        value = self._message.get(key, ABSENT)
        if isinstance(value, bool):
            return value
        if value is ABSENT:
            raise self.invalid(f"Expected a {key} field but none was found.")
        raise self._wrong(key, value, "bool")

    def number(self, key: str) -> float | None:
        """Return a finite number, if there is one."""
        value = self._message.get(key)
        if value is None:
            return None
        if not isinstance(value, (int, float)):
            raise self._wrong(key, value, "int")
        if isinstance(value, float) and not math.isfinite(value):
            return None
        return value

    def count(self, key: str, default: int) -> int:
        value = self.number(key)
        return default if value is None else max(0, int(value))

    def size(self, key: str = "fragment_size") -> int | None:
        return self.count(key, 0) or None

    def id_or_suffix(self, name: str) -> Any:
        """Return the id, or what follows ``#`` in an old client's name."""
        if self.id is ABSENT:
            _, mark, suffix = name.partition("#")
            return suffix if mark else ABSENT
        return self.id


def _advertise(f: _Fields) -> Advertise:
    return Advertise(
        topic=f.name("topic"),
        type=f.name("type"),
        id=f.id,
        latch=bool(f.raw("latch")),
        queue_size=_lenient_count(f.raw("queue_size"), 100),
        qos=f.object("qos"),
        compression=f.optional_name("compression"),
        ropeway=f.object("ropeway"),
    )


def _lenient_count(value: object, default: int) -> int:
    """Return a count from a field that rosbridge does not check."""
    if isinstance(value, (int, float)) and math.isfinite(value):
        return max(0, int(value))
    return default


def _publish(f: _Fields) -> Publish:
    topic = f.name("topic")
    msg = f.raw("msg", ABSENT)
    if not isinstance(msg, (dict, bytes)):
        if msg is not ABSENT:
            raise f._wrong("msg", msg, "dict")
        msg = {}
    latch, queue_size = f.raw("latch"), f.raw("queue_size")
    return Publish(
        topic=topic,
        msg=msg,
        id=f.id,
        type=f.optional_name("type"),
        latch=None if latch is None else bool(latch),
        queue_size=None if queue_size is None else _lenient_count(queue_size, 100),
        qos=f.object("qos"),
        compression=f.optional_name("compression"),
        ropeway=f.object("ropeway"),
    )


def _subscribe(f: _Fields) -> Subscribe:
    return Subscribe(
        topic=f.name("topic"),
        id=f.id,
        type=f.optional_name("type"),
        throttle_rate=max(0, f.number("throttle_rate") or 0),
        queue_length=f.count("queue_length", 0),
        fragment_size=f.size(),
        compression=f.optional_name("compression"),
        qos=f.object("qos"),
        ropeway=f.object("ropeway"),
    )


def _call_service(f: _Fields) -> CallService:
    service = f.name("service")
    type = f.raw("type")
    f.id = f.id_or_suffix(service)
    return CallService(
        service=service,
        args=f.raw("args"),
        id=f.id,
        type=type if isinstance(type, str) and len(type) <= _NAMED_CHARACTERS else None,
        timeout=f.number("timeout"),
        fragment_size=f.size(),
        compression=f.optional_name("compression"),
        ropeway=f.object("ropeway"),
    )


def _service_response(f: _Fields) -> ServiceResponse:
    return ServiceResponse(
        service=f.name("service"),
        values=f.raw("values"),
        result=f.truth("result"),
        id=f.id,
        compression=f.optional_name("compression"),
        ropeway=f.object("ropeway"),
    )


def _send_action_goal(f: _Fields) -> SendActionGoal:
    action = f.name("action")
    f.id = f.id_or_suffix(action)
    return SendActionGoal(
        action=action,
        action_type=f.name("type" if f.raw("action_type") is None and f.raw("type") is not None else "action_type"),
        args=f.raw("args"),
        id=f.id,
        feedback=bool(f.raw("feedback")),
        fragment_size=f.size(),
        compression=f.optional_name("compression"),
        ropeway=f.object("ropeway"),
    )


def _action_feedback(f: _Fields) -> ActionFeedback:
    result = f.raw("result")
    return ActionFeedback(
        action=f.name("action"),
        values=f.raw("values"),
        id=f.id,
        goal_id=f.optional_name("goal_id"),
        result=result if isinstance(result, bool) else None,
        compression=f.optional_name("compression"),
        ropeway=f.object("ropeway"),
    )


def _action_result(f: _Fields) -> ActionResult:
    action = f.name("action")
    result = f.truth("result")
    return ActionResult(
        action=action,
        values=f.raw("values"),
        status=f.count("status", 4 if result else 6),
        result=result,
        id=f.id,
        goal_id=f.optional_name("goal_id"),
        compression=f.optional_name("compression"),
        ropeway=f.object("ropeway"),
    )


def _fragment(f: _Fields) -> Fragment:
    if f.id is ABSENT:
        raise f.invalid("received invalid fragment! No message ID found.")
    data, num, total = f.raw("data"), f.raw("num"), f.raw("total")
    if (
        not isinstance(data, str)
        or not isinstance(num, int)
        or not isinstance(total, (int, float))
        or not 0 <= num < total < 1e9
    ):
        raise f.invalid("received invalid fragment!")
    # servers before 2.0.8 tell the total as a fraction
    return Fragment(id=f.id, data=data, num=num, total=math.ceil(total), ropeway=f.object("ropeway"))


_READERS: Final[dict[str, Callable[[_Fields], Op]]] = {
    "advertise": _advertise,
    "unadvertise": lambda f: Unadvertise(topic=f.name("topic"), id=f.id, ropeway=f.object("ropeway")),
    "publish": _publish,
    "subscribe": _subscribe,
    "unsubscribe": lambda f: Unsubscribe(topic=f.name("topic"), id=f.id, ropeway=f.object("ropeway")),
    "fragment": _fragment,
    "advertise_service": lambda f: AdvertiseService(
        service=f.name("service"),
        type=f.name("type"),
        id=f.id,
        compression=f.optional_name("compression"),
        ropeway=f.object("ropeway"),
    ),
    "unadvertise_service": lambda f: UnadvertiseService(
        service=f.name("service"), id=f.id, ropeway=f.object("ropeway")
    ),
    "call_service": _call_service,
    "service_response": _service_response,
    "advertise_action": lambda f: AdvertiseAction(
        action=f.name("action"),
        type=f.name("type"),
        id=f.id,
        compression=f.optional_name("compression"),
        ropeway=f.object("ropeway"),
    ),
    "unadvertise_action": lambda f: UnadvertiseAction(action=f.name("action"), id=f.id, ropeway=f.object("ropeway")),
    "send_action_goal": _send_action_goal,
    "cancel_action_goal": lambda f: CancelActionGoal(
        action=(action := f.name("action")), id=f.id_or_suffix(action), ropeway=f.object("ropeway")
    ),
    "action_feedback": _action_feedback,
    "action_result": _action_result,
    "png": lambda f: Png(data=f.text("data"), ropeway=f.object("ropeway")),
    "status": lambda f: Status(
        level=f.optional_text("level") or "", msg=_show(f.raw("msg")), id=f.id, ropeway=f.object("ropeway")
    ),
}

ALLOWED: Final = tuple(op for op in _READERS if op not in ("png", "status"))
"""The operations that a server carries out, in the order of its error text."""
