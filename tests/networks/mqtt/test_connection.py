"""ropeway.networks.mqtt.connection: brokers that flap, die, stall, refuse, or are none."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import logging
import socket
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import psutil
import pytest

from ropeway.errors import GraphUnavailable
from ropeway.networks.mqtt.address import parse_address
from ropeway.networks.mqtt.graph import MqttGraph
from ropeway.qos import LATCHED, SENSOR_DATA, QoS
from ropeway.tasks import Chores, background, end
from tests.support.authority import Authority
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample
from tests.support.ports import free_port
from tests.support.until import until

from .broker import HAS_BROKER, MOSQUITTO, WHY_NOT, Broker
from .cable import Cable
from .conftest import Place

needs_broker = pytest.mark.skipif(not HAS_BROKER, reason=WHY_NOT)


async def test_broker_that_dies(place: Place) -> None:
    """After a broker was killed, data flows again with the next: readers are subscribed, the last value is kept."""
    near, far = await place.graph("near"), await place.graph("far")
    inbox, latched = Inbox(), Inbox()
    await far.create_subscription("/t", STRING, QoS(), inbox)
    publisher, map = await near.create_publisher("/t", STRING), await near.create_publisher("/map", STRING, LATCHED)
    map.publish(sample("map"))
    publisher.publish(sample("before"))
    await inbox.wait(1)
    for round in range(3):
        place.broker.stop()
        await until(lambda: not near.connected and not far.connected)
        assert not far.nodes()
        place.broker.start()
        await until(lambda: near.connected and far.connected and far.nodes())
        publisher.publish(sample(f"after {round}"))
        await inbox.wait(2 + round)
    await far.create_subscription("/map", STRING, LATCHED, latched)
    await latched.wait(1)
    assert (inbox.texts, latched.texts) == (["before", "after 0", "after 1", "after 2"], ["map"])
    assert near.connection.error == ""


async def test_while_away(place: Place) -> None:
    """While a broker is away reliable messages wait, as many as the profile keeps; what is of the moment is counted."""
    far, inbox = await place.graph("far"), Inbox()
    await far.create_subscription("/t", STRING, QoS(), inbox)
    await far.create_subscription("/sensor", STRING, QoS(), inbox)
    cable = await place.stack.enter_async_context(Cable(place.broker))
    near = await place.graph("near", cable.url)
    reliable = await near.create_publisher("/t", STRING, QoS(depth=3))
    sensor = await near.create_publisher("/sensor", STRING, SENSOR_DATA)
    cable.cut()
    await until(lambda: not near.connected)
    for number in range(5):
        reliable.publish(sample(f"{number}"))
        sensor.publish(sample(f"{number}"))
    assert reliable.waiting == 3
    assert reliable.statistics().lost == {"a fresher one took its place": 2}
    assert sensor.statistics().lost == {"the link closed before it could be sent": 5}
    cable.whole = True
    await inbox.wait(3)
    assert inbox.texts == ["2", "3", "4"]
    await reliable.arrived()
    assert reliable.waiting == 0


async def test_cable_that_flaps(place: Place) -> None:
    """A link that comes and goes costs no reliable message: what was not acknowledged is sent again."""
    far, inbox = await place.graph("far"), Inbox()
    await far.create_subscription("/t", STRING, QoS(depth=1000), inbox)
    cable = await place.stack.enter_async_context(Cable(place.broker))
    near = await place.graph("near", cable.url)
    publisher = await near.create_publisher("/t", STRING, QoS(depth=1000))
    for round in range(5):
        for number in range(40):
            publisher.publish(sample(f"{round} {number}"))
        await inbox.wait(len(inbox.samples) + 1)
        cable.cut()
        await until(lambda: not near.connected)
        cable.whole = True
        await until(lambda: near.connected)
    await publisher.arrived()
    wanted = {f"{round} {number}" for round in range(5) for number in range(40)}
    await until(lambda: set(inbox.texts) == wanted)
    assert not publisher.statistics().lost


async def test_broker_that_stalls(place: Place) -> None:
    """A broker that stalls holds nothing up: what waits is bounded, the newest comes, and the silence is noticed."""
    near = await place.graph("near", "?keep_alive_s=2")
    publisher = await near.create_publisher("/images", STRING, QoS(reliability="best_effort", depth=1))
    place.broker.pause()
    for number in range(200):
        publisher.publish(sample(f"{number} {'x' * 300_000}"))
    lost = publisher.statistics().lost
    assert publisher.waiting <= 2
    assert lost["a fresher one took its place"] > 100
    await until(lambda: not near.connected)
    place.broker.go_on()
    await until(lambda: near.connected)
    device = place.device("images")
    publisher.publish(sample("fresh"))
    await until(lambda: device.got and device.got[-1][1] == b"fresh")


async def test_broker_that_flaps(place: Place) -> None:
    """A broker that comes and goes costs no message that it acknowledged, and leaves nothing behind."""
    near, device_count = await place.graph("near"), 0
    publisher = await near.create_publisher("/t", STRING, QoS(depth=100))
    for round in range(5):
        for number in range(20):
            publisher.publish(sample(f"{round} {number}"))
        await publisher.arrived()
        device_count += 20
        place.broker.stop()
        await until(lambda: not near.connected)
        place.broker.start()
        await until(lambda: near.connected)
    assert near.outgoing.waiting == 0
    assert near.connection.dials >= 6


@needs_broker
async def test_refused_password(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A broker that refuses the password is told with what to do; the password stands in no log and no error."""
    passwords = tmp_path / "passwords"
    passwords.write_text("")
    passwords.chmod(0o600)
    tool = str(Path(MOSQUITTO).parent.parent / "bin" / "mosquitto_passwd")
    process = await asyncio.create_subprocess_exec(tool, "-b", str(passwords), "robot", "right")
    assert await process.wait() == 0
    caplog.set_level(logging.DEBUG)
    with Broker(f"password_file {passwords}", anonymous=False) as broker:
        good = MqttGraph(parse_address(f"{broker.url}?user=robot"), password="right")
        await good.open()
        assert good.connected
        await good.close()
        for user, password in (("robot", "hidden-word"), ("", None)):
            bad = MqttGraph(parse_address(broker.url), user=user, password=password)
            with pytest.raises(GraphUnavailable, match="check the user, the password") as caught:
                await bad.open()
            assert "hidden-word" not in str(caught.value)
            assert "hidden-word" not in repr(bad.connection.plan)
        later = MqttGraph(parse_address(broker.url), user="robot", password="hidden-word", wait_s=0.0)
        await later.open()
        await until(lambda: later.connection.dials >= 2)
        assert "check the user" in later.status()["error"]
        later.renew("right", None, anew=True)
        await until(lambda: later.connected)
        await later.close()
    assert "hidden-word" not in caplog.text


