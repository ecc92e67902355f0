"""The operations of the rosbridge protocol, one class each.

``to_dict`` writes the keys in the order of rosbridge, and of the original ROS Gateway (rosgw) where the operation
names its ``compression``; what has its default is left out. Bodies (``msg``, ``args``, ``values``) are as ``codec``
makes and takes them. Every class has ``ropeway``, an object for what Ropeway gateways tell each other; it is not
interpreted here.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal, TypeAlias

from ropeway.fault_log import ABSENT

__all__ = [
    "ABSENT",
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
    "present",
]


def present(id: object) -> bool:
    """Return whether the operation has an id, whatever it is."""
    return id is not ABSENT


class Operation:
    """The base of all operations. ``KEYS`` are in the order of rosbridge, ``ROSGW_KEYS`` in that of rosgw."""

    __slots__ = ()
    op: ClassVar[str]
    KEYS: ClassVar[tuple[str, ...]]
    ROSGW_KEYS: ClassVar[tuple[str, ...]] = ()
    id: Any
    compression: str | None = None
    ropeway: dict[str, Any] | None

    @property
    def about(self) -> tuple[str, str]:
        """The kind (``topic``, ``service`` or ``action``) and the name of what it is about; empty for others."""
        return "", ""

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object, or with a binary body the CBOR map."""
        cls = type(self)
        rosgw = cls.ROSGW_KEYS and self.compression is not None
        out: dict[str, Any] = {"op": cls.op}
        defaults = _DEFAULTS.get(cls) or _defaults(cls)
        for key in (*(cls.ROSGW_KEYS if rosgw else cls.KEYS), "ropeway"):
            default = defaults[key]
            value = getattr(self, key)
            if value is not default and (value != default or type(value) is not type(default)):
                out[key] = value
        return out


class TopicOperation(Operation):
    """The base of operations on a topic."""

    __slots__ = ()
    topic: str

    @property
    def about(self) -> tuple[str, str]:
        """See ``Operation.about``."""
        return "topic", self.topic


class ServiceOperation(Operation):
    """The base of operations on a service."""

    __slots__ = ()
    service: str

    @property
    def about(self) -> tuple[str, str]:
        """See ``Operation.about``."""
        return "service", self.service


class ActionOperation(Operation):
    """The base of operations on an action."""

    __slots__ = ()
    action: str

    @property
    def about(self) -> tuple[str, str]:
        """See ``Operation.about``."""
        return "action", self.action


def _defaults(cls: type[Operation]) -> dict[str, Any]:
    found = _DEFAULTS[cls] = {field.name: field.default for field in dataclasses.fields(cls)}  # type: ignore[arg-type]
    return found


_DEFAULTS: Final[dict[type[Operation], dict[str, Any]]] = {}


@dataclass(slots=True, kw_only=True)
class Advertise(TopicOperation):
    """I publish ``topic``. ``qos`` is rosbridge's object; ``latch`` and ``queue_size`` count only without it."""

    op: ClassVar[Literal["advertise"]] = "advertise"
    KEYS = ("id", "topic", "type", "latch", "queue_size", "qos", "compression")
    topic: str
    type: str
    id: Any = ABSENT
    latch: bool = False
    queue_size: int = 100
    qos: dict[str, Any] | None = None
    compression: str | None = None
    ropeway: dict[str, Any] | None = None


@dataclass(slots=True, kw_only=True)
class Unadvertise(TopicOperation):
    """I publish ``topic`` no more; with an ``id``, only that registration ends."""

    op: ClassVar[Literal["unadvertise"]] = "unadvertise"
    KEYS = ("id", "topic")
    topic: str
    id: Any = ABSENT
    ropeway: dict[str, Any] | None = None


@dataclass(slots=True, kw_only=True)
class Publish(TopicOperation):
    """A message: ``msg`` is an object, or bytes in the encodings of rosgw.

    ``type``, ``latch``, ``queue_size`` and ``qos`` count where the topic was not advertised.
    """

    op: ClassVar[Literal["publish"]] = "publish"
    KEYS = ("id", "topic", "msg", "type", "latch", "queue_size", "qos", "compression")
    topic: str
    msg: Any
    id: Any = ABSENT
    type: str | None = None
    latch: bool | None = None
    queue_size: int | None = None
    qos: dict[str, Any] | None = None
    compression: str | None = None
    ropeway: dict[str, Any] | None = None


