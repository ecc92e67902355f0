"""Makes what runs a configuration: a gateway in this process, or workers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ropeway.audit.note import NO_AUDIT

if TYPE_CHECKING:
    from ropeway.audit.trail import AuditTrail
    from ropeway.gateway.config.config import Config
    from ropeway.gateway.gateway import Gateway
    from ropeway.gateway.process.supervisor import Supervisor

__all__ = ["make_gateway"]


def make_gateway(config: Config, *, log_level: str = "INFO", audit: AuditTrail | None = None) -> Gateway | Supervisor:
    """Return a gateway that is not up yet, or a supervisor of workers, as the configuration says.

    ``log_level`` is that of workers; ``audit`` is the audit log, if one is kept.
    """
    if config.gateway.workers == 0:
        from ropeway.gateway.gateway import Gateway  # a supervisor loads no kind of network

        return Gateway(config, audit=audit or NO_AUDIT)
    from ropeway.gateway.process.supervisor import Supervisor

    return Supervisor(config, log_level=log_level, audit=audit)