@needs_broker
async def test_refused_topics(tmp_path: Path) -> None:
    """A topic that a broker does not let be read is an error with its reason; others are read."""
    rules = tmp_path / "acl"
    rules.write_text("topic readwrite open/#\n")
    with Broker(f"acl_file {rules}") as broker:
        near, far = (MqttGraph(parse_address(broker.url), node=name) for name in ("near", "far"))
        await near.open()
        await far.open()
        inbox = Inbox()
        await far.create_subscription("/open/t", STRING, QoS(), inbox)
        closed = await near.create_publisher("/closed/t", STRING)
        publisher = await near.create_publisher("/open/t", STRING)
        closed.publish(sample("closed"))
        publisher.publish(sample("open"))
        await inbox.wait(1)
        await until(lambda: closed.refused)
        assert (publisher.refused, near.drops.total() >= 1) == ("", True)
        await near.close()
        await far.close()


@needs_broker
@pytest.mark.filterwarnings(
    "ignore:Exception ignored (in.|while finalizing socket) <ssl.SSLSocket:pytest.PytestUnraisableExceptionWarning"
)  # paho
async def test_tls(tmp_path: Path) -> None:
    """Over TLS a broker is trusted by its authority, and may ask for a certificate."""
    ours, others = Authority(tmp_path, "ours"), Authority(tmp_path, "others")
    server, client = ours.sign("broker"), ours.sign("robot")
    lines = (
        f"cafile {ours.file}",
        f"certfile {server['certificate']}",
        f"keyfile {server['key']}",
        "require_certificate true",
    )
    with Broker(*lines) as broker:
        address = parse_address(broker.url.replace("mqtt:", "mqtts:"))
        good = ssl.create_default_context(cafile=ours.file)
        good.load_cert_chain(client["certificate"], client["key"])
        near, far = (MqttGraph(address, node=name, ssl_context=good) for name in ("near", "far"))
        await near.open()
        await far.open()
        inbox = Inbox()
        await far.create_subscription("/t", STRING, QoS(depth=200), inbox)
        publisher = await near.create_publisher("/t", STRING, QoS(depth=200))
        for number in range(100):
            publisher.publish(sample(f"{number}"))
        await inbox.wait(100)
        publisher.publish(sample("x" * 3_000_000))
        await inbox.wait(101)
        assert inbox.texts[:100] == [*map(str, range(100))]
        await near.close()
        await far.close()
        with pytest.raises(GraphUnavailable, match=r"is not trusted: .*; name its authority as ca"):
            await MqttGraph(address, ssl_context=ssl.create_default_context(cafile=others.file)).open()
        bare = ssl.create_default_context(cafile=ours.file)
        with pytest.raises(GraphUnavailable):
            await MqttGraph(address, ssl_context=bare).open()
        gc.collect()  # of a handshake that failed, here


