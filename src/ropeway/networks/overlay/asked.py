"""A query that another member asks over Zenoh."""

from __future__ import annotations

import contextlib

import zenoh

__all__ = ["Asked"]


class Asked:
    """A query that somebody asks us; answered at most once, and given up when it is let go."""

    __slots__ = ("_queries", "payload")

    def __init__(self, query: zenoh.Query) -> None:
        self._queries = [query]
        self.payload = bytes(query.payload) if query.payload is not None else b""

    def join(self, other: Asked) -> None:
        """Answer the same query, which came by another link as well, together with this one."""
        if self._queries:
            self._queries += other._queries
            other._queries = []
        else:
            other.done()

    def part(self, payload: bytes) -> None:
        """Send one answer of several."""
        for query in self._queries:
            with contextlib.suppress(zenoh.ZError):  # who asked has left
                query.reply(query.key_expr, payload)

    def done(self) -> None:
        """End the answers."""
        queries, self._queries = self._queries, []
        for query in queries:
            query.drop()  # type: ignore[no-untyped-call]

    def answer(self, payload: bytes) -> None:
        """Send the only answer."""
        self.part(payload)
        self.done()
