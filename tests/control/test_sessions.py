"""Clients are seen, and disconnected, over the control API."""

from __future__ import annotations

from tests.control.conftest import Begin
from tests.support.until import until
from tests.support.websocket import Client

JSON = {"content-type": "application/json"}


async def test_a_client_is_disconnected(begin: Begin) -> None:
    """An operator disconnects one client by its address, and others stay."""
    running = await begin(listen=["ws://127.0.0.1:0"])
    port = running.gateway.servers[0].listeners[0].port
    async with Client(port), Client(port):
        await until(lambda: len(running.gateway.servers[0].sessions) == 2)
        found = (await running.client.get("/v1/sessions")).json()
        assert {"peer", "since", "agent", "role", "dialect"} <= found[0].keys()
        peer = found[0]["peer"]
        assert (await running.client.delete(f"/v1/sessions/{peer}", headers=JSON)).json() == {"kicked": peer}
        await until(lambda: len(running.gateway.servers[0].sessions) == 1)
        assert (await running.client.delete(f"/v1/sessions/{peer}", headers=JSON)).status_code == 404
        kicked = [event for event in running.manager.events.last() if event.data.get("state") == "kicked"]
        assert [event.name for event in kicked] == [peer]
