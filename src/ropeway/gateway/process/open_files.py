"""Makes room for connections: each is an open file to the system, and many systems allow 1,024 by default."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ropeway.errors import GraphUnavailable
from ropeway.limits import PENDING_CONNECTIONS

__all__ = ["Room", "make_room"]

log = logging.getLogger("ropeway.gateway")

_OTHERS: Final = 512  # files of the gateway itself: graphs, stores, libraries
_LEAST: Final = 128  # beside those that are open: below, a graph with some topics leaves nothing for clients
_PENDING_PART: Final = 4  # the part of the room for those who are not let in yet


@dataclass(frozen=True, slots=True)
class Room:
    """The number of connections there is room for: of clients that are admitted, and of those that are not yet."""

    clients: int
    pending: int = PENDING_CONNECTIONS


def make_room(clients: int) -> Room:
    """Ask the system to allow connections of this many clients; return how many there is room for.

    Call it once graphs are open: a library that knows only the first 1,024 files has its own by then. Says in the log
    if fewer have room than wanted. Raises ``GraphUnavailable`` where so few files may be open that a gateway would only
    fail later.
    """
    try:
        import resource
    except ImportError:  # Windows knows no such limit
        return Room(clients)
    wanted = clients + PENDING_CONNECTIONS + _OTHERS
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
    if soft != resource.RLIM_INFINITY and soft < most:
        try:
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
            soft = most
        except (OSError, ValueError) as error:
            log.debug("the limit of open files stays at %d: %s", soft, error)
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return Room(clients)
    return _divided(clients, soft, _open_files())


def _divided(clients: int, allowed: int, open_now: int) -> Room:
    """Divide the files that may be open: for the gateway itself, for clients, and for those that are not in yet."""
    free = allowed - open_now
    if free < _LEAST:
        reason = (
            f"the system allows {allowed} open files, of which {open_now} are open already; at least "
            f"{open_now + _LEAST} are needed (ulimit -n, LimitNOFILE= of systemd)"
        )
        raise GraphUnavailable("gateway", reason)
    room = free - min(_OTHERS, free // 2)
    pending = min(PENDING_CONNECTIONS, room // _PENDING_PART)
    let_in = min(clients, room - pending)
    if let_in < clients:
        log.warning(
            "the system allows %d open files: there is room for %d clients, not for the %d of the configuration",
            allowed,
            let_in,
            clients,
        )
    return Room(let_in, pending)


def _open_files() -> int:
    listed = Path("/dev/fd")
    return sum(1 for _ in listed.iterdir()) if listed.exists() else 0
