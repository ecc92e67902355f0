"""A query that another member asks over Zenoh."""

from __future__ import annotations

import contextlib

import zenoh

__all__ = ["Asked"]


class Asked:
    """A query that somebody asks us; answered at most once, and given up when it is let go."""

    __slots__ = ("_query", "payload")

    def __init__(self, query: zenoh.Query) -> None:
        self._query: zenoh.Query | None = query
        self.payload = bytes(query.payload) if query.payload is not None else b""

    def part(self, payload: bytes) -> None:
        """Send one answer of several."""
        if self._query is not None:
            with contextlib.suppress(zenoh.ZError):  # who asked has left
                self._query.reply(self._query.key_expr, payload)

    def done(self) -> None:
        """End the answers."""
        query, self._query = self._query, None
        if query is not None:
            query.drop()  # type: ignore[no-untyped-call]

    def answer(self, payload: bytes) -> None:
        """Send the only answer."""
        self.part(payload)
        self.done()
