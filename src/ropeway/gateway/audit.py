"""Opens the audit log of a gateway, and tells it what crosses the routes that are to be written down."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from ropeway.audit.note import AuditNote, Auditor
from ropeway.gateway.state_place import default_journal
from ropeway.listener.http import without_token

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ropeway.audit.trail import AuditTrail
    from ropeway.delivery.pipeline import Witness
    from ropeway.gateway.config.config import Config, Route

__all__ = ["default_audit", "open_trail", "route_witness"]

_OPERATIONS: Final[Mapping[str, str]] = {
    "topic": "publish",
    "service": "call_service",
    "action": "send_action_goal",
}


def default_audit(name: str, source: str) -> Path:
    """Return where the audit log of a gateway is that runs a file: beside its journal."""
    return default_journal(name, source).with_suffix(".audit")


def open_trail(config: Config) -> AuditTrail | None:
    """Make the audit log that a configuration asks for; nothing is written before the first note."""
    audit = config.gateway.audit
    if not audit.enabled or not (audit.path or config.source):
        return None
    from ropeway.audit.files import AuditFiles
    from ropeway.audit.trail import AuditTrail

    control = config.gateway.control
    path = Path(audit.path).expanduser() if audit.path else None
    files = AuditFiles(
        path or default_audit(control.name or config.gateway.name, config.source),
        file_bytes=audit.file_bytes,
        files=audit.files,
        file_days=audit.file_days,
        keep_days=audit.keep_days,
    )
    return AuditTrail(files)


def route_witness(audit: Auditor, route: Route) -> Witness:
    """Return what writes down what crosses a route."""
    operation, remote = _OPERATIONS[route.kind], without_token(route.remote.address)

    def tell(payload: bytes, who: str) -> None:
        details = {"route": f"{route.operation} {route.name}"}
        audit.note(AuditNote("command", operation, route.name, who, remote, payload=payload, details=details))

    return tell
