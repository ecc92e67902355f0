"""Opens the store of a gateway's last values."""

from __future__ import annotations

from contextlib import AsyncExitStack
from typing import TYPE_CHECKING

from ropeway.gateway.config.iort_model import StoreConfig

if TYPE_CHECKING:
    from ropeway.gateway.config.model import GatewayConfig
    from ropeway.store import Store

__all__ = ["open_store"]


async def open_store(settings: GatewayConfig, stack: AsyncExitStack) -> Store:
    """Open the store that a configuration says; ``stack`` closes it."""
    from ropeway.store import Store, default_path, make_backend, make_mirror

    config = settings.store or StoreConfig.model_validate({})
    mirror = None if config.mongodb is None else make_mirror(config.mongodb)
    backend = make_backend(config.path or default_path(settings.name))
    store = Store(backend, mirror=mirror, limits=config.limits())
    await store.open()
    stack.push_async_callback(store.close)
    return store
