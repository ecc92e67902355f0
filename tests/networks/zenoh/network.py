"""Networks of rmw_zenoh on the loopback interface, and what foreign participants put on them."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import zenoh

from ropeway.networks.zenoh import ZenohGraph
from ropeway.networks.zenoh.address import ZenohAddress
from tests.support.ports import free_port
from tests.support.until import until

__all__ = ["endpoint", "foreign_session", "open_pair"]


def endpoint() -> str:
    """A TCP endpoint of Zenoh that nobody listens on."""
    return f"tcp/127.0.0.1:{free_port()}"


@asynccontextmanager
async def open_pair(*, domain: int = 0, **far_options: Any) -> AsyncIterator[tuple[ZenohGraph, ZenohGraph, str]]:
    """Two nodes that know each other, of which the first listens, and where."""
    where = endpoint()
    async with AsyncExitStack() as stack:
        near = ZenohGraph(ZenohAddress(domain, (), (where,), "peer"), name="near")
        far = ZenohGraph(ZenohAddress(domain, (where,), (), "peer"), name="far", **far_options)
        for graph in (near, far):
            await graph.open()
            stack.push_async_callback(graph.close)
        await until(lambda: "/far" in near.nodes() and "/near" in far.nodes())
        yield near, far, where


def foreign_session(where: str) -> zenoh.Session:
    """A session of somebody else, to put anything on the network of ``where``."""
    config = zenoh.Config()
    for key, value in {
        "mode": "peer",
        "connect/endpoints": [where],
        "listen/endpoints": [],
        "scouting/multicast/enabled": False,
    }.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)
