"""Connections with one request, and what they may hold up."""

from __future__ import annotations

import asyncio
import socket
from contextlib import AsyncExitStack

from ropeway.gateway.rest.pages import RestPages
from ropeway.graph.base import SEQ_NONE, Sample, new_origin
from ropeway.hub.hub import Hub
from ropeway.listener.authorization import Access
from ropeway.listener.http import parse_head
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.types import TypeRegistry
from tests.support.until import until

IMAGE = "sensor_msgs/msg/CompressedImage"
HEAD = b"GET /ros/topics/image HTTP/1.1\r\nhost: x\r\naccept: text/event-stream\r\n\r\n"


async def test_a_reader_that_stalls_is_dropped() -> None:
    """Whoever asks for a stream and takes nothing of it is disconnected, and the topic is no longer read for it."""
    registry = TypeRegistry()
    async with AsyncExitStack() as stack:
        graph, robot = MemoryGraph("stalled", node="/gateway"), MemoryGraph("stalled", node="/robot")
        for opened in (graph, robot):
            await opened.open()
            stack.push_async_callback(opened.close)
        hub = Hub(graph)
        await hub.open()
        stack.push_async_callback(hub.close)
        pages = RestPages(hub, registry, unregister_timeout_s=1, call_timeout_s=1, reader_s=0.05)
        stack.push_async_callback(pages.close)
        request, access = parse_head(HEAD), Access()
        loop = asyncio.get_running_loop()
        server = await loop.create_server(lambda: pages(request, access), "127.0.0.1", 0)  # type: ignore[arg-type, return-value]
        stack.callback(server.close)
        client = stack.enter_context(socket.create_connection(server.sockets[0].getsockname()))
        client.sendall(HEAD)
        publisher = await robot.create_publisher("/image", IMAGE)
        payload = registry.codec(IMAGE).encode({"format": "jpeg", "data": bytes(1 << 20)})
        await until(lambda: publisher.subscribers)
        assert pages.connections == 1

        def dropped() -> bool:
            publisher.publish(Sample(payload, IMAGE, 0, new_origin(), SEQ_NONE))
            return not pages.connections

        await until(dropped)
