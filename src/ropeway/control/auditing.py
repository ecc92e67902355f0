"""Makes notes for the audit log of what callers of the control API do, with how it ended."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final, Literal

from ropeway.audit.note import AuditKind, AuditNote, Auditor
from ropeway.errors import ConfigError, ControlRefused, RopewayError
from ropeway.listener.http import without_token
from ropeway.tasks import describe

if TYPE_CHECKING:
    from ropeway.control.caller import Caller

__all__ = ["Outcome", "ended", "note_of", "reload_audited"]

Outcome = Literal["done", "failed", "refused"]

_FORBIDDEN: Final = 403


@contextmanager
def reload_audited(audit: Auditor, caller: Caller) -> Iterator[None]:
    """Note that the file was read again, by a signal or because it has changed."""
    with ended(lambda outcome, why, _: audit.note(note_of("change", "reload", "", caller, outcome, why, {}))):
        yield


@contextmanager
def ended(tell: Callable[[Outcome, str, bool], None]) -> Iterator[None]:
    """Tell how something ended, why, and whether the caller was denied it."""
    try:
        yield
    except ControlRefused as error:
        tell("refused", error.text, error.status == _FORBIDDEN)
        raise
    except ConfigError as error:  # its text may show what was configured
        tell("refused", f"faults at {', '.join(path for path, _ in error.problems)}", False)
        raise
    except RopewayError as error:
        tell("failed", str(error), False)
        raise
    except Exception as error:
        tell("failed", describe(error), False)
        raise
    tell("done", "", False)


def note_of(
    kind: AuditKind,
    operation: str,
    name: str,
    caller: Caller,
    outcome: Outcome,
    why: str,
    details: Mapping[str, Any],
) -> AuditNote:
    """Return a note of what a caller did, without tokens in addresses."""
    return AuditNote(
        kind, operation, without_token(name), caller.name, caller.where, outcome, without_token(why), details=details
    )
