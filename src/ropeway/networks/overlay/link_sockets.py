"""Sets kernel options on the TCP connections that Zenoh makes, since it sets none itself.

When the address of a machine changes, its old TCP connections live on without anybody at the other end; whoever writes
to one waits. Zenoh sees by its lease that nothing comes, but a transport that is blocked in writing closes late, or not
at all. ``TCP_USER_TIMEOUT`` (RFC 5482) ends the connection itself.

Little is to wait in the kernel, what is lost goes again soon, and the congestion control is to suit the link. BBR stops
for a fifth of a second every ten to see the shortest round trip, which looks like a loss from above, unless it is begun
anew in time; others take a lost packet for a full link. So it is used where packets are lost, and only there.
"""

from __future__ import annotations

import contextlib
import os
import re
import socket
import time
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Final

from ropeway.delivery.pacing.tcp import LOSSES_BORNE_S, Tcp, tcp_info

__all__ = ["Losses", "set_options"]

_LOCATOR: Final = re.compile(r"(?:tls|tcp)/(?:\[(?P<six>[^\]]+)\]|(?P<four>[^:]+)):(?P<port>\d+)")
_DESCRIPTORS: Final = Path("/proc/self/fd")
_NOTSENT_LOWAT: Final[int | None] = getattr(socket, "TCP_NOTSENT_LOWAT", None)
_UNSENT_BYTES: Final = 128 * 1024  # the next batch of Zenoh's, of 32 kB, is there before the last has left
_TELLING_BYTES: Final = 64 * 1024  # fewer say nothing of a link
_LOSSY: Final = 0.003  # of what was sent, sent again

Ends = tuple[tuple[str, int], tuple[str, int]]


def set_options(source: str, target: str, timeout_ms: int) -> bool:
    """Set the options of the TCP connection between two locators of Zenoh (``tls/10.0.0.1:7447``).

    It ends once data is unacknowledged for ``timeout_ms``. False where there is no such connection in this process, or
    where the system knows no such limit.
    """
    option = getattr(socket, "TCP_USER_TIMEOUT", None)
    if option is None:
        return False
    found = False
    for _, link in _sockets({(source, target)}):
        link.setsockopt(socket.IPPROTO_TCP, option, timeout_ms)
        if _NOTSENT_LOWAT is not None:
            link.setsockopt(socket.IPPROTO_TCP, _NOTSENT_LOWAT, _UNSENT_BYTES)
        tcp = Tcp(link)
        tcp.retransmit_soon()
        tcp.stay_steady()
        found = True
    return found


class Losses:
    """Sees which connections lose packets, and has them use a congestion control that bears it."""

    def __init__(self) -> None:
        self._seen: dict[tuple[str, str], tuple[int, int]] = {}  # bytes sent, and sent again, at the last look
        self._bearing_s: dict[tuple[str, str], float] = {}  # since when

    def look(self, links: Collection[tuple[str, str]]) -> None:
        """Read the losses of the connections between these pairs of locators."""
        now_s, seen, bearing_s = time.monotonic(), self._seen, self._bearing_s
        self._seen, self._bearing_s = {}, {}
        for link, sock in _sockets(links):
            info, tcp = tcp_info(sock), Tcp(sock)
            since_s = bearing_s.get(link)
            if since_s is not None:
                if now_s - since_s >= LOSSES_BORNE_S:
                    since_s = now_s
                    tcp.bear_losses()
                self._bearing_s[link] = since_s
                continue
            if info is None:
                continue
            sent, again = seen.get(link, (0, 0))
            if info.bytes_sent - sent < _TELLING_BYTES:
                self._seen[link] = sent, again
                continue
            self._seen[link] = info.bytes_sent, info.bytes_sent_again
            if info.bytes_sent_again - again > _LOSSY * (info.bytes_sent - sent):
                self._bearing_s[link] = now_s
                tcp.bear_losses()


def _sockets(links: Collection[tuple[str, str]]) -> Iterator[tuple[tuple[str, str], socket.socket]]:
    """Find the TCP sockets of this process between pairs of locators; each is valid until the next."""
    wanted = {ends: link for link in links if (ends := _ends(*link)) is not None}
    if not wanted or not _DESCRIPTORS.is_dir():
        return
    for entry in list(_DESCRIPTORS.iterdir()):
        with contextlib.suppress(OSError, ValueError):  # one that is no TCP socket, or was closed meanwhile
            if not str(entry.readlink()).startswith("socket:"):
                continue
            with socket.socket(fileno=os.dup(int(entry.name))) as sock:
                if sock.family not in (socket.AF_INET, socket.AF_INET6) or sock.type != socket.SOCK_STREAM:
                    continue
                link = wanted.get((_pair(sock.getsockname()), _pair(sock.getpeername())))
                if link is not None:
                    yield link, sock


def _ends(source: str, target: str) -> Ends | None:
    near, far = _address(source), _address(target)
    return None if near is None or far is None else (near, far)


def _address(locator: str) -> tuple[str, int] | None:
    match = _LOCATOR.match(locator)
    return None if match is None else _pair((match["six"] or match["four"], int(match["port"])))


def _pair(name: tuple[object, ...]) -> tuple[str, int]:
    host, port = name[:2]
    return str(host).removeprefix("::ffff:"), int(str(port))