@dataclass(slots=True, kw_only=True)
class Subscribe(TopicOperation):
    """Send me ``topic``.

    ``throttle_rate``: at most one message in so many milliseconds. ``queue_length``: so many may wait, 0 for none.
    ``fragment_size``: longer frames come in fragments of so many characters, ``None`` for never.
    """

    op: ClassVar[Literal["subscribe"]] = "subscribe"
    KEYS = ("id", "topic", "type", "throttle_rate", "queue_length", "fragment_size", "compression", "qos")
    topic: str
    id: Any = ABSENT
    type: str | None = None
    throttle_rate: float = 0
    queue_length: int = 0
    fragment_size: int | None = None
    compression: str | None = None
    qos: dict[str, Any] | None = None
    ropeway: dict[str, Any] | None = None


@dataclass(slots=True, kw_only=True)
class Unsubscribe(TopicOperation):
    """Send me ``topic`` no more; with an ``id``, only that subscription ends."""

    op: ClassVar[Literal["unsubscribe"]] = "unsubscribe"
    KEYS = ("id", "topic")
    topic: str
    id: Any = ABSENT
    ropeway: dict[str, Any] | None = None


@dataclass(slots=True, kw_only=True)
class CallService(ServiceOperation):
    """A request. ``service`` is as sent, perhaps with an old-style ``#id``; ``name`` is without.

    ``args`` is an object or a list of the fields' values. ``timeout`` in seconds, 0 and below for ever, ``None``
    where the client leaves it to the server. ``type`` is ignored by rosbridge.
    """

    op: ClassVar[Literal["call_service"]] = "call_service"
    KEYS = ("id", "service", "type", "args", "timeout", "fragment_size", "compression")
    service: str
    args: Any
    id: Any = ABSENT
    type: str | None = None
    timeout: float | None = None
    fragment_size: int | None = None
    compression: str | None = None
    ropeway: dict[str, Any] | None = None

    @property
    def name(self) -> str:
        """The service to call."""
        return self.service.partition("#")[0]


@dataclass(slots=True, kw_only=True)
class ServiceResponse(ServiceOperation):
    """An answer: ``values`` is the response, or with a false ``result`` a text that says what went wrong."""

    op: ClassVar[Literal["service_response"]] = "service_response"
    KEYS = ("service", "values", "result", "id")
    ROSGW_KEYS = ("service", "result", "id", "values", "compression")
    service: str
    values: Any
    result: bool
    id: Any = ABSENT
    compression: str | None = None
    ropeway: dict[str, Any] | None = None


@dataclass(slots=True, kw_only=True)
class AdvertiseService(ServiceOperation):
    """I answer calls of ``service``."""

    op: ClassVar[Literal["advertise_service"]] = "advertise_service"
    KEYS = ("id", "service", "type", "compression")
    service: str
    type: str
    id: Any = ABSENT
    compression: str | None = None
    ropeway: dict[str, Any] | None = None


@dataclass(slots=True, kw_only=True)
class UnadvertiseService(ServiceOperation):
    """I answer calls of ``service`` no more."""

    op: ClassVar[Literal["unadvertise_service"]] = "unadvertise_service"
    KEYS = ("id", "service")
    service: str
    id: Any = ABSENT
    ropeway: dict[str, Any] | None = None


@dataclass(slots=True, kw_only=True)
class SendActionGoal(ActionOperation):
    """A goal. ``action`` is as sent, perhaps with an old-style ``#id``; ``name`` is without."""

    op: ClassVar[Literal["send_action_goal"]] = "send_action_goal"
    KEYS = ("id", "action", "action_type", "args", "feedback", "fragment_size", "compression")
    action: str
    action_type: str
    args: Any
    id: Any = ABSENT
    feedback: bool = False
    fragment_size: int | None = None
    compression: str | None = None
    ropeway: dict[str, Any] | None = None

    @property
    def name(self) -> str:
        """The action that is meant."""
        return self.action.partition("#")[0]


