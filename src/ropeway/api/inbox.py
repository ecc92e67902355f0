"""Messages that wait for a program: bounded in number and bytes, the oldest go first, and what went is counted."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Final

from ropeway.api.message import TypedMessage

__all__ = ["QUEUE_BYTES", "QUEUE_MESSAGES", "Inbox"]

QUEUE_MESSAGES: Final = 1000  # ten seconds of a topic at 100 Hz
QUEUE_BYTES: Final = 64 << 20  # a second of uncompressed Full HD images at 10 Hz


class Inbox:
    """A queue between the graph, which never waits, and a program, which may be slow. ``dropped`` counts what went."""

    def __init__(self, limit_messages: int, limit_bytes: int) -> None:
        self.dropped = 0
        self._limit_messages, self._limit_bytes = limit_messages, limit_bytes
        self._waiting: deque[TypedMessage] = deque()
        self._bytes = 0
        self._news = asyncio.Event()
        self._error: Exception | None = None
        self._closed = False

    def put(self, message: TypedMessage) -> None:
        """Add a message; drop the oldest if there are too many. The newest always has a place."""
        self._waiting.append(message)
        self._bytes += len(message.raw)
        while len(self._waiting) > 1 and (len(self._waiting) > self._limit_messages or self._bytes > self._limit_bytes):
            self._bytes -= len(self._waiting.popleft().raw)
            self.dropped += 1
        self._news.set()

    async def get(self) -> TypedMessage | None:
        """Return the next message, ``None`` if no more will come. Raises the error that ``fail`` was given."""
        while not self._waiting:
            if self._error is not None:
                raise self._error
            if self._closed:
                return None
            self._news.clear()
            await self._news.wait()
        message = self._waiting.popleft()
        self._bytes -= len(message.raw)
        return message

    def fail(self, error: Exception | None) -> None:
        """Raise ``error`` to whoever waits, once everything that came before was taken; ``None`` takes it back."""
        self._error = error
        self._news.set()

    def finish(self) -> None:
        """Wake everybody who waits, once everything that came before was taken."""
        self._closed = True
        self._news.set()

    def close(self) -> None:
        """Forget what waits, and have nobody wait any more."""
        self._waiting.clear()
        self._bytes = 0
        self.finish()
