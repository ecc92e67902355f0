"""The ``fragment`` operation: long texts in pieces, out (``Fragmenter``) and in (``Defragmenter``)."""

from __future__ import annotations

import itertools
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Final

from ropeway.errors import InvalidOperation
from ropeway.limits import FRAGMENTS, UNFINISHED_MESSAGES
from ropeway.networks.rosbridge.protocol.ops import Fragment, dumps

__all__ = ["MIN_FRAGMENT_SIZE", "Defragmenter", "Fragmenter"]

MIN_FRAGMENT_SIZE: Final = 32
"""Characters; a client that asks for less gets this, or the frames around them would be most of the traffic."""


class Fragmenter:
    """Splits the texts that one connection sends; every text gets its own number as id."""

    def __init__(self) -> None:
        self._ids = itertools.count(1)

    def split(self, text: bytes, fragment_size: int | None) -> list[bytes]:
        """Split an operation's JSON text in ASCII into the frames to send, in order.

        A text of at most ``fragment_size`` characters stays as it is; ``None`` means no limit.
        """
        if fragment_size is None or len(text) <= fragment_size:
            return [text]
        size = max(fragment_size, MIN_FRAGMENT_SIZE)
        total = -(-len(text) // size)
        id = str(next(self._ids))
        return [
            dumps(
                {
                    "op": "fragment",
                    "id": id,
                    "data": text[num * size : (num + 1) * size].decode("ascii"),
                    "num": num,
                    "total": total,
                }
            )
            for num in range(total)
        ]


_KEEPING_BYTES: Final = 160  # of one piece, besides its characters: an entry of a table, a number and a header


class _Partial:
    __slots__ = ("began_s", "parts", "size", "total")

    def __init__(self, total: int, began_s: float) -> None:
        self.total, self.began_s = total, began_s
        self.parts: dict[int, bytes] | None = {}  # None: given up, what still comes is not kept
        self.size = 0


class Defragmenter:
    """Puts together what one peer sends in fragments, in whatever order they come; repeated ones do no harm.

    ``limit_bytes`` bounds all that waits, ``limit_fragments`` the pieces of one text, ``limit_texts`` the texts that
    are not complete (the oldest is forgotten for a new one). A text that is not complete ``timeout_s`` seconds after
    its first fragment is forgotten; ``clock`` counts seconds.
    """

    def __init__(
        self,
        *,
        limit_bytes: int = 64 << 20,
        limit_fragments: int = FRAGMENTS,
        limit_texts: int = UNFINISHED_MESSAGES,
        timeout_s: float = 600.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.limit_bytes, self.limit_fragments, self.limit_texts = limit_bytes, limit_fragments, limit_texts
        self.timeout_s = timeout_s
        self.pending_bytes = self.pending_fragments = 0
        self.forgotten = 0  # texts that never became complete
        self._clock = clock
        self._partials: OrderedDict[bytes, _Partial] = OrderedDict()  # the oldest first

    @property
    def held_bytes(self) -> int:
        """The bytes kept in all: pieces may be so small that keeping them costs more than they hold."""
        return self.pending_bytes + _KEEPING_BYTES * (self.pending_fragments + len(self._partials))

    def clear(self) -> None:
        """Forget everything."""
        self._partials.clear()
        self.pending_bytes = self.pending_fragments = 0

    @property
    def pending(self) -> int:
        """The number of incomplete texts."""
        return len(self._partials)

    def add(self, fragment: Fragment) -> bytes | None:
        """Take a fragment; returns the text that it completes.

        Raises ``InvalidOperation`` for one that contradicts the others of its text, or is beyond a limit; the
        text is then given up.
        """
        self.expire()
        key = dumps({"id": fragment.id})
        partial = self._partials.get(key)
        if partial is None:
            if len(self._partials) >= self.limit_texts:
                self._forget(next(iter(self._partials)))
            partial = self._partials[key] = _Partial(fragment.total, self._clock())
        if partial.parts is None:
            return None
        num = fragment.num
        if fragment.total != partial.total or not 0 <= num < partial.total:
            raise self._give_up(partial, fragment, f"error while trying to append fragment {num}")
        if partial.total > self.limit_fragments:
            reason = f"received invalid fragment! {partial.total} are more than {self.limit_fragments}"
            raise self._give_up(partial, fragment, reason)
        data = fragment.data.encode(errors="surrogatepass")
        known = partial.parts.get(num)
        if known is not None:
            if known != data:
                raise self._give_up(partial, fragment, f"error while trying to append fragment {num}")
            return None
        if self.pending_bytes + len(data) > self.limit_bytes:
            reason = f"received invalid fragment! more than {self.limit_bytes} bytes wait for others"
            raise self._give_up(partial, fragment, reason)
        partial.parts[num] = data
        partial.size += len(data)
        self.pending_bytes += len(data)
        self.pending_fragments += 1
        if len(partial.parts) < partial.total:
            return None
        del self._partials[key]
        self.pending_bytes -= partial.size
        self.pending_fragments -= partial.total
        return b"".join(partial.parts[i] for i in range(partial.total))

    def expire(self) -> None:
        """Forget what has waited too long."""
        oldest = self._clock() - self.timeout_s
        while self._partials:
            key, partial = next(iter(self._partials.items()))
            if partial.began_s > oldest:
                break
            self._forget(key)

    def _forget(self, key: bytes) -> None:
        partial = self._partials.pop(key)
        if partial.parts is not None:
            self._release(partial)

    def _give_up(self, partial: _Partial, fragment: Fragment, reason: str) -> InvalidOperation:
        self._release(partial)
        return InvalidOperation("fragment", reason, id=fragment.id)

    def _release(self, partial: _Partial) -> None:
        assert partial.parts is not None
        self.pending_bytes -= partial.size
        self.pending_fragments -= len(partial.parts)
        self.forgotten += 1
        partial.parts, partial.size = None, 0
