"""Two gateways under steady traffic, which hold no more after a while than soon after the start."""

from __future__ import annotations

import asyncio
import base64
import os
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ropeway import aio
from tests.soak.process import Held, Served, serving
from tests.support.websocket import Client

SECONDS = float(os.environ.get("ROPEWAY_SOAK_SECONDS", "30"))
WARM_UP_S = 8.0
GROWTH_BYTES = 12 << 20
GROWTH_OBJECTS = 1100  # of one class: what is remembered of calls is bounded by 1,024
MOMENTARY = 10  # tasks and descriptors of what is under way
TEXT, IMAGE, TRIGGER = "std_msgs/String", "sensor_msgs/Image", "std_srvs/Trigger"
PICTURE = base64.b64encode(bytes(range(256)) * 300).decode()

pytestmark = [pytest.mark.slow, pytest.mark.timeout(SECONDS + 300)]


def robot(port: int) -> dict[str, Any]:
    """A gateway that dials the one at this port, and joins topics both ways and a service."""
    return {
        "gateway": {"name": "robot", "graphs": ["memory:robot"], "listen": ["ws://127.0.0.1:0"]},
        "remotes": [
            {
                "address": f"ws://127.0.0.1:{port}",
                "publish": [{"name": "/up", "type": TEXT}, {"name": "/image", "type": IMAGE}],
                "subscribe": [{"name": "/down", "type": TEXT, "priority": "command"}],
                "expose-service": [{"name": "/ask", "type": TRIGGER}],
            }
        ],
    }


class Traffic:
    """Clients on both sides that publish, read, call and answer until they are told to stop."""

    def __init__(self, here: Client, there: Client) -> None:
        self.here, self.there = here, there
        self.heard = {"/up": 0, "/image": 0, "/down": 0, "/ask": 0}
        self.ended = False

    def begin(self) -> None:
        for client, topics in ((self.here, {"/down": TEXT}), (self.there, {"/up": TEXT, "/image": IMAGE})):
            for topic, type in topics.items():
                client.send({"op": "subscribe", "topic": topic, "type": type})
        for client, topics in ((self.there, {"/down": TEXT}), (self.here, {"/up": TEXT, "/image": IMAGE})):
            for topic, type in topics.items():
                client.send({"op": "advertise", "topic": topic, "type": type})
        self.here.send({"op": "advertise_service", "service": "/ask", "type": TRIGGER})

    async def publish(self) -> None:
        number = 0
        while not self.ended:
            number += 1
            self.here.send({"op": "publish", "topic": "/up", "msg": {"data": f"up {number}"}})
            self.there.send({"op": "publish", "topic": "/down", "msg": {"data": f"down {number}"}})
            if number % 10 == 0:
                picture = {"height": 240, "width": 320, "encoding": "mono8", "step": 320, "data": PICTURE}
                self.here.send({"op": "publish", "topic": "/image", "msg": picture})
            if number % 5 == 0:
                self.there.send({"op": "call_service", "service": "/ask", "id": str(number)})
            await asyncio.sleep(0.02)

    async def listen(self, client: Client) -> None:
        while not self.ended:
            got = await client.json(30)
            if got["op"] == "call_service":
                values = {"success": True, "message": "yes"}
                client.send({**got, "op": "service_response", "values": values, "result": True})
            elif got["op"] == "service_response":
                self.heard["/ask"] += got["result"] is True
            elif got["op"] == "publish":
                self.heard[got["topic"]] += 1


async def held(gateways: list[Served]) -> list[Held]:
    return [await gateway.held() for gateway in gateways]


async def test_steady_traffic_holds_no_more() -> None:
    """Memory, descriptors, threads, tasks, sessions and objects stay what they were soon after the start."""
    cloud_config = {"gateway": {"name": "cloud", "graphs": ["memory:cloud"], "listen": ["ws://127.0.0.1:0"]}}
    async with AsyncExitStack() as stack:
        cloud = await stack.enter_async_context(serving(cloud_config))
        near = await stack.enter_async_context(serving(robot(cloud.ports[0])))
        here, there = [await stack.enter_async_context(Client(each.ports[0])) for each in (near, cloud)]
        traffic = Traffic(here, there)
        traffic.begin()
        async with aio.TaskGroup() as tasks:
            for work in (traffic.publish(), traffic.listen(here), traffic.listen(there)):
                tasks.create_task(work)
            await asyncio.sleep(WARM_UP_S)
            before, heard = await held([near, cloud]), dict(traffic.heard)
            await asyncio.sleep(SECONDS)
            after = await held([near, cloud])
            traffic.ended = True
    assert all(traffic.heard[what] > heard[what] for what in heard), (heard, traffic.heard)
    for then, now in zip(before, after, strict=True):
        assert now.rss_bytes - then.rss_bytes < GROWTH_BYTES
        grown = now.grown(then, GROWTH_OBJECTS)
        assert {what for what in grown if grown[what] > MOMENTARY} == set()
