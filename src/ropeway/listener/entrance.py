"""The entrance that all listeners of a gateway share: admits clients in their role, and answers all others."""

from __future__ import annotations

import json
import math
from collections import Counter
from dataclasses import replace

from ropeway.audit.note import NO_AUDIT, AuditNote, Auditor
from ropeway.fault_log import FaultLog
from ropeway.listener.authentication import Door, Rejection, given_token, refusal
from ropeway.listener.authorization import Role
from ropeway.listener.connection import Limits
from ropeway.listener.http import HttpRequest
from ropeway.listener.lobby import Lobby, network_of
from ropeway.listener.lockout import Lockout
from ropeway.listener.presence import ip_address

__all__ = ["Entrance", "narrowed"]


def narrowed(limits: Limits, role: Role) -> Limits:
    """Return the limits of the connection of a client of this role."""
    if role.max_message_bytes is None:
        return limits
    return replace(limits, max_message_bytes=min(role.max_message_bytes, limits.max_message_bytes))


class Entrance:
    """Admits clients, slows down guessing of tokens, counts refusals and logs them.

    ``door`` may be replaced at any time. ``lobby`` has the connections that are not let in yet. ``audit`` is told of
    everybody who is refused, and of what the clients' roles are denied.
    """

    def __init__(
        self,
        door: Door | None = None,
        *,
        lobby: Lobby | None = None,
        lockout: Lockout | None = None,
        audit: Auditor = NO_AUDIT,
    ) -> None:
        self.audit = audit
        self.door, self.lockout = door or Door(), lockout or Lockout()
        self.lobby = Lobby() if lobby is None else lobby
        self.refused: Counter[str] = Counter()  # by status and reason
        self._inside: Counter[str] = Counter()  # by role
        self._room: int | None = None  # clients that there are open files for
        self._fault_log = FaultLog("server")

    def admit(self, request: HttpRequest) -> Role | Rejection:
        """Return the role of who sent this, or the answer that refuses it, which is counted and logged."""
        sender = network_of(ip_address(request.peer))
        if self.door.tokens and given_token(request):
            locked_s = self.lockout.locked_s(sender)
            if locked_s > 0:
                return self.refuse(request, _locked_out(locked_s))
        role = self.door.role_of(request)
        if isinstance(role, Role):
            return role
        if role.wrong_token:
            role = role.later(self.lockout.wrong(sender))
        return self.refuse(request, role)

    def admit_page(self, request: HttpRequest) -> Rejection | None:
        """Return the answer that refuses a request for what everybody may read, or ``None``."""
        found = self.door.refuses(request)
        return None if found is None else self.refuse(request, found)

    def set_room(self, *, clients: int, pending: int) -> None:
        """Limit the clients of all listeners together to ``clients``, and the connections that wait to ``pending``."""
        self._room = clients
        self.lobby.set_limit(pending)

    def full(self, role: Role) -> str:
        """Return why there is no room for another client of this role, ``""`` if there is."""
        if self._room is not None and self._inside.total() >= self._room:
            return f"there are {self._room} clients and nodes, and the system has no open files for more"
        if role.max_clients is not None and self._inside[role.name] >= role.max_clients:
            return f"there are {role.max_clients} clients of this role, and no more may come"
        return ""

    def crowded(self, role: Role, limits: Limits, clients: int) -> Rejection | None:
        """Return the answer that refuses another client of this role beside ``clients`` of a server, if it has to."""
        most = self.door.max_clients
        why = limits.budget.full
        if not why and most is not None and clients >= most:
            why = f"there are {most} clients, and no more may come"
        why = why or self.full(role)
        return refusal(503, why, Retry_After="10") if why else None

    def keeps(self, request: HttpRequest | None, role: Role, *, certificates: bool) -> bool:
        """Return whether a client that came with this request would get the same role again.

        With ``certificates`` whoever showed one has to show it again.
        """
        if request is None or (certificates and request.fingerprint):
            return False
        return self.door.role_of(request) == role

    def came(self, role: Role) -> None:
        """Count another client of a role, until ``left``."""
        self._inside[role.name] += 1

    def left(self, role: Role) -> None:
        """Count one less."""
        self._inside[role.name] -= 1

    def refuse(self, request: HttpRequest, found: Rejection) -> Rejection:
        """Count and log a refusal; return it."""
        self.refused[found.reason] += 1
        text = json.loads(found.body)["error"]
        said = {"status": found.status}
        self.audit.note(
            AuditNote("refused", "connect", where=request.peer, outcome="refused", why=found.reason, details=said)
        )
        self._fault_log.note(found.kind, "", f"{request.peer} is refused: {found.status} {text}")
        return found

    def tell_kicked(self, peer: str, role: Role) -> None:
        """Tell the audit log of a client that is disconnected because the rules have changed."""
        why = f"what role {role.name} may do has changed"
        self.audit.note(AuditNote("kicked", "disconnect", peer, "configuration", peer, why=why))

    def status(self) -> dict[str, dict[str, int]]:
        """Return who was refused, and how many wait to be let in, as JSON."""
        return {"refused": dict(self.refused), "tokens": self.lockout.status(), "pending": self.lobby.status()}


def _locked_out(seconds: float) -> Rejection:
    left = str(math.ceil(seconds))
    text = f"too many wrong tokens came from this address; try again in {left} s"
    return refusal(429, text, reason="429 too many wrong tokens", kind="token guesses", Retry_After=left)
