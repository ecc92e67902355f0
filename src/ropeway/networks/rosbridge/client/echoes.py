"""Recognize what a plain rosbridge server sends back of what we published to it."""

from __future__ import annotations

from collections import deque
from typing import Final

__all__ = ["EchoFilter"]

_ECHOES: Final = 256


class EchoFilter:
    """Recognises what a plain rosbridge server sends back of what we published to it."""

    def __init__(self) -> None:
        self._sent: deque[int] = deque(maxlen=_ECHOES)

    def sent(self, payload: bytes) -> None:
        """Remember a message that went out."""
        self._sent.append(hash(payload))

    def echoes(self, payload: bytes) -> bool:
        """Return true, once, for a message that went out before."""
        key = hash(payload)
        if key in self._sent:
            self._sent.remove(key)
            return True
        return False
