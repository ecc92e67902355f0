"""Finds out whether the ports of listeners are free, for workers, which share theirs with whoever asks."""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import Iterable
from urllib.parse import urlsplit

from ropeway.errors import ConnectFailed

__all__ = ["check_free"]


async def check_free(addresses: Iterable[str]) -> None:
    """Raise ``ConnectFailed`` for the first address that somebody listens on, whether or not they would share it.

    Linux lets every process of a user join in on a port that is shared (``SO_REUSEPORT``), also a second gateway that
    was started by mistake: clients would then reach either.
    """
    loop = asyncio.get_running_loop()
    for address in addresses:
        parts = urlsplit(address)
        if not parts.port:
            continue
        try:
            found = await loop.getaddrinfo(parts.hostname, parts.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
            for family, kind, protocol, _, name in found:
                with socket.socket(family, kind, protocol) as probe:
                    probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                    if family == socket.AF_INET6:
                        probe.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
                    probe.bind(name)
        except OSError as error:
            what = os.strerror(error.errno) if error.errno and not isinstance(error, socket.gaierror) else str(error)
            reason = f"cannot listen: {what}; is another gateway running?"
            raise ConnectFailed(address, reason, retryable=False) from None
