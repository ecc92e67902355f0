"""Tells the audit log of every request that changes something, and of those for which the caller lacks the right."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from ropeway.audit.note import AuditKind
from ropeway.control.auditing import Outcome, ended, note_of

if TYPE_CHECKING:
    from ropeway.control.resource import ControlRequest, Resource

__all__ = ["audited"]

_KINDS: Final[Mapping[str, AuditKind]] = {"configure": "change", "operate": "operate", "observe": "operate"}


@contextmanager
def audited(resource: Resource, asked: ControlRequest) -> Iterator[None]:
    """Note the request and how it ended; one that only reads is noted where it is denied."""
    how, audit = resource.audited, asked.manager.audit

    def tell(outcome: Outcome, why: str, denied: bool) -> None:
        if how is None and not denied:
            return
        details = dict(asked.noted)
        name = str(details.pop("name", "") or ("" if how is None else asked.path.get(how.name, "")))
        operation = f"{resource.method} {resource.path}" if how is None else how.operation
        kind: AuditKind = _KINDS[resource.right]
        if denied:
            kind = "denied"
        elif how is not None and how.kind is not None:
            kind = how.kind
        audit.note(note_of(kind, operation, name, asked.caller, outcome, why, details))

    with ended(tell):
        yield
