"""Describes calls and goals on a link: who and which they are, and why one failed.

Both roles use these notes. Every peer gets a text that says what went wrong; Ropeway gateways also get a code word.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from ropeway.errors import (
    AccessDenied,
    CallError,
    CallFailed,
    CallTimeout,
    GoalRejected,
    NotServed,
    ProviderLost,
)
from ropeway.graph.calls import Goal, Request, new_id

__all__ = ["CallNote", "call_note", "failure", "read_note", "received"]

_WORDS: Final[dict[type[BaseException], str]] = {
    NotServed: "not_served",
    CallTimeout: "timeout",
    ProviderLost: "lost",
    GoalRejected: "rejected",
    AccessDenied: "denied",
}
_NOT_SERVED: Final = re.compile(r"Service \S+ does not exist|No action server available")
_TIMEOUT: Final = "Timeout exceeded while waiting for service response"
_REJECTED: Final = "Action goal was rejected"
_TEXT_LIMIT: Final = 4096  # characters of what a peer says went wrong
_NAME_LIMIT: Final = 200  # characters of an id or a name
_VIA_LIMIT: Final = 64  # gateways
_new: Final = tuple.__new__  # of named tuples, without a call of Python


class CallNote(NamedTuple):
    """Identifies a call or goal; see ``Request``."""

    id: bytes
    via: tuple[str, ...]
    caller: str
    encoding: str


def call_note(request: Request | Goal, gateway_id: str, encoding: str = "auto") -> dict[str, Any]:
    """Return the ``ropeway`` object of a call or goal that this gateway passes on."""
    note: dict[str, Any] = {"call": request.id.hex(), "via": [*request.via, gateway_id] if gateway_id else request.via}
    if request.caller:
        note["caller"] = request.caller
    if encoding != "auto":
        note["encoding"] = encoding
    return note


def read_note(note: Mapping[str, Any] | None) -> CallNote:
    """Read a ``ropeway`` object; whatever is missing or invalid gets its default, the id a new one."""
    note = note or {}
    try:
        id = bytes.fromhex(str(note.get("call", "")))
    except ValueError:
        id = b""
    via: list[str] = []
    gateways = note.get("via")
    for gateway in gateways if isinstance(gateways, (list, tuple)) else ():
        if isinstance(gateway, str) and len(via) < _VIA_LIMIT:
            via.append(gateway[:_NAME_LIMIT])
    caller, encoding = note.get("caller"), note.get("encoding")
    return _new(
        CallNote,
        (
            id if len(id) == 16 else new_id(),
            tuple(via),
            caller[:_NAME_LIMIT] if isinstance(caller, str) else "",
            encoding if isinstance(encoding, str) else "auto",
        ),
    )


def failure(error: BaseException) -> tuple[dict[str, Any], str]:
    """Return the ``ropeway`` object and the text for an error."""
    note = {"error": _WORDS.get(type(error), "failed")}
    if isinstance(error, ProviderLost):
        note["reason"] = error.reason
    return note, str(error) or type(error).__name__


def received(name: str, values: Any, note: Mapping[str, Any] | None, *, kind: str, timeout_s: float) -> CallError:
    """Return the error that a failed response or result reports; ``kind`` is ``service`` or ``action``."""
    text = values[:_TEXT_LIMIT] if isinstance(values, str) else ""
    text = text or f"{name} failed, and does not say why"
    note = note or {}
    word, reason = note.get("error"), note.get("reason")
    if not isinstance(word, str):
        word, reason = _plain_failure(name, text)
    if word == "not_served":
        return NotServed(name, kind)
    if word == "timeout":
        return CallTimeout(name, timeout_s, kind)
    if word == "rejected":
        return GoalRejected(name)
    if word == "lost":
        return ProviderLost(name, reason[:_TEXT_LIMIT] if isinstance(reason, str) else text)
    return CallFailed(name, text)


def _plain_failure(name: str, text: str) -> tuple[str, str]:
    """Return the word and the reason for what a plain server says: its texts are all that its protocol has."""
    if text.startswith(lost := str(ProviderLost(name, ""))):
        return "lost", text[len(lost) :]
    if text == _TIMEOUT:
        return "timeout", ""
    if text == _REJECTED:
        return "rejected", ""
    return ("not_served" if _NOT_SERVED.fullmatch(text) else "failed"), ""