@asynccontextmanager
async def _impostor(answer: bytes) -> AsyncIterator[str]:
    """A server that is no broker, and says the same to everybody."""
    loop, guests = asyncio.get_running_loop(), Chores()

    async def serve(guest: socket.socket) -> None:
        with guest, contextlib.suppress(OSError):
            await loop.sock_sendall(guest, answer)
            while await loop.sock_recv(guest, 4096):
                pass

    async def accept(bound: socket.socket) -> None:
        while True:
            guest, _ = await loop.sock_accept(bound)
            guests.start(serve(guest), "a guest")

    with socket.create_server(("127.0.0.1", 0)) as bound:
        bound.setblocking(False)
        accepting = background(accept(bound), "an impostor")
        try:
            yield f"mqtt://127.0.0.1:{bound.getsockname()[1]}"
        finally:
            await end(accepting)
            await guests.close()


_CONNACK = b"\x20\x03\0\0\0"


@pytest.mark.parametrize(
    "answer",
    [
        b"HTTP/1.1 400 Bad Request\r\n\r\n",
        b"\x20\x03\0\x84\0",
        b"\x20\x02\0\x01",
        b"\x20\x00",
        b"\x20\xff\xff\xff\xff\xff",
        _CONNACK + b"\x30\x03\0\x09x",
        _CONNACK + b"\x30\xff\xff\xff\xff\x7f",
        _CONNACK + b"\x90\x02\0\x01" * 50 + b"\x40\x01\0",
        _CONNACK + b"\x32\x05\0\x01\xff\0\1" + b"\xe0\x00",
        b"\x00" * 100,
        bytes(range(256)),
    ],
    ids=range(11),
)
async def test_garbage(answer: bytes) -> None:
    """Whatever a server says that is no broker, the connection is given up, and made again later."""
    async with _impostor(answer) as url:
        graph = MqttGraph(parse_address(url), wait_s=0.0)
        await graph.open()
        await until(lambda: graph.connection.dials >= 2)
        await graph.close()


async def test_silence() -> None:
    """A server that says nothing is given up after a while; closing need not wait for it."""
    async with _impostor(b"") as url:
        graph = MqttGraph(parse_address(url))
        with pytest.raises(GraphUnavailable, match="did not answer within 5 s"):
            await graph.open()


@pytest.mark.parametrize("host", ["127.0.0.1", "no-such-host.invalid", "a" * 70 + ".x", "[::1]"])
async def test_nobody(host: str) -> None:
    """A broker that is not there is told so, and closing is quick while it is looked for."""
    graph = MqttGraph(parse_address(f"mqtt://{host}:{free_port()}"))
    with pytest.raises(GraphUnavailable, match=r"cannot be (reached|spoken to)"):
        await graph.open()
    assert not graph.connected


async def test_closed_in_the_middle() -> None:
    """A graph that is closed while it connects leaves no socket behind."""
    async with _impostor(b"") as url:
        before = psutil.Process().num_fds()
        for _ in range(5):
            graph = MqttGraph(parse_address(url), wait_s=0.0)
            await graph.open()
            await asyncio.sleep(0)
            await graph.close()
        await until(lambda: psutil.Process().num_fds() <= before)
