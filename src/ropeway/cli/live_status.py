"""Draws the status of the gateway that runs in this process, in place, while its log goes on above."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Mapping
from typing import Any, Final

from rich.console import Console, Group
from rich.live import Live

from ropeway.cli.status.tables import tables

__all__ = ["LiveStatus"]

_LAST_S: Final = 1.0  # how long the last picture may take at the end: a terminal that was stopped will not take it
_TITLES_LINES: Final = 8  # of the tables, their heads and the first link


class LiveStatus:
    """Draws in a thread of its own, one picture at a time: a terminal that was stopped holds nothing up.

    Routes that do not fit on the terminal are left out, so that a thousand of them cost no more than a screen.
    """

    def __init__(self) -> None:
        self._console = Console()
        both = sys.stderr.isatty()  # else the log goes to a file, and is none of the terminal's business
        self._live = Live(console=self._console, auto_refresh=False, redirect_stdout=False, redirect_stderr=both)
        stderr = sys.stderr
        self._live.start()
        self._handlers = [h for h in logging.getLogger().handlers if getattr(h, "stream", None) is stderr and both]
        self._stderr = stderr
        self._redirect(sys.stderr)
        self._thread: threading.Thread | None = None

    def put(self, status: Mapping[str, Any]) -> None:
        """Draw a status, unless the one before it is not drawn yet."""
        if self._thread is not None and self._thread.is_alive():
            return
        shown = {**status, "routes": status["routes"][: self._rows()], "sessions": status["sessions"][: self._rows()]}
        self._thread = threading.Thread(target=self._draw, args=(shown,), name="ropeway table", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Leave the last picture where it is, and the terminal to others."""
        if self._thread is not None:
            self._thread.join(_LAST_S)
        self._redirect(self._stderr)
        if self._thread is None or not self._thread.is_alive():
            self._live.stop()

    def _rows(self) -> int:
        return max(self._console.height - _TITLES_LINES, 1)

    def _draw(self, status: Mapping[str, Any]) -> None:
        self._live.update(Group(*tables(status)), refresh=True)

    def _redirect(self, stream: Any) -> None:
        for handler in self._handlers:
            if isinstance(handler, logging.StreamHandler):
                handler.setStream(stream)
