"""A viewer for tests, frame by frame, and a server of viewers on a network of its own."""

from __future__ import annotations

import itertools
import struct
from contextlib import AsyncExitStack
from typing import Any, NamedTuple

from ropeway import aio
from ropeway.hub.hub import Hub
from ropeway.listener.authentication import Door
from ropeway.listener.connection import Limits
from ropeway.listener.entrance import Entrance
from ropeway.networks.foxglove.server import FoxgloveServer
from ropeway.networks.foxglove.session import ViewerSession
from ropeway.networks.foxglove.settings import FoxgloveSettings
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.types import TypeRegistry
from tests.support.until import PATIENCE_S
from tests.support.websocket import Client

__all__ = ["SDK", "WEBSOCKET", "Arrived", "Sight", "Viewer"]

SDK, WEBSOCKET = "foxglove.sdk.v1", "foxglove.websocket.v1"

_numbers = itertools.count()
_registry = TypeRegistry()


class Arrived(NamedTuple):
    """A message that a viewer got."""

    subscription: int
    stamp_ns: int
    payload: bytes


class Viewer(Client):
    """A viewer. Operations that it was sent are kept by name, messages in ``messages``."""

    def __init__(self, port: int, *, subprotocol: str = SDK, **options: Any) -> None:
        super().__init__(port, subprotocol=subprotocol, **options)
        self.told: list[dict[str, Any]] = []
        self.messages: list[Arrived] = []
        self.binary: list[bytes] = []
        self.channels: dict[int, dict[str, Any]] = {}
        self.services: dict[int, dict[str, Any]] = {}

    async def __aenter__(self) -> Viewer:
        await super().__aenter__()
        return self

    async def take(self) -> dict[str, Any] | bytes:
        """Take the next frame, and note what it tells."""
        got = await self.receive()
        if not got.text:
            if got.data[0] == 1:
                _, subscription, stamp_ns = struct.unpack_from("<BIQ", got.data)
                self.messages.append(Arrived(subscription, stamp_ns, got.data[13:]))
            else:
                self.binary.append(got.data)
            return got.data
        told: dict[str, Any] = got.json
        self.told.append(told)
        for channel in told.get("channels", ()):
            self.channels[channel["id"]] = channel
        for number in told.get("channelIds", ()):
            self.channels.pop(number, None)
        for service in told.get("services", ()):
            self.services[service["id"]] = service
        for number in told.get("serviceIds", ()):
            self.services.pop(number, None)
        return told

    async def until(self, condition: Any) -> Any:
        """Take frames until ``condition()`` is something, and return it."""
        async with aio.timeout(PATIENCE_S):
            while not (found := condition()):
                await self.take()
        return found

    async def op(self, name: str) -> dict[str, Any]:
        """Wait for an operation of this name that was not waited for yet, and return it."""

        def find() -> dict[str, Any] | None:
            return next((told for told in self.told if told["op"] == name), None)

        found: dict[str, Any] = await self.until(find)
        self.told.remove(found)
        return found

    async def complaint(self) -> str:
        """Wait for a complaint, and return its text."""
        return str((await self.op("status"))["message"])

    async def channel(self, topic: str) -> dict[str, Any]:
        """Wait for the channel of a topic."""
        found: dict[str, Any] = await self.until(
            lambda: next((each for each in self.channels.values() if each["topic"] == topic), None)
        )
        return found

    async def service(self, name: str) -> dict[str, Any]:
        """Wait for a service."""
        found: dict[str, Any] = await self.until(
            lambda: next((each for each in self.services.values() if each["name"] == name), None)
        )
        return found

    async def subscribe(self, topic: str, id: int = 1) -> dict[str, Any]:
        """Read a topic, once there is a channel of it."""
        channel = await self.channel(topic)
        self.send({"op": "subscribe", "subscriptions": [{"id": id, "channelId": channel["id"]}]})
        return channel

    async def message(self) -> Arrived:
        """Wait for the next message, and return it."""
        await self.until(lambda: self.messages)
        return self.messages.pop(0)

    async def passed(self) -> None:
        """Wait until everything that was sent so far has been carried out: the answer is a complaint about this."""
        number = next(_numbers)
        self.send({"op": "unadvertise", "channelIds": [4_000_000_000 + number]})
        async with aio.timeout(PATIENCE_S):
            while not any(str(4_000_000_000 + number) in str(told.get("message")) for told in self.told):
                await self.take()
        self.told = [told for told in self.told if str(4_000_000_000 + number) not in str(told.get("message"))]


class Sight:
    """The server, and a robot's participant on its network."""

    def __init__(self, stack: AsyncExitStack) -> None:
        self.stack = stack
        self.registry = _registry
        self.network = f"viewed-{next(_numbers)}"
        self.server: FoxgloveServer
        self.hub: Hub
        self.robot: MemoryGraph
        self.port = 0

    async def start(
        self,
        settings: FoxgloveSettings | None = None,
        *,
        door: Door | None = None,
        limits: Limits | None = None,
        **options: Any,
    ) -> None:
        graph = await self.participant("/gateway")
        self.robot = await self.participant("/robot")
        self.hub = Hub(graph)
        self.server = FoxgloveServer(
            self.hub, self.registry, settings, limits=limits, entrance=Entrance(door), **options
        )
        self.stack.push_async_callback(self.server.close)
        self.port = (await self.server.listen("foxglove://127.0.0.1:0")).port

    async def participant(self, node: str) -> MemoryGraph:
        graph = MemoryGraph(self.network, node=node)
        await graph.open()
        self.stack.push_async_callback(graph.close)
        return graph

    async def viewer(self, **options: Any) -> Viewer:
        viewer = Viewer(self.port, **options)
        await self.stack.enter_async_context(viewer)
        return viewer

    @property
    def session(self) -> ViewerSession:
        """The one viewer's session."""
        (session,) = self.server.sessions
        return session
