"""The lobby: connections that nobody has let in yet, bounded in all and per address.

A connection is in the lobby from the moment that it is accepted until it is let in, answered or gone: during the TLS
handshake, while its request comes, and while a node has to say who it is. Who is silent there never keeps others out:
where there are too many, the oldest is dropped.
"""

from __future__ import annotations

import ipaddress
from collections import Counter
from collections.abc import Callable

from ropeway.limits import PENDING_CONNECTIONS, PENDING_PER_ADDRESS
from ropeway.listener.handshake_turns import HandshakeTurns

__all__ = ["Lobby", "Visit", "network_of"]

_IPV6_NETWORK_BITS = 64  # what one subscriber has, and can take any address of


def network_of(host: str) -> str:
    """Return what counts as one sender: an IPv4 address, the network of an IPv6 address, else ``host`` itself."""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return host
    if isinstance(address, ipaddress.IPv4Address):
        return str(address)
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped)
    return str(ipaddress.ip_network((address, _IPV6_NETWORK_BITS), strict=False))


class Visit:
    """The stay of one connection in a lobby. ``drop`` ends the connection; whoever holds it sets it anew."""

    __slots__ = ("_lobby", "drop", "listener", "sender")

    def __init__(self, lobby: Lobby, sender: str, listener: object, drop: Callable[[], object]) -> None:
        self._lobby, self.sender, self.listener, self.drop = lobby, sender, listener, drop

    def leave(self) -> None:
        """End the stay: the connection was let in, or is gone. Harmless twice."""
        self._lobby.left(self)
        self.drop = _nothing  # or the connection and its visit would keep each other


class Lobby:
    """Keep the connections of all listeners of a process that are not let in; see the module."""

    def __init__(self, *, limit: int = PENDING_CONNECTIONS, per_address: int = PENDING_PER_ADDRESS) -> None:
        self._per_address = per_address
        self.set_limit(limit)
        self.dropped: Counter[str] = Counter()
        self.turns = HandshakeTurns()
        self._visits: dict[Visit, None] = {}
        self._by_sender: dict[str, dict[Visit, None]] = {}

    def set_limit(self, limit: int) -> None:
        """Let no more than ``limit`` connections wait from now on."""
        self.limit = max(limit, 1)
        self.per_address = min(self._per_address, self.limit)

    def __len__(self) -> int:
        """Return how many connections wait."""
        return len(self._visits)

    def enter(self, host: str, listener: object, drop: Callable[[], object]) -> Visit:
        """Begin the stay of a connection from ``host``; the oldest is dropped if that makes too many."""
        visit = Visit(self, network_of(host), listener, drop)
        self._visits[visit] = None
        mine = self._by_sender.setdefault(visit.sender, {})
        mine[visit] = None
        if len(mine) > self.per_address:
            self._drop(next(iter(mine)), "too many from one address")
        if len(self._visits) > self.limit:
            self._drop(next(iter(self._visits)), "too many")
        return visit

    def clear(self, listener: object) -> None:
        """Drop those that came to a listener, which is closed."""
        for visit in [visit for visit in self._visits if visit.listener is listener]:
            drop = visit.drop
            visit.leave()
            drop()

    def relieve(self) -> None:
        """Drop the older half of those that wait: the system has no room for more."""
        for visit in list(self._visits)[: (len(self._visits) + 1) // 2]:
            self._drop(visit, "no open files left")

    def left(self, visit: Visit) -> None:
        """Forget a visit."""
        if visit not in self._visits:
            return
        del self._visits[visit]
        mine = self._by_sender[visit.sender]
        del mine[visit]
        if not mine:
            del self._by_sender[visit.sender]

    def status(self) -> dict[str, int]:
        """Return how many wait, and how many were dropped for which reason."""
        dropped = self.dropped + Counter({"a handshake that took long": self.turns.given_up})
        return {"waiting": len(self), **{f"dropped: {why}": n for why, n in dropped.items()}}

    def _drop(self, visit: Visit, why: str) -> None:
        self.dropped[why] += 1
        drop = visit.drop
        visit.leave()
        drop()


def _nothing() -> None:
    """Do nothing: there is nothing left to drop."""
