"""A gateway that reaches another over two links, each from an address of its own."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ropeway.errors import ConfigError
from ropeway.gateway.config import config
from ropeway.graph.calls import Request
from ropeway.qos import QoS
from ropeway.tasks import end
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample
from tests.support.services import ADD, addends, total
from tests.support.until import until
from tests.support.world import World, url

INTERFACES = ["127.0.0.2", "127.0.0.3"]
DEEP = QoS(depth=200)


@pytest.fixture
async def world() -> AsyncIterator[World]:
    async with AsyncExitStack() as stack:
        yield World(stack)


class Pair:
    """A robot, a cloud, and two links between them."""

    def __init__(self, world: World) -> None:
        self.world = world

    async def start(self, **remote: Any) -> None:
        self.cloud_gateway = await self.world.gateway("cloud", [])
        self.cloud = await self.world.robot("cloud")
        remotes = [{"address": url(self.cloud_gateway), "interfaces": INTERFACES, **remote}]
        self.gateway = await self.world.gateway("robot", remotes)
        self.robot = await self.world.robot("robot")
        await until(lambda: all(link["up"] for link in self.status["links"]["members"].values()))

    @property
    def status(self) -> dict[str, Any]:
        found: dict[str, Any] = self.gateway.status()["remotes"][0]
        return found

    def cut(self, interface: str) -> None:
        """End the link from an address, as the far side sees it."""
        for session in list(self.cloud_gateway.servers[0].sessions):
            if interface in str(session.status()["peer"]):
                session.peer.connection.abort("cut")


TOPICS: dict[str, Any] = {
    "publish": [{"name": "/up", "type": STRING, "qos": {"depth": 200}}],
    "subscribe": [{"name": "/down", "type": STRING, "qos": {"depth": 200}}],
}


async def test_duplicate(world: World) -> None:
    """What goes over two links at once arrives once and all of it, both ways, while one of them is cut."""
    pair = Pair(world)
    await pair.start(links="duplicate", **TOPICS)
    up, down = Inbox(), Inbox()
    await pair.cloud.create_subscription("/up", STRING, DEEP, up)
    await pair.robot.create_subscription("/down", STRING, DEEP, down)
    publishers = [await pair.robot.create_publisher("/up", STRING, DEEP)]
    publishers.append(await pair.cloud.create_publisher("/down", STRING, DEEP))
    await until(lambda: all(publisher.subscribers for publisher in publishers))
    for number in range(60):
        for publisher in publishers:
            publisher.publish(sample(str(number)))
        if number == 30:
            pair.cut(INTERFACES[0])
        await asyncio.sleep(0.002)
    for inbox in (up, down):
        await inbox.wait(60, 30)
        assert [int(one.payload[8:-1]) for one in inbox.samples] == list(range(60))
    assert pair.status["links"]["drops"]["/down: the same came by another link"] > 0


async def test_best(world: World) -> None:
    """Of two links one carries what goes; when it is cut the other does, both ways, and nothing comes twice."""
    pair = Pair(world)
    await pair.start(**TOPICS)
    up, down = Inbox(), Inbox()
    await pair.cloud.create_subscription("/up", STRING, DEEP, up)
    await pair.robot.create_subscription("/down", STRING, DEEP, down)
    publishers = [await pair.robot.create_publisher("/up", STRING, DEEP)]
    publishers.append(await pair.cloud.create_publisher("/down", STRING, DEEP))
    await until(lambda: all(publisher.subscribers for publisher in publishers))
    numbers = itertools.count()

    async def until_both_ways() -> None:
        before = len(up.samples), len(down.samples)

        def came() -> bool:
            for publisher in publishers:
                publisher.publish(sample(str(next(numbers))))
            return len(up.samples) > before[0] and len(down.samples) > before[1]

        await until(came)

    await until_both_ways()
    current = pair.status["links"]["current"]
    pair.cut(current)
    await until(lambda: pair.status["links"]["current"] not in ("", current))
    await until_both_ways()
    for inbox in (up, down):
        came = [int(one.payload[8:-1]) for one in inbox.samples]
        assert came == sorted(set(came))


async def test_a_call_is_carried_out_once(world: World) -> None:
    """A call goes over both links, is carried out once and answered once."""
    pair = Pair(world)
    await pair.start(links="duplicate", **{"reserve-service": [{"name": "/add", "type": ADD}]})
    calls = 0

    async def add(request: Request) -> bytes:
        nonlocal calls
        calls += 1
        return total(calls)

    await pair.cloud.create_service("/add", ADD, add)
    client = await pair.robot.create_client("/add", ADD)
    assert await client.wait_available(30)
    for number in range(1, 6):
        assert await client.call(Request(addends(1))) == total(number)
    assert calls == 5


@pytest.mark.parametrize(
    ("remote", "path", "words"),
    [
        ({"address": "iort://a", "interfaces": ["wlan0"]}, "remotes[0].interfaces", "only ws:// and wss://"),
        ({"address": "ws://a", "interfaces": ["wlan0", "wlan0"]}, "remotes[0].interfaces", "twice"),
        ({"address": "ws://a", "links": "best"}, "remotes[0].links", "needs several interfaces"),
        ({"address": ["ws://a", "ws://b"], "interfaces": ["x", "y"]}, "remotes[0].interfaces", "one address"),
        ({"address": "ws://a", "interfaces": ["w l"]}, "remotes[0].interfaces[0]", "wlan0"),
    ],
)
def test_mistakes(remote: dict[str, Any], path: str, words: str) -> None:
    """Links that cannot be meant are refused with the path of the mistake and what to write."""
    with pytest.raises(ConfigError) as caught:
        config.parse([remote])
    assert any(where == path and words in text for where, text in caught.value.problems), caught.value.problems


class Cables:
    """Carries connections to a port; one from an address that is frozen stands, and carries nothing."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._frozen: dict[str, asyncio.Event] = {name: asyncio.Event() for name in INTERFACES}
        self._tasks: set[asyncio.Task[None]] = set()
        for thawed in self._frozen.values():
            thawed.set()

    async def start(self, stack: AsyncExitStack) -> str:
        server = await asyncio.start_server(self._carry, "127.0.0.1", 0)
        stack.push_async_callback(self._end, server)
        return f"ws://127.0.0.1:{server.sockets[0].getsockname()[1]}"

    async def _end(self, server: asyncio.Server) -> None:
        server.close()
        await end(*self._tasks)

    def freeze(self, name: str) -> None:
        self._frozen[name].clear()

    async def _carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        thawed = self._frozen[writer.get_extra_info("peername")[0]]
        far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self._port)
        for source, sink in ((reader, far_writer), (far_reader, writer)):
            task = asyncio.create_task(self._pump(source, sink, thawed))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    @staticmethod
    async def _pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, thawed: asyncio.Event) -> None:
        try:
            with contextlib.suppress(ConnectionError):
                while data := await reader.read(1 << 16):
                    await thawed.wait()
                    writer.write(data)
        finally:
            writer.transport.abort()


