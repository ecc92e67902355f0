"""ropeway.hub.kept_clients: clients of services that a session uses again."""

from __future__ import annotations

from contextlib import AsyncExitStack

from ropeway.hub import kept_clients
from ropeway.hub.hub import Hub
from ropeway.networks.memory.graph import MemoryGraph

TRIGGER = "std_srvs/srv/Trigger"


async def test_the_least_used_goes() -> None:
    """A client is used again, and where there are too many that not used for longest is closed."""
    async with AsyncExitStack() as stack:
        graph = MemoryGraph("kept-clients", node="/gateway")
        await graph.open()
        stack.push_async_callback(graph.close)
        hub = Hub(graph, gateway_id="a")
        await hub.open()
        stack.push_async_callback(hub.close)
        kept = kept_clients.KeptClients(hub.view("session"))
        names = [f"/s{number}" for number in range(kept_clients.KEPT_CLIENTS)]
        clients = [await kept.take(name, TRIGGER) for name in names]
        assert await kept.take("/s0", TRIGGER) is clients[0]
        await kept.take("/more", TRIGGER)
        assert kept.kept["/s0", TRIGGER] is clients[0]
        assert ("/s1", TRIGGER) not in kept.kept
        kept.kept.move_to_end(("/s2", TRIGGER))
        await kept.take("/still_more", TRIGGER)
        assert kept.kept["/s2", TRIGGER] is clients[2]
        assert ("/s3", TRIGGER) not in kept.kept
        await kept.close()
        assert not kept.kept
