"""What the overlay graph does beyond the contract."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Mapping
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ropeway import aio
from ropeway.errors import CallError, CallFailed, CallTimeout, ProviderLost
from ropeway.graph.base import Delivery
from ropeway.graph.calls import Request
from ropeway.networks.overlay.gateway_path import Path
from ropeway.networks.overlay.graph import OverlayGraph
from ropeway.networks.overlay.graph.packing import TopicPacking
from ropeway.networks.overlay.names import Metadata
from ropeway.networks.overlay.node import OverlayNode
from ropeway.networks.overlay.packet_item import RAW, PacketItem
from ropeway.networks.overlay.router import Router
from ropeway.networks.overlay.rpc import Rpc
from ropeway.qos import LATCHED, SENSOR_DATA, QoS
from tests.networks.overlay.conftest import Site
from tests.networks.overlay.conftest import site as site
from tests.networks.overlay.fleet import member
from tests.support.inbox import Inbox
from tests.support.messages import STRING
from tests.support.messages import sample as text
from tests.support.ports import free_endpoint
from tests.support.services import ADD
from tests.support.until import PATIENCE_S, until


def numbers(inbox: Inbox) -> list[int]:
    return [int(sample.payload[8:-1]) for sample in inbox.samples]


class Wire:
    """A TCP link that can be cut and mended."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.server: asyncio.Server | None = None
        self.where = 0
        self.writers: set[asyncio.StreamWriter] = set()
        self.tasks: set[asyncio.Task[None]] = set()

    @property
    def endpoint(self) -> str:
        return f"tls/127.0.0.1:{self.where}"

    async def mend(self) -> None:
        self.server = await asyncio.start_server(self._carry, "127.0.0.1", self.where)
        self.where = self.server.sockets[0].getsockname()[1]

    async def cut(self) -> None:
        assert self.server is not None
        self.server.close()
        for writer in list(self.writers):
            writer.transport.abort()
        await asyncio.gather(*self.tasks, return_exceptions=True)

    async def _carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            other_reader, other_writer = await asyncio.open_connection("127.0.0.1", self.port)
        except OSError:
            writer.close()
            return
        self.writers |= {writer, other_writer}
        for pair in ((reader, other_writer), (other_reader, writer)):
            task = asyncio.create_task(self._pump(*pair))
            self.tasks.add(task)
            task.add_done_callback(self.tasks.discard)

    async def _pump(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while data := await reader.read(1 << 16):
                writer.write(data)
                await writer.drain()
        except OSError:
            pass
        finally:
            writer.close()
            self.writers.discard(writer)


@pytest.fixture
async def wired() -> AsyncIterator[tuple[OverlayGraph, OverlayGraph, Wire]]:
    """Two members, linked over a wire that can be cut."""
    async with AsyncExitStack() as stack:
        endpoint = free_endpoint()
        near = OverlayGraph(OverlayNode(member("near"), routers=(), listen=(endpoint,)))
        await near.open()
        stack.push_async_callback(near.close)
        wire = Wire(int(endpoint.rpartition(":")[2]))
        await wire.mend()
        stack.push_async_callback(wire.cut)
        far = OverlayGraph(OverlayNode(member("far"), routers=(wire.endpoint,), listen=()))
        await far.open()
        stack.push_async_callback(far.close)
        await until(lambda: near.node.membership.gateways() and far.node.membership.gateways())
        yield near, far, wire


async def test_reliable_over_a_cut(wired: tuple[OverlayGraph, OverlayGraph, Wire]) -> None:
    """A cut in mid-stream costs a reliable reader no message within the depth, and none comes twice or out of order."""
    near, far, wire = wired
    inbox = Inbox()
    await far.create_subscription("/a", STRING, QoS(depth=1000), inbox)
    publisher = await near.create_publisher("/a", STRING, QoS(depth=1000))
    await until(lambda: publisher.subscribers)
    for number in range(400):
        publisher.publish(text(str(number)))
        if number == 100:
            await wire.cut()
        if number == 250:
            await wire.mend()
        await asyncio.sleep(0.005)
    await inbox.wait(400, 30)
    assert numbers(inbox) == list(range(400))


async def test_beyond_the_depth(wired: tuple[OverlayGraph, OverlayGraph, Wire]) -> None:
    """What a cut lost beyond the depth stays lost and is counted; what comes after it is in order."""
    near, far, wire = wired
    inbox = Inbox()
    await far.create_subscription("/a", STRING, QoS(depth=5), inbox)
    publisher = await near.create_publisher("/a", STRING, QoS(depth=5))
    await until(lambda: publisher.subscribers)
    publisher.publish(text("0"))
    await inbox.wait(1)
    await wire.cut()
    for number in range(1, 60):
        publisher.publish(text(str(number)))
        await asyncio.sleep(0.005)
    await wire.mend()
    await until(lambda: inbox.samples[-1].payload[8:-1] == b"59")
    got = numbers(inbox)
    assert got == sorted(set(got))
    assert got[-5:] == [55, 56, 57, 58, 59]


async def test_call_over_a_cut(wired: tuple[OverlayGraph, OverlayGraph, Wire]) -> None:
    """A call whose link is cut fails within seconds, and the next one after the cut is answered."""
    near, far, wire = wired
    called = asyncio.Event()

    async def slow(request: Request) -> bytes:
        called.set()
        if request.payload[4]:
            await asyncio.sleep(3600)
        return b"\0\1\0\0" + bytes(8)

    await near.create_service("/slow", ADD, slow)
    client = await far.create_client("/slow", ADD)
    assert await client.wait_available(PATIENCE_S)
    call = asyncio.create_task(client.call(Request(b"\0\1\0\0\1" + bytes(15)), 3600))
    await called.wait()
    await wire.cut()
    async with aio.timeout(PATIENCE_S):
        with pytest.raises((ProviderLost, CallFailed)):
            await call
    await wire.mend()

    async def works() -> bool:
        try:
            return len(await client.call(Request(b"\0\1\0\0" + bytes(16)), 2)) == 12
        except CallError:
            return False

    async with aio.timeout(PATIENCE_S):
        while not await works():
            pass


async def test_call_over_a_short_cut(wired: tuple[OverlayGraph, OverlayGraph, Wire]) -> None:
    """A call that is made while a link is cut for a moment is answered when it is back, and carried out once."""
    near, far, wire = wired
    seen: list[bytes] = []

    async def add(request: Request) -> bytes:
        seen.append(request.id)
        return b"\0\1\0\0" + bytes(8)

    await near.create_service("/add", ADD, add)
    client = await far.create_client("/add", ADD)
    assert await client.wait_available(PATIENCE_S)
    await client.call(Request(b"\0\1\0\0" + bytes(16)))
    await wire.cut()
    call = asyncio.create_task(client.call(Request(b"\0\1\0\0" + bytes(16)), 30))
    await asyncio.sleep(0.3)
    await wire.mend()
    assert len(await call) == 12
    assert len(seen) == 2


async def test_another_router() -> None:
    """A router that dies is replaced by another of the mesh, and a reliable reader misses nothing."""
    async with AsyncExitStack() as stack:
        one, two = free_endpoint(), free_endpoint()
        first = Router(member("r", role="router"), listen=[one])
        await first.__aenter__()
        await stack.enter_async_context(Router(member("r", role="router"), listen=[two], connect=[one]))
        graphs = []
        for _ in range(2):
            graph = OverlayGraph(OverlayNode(member(), routers=[one, two], listen=()))
            await graph.open()
            stack.push_async_callback(graph.close)
            graphs.append(graph)
        near, far = graphs
        inbox = Inbox()
        await far.create_subscription("/a", STRING, QoS(depth=1000), inbox)
        publisher = await near.create_publisher("/a", STRING, QoS(depth=1000))
        await until(lambda: publisher.subscribers)
        for number in range(300):
            publisher.publish(text(str(number)))
            if number == 100:
                await first.__aexit__()
            await asyncio.sleep(0.005)
        await inbox.wait(300, 30)
        assert numbers(inbox) == list(range(300))


async def test_big_messages(site: Site) -> None:
    """Messages of 60 MB arrive whole, over a router."""
    near, far = await site.join(), await site.join()
    inbox = Inbox()
    await far.create_subscription("/map", STRING, QoS(depth=1), inbox)
    publisher = await near.create_publisher("/map", STRING, QoS(depth=1))
    await until(lambda: publisher.subscribers)
    big = text("x" * 60_000_000)
    publisher.publish(big)
    assert (await inbox.wait(1, 3 * PATIENCE_S))[0].payload == big.payload


async def test_slowly_brought_again(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    """Messages of before that take a while to be brought, as they are big and the link is slow, arrive all the same."""
    ask = Rpc.ask

    async def ask_slowly(
        rpc: Rpc, gateway: bytes, request: Mapping[str, Any], timeout_s: float, *, lane: int = 1
    ) -> Any:
        if request["op"] == "history" and timeout_s < 20:
            raise CallTimeout("history", timeout_s)
        return await ask(rpc, gateway, request, timeout_s, lane=lane)

    monkeypatch.setattr(Rpc, "ask", ask_slowly)
    near, far = await site.join(), await site.join()
    publisher = await near.create_publisher("/map", STRING, LATCHED)
    publisher.publish(text("the map"))
    inbox = Inbox()
    await far.create_subscription("/map", STRING, LATCHED, inbox)
    assert (await inbox.wait(1))[0].payload == text("the map").payload


async def test_latched_of_several(site: Site) -> None:
    """A late joiner gets what each of several latched publishers keeps, each once."""
    graphs = [await site.join() for _ in range(3)]
    publishers = [await graph.create_publisher("/tf_static", STRING, LATCHED) for graph in graphs[:2]]
    for number, publisher in enumerate(publishers):
        publisher.publish(text(str(number)))
    await until(lambda: len(graphs[2].node.rib.all("publisher")) == 2)
    inbox = Inbox()
    await graphs[2].create_subscription("/tf_static", STRING, None, inbox)
    await inbox.wait(2)
    for publisher in publishers:  # whatever came twice would have come before these
        publisher.publish(text("2"))
    await inbox.wait(4)
    assert sorted(numbers(inbox)) == [0, 1, 2, 2]


async def test_apart(site: Site) -> None:
    """What is unique in the metadata keeps two deployments of one name apart."""
    near, far, other = (
        await site.join(metadata=Metadata(unique="a")),
        await site.join(metadata=Metadata(unique="a")),
        await site.join(metadata=Metadata(unique="b")),
    )
    boxes = [Inbox(), Inbox()]
    for graph, box in zip((far, other), boxes, strict=True):
        await graph.create_subscription("/a", STRING, QoS(), box)
    publisher = await near.create_publisher("/a", STRING)
    await until(lambda: publisher.subscribers)
    publisher.publish(text("1"))
    await boxes[0].wait(1)
    assert publisher.subscribers == 1
    assert not boxes[1].samples


async def test_qos_that_does_not_match(site: Site) -> None:
    """A reader that asks for more than is offered gets nothing, as in ROS 2."""
    near, far = await site.join(), await site.join()
    inbox = Inbox()
    await far.create_subscription("/a", STRING, QoS(), inbox)
    sensor = await near.create_publisher("/a", STRING, SENSOR_DATA)
    reader = Inbox()
    await far.create_subscription("/a", STRING, SENSOR_DATA, reader)
    await until(lambda: sensor.subscribers == 1)
    sensor.publish(text("1"))
    await reader.wait(1)
    assert not inbox.samples


async def test_many_small_messages(site: Site) -> None:
    """Thousands of messages at once arrive in order, in few packets."""
    near, far = await site.join(), await site.join()
    inbox = Inbox()
    await far.create_subscription("/a", STRING, QoS(history="keep_all"), inbox)
    publisher = await near.create_publisher("/a", STRING, QoS(history="keep_all"))
    await until(lambda: publisher.subscribers)
    for number in range(5000):
        publisher.publish(text(str(number)))
    await inbox.wait(5000, 30)
    assert numbers(inbox) == list(range(5000))


async def test_commands_first(site: Site) -> None:
    """A command does not wait behind a big message of another lane."""
    near, far = await site.join(), await site.join()
    bulk, command = Inbox(), Inbox()
    await far.create_subscription("/bulk", STRING, QoS(depth=1), bulk)
    await far.create_subscription("/cmd", STRING, QoS(depth=1), command)
    images = await near.create_publisher("/bulk", STRING, QoS(depth=1), delivery=Delivery(priority=7))
    orders = await near.create_publisher("/cmd", STRING, QoS(depth=1), delivery=Delivery(priority=0))
    await until(lambda: images.subscribers and orders.subscribers)
    images.publish(text("x" * 60_000_000))
    await asyncio.sleep(0)
    orders.publish(text("stop"))
    await command.wait(1)
    await bulk.wait(1, 50)


async def test_commands_without_room(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    """Small messages go while their path has no room, but no more of them than it hardly notices."""
    near, far = await site.join(), await site.join()
    inbox, few = Inbox(), text("stop")
    await far.create_subscription("/cmd", STRING, QoS(history="keep_all"), inbox)
    orders = await near.create_publisher("/cmd", STRING, QoS(history="keep_all"))
    await until(lambda: orders.subscribers and near.node.receipts.paths)
    orders.publish(few)
    await inbox.wait(1)
    with monkeypatch.context() as closed:
        closed.setattr(Path, "room_bytes", lambda *_: -1_000_000)
        orders.publish(few)
        await inbox.wait(2)
        for number in range(1000):
            orders.publish(text(f"{number} {'x' * 1000}"))
        await inbox.wait(3)
        assert orders.queue.waiting
    orders.publish(few)
    await inbox.wait(1003)
    assert not orders.queue.waiting


@pytest.mark.parametrize("encoding", ["zstd", "zip", "rawzip", "none", "auto"])
async def test_encodings(site: Site, encoding: str) -> None:
    """Whatever encoding is configured, a message arrives byte for byte; those that compress send less."""
    near, far = await site.join(), await site.join()
    inbox = Inbox()
    await far.create_subscription("/a", STRING, QoS(history="keep_all"), inbox)
    publisher = await near.create_publisher("/a", STRING, QoS(history="keep_all"), delivery=Delivery(encoding=encoding))
    await until(lambda: publisher.subscribers)
    for message in (text("short"), text("long " * 50_000)):
        publisher.publish(message)
    await inbox.wait(2)
    assert [s.payload for s in inbox.samples] == [text("short").payload, text("long " * 50_000).payload]
    assert publisher.packing.on == (encoding in ("zstd", "zip", "rawzip"))


def test_packing_follows_the_path() -> None:
    """Where what was sent took long, the next is compressed; where the path is fast again, it is not."""
    packing = TopicPacking(STRING, "auto")
    item = PacketItem(1, 0, 0, bytes(16), 0, RAW, b"x" * 100_000)
    packing.taken(100, 10.0)
    assert not packing.choose(len(item.payload), Counter())
    packing.taken(1_000_000, 1.0)
    assert packing.choose(len(item.payload), Counter())  # once, to see what it brings
    assert len(packing.pack(item, True).payload) < 1000
    assert packing.choose(len(item.payload), Counter())
    assert packing.used == "zstd"
    assert packing.pack(item._replace(payload=b"short"), True).encoding == RAW
    for _ in range(10):
        packing.taken(1_000_000, 0.0001)
    assert not packing.choose(len(item.payload), Counter())
    assert packing.used == "cbor-raw"
    assert packing.pack(item, False) == item


async def test_keys_rotate(site: Site) -> None:
    """A content key is replaced when it has served its time, and no message is lost by it."""
    near, far = await site.join(rotate_s=0.01), await site.join()
    inbox = Inbox()
    await far.create_subscription("/a", STRING, QoS(depth=1000), inbox)
    publisher = await near.create_publisher("/a", STRING, QoS(depth=1000))
    await until(lambda: publisher.subscribers)
    epochs = set()
    for number in range(100):
        publisher.publish(text(str(number)))
        if number % 10 == 0:
            near.node.recheck()
        epochs.add(publisher.source._sealer.epoch)
        await asyncio.sleep(0.01)
    await inbox.wait(100, 20)
    assert numbers(inbox) == list(range(100))
    assert len(epochs) > 5
    assert not near.node.refusals


async def test_a_call_runs_once(site: Site) -> None:
    """The same call made twice is carried out once, and answered twice."""
    near, far = await site.join(), await site.join()
    seen: list[bytes] = []

    async def add(request: Request) -> bytes:
        seen.append(request.id)
        return b"\0\1\0\0" + bytes(8)

    await far.create_service("/add", ADD, add)
    client = await near.create_client("/add", ADD)
    assert await client.wait_available(PATIENCE_S)
    request = Request(b"\0\1\0\0" + bytes(16))
    assert await client.call(request) == await client.call(request)
    assert len(seen) == 1