@pytest.mark.parametrize("links", ["best", "duplicate"])
async def test_a_link_falls_silent(world: World, links: str) -> None:
    """A link that carries nothing any more, while its connection stands, is left; nothing is lost either way."""
    pair = Pair(world)
    cloud = await world.gateway("cloud", [])
    cables = Cables(cloud.servers[0].listeners[0].port)
    remote = {"address": await cables.start(world.stack), "interfaces": INTERFACES, "links": links, **TOPICS}
    pair.gateway = await world.gateway("robot", [remote])
    robot, far = await world.robot("robot"), await world.robot("cloud")
    up, down = Inbox(), Inbox()
    await far.create_subscription("/up", STRING, DEEP, up)
    await robot.create_subscription("/down", STRING, DEEP, down)
    publishers = [await robot.create_publisher("/up", STRING, DEEP), await far.create_publisher("/down", STRING, DEEP)]
    await until(lambda: all(publisher.subscribers for publisher in publishers))
    await until(lambda: all(m["up"] for m in pair.status["links"]["members"].values()))
    numbers = itertools.count()

    def publish() -> bool:
        number = next(numbers)
        for publisher in publishers:
            publisher.publish(sample(str(number)))
        return len(up.samples) > 5 and len(down.samples) > 5

    await until(publish)
    current = pair.status["links"]["current"]
    cables.freeze(current)
    before = len(up.samples), len(down.samples)

    def goes_on() -> bool:
        publish()
        left = pair.status["links"]["current"] != current
        return left and len(up.samples) > before[0] + 5 and len(down.samples) > before[1] + 5

    await until(goes_on)
    sent = next(numbers)
    for inbox in (up, down):
        came = [int(one.payload[8:-1]) for one in inbox.samples]
        assert came == sorted(set(came))
        await until(lambda: int(inbox.samples[-1].payload[8:-1]) == sent - 1)  # noqa: B023
        came = [int(one.payload[8:-1]) for one in inbox.samples]
        assert came == list(range(came[0], sent))
