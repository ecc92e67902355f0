"""Tells whoever keeps a long-running verb how it is: ready, reloading, stopping, alive.

A service manager (``Type=notify`` of systemd) is told at the ``NOTIFY_SOCKET`` of the environment. For the health check
of a container, which has none, the file that ``ROPEWAY_ALIVE_FILE`` names is touched while the verb is ready and alive,
and is gone when it is not. Where the environment has neither, nothing is told.
"""

from __future__ import annotations

import asyncio
import logging
import os
import socket
import time
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Final

from ropeway.tasks import Supervised, end

__all__ = ["Notifier", "notifying"]

log = logging.getLogger("ropeway.service")

_BEATS: Final = 3  # in the time that the manager waits for one: one may be late, and one may be lost
_TOUCHED_S: Final = 5.0  # between two touches of the file; a health check allows for 30 s
_STATUS_CHARACTERS: Final = 500  # of a status, which is one line of a listing


class Notifier:
    """Sends the manager's datagrams, and keeps the file. ``environ`` is that of the process."""

    def __init__(self, environ: Mapping[str, str] = os.environ) -> None:
        path = environ.get("NOTIFY_SOCKET", "")
        self._address = f"\0{path[1:]}" if path.startswith("@") else path
        file = environ.get("ROPEWAY_ALIVE_FILE", "")
        self._file = Path(file) if file else None
        self._is_ready = False
        watchdog_s = _watchdog_s(environ) if self._address else 0.0
        self.beat_s = min(watchdog_s / _BEATS or _TOUCHED_S, _TOUCHED_S) if watchdog_s or self._file else 0.0

    def ready(self, status: str) -> None:
        """Tell that the service is up; ``status`` is shown by ``systemctl status``."""
        self._is_ready = True
        self._touch()
        self._send("READY=1", _status(status))

    def status(self, status: str) -> None:
        """Tell what it is doing."""
        self._send(_status(status))

    def reloading(self) -> None:
        """Tell that it reads its files again; ``ready`` tells the end of that."""
        self._send("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def stopping(self) -> None:
        """Tell that it ends in order."""
        self._is_ready = False
        if self._file is not None:
            self._file.unlink(missing_ok=True)
        self._send("STOPPING=1")

    def alive(self) -> None:
        """Tell that the event loop turns."""
        self._touch()
        self._send("WATCHDOG=1")

    def _touch(self) -> None:
        if self._file is None or not self._is_ready:
            return
        try:
            self._file.touch()
        except OSError as error:
            log.warning("%s cannot be touched: %s", self._file, error)

    def _send(self, *lines: str) -> None:
        if not self._address:
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as channel:
                channel.setblocking(False)
                channel.sendto("\n".join(lines).encode(), self._address)
        except OSError as error:
            log.warning("the service manager cannot be told %s: %s", lines[0], error)


@asynccontextmanager
async def notifying(notifier: Notifier) -> AsyncIterator[Notifier]:
    """Tell that the loop is alive, as often as is wanted, until the block ends."""
    beating = Supervised(lambda: _beat(notifier), "watchdog") if notifier.beat_s else None
    if beating is not None:
        beating.start()
    try:
        yield notifier
    finally:
        await end(beating)


async def _beat(notifier: Notifier) -> None:
    while True:
        notifier.alive()
        await asyncio.sleep(notifier.beat_s)


def _status(text: str) -> str:
    return f"STATUS={' '.join(text.split())[:_STATUS_CHARACTERS]}"


def _watchdog_s(environ: Mapping[str, str]) -> float:
    """Return after how long a silence the manager takes this process for dead, 0 for never."""
    pid, usec = environ.get("WATCHDOG_PID", ""), environ.get("WATCHDOG_USEC", "")
    if not usec.isdecimal() or pid not in ("", str(os.getpid())):
        return 0.0
    return int(usec) / 1e6
