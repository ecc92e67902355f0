"""Keeps what was sent last over a link, until it has surely arrived or the link is doubted."""

from __future__ import annotations

from collections import deque
from typing import Final, Generic, TypeVar

from ropeway.limits import LINK_SENT_AGAIN_BYTES

__all__ = ["Recent"]

_KEPT_S: Final = 1.0  # a link is doubted long before

T = TypeVar("T")


class Recent(Generic[T]):
    """The last things that were sent, and when; bounded by bytes and by age."""

    def __init__(self) -> None:
        self._sent: deque[tuple[float, int, T]] = deque()
        self._bytes = 0

    def note(self, what: T, size_bytes: int, now_s: float) -> None:
        """Keep something that is sent now; of what is too large for the bound nothing is kept."""
        sent = self._sent
        sent.append((now_s, size_bytes, what))
        self._bytes += size_bytes
        while sent and (self._bytes > LINK_SENT_AGAIN_BYTES or sent[0][0] < now_s - _KEPT_S):
            self._bytes -= sent.popleft()[1]

    def take(self, since_s: float) -> list[T]:
        """Return what was sent since then, in order, and forget all."""
        found = [what for at_s, _, what in self._sent if at_s >= since_s]
        self.forget()
        return found

    def forget(self) -> None:
        """Forget all: it has gone by every link that is used, or by one that is used no longer."""
        self._sent.clear()
        self._bytes = 0
