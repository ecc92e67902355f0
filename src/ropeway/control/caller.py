"""Callers of the control API: the other ends of connections, and what they may do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from ropeway.errors import ControlRefused
from ropeway.listener.authorization import CONTROL_RIGHTS, EVERYTHING, Role

__all__ = ["Caller", "ControlPeer"]

_STATUS_FORBIDDEN: Final = 403


@dataclass(frozen=True, slots=True)
class ControlPeer:
    """The other end of a connection, as the operating system and TLS know it.

    ``uid`` is that of a process on a UNIX socket, ``None`` for TCP. ``certificate`` is what TLS verified.
    """

    address: str
    local: str = ""
    uid: int | None = None
    secure: bool = False
    certificate: Any = None
    fingerprint: str = ""


@dataclass(frozen=True, slots=True)
class Caller:
    """A person or a program that was let in. ``name`` and ``where`` go to the journal and the log.

    ``role`` says which topics it may read and publish.
    """

    name: str
    where: str
    rights: frozenset[str] = CONTROL_RIGHTS
    role: Role = EVERYTHING

    def demand(self, right: str) -> None:
        """Raise ``ControlRefused`` where the caller lacks a right."""
        if right not in self.rights:
            raise ControlRefused(
                _STATUS_FORBIDDEN,
                f'{self.name} lacks the right "{right}"; list it under "control" of the role in gateway.auth.roles',
            )

    def demand_topic(self, verb: str, topic: str) -> None:
        """Raise ``ControlRefused`` where the role does not let the caller ``publish`` or ``subscribe`` to a topic."""
        rule = self.role.rule_against(verb, topic)
        if rule:
            raise ControlRefused(_STATUS_FORBIDDEN, f"{self.name} may not {verb} {topic}: {rule}")
