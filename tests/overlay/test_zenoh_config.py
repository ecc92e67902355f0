"""How Zenoh is set up."""

from __future__ import annotations

import json
from contextlib import AsyncExitStack

from ropeway.graph.overlay import OverlayGraph
from ropeway.overlay.fabric import Fabric
from ropeway.overlay.node import OverlayNode
from ropeway.overlay.router import Router
from ropeway.overlay.zenoh_config import gateway_config, gateway_id
from tests.overlay.conftest import Site
from tests.overlay.conftest import site as site
from tests.overlay.fleet import fleet, member
from tests.support.ports import free_endpoint
from tests.support.until import until


def endpoints(*connect: str) -> list[str]:
    fleet()
    config = gateway_config(member(), gateway=gateway_id(), connect=connect, listen=())
    found: list[str] = json.loads(config.get_json("connect/endpoints"))
    return found


def test_two_connections_to_each() -> None:
    """Each endpoint is dialled twice, once for what is small or urgent; one that says what it carries is left alone."""
    assert endpoints("tls/[::1]:7447#iface=eth0") == [
        "tls/[::1]:7447?prio=0-4#iface=eth0",
        "tls/[::1]:7447?prio=5-7#iface=eth0",
    ]
    assert endpoints("tls/a:1?prio=1-7") == ["tls/a:1?prio=1-7"]


def carried(fabric: Fabric) -> list[tuple[int, int] | None]:
    """What the connections of a member carry."""
    return sorted((link.priorities for link in fabric.session.info.links()), key=str)


async def test_two_connections_stand(site: Site) -> None:
    """A member and its router are joined by two connections."""
    graph = await site.join(alone=True)
    await until(lambda: carried(graph.node.fabric) == [(0, 4), (5, 7)])


async def test_two_connections_between_members() -> None:
    """Members that learn of each other from a router are joined directly by two connections, too."""
    fleet()
    async with AsyncExitStack() as stack:
        endpoint = free_endpoint()
        await stack.enter_async_context(Router(member("router", role="router"), listen=[endpoint]))
        nodes = [OverlayNode(member(), routers=[endpoint], listen=["tls/127.0.0.1:0"]) for _ in range(2)]
        for node in nodes:
            graph = OverlayGraph(node)
            await graph.open()
            stack.push_async_callback(graph.close)
        near, far = nodes

        def between() -> set[tuple[int, int] | None]:
            links = near.fabric.session.info.links()
            return {link.priorities for link in links if str(link.zid) == str(far.fabric.session.info.zid())}

        await until(lambda: between() == {(0, 4), (5, 7)}, 30)