@dataclass(slots=True, kw_only=True)
class CancelActionGoal(ActionOperation):
    """Stop the goal ``id``."""

    op: ClassVar[Literal["cancel_action_goal"]] = "cancel_action_goal"
    KEYS = ("id", "action")
    action: str
    id: Any = ABSENT
    ropeway: dict[str, Any] | None = None

    @property
    def name(self) -> str:
        """The action that is meant."""
        return self.action.partition("#")[0]


@dataclass(slots=True, kw_only=True)
class ActionFeedback(ActionOperation):
    """Reports the progress of a goal. ``goal_id`` and ``result`` are rosgw's."""

    op: ClassVar[Literal["action_feedback"]] = "action_feedback"
    KEYS = ("goal_id", "action", "values", "result", "id")
    ROSGW_KEYS = ("goal_id", "action", "result", "id", "values", "compression")
    action: str
    values: Any
    id: Any = ABSENT
    goal_id: str | None = None
    result: bool | None = None
    compression: str | None = None
    ropeway: dict[str, Any] | None = None


@dataclass(slots=True, kw_only=True)
class ActionResult(ActionOperation):
    """Reports the end of a goal: ``status`` as in action_msgs/GoalStatus (4 succeeded, 5 canceled, 6 aborted).

    With a false ``result`` there is no result and ``values`` is a text. ``goal_id`` is rosgw's.
    """

    op: ClassVar[Literal["action_result"]] = "action_result"
    KEYS = ("goal_id", "action", "values", "status", "result", "id")
    ROSGW_KEYS = ("goal_id", "action", "result", "id", "values", "compression")
    action: str
    values: Any
    status: int
    result: bool
    id: Any = ABSENT
    goal_id: str | None = None
    compression: str | None = None
    ropeway: dict[str, Any] | None = None


@dataclass(slots=True, kw_only=True)
class AdvertiseAction(ActionOperation):
    """I carry out goals of ``action``."""

    op: ClassVar[Literal["advertise_action"]] = "advertise_action"
    KEYS = ("id", "action", "type", "compression")
    action: str
    type: str
    id: Any = ABSENT
    compression: str | None = None
    ropeway: dict[str, Any] | None = None


@dataclass(slots=True, kw_only=True)
class UnadvertiseAction(ActionOperation):
    """I carry out goals of ``action`` no more."""

    op: ClassVar[Literal["unadvertise_action"]] = "unadvertise_action"
    KEYS = ("id", "action")
    action: str
    id: Any = ABSENT
    ropeway: dict[str, Any] | None = None


@dataclass(slots=True, kw_only=True)
class Fragment(Operation):
    """Carries part ``num`` (from 0) of the ``total`` parts of the text of an operation."""

    op: ClassVar[Literal["fragment"]] = "fragment"
    KEYS = ("id", "data", "num", "total")
    id: Any
    data: str
    num: int
    total: int
    ropeway: dict[str, Any] | None = None


@dataclass(slots=True, kw_only=True)
class Png(Operation):
    """The text of an operation as the pixels of a PNG image, in base64."""

    op: ClassVar[Literal["png"]] = "png"
    KEYS = ("data",)
    data: str
    id: Any = ABSENT  # it has none of its own
    ropeway: dict[str, Any] | None = None


@dataclass(slots=True, kw_only=True)
class Status(Operation):
    """A notice, as rosbridge had it for ROS 1: ``level`` is error, warning, info or none."""

    op: ClassVar[Literal["status"]] = "status"
    KEYS = ("id", "level", "msg")
    level: str
    msg: str
    id: Any = ABSENT
    ropeway: dict[str, Any] | None = None


Op: TypeAlias = (
    Advertise
    | Unadvertise
    | Publish
    | Subscribe
    | Unsubscribe
    | CallService
    | ServiceResponse
    | AdvertiseService
    | UnadvertiseService
    | SendActionGoal
    | CancelActionGoal
    | ActionFeedback
    | ActionResult
    | AdvertiseAction
    | UnadvertiseAction
    | Fragment
    | Png
    | Status
)
