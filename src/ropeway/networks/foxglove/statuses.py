"""Tells a viewer what went wrong: as much as a person reads, and no more than the viewer takes."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final

from ropeway.limits import SHOWN_TEXT_CHARACTERS, UNREAD_STATUS_BYTES, VIEWER_STATUSES, VIEWER_STATUSES_PER_S
from ropeway.networks.foxglove.wire import dumps

if TYPE_CHECKING:
    from ropeway.networks.foxglove.sender import ViewerSender

__all__ = ["ERROR", "INFO", "WARNING", "Statuses"]

INFO: Final = 0
WARNING: Final = 1
ERROR: Final = 2


class Statuses:
    """Sends statuses to one viewer. Those that are too many are left out, and the next says how many."""

    def __init__(self, sender: ViewerSender, clock: Callable[[], float] = time.monotonic) -> None:
        self._sender, self._clock = sender, clock
        self._left, self._at = float(VIEWER_STATUSES), clock()
        self._unsaid = 0
        self._standing: dict[str, str] = {}

    def tell(self, level: int, text: str) -> None:
        """Tell something that has happened."""
        now = self._clock()
        self._left = min(self._left + (now - self._at) * VIEWER_STATUSES_PER_S, float(VIEWER_STATUSES))
        self._at = now
        if self._left < 1 or self._sender.answers_bytes > UNREAD_STATUS_BYTES:
            self._unsaid += 1
            return
        self._left -= 1
        more = f" ({self._unsaid} more were left out)" if self._unsaid else ""
        self._unsaid = 0
        self._send({"op": "status", "level": level, "message": text[:SHOWN_TEXT_CHARACTERS] + more})

    def stand(self, texts: Mapping[str, str]) -> None:
        """Show exactly these warnings, by their ids, until the next call: tell new ones, and take back the others."""
        gone = [id for id in self._standing if id not in texts]
        if gone:
            self._send({"op": "removeStatus", "statusIds": gone})
        for id, text in texts.items():
            if self._standing.get(id) != text:
                self._send({"op": "status", "level": WARNING, "message": text[:SHOWN_TEXT_CHARACTERS], "id": id})
        self._standing = dict(texts)

    def _send(self, message: dict[str, Any]) -> None:
        self._sender.text(dumps(message))
