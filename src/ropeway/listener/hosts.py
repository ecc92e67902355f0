"""The names that a server is reached by, and the web pages that may talk to it.

A browser sends requests for whatever page is open in it, with the user's place in the network. Two things tell such a
request apart: ``Origin``, the page whose script it is, and ``Host``, the name under which the browser found the server.
A page of a stranger can make its own name lead to our address (DNS rebinding), but then ``Host`` is that name.

A browser says ``Origin`` in every request for a WebSocket, and no script can leave it out or ask for one by other
means: ``Upgrade`` and ``Sec-WebSocket-Key`` are not for scripts to set. So a request for a WebSocket without it is a
program's, which may have found us under any name. Of plain HTTP that cannot be said: a page that fetches from its own
name, which is all that a rebound page has to do, sends no ``Origin``, and over ``http://`` nothing else that only
browsers send.
"""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Final

from ropeway.listener.http import HttpRequest

__all__ = ["Hosts", "host_of", "own_names"]

_AUTHORITY: Final = re.compile(r"(\[[0-9A-Fa-f:.%\w-]+\]|[^\s:/\[\]@?#]+)(?::\d{0,5})?")
_PAGE: Final = re.compile(r"https?://(.+)", re.IGNORECASE)
_LOOPBACK_NAMES: Final = frozenset(("localhost", "localhost.localdomain", "ip6-localhost", "ip6-loopback"))

Address = ipaddress.IPv4Address | ipaddress.IPv6Address


def host_of(authority: str) -> str:
    """Return the host of ``Host: name:port`` in one spelling, ``""`` for an invalid one.

    That is in lower case, without port, brackets, zone or the dot at its end.
    """
    match = _AUTHORITY.fullmatch(authority.strip())
    if match is None:
        return ""
    host = match[1].lower()
    if host.startswith("["):
        return host[1:-1].partition("%")[0]
    return host.removesuffix(".")


def own_names() -> frozenset[str]:
    """Return the names of this machine: its host name, in full and in short, and that of multicast DNS."""
    name = socket.gethostname().lower().removesuffix(".")
    short = name.partition(".")[0]
    return frozenset((name, short, f"{short}.local")) if short else frozenset()


def _address(host: str) -> Address | None:
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return None
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return mapped or address


def _is_local(host: str) -> bool:
    """Return whether a browser reaches nothing but its own machine under this host; 0.0.0.0 is one, too."""
    address = _address(host)
    if address is not None:
        return address.is_loopback or address.is_unspecified
    return host in _LOOPBACK_NAMES or host.endswith(".localhost")


def _fits(host: str, authority: str, patterns: Iterable[str]) -> bool:
    whole = authority.strip().lower()
    return any(fnmatchcase(host, pattern) or fnmatchcase(whole, pattern) for pattern in patterns)


@dataclass(frozen=True)
class Hosts:
    """Decide by ``Host`` and ``Origin`` whether a request may be answered.

    ``names`` are those of this machine and its listeners; ``patterns`` name others that lead here. ``origins`` are
    patterns of the web pages that may connect; ``None`` is for pages of the browser's own machine and of ours.
    """

    names: frozenset[str] = frozenset()
    patterns: Sequence[str] = ()
    origins: Sequence[str] | None = None

    def knows(self, request: HttpRequest) -> bool:
        """Return whether ``Host`` leads here. What is no browser may leave it out, or have any name for us.

        Nobody can make a name of an address, so any address will do where others than this machine connect: behind a
        router it is another than ours.
        """
        authority = request.headers.get("host", "")
        if not authority or request.from_program:
            return True
        host = host_of(authority)
        if not host:
            return False
        if _is_local(host) or host in self.names or _fits(host, authority, self.patterns):
            return True
        address = _address(host)
        return address is not None and not _is_local(request.local)

    def knows_page(self, request: HttpRequest) -> bool:
        """Return whether the page that sent this may; a program that is no browser names none."""
        origin = request.headers.get("origin", "").strip().lower()
        if not origin:
            return True
        if self.origins is not None:
            return any(fnmatchcase(origin, pattern.lower()) for pattern in self.origins)
        page = _PAGE.fullmatch(origin)
        host = host_of(page[1]) if page is not None else ""
        if not host:
            return False
        if _is_local(host) or host in self.names:
            return True
        if _address(host) is not None and _address(host) == _address(request.local):
            return True
        return self.knows(request) and host == host_of(request.headers.get("host", ""))
