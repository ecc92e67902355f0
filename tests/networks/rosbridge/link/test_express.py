"""ropeway.networks.rosbridge.link.express: a second connection for small messages, over real sockets."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest

from ropeway.errors import ConnectFailed
from ropeway.listener.connection import Connection
from ropeway.listener.websocket import connect, listen
from ropeway.networks.rosbridge.link.channel import EXPRESS_BYTES
from ropeway.networks.rosbridge.link.express import HEADER
from ropeway.networks.rosbridge.link.peer import Channel, Peer
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY_SUBPROTOCOL
from tests.networks.rosbridge.link.test_peer import LIMITS, REGISTRY, Handler, sample
from tests.support.messages import STRING, text
from tests.support.until import until


class Pair:
    """Two peers, and a second connection between them when it is asked for."""

    def __init__(self) -> None:
        self.near_handler, self.far_handler = Handler(), Handler()
        self.near: Peer
        self.far: Peer
        self.seconds: list[Connection] = []
        self._port = 0

    async def start(self) -> Any:
        def accept(connection: Connection) -> None:
            assert connection.handshake is not None
            secret = connection.handshake.headers.get(HEADER.lower())
            if secret is None:
                self.far = Peer(connection, REGISTRY, self.far_handler)
                self.far.hello("far", "far", express=True)
            elif self.far.express.knows(secret):
                self.far.express.attach(connection)
            else:
                connection.close(1008, "unknown")

        server = await listen("127.0.0.1", 0, accept, limits=LIMITS, subprotocols=(ROPEWAY_SUBPROTOCOL,))
        self._port = server.port

        def connected(connection: Connection) -> None:
            self.near = Peer(connection, REGISTRY, self.near_handler)

        await self.connect(connected, {})
        await until(lambda: self.near.express.offered)
        return server

    async def connect(self, connected: Any, headers: dict[str, str]) -> Connection:
        return await connect(
            f"ws://127.0.0.1:{self._port}",
            limits=LIMITS,
            subprotocols=(ROPEWAY_SUBPROTOCOL,),
            headers=headers,
            on_connection=connected,
        )

    async def second(self) -> Connection:
        """Open the second connection."""
        made = await self.connect(self.near.express.attach, {HEADER: self.near.express.offered})
        self.seconds.append(made)
        await until(lambda: self.far.express.open)
        return made

    def channel(self, number: int, **options: Any) -> Channel:
        settings: dict[str, Any] = {"encoding": "cbor-raw", "priority": 4, "depth": None, "lifespan_s": None}
        return self.near.open_channel(number, f"/t{number}", STRING, **{**settings, **options})

    def bodies(self, number: int) -> list[bytes]:
        return [arrival.body for arrival in self.far_handler.arrivals if arrival.channel == number]


@pytest.fixture
async def pair() -> AsyncIterator[Pair]:
    made = Pair()
    server = await made.start()
    yield made
    made.near.connection.abort("the test is over")
    await until(lambda: made.near_handler.ends and made.far_handler.ends)
    await server.close()


def numbered(count: int, start: int = 0) -> list[bytes]:
    return [text(f"{start + i:06}") for i in range(count)]


async def test_small_messages_take_the_second_connection(pair: Pair) -> None:
    """A topic goes by the second connection while its messages are small, in order, one that is large by the first."""
    second = await pair.second()
    small, large = pair.channel(1), pair.channel(2)
    for body in numbered(100):
        small.put(sample(body))
        large.put(sample(text("x" * EXPRESS_BYTES)))
    await until(lambda: len(pair.far_handler.arrivals) == 200)
    assert pair.bodies(1) == numbered(100)
    assert small.sender is not pair.near.sender
    assert large.sender is pair.near.sender
    before = pair.near.connection.bytes_out
    small.put(sample(text("after")))
    await until(lambda: len(pair.far_handler.arrivals) == 201)
    assert pair.near.connection.bytes_out == before
    assert second.bytes_out > 100 * len(numbered(1)[0])


async def test_a_large_message_brings_its_topic_back(pair: Pair) -> None:
    """With its first large message a topic goes by the first connection for good, and nothing overtakes anything."""
    await pair.second()
    channel = pair.channel(1)
    sent = []
    for i in range(300):
        body = text(f"{i}" + ("x" * EXPRESS_BYTES if i in (100, 101, 200) else ""))
        sent.append(body)
        channel.put(sample(body))
        if i % 50 == 0:
            await until(lambda: len(pair.bodies(1)) >= len(sent) - 60)
    await until(lambda: len(pair.bodies(1)) == 300)
    assert pair.bodies(1) == sent
    assert channel.sender is pair.near.sender


async def test_a_large_message_while_its_topic_changes_its_connection(pair: Pair) -> None:
    """A large message never goes by the second connection, also where its topic was about to: nothing is refused."""
    await pair.second()
    channels = [pair.channel(number) for number in range(1, 20)]
    for channel in channels:
        channel.put(sample(text("small")))
        channel.put(sample(text("x" * 1_000_000)))
    await until(lambda: len(pair.far_handler.arrivals) == 2 * len(channels))
    for channel in channels:
        assert pair.bodies(channel.number) == [text("small"), text("x" * 1_000_000)]
        assert channel.sender is pair.near.sender
    assert not pair.far.fault_log.counts


async def test_the_second_connection_may_come_late_and_go(pair: Pair) -> None:
    """A topic moves when the second connection comes and when it is lost: nothing is missing, and the order holds."""
    channel = pair.channel(1)
    for body in numbered(10):
        channel.put(sample(body))
    await until(lambda: len(pair.bodies(1)) == 10)
    second = await pair.second()
    for body in numbered(10, 10):
        channel.put(sample(body))
    await until(lambda: len(pair.bodies(1)) == 20)
    assert pair.bodies(1) == numbered(20)
    second.abort("lost")
    await until(lambda: not pair.near.express.open)
    for body in numbered(10, 20):
        channel.put(sample(body))
    await until(lambda: pair.bodies(1)[-1:] == numbered(1, 29))
    assert list(dict.fromkeys(pair.bodies(1))) == numbered(30), "what was sent last may come twice, and is known again"
    await pair.second()
    channel.put(sample(text("again")))
    await until(lambda: pair.bodies(1)[-1:] == [text("again")])
    assert channel.sender is not pair.near.sender


async def test_what_was_asked_for_begins_there(pair: Pair) -> None:
    """A topic that the peer has asked for begins on the second connection, and waits for nothing."""
    await pair.second()
    asked, told = pair.channel(1), pair.channel(2)
    asked.asked = True
    for channel in (asked, told):
        channel.put(sample(text("first")))
    assert asked.sender.second
    assert not asked.queue.held
    assert told.queue.held
    await until(lambda: len(pair.far_handler.arrivals) == 2)


async def test_both_connections_end_together(pair: Pair) -> None:
    """When the link closes, its second connection closes, too."""
    second = await pair.second()
    pair.near.connection.abort("lost")
    await until(lambda: second.closed)
    await until(lambda: not pair.far.express.open)


async def test_a_wrong_secret(pair: Pair) -> None:
    """Without the secret of the link nobody attaches a second connection to it."""
    try:
        made = await pair.connect(lambda connection: None, {HEADER: "0" * 32})
    except ConnectFailed:
        pass  # it was closed before it was open
    else:
        assert (await made.wait_closed())[0] == 1008
    assert not pair.far.express.open


async def test_a_channel_is_closed_on_its_way(pair: Pair) -> None:
    """A topic that is withdrawn while it changes its connection is gone, and others go on."""
    await pair.second()
    for number in range(1, 20):
        channel = pair.channel(number)
        channel.put(sample(text("one")))
        channel.close()
    other = pair.channel(50)
    for body in numbered(20):
        other.put(sample(body))
    await until(lambda: len(pair.bodies(50)) == 20)
    assert pair.near.sender.outbox.statistics().messages == 0


@pytest.mark.parametrize("small", [1, 2, 3])
async def test_a_large_message_follows_at_once(pair: Pair, small: int) -> None:
    """A large message that comes while its topic changes to the second connection goes by the first, in order."""
    await pair.second()
    channel = pair.channel(1)
    sent = numbered(small)
    for body in sent:
        channel.put(sample(body))
        await asyncio.sleep(0)
    sent.append(text("x" * 3_000_000))
    channel.put(sample(sent[-1]))
    sent += numbered(5, 10)
    for body in sent[-5:]:
        channel.put(sample(body))
    await until(lambda: len(pair.bodies(1)) == len(sent))
    assert pair.bodies(1) == sent
    assert channel.sender is pair.near.sender
    assert pair.seconds[0].bytes_out < 100_000


async def test_a_mark_comes_behind_what_was_sent(pair: Pair) -> None:
    """What a topic has sent on the second connection has arrived once its mark is reached."""
    await pair.second()
    channel = pair.channel(1, depth=1000)
    for number in range(100):
        channel.put(sample(text(str(number))))
    await until(lambda: not channel.queue.waiting and not channel.queue.under_way)
    reached = pair.near.express.mark(channel)
    assert reached is not None
    await reached
    assert pair.bodies(1) == [text(str(number)) for number in range(100)]


async def test_a_mark_is_not_waited_for_in_vain(pair: Pair) -> None:
    """A topic of the first connection needs no mark, and one that waits goes on when the second connection is gone."""
    first = pair.channel(1)
    assert pair.near.express.mark(first) is None
    second = await pair.second()
    channel = pair.channel(2)
    channel.put(sample(text("a")))
    await until(lambda: channel.sender.second)
    reached = pair.near.express.mark(channel)
    assert reached is not None
    second.abort("lost")
    await reached
