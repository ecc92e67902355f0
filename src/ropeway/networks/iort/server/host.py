"""The part of a server of nodes that its sessions may use."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Coroutine
from typing import Any, Protocol, TypeVar

from ropeway.networks.iort.space import Space
from ropeway.store import Entry

__all__ = ["NodesHost"]

S = TypeVar("S", contravariant=True)


class NodesHost(Protocol[S]):
    """Gives a session the part of its server that it may use; ``IortServer`` does so."""

    space: Space
    max_packet_bytes: int
    kinds: dict[str, str]
    counts: Counter[str]
    render: Callable[[Entry], bytes]

    def welcome(self, session: S, transport: asyncio.Transport) -> None:
        """Take a node that connected."""

    def heard(self, session: S) -> bool:
        """Let a node in of which the first has come; return whether it may stay."""

    def hello(self, session: S, name: str, token: str | None) -> str:
        """Admit a node that says who it is, and return what it should know. Raises ``NodeError``."""

    def too_late(self, session: S) -> None:
        """Give up a node that did not say who it is."""

    def browser_came(self, session: S) -> None:
        """Send a browser away."""

    def gone(self, session: S) -> None:
        """Forget a node, which is gone."""

    def spawn(self, work: Coroutine[Any, Any, None]) -> None:
        """Start a task that ends with the server."""
