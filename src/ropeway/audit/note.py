"""Notes for the audit log, and the protocol of whatever takes them."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, Protocol

__all__ = ["KINDS", "NO_AUDIT", "AuditKind", "AuditNote", "Auditor"]

AuditKind = Literal["change", "operate", "command", "denied", "refused", "kicked", "audit"]

KINDS: Final[Mapping[AuditKind, str]] = {
    "change": "the configuration was changed or planned: operation, outcome, steps",
    "operate": "something was done by hand over the control API",
    "command": "a message, a call or a goal, where the configuration asks for it: its name and the hash of its payload",
    "denied": "a client was denied what its role does not allow",
    "refused": "a client was not let in, as with a wrong token",
    "kicked": "a client was disconnected",
    "audit": "the log itself: what did not fit, what could not be written",
}
"""The kinds of entries, each with what it says."""

_OVERHEAD_BYTES: Final = 512  # of a note without its payload


@dataclass(frozen=True, slots=True)
class AuditNote:
    """A note: who did what, from where. Of ``payload`` the log gets the hash, which is computed in its own thread.

    ``name`` is of what was acted on; ``outcome`` is ``done``, ``failed`` or ``refused``, and ``why`` says more.
    Neither payloads nor tokens may stand in any other field.
    """

    kind: AuditKind
    operation: str
    name: str = ""
    who: str = ""
    where: str = ""
    outcome: Literal["done", "failed", "refused"] = "done"
    why: str = ""
    payload: bytes | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    time_s: float = field(default_factory=time.time)

    @property
    def size_bytes(self) -> int:
        """The bytes that the note keeps while it waits."""
        return _OVERHEAD_BYTES + (0 if self.payload is None else len(self.payload))


class Auditor(Protocol):
    """Takes notes."""

    def note(self, note: AuditNote) -> None:
        """Take a note. Returns at once and never raises, from any thread."""


class _NoAuditor:
    """Drops all notes."""

    def note(self, note: AuditNote) -> None:
        """See ``Auditor``."""


NO_AUDIT: Final[Auditor] = _NoAuditor()
"""Stands where no audit log is kept."""
