"""Defines every error of the package, in one tree.

::

    RopewayError
    ├── ConfigError               a configuration cannot be used: where, what was expected, the nearest valid key
    ├── TypesError                message definitions and values
    │   ├── InvalidTypeName       not of the form pkg/Name or pkg/msg/Name
    │   ├── UnknownType           no definition is known for this name
    │   ├── InvalidDefinition     a .msg, .srv or .action text cannot be parsed
    │   ├── TypeConflict          one name, two definitions or two types
    │   ├── DecodeError           bytes that are not a message of this type (CDR, ROS 1, CBOR, LZ4, zstd)
    │   ├── ValueMismatch         a JSON or CBOR value that does not fit the field it is meant for
    │   └── ConversionError       a text of a robot, or a message, that its map cannot convert
    ├── WireError                 the rosbridge protocol
    │   ├── InvalidFrame          a frame that is neither JSON nor CBOR, or not an object with an "op"
    │   ├── InvalidOperation      an operation with a missing or ill-typed field, or one nobody knows
    │   └── MessageTooBig         above the limit of this connection
    ├── GraphError                a kind of network
    │   ├── GraphUnavailable      it cannot be opened, or has gone away
    │   ├── InvalidName           not a topic, service, action or node name
    │   └── CallError             a service call or an action goal without an answer
    │       ├── NotServed         nobody serves it
    │       ├── CallTimeout       no answer in time
    │       ├── ProviderLost      who served it, or the link to it, has gone in mid-call
    │       ├── CallFailed        the provider says why it did not do it
    │       └── GoalRejected      the action server does not take this goal
    ├── LinkError                 a connection between two gateways
    │   ├── ConnectFailed         nobody answered, or the answer was a refusal
    │   ├── Refused               the peer does not give, or take, what it was asked for
    │   └── OutboxFull            more calls and answers wait for the link than it may hold
    ├── OverlayError              the global overlay
    │   ├── IdentityError         a bundle, certificate or key that cannot be used
    │   └── SealError             what came sealed or signed is refused
    ├── StoreError                last values
    │   ├── StoreUnavailable      a database or a file that cannot be read or written now
    │   └── ValueRefused          a value that is not kept: too big, too many, or older than what is there
    ├── WaitTimeout               what a program waits for has not come in time; also a TimeoutError
    ├── MissingExtra              a part of the package that is not installed
    ├── ControlError              the control API of a running gateway
    │   ├── ControlUnavailable    its socket cannot be had, or nobody answers there
    │   │   └── NameTaken         another gateway that runs has the name
    │   ├── JournalError          what was changed cannot be written down, or read again
    │   └── ControlRefused        an answer that is an error: not allowed, not there, changed meanwhile
    ├── AccessDenied              a role, a glob or a limit of the server does not allow it
    └── BagUnreadable             a recording that is missing, damaged or of an unknown kind

An error carries what a program needs as attributes and says in its text what a person can do next.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from typing import Any, Final

from ropeway.limits import SHOWN_TEXT_CHARACTERS

__all__ = [
    "TOP_LEVEL",
    "AccessDenied",
    "BagUnreadable",
    "CallError",
    "CallFailed",
    "CallTimeout",
    "ConfigError",
    "ConnectFailed",
    "ControlError",
    "ControlRefused",
    "ControlUnavailable",
    "ConversionError",
    "DecodeError",
    "GoalRejected",
    "GraphError",
    "GraphUnavailable",
    "IdentityError",
    "InvalidDefinition",
    "InvalidFrame",
    "InvalidName",
    "InvalidOperation",
    "InvalidTypeName",
    "JournalError",
    "LinkError",
    "MessageTooBig",
    "MissingExtra",
    "NameTaken",
    "NotServed",
    "OutboxFull",
    "OverlayError",
    "ProviderLost",
    "RecordingFailed",
    "Refused",
    "RopewayError",
    "SealError",
    "StoreError",
    "StoreUnavailable",
    "TypeConflict",
    "TypesError",
    "UnknownType",
    "ValueMismatch",
    "ValueRefused",
    "WaitTimeout",
    "WireError",
]


TOP_LEVEL: Final = "(top level)"  # the path of a fault of a whole document


def _short(text: str) -> str:
    """Return a text of somebody else as far as people want to read it: errors are logged, and sent as answers."""
    return text if len(text) <= SHOWN_TEXT_CHARACTERS else f"{text[: SHOWN_TEXT_CHARACTERS - 1]}…"


class RopewayError(Exception):
    """The root of all errors that Ropeway raises on purpose."""


class ConfigError(RopewayError):
    """A configuration that cannot be used; ``problems`` has the JSON path of each fault and one line about it."""

    def __init__(self, problems: list[tuple[str, str]], source: str = "") -> None:
        self.problems = problems
        self.source = source
        where = f"{source}: " if source else ""
        lines = (where + (text if source and path == TOP_LEVEL else f"{path}: {text}") for path, text in problems)
        super().__init__("\n".join(lines))


class TypesError(RopewayError):
    """Raised for message definitions and values."""


class InvalidTypeName(TypesError):
    """A type name that is not of the form ``pkg/Name`` or ``pkg/msg/Name``."""

    def __init__(self, name: object) -> None:
        self.name = name
        expected = "expected pkg/Name or pkg/msg/Name, as in std_msgs/msg/String"
        super().__init__(f"{_short(repr(name))} is not a type name: {expected}")


class UnknownType(TypesError):
    """A type without a known definition. ``hint`` says what to do where that is not what most graphs need."""

    def __init__(self, name: str, *, needed_by: str = "", nearest: str = "", hint: str = "") -> None:
        self.name, self.needed_by, self.nearest = name, needed_by, nearest
        by = f" (needed by {needed_by})" if needed_by else ""
        if hint:
            advice = f": {hint}"
        elif nearest:
            advice = f"; did you mean {nearest}?"
        else:
            advice = '. Name its directory or file with --types, under "types" in a configuration, or with types= in a '
            advice += "program; or source the workspace that has it."
        super().__init__(f"the definition of {name} is not known{by}{advice}")


class InvalidDefinition(TypesError):
    """A definition text that cannot be parsed."""

    def __init__(self, name: str, reason: str, *, file: str = "") -> None:
        self.name, self.reason, self.file = name, reason, file
        super().__init__(f"{file + ': ' if file else ''}the definition of {name} cannot be used: {_short(reason)}")


class TypeConflict(TypesError):
    """Raised for one name with two types, or one type name with two definitions."""

    def __init__(self, name: str, known: str, offered: str) -> None:
        self.name, self.known, self.offered = name, known, offered
        super().__init__(f"{name} is already established with type {_short(known)}, not {_short(offered)}")


class DecodeError(TypesError):
    """Bytes that are not a message of the type they claim to be."""

    def __init__(self, type: str, encoding: str, reason: str) -> None:
        self.type, self.encoding, self.reason = type, encoding, reason
        super().__init__(f"{encoding} bytes are not a {type}: {reason}")


class ValueMismatch(TypesError):
    """A JSON or CBOR value that does not fit its field. ``field`` is a dotted path below the message."""

    def __init__(self, type: str, field: str, reason: str) -> None:
        self.type, self.field, self.reason = type, field, reason
        super().__init__(f"{type} message: field {field or '(root)'}: {reason}")


class ConversionError(TypesError):
    """A text of a robot, an answer of a web server, or a message, that its map or rule cannot convert."""


class WireError(RopewayError):
    """The rosbridge protocol."""


class InvalidFrame(WireError):
    """A frame that is neither JSON nor CBOR, or not an object.

    ``message`` is what could be read of it all the same: whoever waits for an answer to it is told by its ``id``.
    """

    def __init__(self, reason: str, size_bytes: int = 0, *, message: dict[Any, Any] | None = None) -> None:
        self.reason, self.size_bytes, self.message = reason, size_bytes, message
        super().__init__(reason)


class InvalidOperation(WireError):
    """An operation with a missing or ill-typed field, or an unknown one."""

    def __init__(self, op: str, reason: str, *, id: object = None) -> None:
        self.op, self.reason, self.id = op, reason, id
        super().__init__(f"{op}: {reason}" if op else reason)


class MessageTooBig(WireError):
    """A message above the limit of its connection."""

    def __init__(self, size_bytes: int, limit_bytes: int) -> None:
        self.size_bytes, self.limit_bytes = size_bytes, limit_bytes
        super().__init__(f"a message of {size_bytes} bytes is above the limit of {limit_bytes} bytes")


class MissingExtra(RopewayError):
    """A part of the package that only some users need, and that is not installed."""

    def __init__(self, extra: str, purpose: str) -> None:
        self.extra, self.purpose = extra, purpose
        super().__init__(f"{purpose} needs more than is installed: pip install 'ropeway[{extra}]'")


class GraphError(RopewayError):
    """A kind of network."""


class GraphUnavailable(GraphError):
    """A graph that cannot be opened, or has gone away."""

    def __init__(self, graph: str, reason: str) -> None:
        self.graph, self.reason = graph, reason
        super().__init__(f"{graph}: {reason}")


class InvalidName(GraphError):
    """A text that is not a topic, service, action or node name."""

    def __init__(self, name: object, reason: str) -> None:
        self.name, self.reason = name, reason
        super().__init__(f"{_short(repr(name))} is not a valid name: {reason}")


class CallError(GraphError):
    """A service call or an action goal without an answer. ``name`` is the service or action."""

    def __init__(self, name: str, text: str) -> None:
        self.name = name
        super().__init__(text)


class NotServed(CallError):
    """Raised when nobody serves a name. The texts are those of rosbridge. ``kind`` is ``service`` or ``action``."""

    def __init__(self, name: str, kind: str = "service") -> None:
        self.kind = kind
        super().__init__(name, f"Service {name} does not exist" if kind == "service" else "No action server available")


class CallTimeout(CallError):
    """Raised when no answer came in time. The text for a service is that of rosbridge."""

    def __init__(self, name: str, timeout_s: float, kind: str = "service") -> None:
        self.timeout_s, self.kind = timeout_s, kind
        text = "Timeout exceeded while waiting for service response"
        super().__init__(name, text if kind == "service" else f"{name} gave no answer within {timeout_s:g} s")


class ProviderLost(CallError):
    """Raised when the provider, or the link to it, vanished in mid-call; the call may or may not have been
    carried out.
    """

    def __init__(self, name: str, reason: str) -> None:
        self.reason = reason
        super().__init__(name, f"{name} was not answered: {reason}")


class CallFailed(CallError):
    """The provider says why it did not do it; ``str(error)`` is what it said."""


class GoalRejected(CallError):
    """The action server does not take this goal. The text is that of rosbridge."""

    def __init__(self, name: str) -> None:
        super().__init__(name, "Action goal was rejected")


class LinkError(RopewayError):
    """A connection between two gateways."""


class ConnectFailed(LinkError):
    """Raised when a peer did not answer or refused the connection. ``retryable`` tells whether trying again
    can help.
    """

    def __init__(self, address: str, reason: str, *, retryable: bool = True) -> None:
        self.address, self.reason, self.retryable = address, reason, retryable
        super().__init__(f"{address}: {reason}")


class Refused(LinkError):
    """The peer at ``address`` does not give, or take, the topic ``name``; ``reason`` is what it says."""

    def __init__(self, address: str, name: str, reason: str) -> None:
        self.address, self.name, self.reason = address, name, reason
        super().__init__(f"{address}: {name} was refused: {_short(reason)}")


class OutboxFull(LinkError):
    """Raised when more calls and answers wait for the link than it may hold: it is slow, or its peer does not read."""

    def __init__(self, address: str, waiting_bytes: int, limit_bytes: int) -> None:
        self.address, self.waiting_bytes, self.limit_bytes = address, waiting_bytes, limit_bytes
        super().__init__(
            f"{address}: {waiting_bytes} bytes of calls and answers wait for the link, which may hold {limit_bytes}"
        )


class OverlayError(RopewayError):
    """The global overlay."""


class IdentityError(OverlayError):
    """A bundle, a certificate or a key that cannot be used; ``reason`` says why and what to do."""

    def __init__(self, what: str, reason: str) -> None:
        self.what, self.reason = what, reason
        super().__init__(f"{what}: {reason}")


class SealError(OverlayError):
    """Raised for sealed or signed data that is refused; ``reason`` is a
    ``ropeway.networks.overlay.refusal.Refusal``.
    """

    def __init__(self, reason: enum.Enum, detail: str = "") -> None:
        self.reason, self.detail = reason, detail
        super().__init__(f"{reason.value}{f': {detail}' if detail else ''}")


class StoreError(RopewayError):
    """Raised for last values that cannot be read or kept."""


class StoreUnavailable(StoreError):
    """A database or a file that cannot be read or written now. ``url`` names it."""

    def __init__(self, url: str, reason: str) -> None:
        self.url, self.reason = url, reason
        super().__init__(f"{url}: {reason}")


class ValueRefused(StoreError):
    """A value that is not kept. ``code`` is a word for programs: ``too-big``, ``full``, ``stale`` or ``name``."""

    def __init__(self, system: str, topic: str, code: str, reason: str) -> None:
        self.system, self.topic, self.code, self.reason = system, topic, code, reason
        super().__init__(f"{system}/{topic}: {reason}")


class WaitTimeout(RopewayError, TimeoutError):
    """Raised when something that a program waits for has not come in time: a message, a subscriber, the type of a
    topic.
    """

    def __init__(self, waiting_for: str, timeout_s: float, hint: str = "") -> None:
        self.waiting_for, self.timeout_s = waiting_for, timeout_s
        super().__init__(f"no {waiting_for} within {timeout_s:g} s{f'; {hint}' if hint else ''}")


class AccessDenied(RopewayError):
    """A rule of the server does not allow what a client asks for.

    ``verb`` is one of ``authorization.VERBS``, ``name`` the topic, service or action, ``rule`` what denied it.
    """

    def __init__(self, verb: str, name: str, rule: str) -> None:
        self.verb, self.name, self.rule = verb, name, rule
        super().__init__(f"{verb.replace('_', ' ')} {name}: not allowed: {rule}")


class ControlError(RopewayError):
    """The control API of a running gateway."""


class ControlUnavailable(ControlError):
    """A socket that cannot be had, or where nobody answers. ``where`` is its path or address."""

    def __init__(self, where: str, reason: str) -> None:
        self.where, self.reason = where, reason
        super().__init__(f"{where}: {reason}")


class NameTaken(ControlUnavailable):
    """Raised where another gateway that runs has the name."""


class JournalError(ControlError):
    """A journal that cannot be written or read. ``path`` is its file."""

    def __init__(self, path: str, reason: str) -> None:
        self.path, self.reason = path, reason
        super().__init__(f"the journal {path}: {reason}")


class ControlRefused(ControlError):
    """An answer of the control API that is an error.

    ``status`` is that of HTTP; ``details`` are what programs need; ``headers`` are sent with the answer.
    """

    def __init__(
        self,
        status: int,
        text: str,
        details: Mapping[str, Any] | None = None,
        *,
        headers: Mapping[str, str] | None = None,
    ) -> None:
        self.status, self.text, self.details, self.headers = status, text, dict(details or {}), dict(headers or {})
        super().__init__(text)


class BagUnreadable(RopewayError):
    """A recording that cannot be read."""

    def __init__(self, path: str, reason: str) -> None:
        self.path, self.reason = path, reason
        super().__init__(f"{path}: {reason}")


class RecordingFailed(RopewayError):
    """A recording that cannot be written."""

    def __init__(self, path: str, reason: str) -> None:
        self.path, self.reason = path, reason
        super().__init__(f"{path}: {reason}")
