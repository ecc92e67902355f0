"""Recognises our own messages where a broker sends them back, as MQTT 3.1.1 does to who reads what he publishes."""

from __future__ import annotations

from collections import OrderedDict
from typing import Final

__all__ = ["Echoes"]

_REMEMBERED: Final = 4096


class Echoes:
    """The messages that were sent to topics that are read here, each until it has come back once."""

    def __init__(self) -> None:
        self._sent: OrderedDict[tuple[str, int], int] = OrderedDict()

    def sent(self, topic: str, payload: bytes) -> None:
        """Expect a message to come back."""
        key = (topic, hash(payload))
        self._sent[key] = self._sent.pop(key, 0) + 1
        if len(self._sent) > _REMEMBERED:
            self._sent.popitem(last=False)

    def is_own(self, topic: str, payload: bytes) -> bool:
        """Return whether a message is one of ours that comes back."""
        if not self._sent:
            return False
        key = (topic, hash(payload))
        left = self._sent.get(key, 0)
        if left > 1:
            self._sent[key] = left - 1
        elif left:
            del self._sent[key]
        return left > 0

    def clear(self) -> None:
        """Expect nothing any more: the connection is lost."""
        self._sent.clear()
