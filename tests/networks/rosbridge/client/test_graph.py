"""client: the client role against our server, and against servers that are odd, hostile or away."""

from __future__ import annotations

import asyncio
import json
import logging
from contextlib import AsyncExitStack
from typing import Any

import cbor2
import pytest

from ropeway.delivery.outbox import Lost
from ropeway.errors import ConnectFailed, GraphUnavailable, UnknownType
from ropeway.graph.base import Delivery
from ropeway.listener.connection import Connection, Limits
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.rosbridge.client import LinkState, RosbridgeGraph
from ropeway.networks.rosbridge.protocol import codec, png
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY_SUBPROTOCOL
from ropeway.networks.rosbridge.protocol.fragment import Fragmenter
from ropeway.qos import LATCHED, QoS
from ropeway.types import TypeRegistry
from tests.networks.rosbridge.server.test_fuzz import Hostile
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample, text
from tests.support.rosbridge import FAST, REGISTRY, Cloud, FakeServer
from tests.support.until import until

pytestmark = pytest.mark.jumping

OWN = "my_msgs/msg/Own"


@pytest.fixture
async def fake(stack: AsyncExitStack) -> FakeServer:
    made = FakeServer()
    stack.push_async_callback(made.stop)
    return made


async def client(stack: AsyncExitStack, url: str, **options: Any) -> RosbridgeGraph:
    graph = RosbridgeGraph(url, registry=options.pop("registry", REGISTRY), ask_rosapi=False, **options)
    await graph.open()
    stack.push_async_callback(graph.close)
    return graph


@pytest.fixture
async def cloud(stack: AsyncExitStack, request: pytest.FixtureRequest) -> Cloud:
    made = Cloud(request.node.name)
    stack.push_async_callback(made.stop)
    await made.start()
    return made


# ── connecting ─────────────────────────────────────────────────────────────────────────────────────────────────────


async def test_knows_its_peer(stack: AsyncExitStack, cloud: Cloud) -> None:
    """A gateway tells its name and id as soon as it is connected to."""
    graph = await client(stack, f"ws://127.0.0.1:{cloud.port}")
    await until(lambda: graph.remote)
    assert graph.remote == {"gateway": "the cloud", "name": "cloud"}


async def test_nobody_there(fake: FakeServer) -> None:
    """Opening fails where nobody answers, and leaves nothing behind."""
    await fake.start()
    await fake.stop()
    graph = RosbridgeGraph(fake.url, registry=REGISTRY)
    with pytest.raises(ConnectFailed, match="Connection refused"):
        await graph.open()
    assert graph.state is LinkState.CLOSED
    with pytest.raises(GraphUnavailable):
        await graph.create_publisher("/x", STRING)
    await graph.close()


async def test_waits_for_its_server(stack: AsyncExitStack, fake: FakeServer, caplog: pytest.LogCaptureFixture) -> None:
    """Without wait, the connection is made when the server appears; the log tells once that it is missing."""
    caplog.set_level(logging.INFO)
    await fake.start()
    await fake.stop()
    graph = await client(stack, fake.url, wait=False)
    states: list[LinkState] = []
    graph.on_state(states.append)
    inbox = Inbox()
    await graph.create_subscription("/x", STRING, None, inbox)
    publisher = await graph.create_publisher("/y", STRING)
    publisher.publish(sample("lost"))
    await until(lambda: states.count(LinkState.WAITING) >= 3)
    assert "Connection refused" in graph.last_error
    assert len([m for m in caplog.messages if "trying again until it answers" in m]) == 1
    fake.connections.clear()
    await fake.start()
    await until(lambda: fake.ops("subscribe") and fake.ops("advertise"))
    assert states[-1] is LinkState.CONNECTED
    assert graph.last_error == ""
    assert publisher.lost == {Lost.UNSENT: 1}
    fake.say({"op": "publish", "topic": "/x", "msg": {"data": "hello"}})
    await inbox.wait(1)


