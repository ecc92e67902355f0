"""Makes the pages that rosbridge listeners serve to clients: values of the store, topics and services."""

from __future__ import annotations

from contextlib import AsyncExitStack
from typing import TYPE_CHECKING

from ropeway.loading import load

if TYPE_CHECKING:
    from ropeway.gateway.config.model import GatewayConfig
    from ropeway.hub.hub import Hub
    from ropeway.listener.client_pages import ClientPages
    from ropeway.store import Store
    from ropeway.types import TypeRegistry

__all__ = ["client_pages"]


async def client_pages(
    settings: GatewayConfig, hub: Hub, registry: TypeRegistry, store: Store | None, stack: AsyncExitStack
) -> list[ClientPages]:
    """Return the pages that a configuration asks for; ``stack`` ends them."""
    pages: list[ClientPages] = []
    if store is not None:
        from ropeway.listener.store_pages import StorePages

        pages.append(StorePages(store, registry))
    if settings.rest:
        module = await load("ropeway.gateway.rest.pages")  # 0.2 s for HTTP
        clients = settings.clients
        rest = module.RestPages(
            hub,
            registry,
            unregister_timeout_s=clients.unregister_timeout_s,
            call_timeout_s=clients.call_timeout_s,
        )
        stack.push_async_callback(rest.close)
        pages.append(rest)
    return pages
