"""Has the kernel give a link up whose far end no longer acknowledges: Zenoh's own lease does not reach a blocked one.

When the address of a machine changes, its old TCP connections live on without anybody at the other end; whoever writes
to one waits. Zenoh sees by its lease that nothing comes, but a transport that is blocked in writing closes late, or not
at all. ``TCP_USER_TIMEOUT`` (RFC 5482) ends the connection itself. Zenoh does not set it, so it is set here, on the
socket of the link.
"""

from __future__ import annotations

import contextlib
import os
import re
import socket
from pathlib import Path
from typing import Final

__all__ = ["limit"]

_LOCATOR: Final = re.compile(r"(?:tls|tcp)/(?:\[(?P<six>[^\]]+)\]|(?P<four>[^:]+)):(?P<port>\d+)")
_DESCRIPTORS: Final = Path("/proc/self/fd")
_NOTSENT_LOWAT: Final[int | None] = getattr(socket, "TCP_NOTSENT_LOWAT", None)
_UNSENT_BYTES: Final = 128 * 1024  # the next batch of Zenoh's, of 32 kB, is there before the last has left
_CONGESTION: Final[int | None] = getattr(socket, "TCP_CONGESTION", None)
_LOSS_TOLERANT: Final = b"bbr"


def limit(source: str, target: str, timeout_ms: int) -> bool:
    """End the TCP connection between two locators of Zenoh (``tls/10.0.0.1:7447``) once data is unacknowledged so long.

    False where there is none in this process, or where the system knows no such limit.
    """
    option = getattr(socket, "TCP_USER_TIMEOUT", None)
    ends = _address(source), _address(target)
    if option is None or None in ends or not _DESCRIPTORS.is_dir():
        return False
    found = False
    for entry in _DESCRIPTORS.iterdir():
        with contextlib.suppress(OSError, ValueError):  # one that is no TCP socket, or was closed meanwhile
            if not str(entry.readlink()).startswith("socket:"):
                continue
            with socket.socket(fileno=os.dup(int(entry.name))) as link:
                if link.family not in (socket.AF_INET, socket.AF_INET6) or link.type != socket.SOCK_STREAM:
                    continue
                if (_pair(link.getsockname()), _pair(link.getpeername())) == ends:
                    link.setsockopt(socket.IPPROTO_TCP, option, timeout_ms)
                    _keep_fresh(link)
                    found = True
    return found


def _keep_fresh(link: socket.socket) -> None:
    """Have little wait in the kernel, and a link with losses filled all the same, where the system can."""
    for option, value in ((_NOTSENT_LOWAT, _UNSENT_BYTES), (_CONGESTION, _LOSS_TOLERANT)):
        if option is not None:
            with contextlib.suppress(OSError):  # there is no such congestion control here
                link.setsockopt(socket.IPPROTO_TCP, option, value)


def _address(locator: str) -> tuple[str, int] | None:
    match = _LOCATOR.match(locator)
    return None if match is None else _pair((match["six"] or match["four"], int(match["port"])))


def _pair(name: tuple[object, ...]) -> tuple[str, int]:
    host, port = name[:2]
    return str(host).removeprefix("::ffff:"), int(str(port))
