"""Keeps clients of services for further calls of a session, so that a caller that polls makes none anew."""

from __future__ import annotations

from collections import OrderedDict
from typing import Final

from ropeway.hub.calls import ViewClient
from ropeway.hub.hub import View

__all__ = ["KEPT_CLIENTS", "KeptClients"]

KEPT_CLIENTS: Final = 32
"""Services that one session calls again soon."""


class KeptClients:
    """The clients that a session has on its view.

    ``kept`` has them by the name and the type of their services, that not used for longest first; who uses one from
    there moves it to the end.
    """

    def __init__(self, view: View) -> None:
        self.kept: OrderedDict[tuple[str, str], ViewClient] = OrderedDict()
        self._view = view

    async def take(self, name: str, type: str) -> ViewClient:
        """Return the client of a service, a new one where none is kept."""
        client = self.kept.pop((name, type), None) or await self._view.create_client(name, type)
        return await self.keep(name, type, client)

    async def keep(self, name: str, type: str, client: ViewClient) -> ViewClient:
        """Keep a client for further calls, or take the one that is kept; that not used for longest goes."""
        clients = self.kept
        other = clients.pop((name, type), None)  # of a call that came meanwhile
        if other is not None and other is not client:
            await client.close()
            client = other
        clients[name, type] = client
        while len(clients) > KEPT_CLIENTS:
            oldest = next(iter(clients))
            idle = clients.pop(oldest)
            if idle.busy:
                clients[oldest] = idle
                break
            await idle.close()
        return client

    async def close(self) -> None:
        """Close all of them."""
        clients, self.kept = self.kept, OrderedDict()
        for client in clients.values():
            await client.close()
