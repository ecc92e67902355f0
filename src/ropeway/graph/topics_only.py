"""Implements what graphs share whose networks know neither services nor actions."""

from __future__ import annotations

from typing import ClassVar, NoReturn

from ropeway.errors import GraphUnavailable
from ropeway.graph.base import NO_HINTS, Delivery
from ropeway.graph.calls import (
    ActionClient,
    ActionHandlers,
    ActionInfo,
    ActionServer,
    Client,
    Service,
    ServiceHandler,
    ServiceInfo,
)
from ropeway.graph.graph_base import NetworkGraph

__all__ = ["TopicsOnlyGraph"]


class TopicsOnlyGraph(NetworkGraph):
    """A graph of topics alone: it refuses services and actions with ``no_calls``."""

    no_calls: ClassVar[str]

    async def create_client(self, service: str, type: str, *, delivery: Delivery = NO_HINTS) -> Client:
        """Raise ``GraphUnavailable``: there are no services."""
        self._refuse()

    async def create_service(
        self, service: str, type: str, handler: ServiceHandler, *, delivery: Delivery = NO_HINTS
    ) -> Service:
        """Raise ``GraphUnavailable``: there are no services."""
        self._refuse()

    async def create_action_client(self, action: str, type: str, *, delivery: Delivery = NO_HINTS) -> ActionClient:
        """Raise ``GraphUnavailable``: there are no actions."""
        self._refuse()

    async def create_action_server(
        self, action: str, type: str, handlers: ActionHandlers, *, delivery: Delivery = NO_HINTS
    ) -> ActionServer:
        """Raise ``GraphUnavailable``: there are no actions."""
        self._refuse()

    def services(self) -> dict[str, ServiceInfo]:
        """Return nothing: there are no services."""
        return {}

    def actions(self) -> dict[str, ActionInfo]:
        """Return nothing: there are no actions."""
        return {}

    def _refuse(self) -> NoReturn:
        raise GraphUnavailable(self.name, self.no_calls)