async def test_refusal_is_retried_lazily(stack: AsyncExitStack, caplog: pytest.LogCaptureFixture) -> None:
    """An answer that another try will not change is told as such."""

    async def reply(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        writer.write(b"HTTP/1.1 403 Forbidden\r\n\r\n")
        writer.close()
        await writer.wait_closed()

    server = await asyncio.start_server(reply, "127.0.0.1", 0)
    async with server:
        graph = await client(stack, f"ws://127.0.0.1:{server.sockets[0].getsockname()[1]}", wait=False)
        await until(lambda: graph.last_error)
        assert graph.last_error.endswith("answered HTTP 403")
        assert "trying again every 10 s" in caplog.text
        await graph.close()


async def test_restores_everything(stack: AsyncExitStack, cloud: Cloud) -> None:
    """After the server was away, every publisher and subscription works again, and latched messages are there."""
    graph = await client(stack, f"ws://127.0.0.1:{cloud.port}", limits=FAST)
    inbox, far_inbox, far_map = Inbox(), Inbox(), Inbox()
    robot = MemoryGraph(cloud.network, node="/robot")
    await robot.open()
    stack.push_async_callback(robot.close)
    await graph.create_subscription("/down", STRING, None, inbox)
    up = await graph.create_publisher("/up", STRING)
    latched = await graph.create_publisher("/map", STRING, LATCHED)
    latched.publish(sample("map 1"))
    await robot.create_subscription("/up", STRING, QoS(), far_inbox)
    await robot.create_subscription("/map", STRING, LATCHED, far_map)
    down = await robot.create_publisher("/down", STRING)
    for round in range(1, 4):
        await until(lambda: up.subscribers == 1 and down.subscribers == 1)
        up.publish(sample(f"up {round}"))
        down.publish(sample(f"down {round}"))
        await inbox.wait(round)
        await far_inbox.wait(round)
        await cloud.stop()
        await until(lambda: graph.state is not LinkState.CONNECTED)
        assert up.subscribers == 0
        assert graph.topics() == {}
        up.publish(sample("nobody hears this"))
        latched.publish(sample(f"map {round + 1}"))
        await cloud.start()
    await until(lambda: far_map.payloads[-1:] == [text("map 4")])
    assert inbox.payloads == [text(f"down {i}") for i in (1, 2, 3)]
    assert far_inbox.payloads == [text(f"up {i}") for i in (1, 2, 3)]
    assert graph.connections == 4
    assert up.lost == {Lost.UNSENT: 3}
    assert up.traffic()[0] == 3


async def test_silent_server(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A server that has fallen silent is given up, and connected to again."""
    await fake.start(limits=Limits(ping_interval_s=None))
    graph = await client(stack, fake.url, limits=FAST, watch=False)
    fake.connections[0].pause_reading()
    await until(lambda: graph.connections == 2)
    assert len(fake.connections) == 2


# ── plain servers ──────────────────────────────────────────────────────────────────────────────────────────────────


async def test_plain_server(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A plain server gets what rosbridge knows: no encoding of ours, a qos object, one id for each part."""
    await fake.start()
    graph = await client(stack, fake.url)
    inbox = Inbox()
    delivery = Delivery(rate_hz=10, depth=3)
    subscription = await graph.create_subscription("/in", STRING, QoS(depth=5), inbox, delivery=delivery)
    publisher = await graph.create_publisher("/out", STRING, QoS(depth=7))
    publisher.publish(sample("ü"))
    await until(lambda: fake.ops("publish"))
    (advertise,), (subscribe,), (publish,) = fake.ops("advertise"), fake.ops("subscribe"), fake.ops("publish")
    assert advertise["qos"]["depth"] == 7
    assert not advertise.keys() & {"ropeway", "compression"}
    assert publish == {"op": "publish", "topic": "/out", "msg": {"data": "ü"}}
    assert (subscribe["throttle_rate"], subscribe["queue_length"]) == (100, 3)
    assert subscribe["compression"] == "cbor-raw"
    assert "ropeway" not in subscribe
    fake.say({"op": "publish", "topic": "/in", "msg": {"data": "text"}})
    raw = {"op": "publish", "topic": "/in", "msg": {"secs": 1, "nsecs": 0, "bytes": text("raw")}}
    fake.connections[0].send_binary(cbor2.dumps(raw))
    await inbox.wait(2)
    assert inbox.payloads == [text("text"), text("raw")]
    await subscription.close()
    await publisher.close()
    await until(lambda: fake.ops("unsubscribe") and fake.ops("unadvertise"))
    assert fake.ops("unsubscribe")[0]["id"] == subscribe["id"]
    assert fake.ops("unadvertise")[0]["id"] == advertise["id"]


@pytest.mark.parametrize("encoding", ["auto", "none", "png", "zstd"])
async def test_encodings_of_a_plain_server(stack: AsyncExitStack, fake: FakeServer, encoding: str) -> None:
    """What a plain server cannot read is published to it as plain JSON."""
    await fake.start()
    graph = await client(stack, fake.url)
    publisher = await graph.create_publisher("/out", STRING, delivery=Delivery(encoding=encoding))
    publisher.publish(sample("x"))
    await until(lambda: fake.ops("publish"))
    assert fake.ops("publish") == [{"op": "publish", "topic": "/out", "msg": {"data": "x"}}]


async def test_fragments_and_images(stack: AsyncExitStack, fake: FakeServer) -> None:
    """What a server sends in fragments or as an image is put together."""
    await fake.start()
    graph = await client(stack, fake.url)
    inbox = Inbox()
    await graph.create_subscription("/in", STRING, None, inbox, delivery=Delivery(encoding="png"))
    await until(lambda: fake.ops("subscribe"))
    assert fake.ops("subscribe")[0]["compression"] == "png"
    whole = json.dumps({"op": "publish", "topic": "/in", "msg": {"data": "x" * 1000}}).encode()
    image = codec.encode_publish("/in", text("y" * 1000), REGISTRY.codec(STRING), "png", stamp_ns=0).data
    connection = fake.connections[0]
    for part in (*Fragmenter().split(whole, 100), image, *reversed(Fragmenter().split(image, 50))):
        connection.send_text(part)
    await inbox.wait(3)
    assert inbox.payloads == [text("x" * 1000), text("y" * 1000), text("y" * 1000)]
    nested = png.pack(png.pack(whole))
    for bad in ("no base64 §", "AAAA", nested.hex()):
        fake.say({"op": "png", "data": bad})
    fake.say({"op": "publish", "topic": "/in", "msg": {"data": "end"}})
    await inbox.wait(4)
    assert graph.peer is not None
    assert graph.peer.fault_log.counts == {("png", ""): 3}


async def test_own_echo(stack: AsyncExitStack, fake: FakeServer) -> None:
    """What a plain server sends back of our own messages is not heard; the same from others is."""
    await fake.start()
    graph = await client(stack, fake.url)
    inbox = Inbox()
    await graph.create_subscription("/x", STRING, None, inbox)
    publisher = await graph.create_publisher("/x", STRING)
    publisher.publish(sample("mine"))
    await until(lambda: fake.ops("publish"))
    for _ in range(2):
        fake.say({"op": "publish", "topic": "/x", "msg": {"data": "mine"}})
    await inbox.wait(1)
    await asyncio.sleep(0.05)
    assert inbox.payloads == [text("mine")]


async def test_rosapi(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A plain server is asked for its topics and nodes; one that knows no rosapi is none the worse."""
    answers = {
        "/rosapi/topics": {"topics": ["/a", "/b"], "types": [STRING, "std_msgs/msg/Int32"]},
        "/rosapi/nodes": {"nodes": ["/talker", 5]},
    }

    def serve(connection: Connection) -> None:
        def answer(data: bytes) -> None:
            asked = json.loads(data)
            values = answers.get(asked["service"])
            reply = {"op": "service_response", "service": asked["service"], "id": asked["id"]}
            fake.say({**reply, "values": values or "does not exist", "result": values is not None})

        connection.on_text = answer

    fake.on_connection = serve
    await fake.start()
    for expected in ({"/a": STRING, "/b": "std_msgs/msg/Int32"}, {}):
        graph = RosbridgeGraph(fake.url, registry=REGISTRY)
        await graph.open()
        stack.push_async_callback(graph.close)
        assert {name: t.type for name, t in graph.topics().items()} == expected
        assert set(graph.nodes()) == ({"/talker"} if expected else set())
        await graph.close()
        answers.clear()


# ── types ──────────────────────────────────────────────────────────────────────────────────────────────────────────


async def test_unknown_type_towards_a_plain_server(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A topic whose type has no definition is refused with its reason; the link and the other topics live on."""
    await fake.start()
    await fake.stop()
    graph = await client(stack, fake.url, wait=False)
    own = await graph.create_publisher("/own", OWN)
    good = await graph.create_publisher("/good", STRING)
    inbox = Inbox()
    await graph.create_subscription("/own_in", OWN, None, inbox)
    fake.connections.clear()
    await fake.start()
    await until(lambda: fake.ops("advertise") and fake.ops("subscribe"))
    assert [op["topic"] for op in fake.ops("advertise")] == ["/good"]
    assert OWN in own.refused
    own.publish(sample("x"))
    good.publish(sample("fine"))
    await until(lambda: fake.ops("publish"))
    with pytest.raises(UnknownType):
        await graph.create_publisher("/own2", OWN)
    fake.say({"op": "publish", "topic": "/own_in", "msg": {"x": 1}})
    await until(lambda: sum(graph.drops.values()) == 1)


async def test_definitions_travel(stack: AsyncExitStack, cloud: Cloud) -> None:
    """Two gateways tell each other the definitions that one of them lacks."""
    knowing, learning = TypeRegistry(), TypeRegistry()
    knowing.add_full_text(OWN, "int32 number\nstd_msgs/Header header\n")
    url = f"ws://127.0.0.1:{cloud.port}"
    cloud.server.registry = knowing
    graph = await client(stack, url, registry=learning)
    robot = MemoryGraph(cloud.network, node="/robot")
    await robot.open()
    stack.push_async_callback(robot.close)
    await robot.create_publisher("/own", OWN)
    await graph.create_subscription("/own", OWN, None, Inbox(), delivery=Delivery(encoding="cbor"))
    await until(lambda: learning.has(OWN))
    assert learning.hash(OWN) == knowing.hash(OWN)


# ── hostile servers ────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("subprotocol", ["", ROPEWAY_SUBPROTOCOL])
async def test_hostile_server(
    stack: AsyncExitStack, fake: FakeServer, subprotocol: str, caplog: pytest.LogCaptureFixture
) -> None:
    """5,000 hostile frames from a server cost complaints, and nothing else."""
    await fake.start(subprotocols=(subprotocol,) if subprotocol else ())
    graph = await client(stack, fake.url, watch=False, registry=TypeRegistry())
    inbox = Inbox()
    await graph.create_subscription("/chatter", STRING, None, inbox)
    await graph.create_subscription("/q", OWN, None, lambda _: None, delivery=Delivery(encoding="png"))
    publisher = await graph.create_publisher("/chatter", STRING, LATCHED)
    hostile = Hostile(11)
    connection = fake.connections[0]
    for i in range(5000):
        text_frame = hostile.random.random() < 0.6
        data = bytearray(hostile.random.choice(hostile.texts if text_frame else hostile.binaries))
        data = hostile.rewritten(data, not text_frame) if hostile.random.random() < 0.5 else hostile.mutated(data)
        (connection.send_text if text_frame else connection.send_binary)(bytes(data))
        if i % 100 == 0:
            await asyncio.sleep(0)
    inbox.samples.clear()
    connection.send_text(b'{"op":"demand","channel":2,"count":1}')
    fake.say({"op": "publish", "topic": "/chatter", "msg": {"data": "still here"}})
    await until(lambda: text("still here") in inbox.payloads)
    publisher.publish(sample("me too"))
    assert graph.connections == 1
    assert graph.peer is not None
    assert graph.peer.fault_log.total > 500
    assert not [r for r in caplog.records if r.levelno >= logging.ERROR], caplog.text[-3000:]


async def test_bad_definition(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A definition that cannot be read is a complaint, and asked for no more."""
    await fake.start(subprotocols=(ROPEWAY_SUBPROTOCOL,))
    graph = await client(stack, fake.url, watch=False, registry=TypeRegistry())
    profiles: list[QoS] = []
    subscription = await graph.create_subscription("/own", OWN, None, Inbox())
    subscription.on_qos(profiles.append)
    await until(lambda: fake.ops("subscribe"))
    assert fake.ops("subscribe")[0]["ropeway"]["want_definition"] is True
    channel = fake.ops("subscribe")[0]["ropeway"]["channel"]
    fake.say({"op": "adopted", "channel": channel, "definition": "?? what", "qos": QoS(depth=3).to_json()})
    fake.say({"op": "adopted", "channel": channel, "qos": {"depth": -1}})
    fake.say({"op": "adopted", "channel": channel, "qos": QoS(depth=4).to_json()})
    await until(lambda: profiles[-1].depth == 4)
    assert graph.peer is not None
    assert graph.peer.fault_log.counts == {("adopted", ""): 1}


async def test_refused(stack: AsyncExitStack, fake: FakeServer, caplog: pytest.LogCaptureFixture) -> None:
    """What the far side refuses is told with its reason."""
    await fake.start(subprotocols=(ROPEWAY_SUBPROTOCOL,))
    graph = await client(stack, fake.url, watch=False)
    publisher = await graph.create_publisher("/x", STRING)
    await until(lambda: fake.ops("advertise"))
    for _ in range(2):
        fake.say({"op": "refused", "channel": publisher.number, "reason": "it is std_msgs/msg/Int32 here"})
    await until(lambda: publisher.refused)
    assert publisher.refused == "it is std_msgs/msg/Int32 here"
    fake.say({"op": "demand", "channel": publisher.number, "count": 2})
    await until(lambda: publisher.subscribers == 2)
    assert len([m for m in caplog.messages if "was refused" in m]) == 1
