"""Says what serves pages to clients that were let in, on the port of a listener."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Protocol

from ropeway.listener.authorization import Access, Role
from ropeway.listener.http import HttpRequest, Response

__all__ = ["ClientPages"]


class ClientPages(Protocol):
    """Serves the pages below some paths."""

    def knows(self, path: str) -> bool:
        """Return whether ``path`` is one of its paths."""
        ...

    def __call__(self, request: HttpRequest, access: Access) -> Response | asyncio.Protocol:
        """Return the answer to a client with these rights, or the protocol that goes on with the connection."""
        ...

    def recheck(self, keeps: Callable[[HttpRequest, Role], bool]) -> None:
        """End what is under way for clients that would no longer come in with the same role."""
        ...
