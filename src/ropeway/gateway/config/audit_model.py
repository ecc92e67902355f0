"""Says what the audit log of a gateway has, and how much is kept: ``gateway.audit``."""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatchcase
from typing import Annotated

from pydantic import BeforeValidator, Field, WithJsonSchema

from ropeway.gateway.config.auth_model import Pattern
from ropeway.gateway.config.fields import Many, Model
from ropeway.gateway.config.suggest import show

__all__ = ["AuditConfig", "AuditItem", "AuditedCommands"]

_MIB = 1 << 20


def _written_out(value: object) -> object:
    if isinstance(value, bool):
        return {"enabled": value}
    if isinstance(value, Mapping | AuditConfig):
        return value
    raise ValueError(f'expected true, false or an object such as {{"keep_days": 30}}, got {show(value)}')


class AuditedCommands(Model):
    """Says whose commands are written down: what clients of these roles publish, call and ask for, by name."""

    roles: Many[Pattern] = Field(("*",), description="patterns of roles; all is that of clients who need no token")
    names: Many[Pattern] = Field(("*",), description="patterns of topics, services and actions")


class AuditConfig(Model):
    """The audit log: who changed the gateway, commanded, was denied or refused, or was disconnected."""

    enabled: bool = Field(True, description="false: nothing is written down")
    path: str | None = Field(None, min_length=1, description="the file; default: one in the user's state directory")
    file_bytes: int = Field(16 * _MIB, ge=4096, description="a file that has so much is full, and a new one is begun")
    files: int = Field(8, ge=1, le=1000, description="how many files there are at most, the one in use included")
    file_days: float = Field(7.0, gt=0, allow_inf_nan=False, description="a file is also full after so many days")
    keep_days: float = Field(365.0, gt=0, allow_inf_nan=False, description="full files are removed after so many days")
    commands: Many[AuditedCommands] = Field(
        (), description='commands that are written down, by role and name; a route has "audit": true instead'
    )

    def audited(self, role: str) -> tuple[str, ...]:
        """Return the patterns of names whose commands are written down for clients of a role."""
        return tuple(
            dict.fromkeys(
                name
                for rule in self.commands
                if any(fnmatchcase(role, pattern) for pattern in rule.roles)
                for name in rule.names
            )
        )


AuditItem = Annotated[
    AuditConfig,
    BeforeValidator(_written_out),
    WithJsonSchema({"anyOf": [{"type": "boolean"}, {"$ref": "#/$defs/AuditConfig"}]}),
]
"""The audit log, of which a truth value alone may be written."""
