"""Decides who may ask the control API: the user on the UNIX socket, and over TCP who shows a token or a certificate."""

from __future__ import annotations

import asyncio
import json
import os
from dataclasses import replace
from typing import TYPE_CHECKING, Final, Protocol

from ropeway.audit.note import NO_AUDIT, AuditNote, Auditor
from ropeway.control.caller import Caller, ControlPeer
from ropeway.errors import ControlRefused
from ropeway.listener.authentication import Door, Rejection
from ropeway.listener.authorization import CONTROL_RIGHTS
from ropeway.listener.entrance import Entrance
from ropeway.listener.http import HttpRequest

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["AnyAdmission", "TcpAdmission", "UnixAdmission"]

_ROOT: Final = 0


class AnyAdmission(Protocol):
    """Lets callers in, or raises ``ControlRefused``."""

    async def admit(self, peer: ControlPeer, method: str, target: str, headers: Mapping[str, str]) -> Caller:
        """Return who asks, and what they may do."""
        ...


class UnixAdmission:
    """Lets in the user whom the socket belongs to, and root; the operating system says who it is."""

    def __init__(self, audit: Auditor = NO_AUDIT) -> None:
        self._audit = audit

    async def admit(self, peer: ControlPeer, method: str, target: str, headers: Mapping[str, str]) -> Caller:
        """See ``AnyAdmission``."""
        if headers.get("origin"):
            raise self._refused(peer, "web pages may not use this socket")
        if peer.uid not in (os.geteuid(), _ROOT):
            raise self._refused(peer, f"the socket belongs to another user than the one with number {peer.uid}")
        return Caller(_user(peer.uid), peer.address, CONTROL_RIGHTS)

    def _refused(self, peer: ControlPeer, why: str) -> ControlRefused:
        who = "" if peer.uid is None else _user(peer.uid)
        self._audit.note(AuditNote("refused", "connect", "control", who, peer.address, "refused", why))
        return ControlRefused(403, why)


class TcpAdmission:
    """Lets in over TCP who shows a token or a certificate of the configuration, with the rights of the role.

    Wrong tokens are answered later and later, and then not at all for a while; web pages and names of strangers are
    refused. Everything refused is counted and logged.
    """

    def __init__(self, door: Door, audit: Auditor = NO_AUDIT) -> None:
        self.entrance = Entrance(replace(door, default=None), audit=audit)

    def renew(self, door: Door) -> None:
        """Go by other rules from now on."""
        self.entrance.door = replace(door, default=None)

    async def admit(self, peer: ControlPeer, method: str, target: str, headers: Mapping[str, str]) -> Caller:
        """See ``AnyAdmission``."""
        request = HttpRequest(
            method,
            target,
            "HTTP/1.1",
            headers,
            peer=peer.address,
            local=peer.local,
            secure=peer.secure,
            certificate=peer.certificate,
            fingerprint=peer.fingerprint,
        )
        role = self.entrance.admit(request)
        if isinstance(role, Rejection):
            await asyncio.sleep(role.delay_s)
            raise ControlRefused(role.status, json.loads(role.body)["error"], headers=role.headers)
        return Caller(f"role {role.name}", peer.address, role.control, role)


def _user(uid: int) -> str:
    import pwd

    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return f"user {uid}"
