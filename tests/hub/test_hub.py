"""ropeway.hub.hub: several users of one graph (the contract of graphs is tested in ``tests/contract``)."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from dataclasses import replace
from types import SimpleNamespace

import pytest

from ropeway.errors import GraphUnavailable
from ropeway.graph import history
from ropeway.graph.base import Sample
from ropeway.hub.hub import Hub
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.qos import LATCHED, SENSOR_DATA, QoS
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample, text
from tests.support.until import PATIENCE_S, until

_numbers = itertools.count()


class Place:
    """A hub, and a robot on its network."""

    def __init__(self, stack: AsyncExitStack) -> None:
        self.stack = stack
        self.network = f"hub-{next(_numbers)}"

    async def open(self) -> None:
        graph = await self.participant("/gateway")
        self.robot = await self.participant("/robot")
        self.hub = Hub(graph, gateway_id="us")
        await self.hub.open()
        self.stack.push_async_callback(self.hub.close)

    async def participant(self, node: str) -> MemoryGraph:
        graph = MemoryGraph(self.network, node=node)
        await graph.open()
        self.stack.push_async_callback(graph.close)
        return graph


@pytest.fixture
async def place() -> AsyncIterator[Place]:
    async with AsyncExitStack() as stack:
        made = Place(stack)
        await made.open()
        yield made


def numbered(seq: int, origin: bytes = b"far gateway     ") -> Sample:
    """A message that came over a link."""
    return Sample(text(str(seq)), STRING, time.time_ns(), origin, seq)


async def test_views_hear_each_other(place: Place) -> None:
    """What one view publishes, the network and all other views hear, itself only with echo; each once."""
    inboxes = {name: Inbox() for name in ("self", "other", "robot", "echoing")}
    plain, other, echoing = place.hub.view("plain"), place.hub.view("other"), place.hub.view("echoing", echo=True)
    await plain.create_subscription("/x", STRING, QoS(), inboxes["self"])
    await other.create_subscription("/x", STRING, QoS(), inboxes["other"])
    await echoing.create_subscription("/x", STRING, QoS(), inboxes["echoing"])
    await place.robot.create_subscription("/x", STRING, QoS(), inboxes["robot"])
    by_plain = await plain.create_publisher("/x", STRING)
    by_echoing = await echoing.create_publisher("/x", STRING)
    by_plain.publish(sample("plain"))
    by_echoing.publish(sample("echoing"))
    await inboxes["robot"].wait(2)
    await asyncio.sleep(0.02)
    assert {name: inbox.payloads for name, inbox in inboxes.items()} == {
        "self": [text("echoing")],
        "other": [text("plain"), text("echoing")],
        "robot": [text("plain"), text("echoing")],
        "echoing": [text("plain"), text("echoing")],
    }


async def test_one_name_fails_alone(
    place: Place, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Where it cannot be seen who else has a name, that is told, and the other names are looked after all the same."""
    looked: list[str] = []
    settle = place.hub.calls.services.settle

    async def odd(name: str, *, raising: bool = False) -> None:
        looked.append(name)
        if name == "/odd":
            raise KeyError(name)
        await settle(name, raising=raising)

    monkeypatch.setattr(place.hub.calls.services, "settle", odd)
    for name in ("/odd", "/good"):
        await place.robot.create_service(name, "std_srvs/srv/Trigger", lambda _: asyncio.sleep(0, b""))
    await until(lambda: looked[-2:] == ["/odd", "/good"])
    assert sum("who else has the service /odd" in message for message in caplog.messages) == 1


async def test_known_messages(place: Place) -> None:
    """A message that comes over two links, or comes back over one, is passed on once, and counted."""
    inbox, there = Inbox(), Inbox()
    links = [place.hub.view(f"link {i}") for i in range(2)]
    reader = place.hub.view("reader")
    await reader.create_subscription("/x", STRING, QoS(), inbox)
    await place.robot.create_subscription("/x", STRING, QoS(), there)
    publishers = [await link.create_publisher("/x", STRING) for link in links]
    for seq in (1, 2):
        for publisher in publishers:
            publisher.publish(numbered(seq))
    publishers[1].publish(numbered(1, b"another gateway "))
    await there.wait(3)
    assert [s.seq for s in there.samples] == [s.seq for s in inbox.samples] == [1, 2, 1]
    talker = await place.robot.create_publisher("/x", STRING)
    talker.publish(sample("from the robot"))
    await inbox.wait(4)
    publishers[0].publish(inbox.samples[-1])
    assert place.hub.duplicates["/x"] == 3
    assert len(inbox.samples) == 4


async def test_relayed_messages(place: Place) -> None:
    """What another gateway on our network publishes of ours is not heard again."""
    inbox = Inbox()
    view, link = place.hub.view("reader"), place.hub.view("link")
    subscription = await view.create_subscription("/x", STRING, QoS(), inbox)
    publisher = await link.create_publisher("/x", STRING)
    publisher.publish(numbered(5))
    again = numbered(5, b"its own publisher")
    again.relayed = True
    subscription.arrived([again, numbered(6)])
    assert [s.seq for s in inbox.samples] == [5, 6]
    assert place.hub.duplicates["/x"] == 1


async def test_demand(place: Place) -> None:
    """A publisher's readers are those of the network and of other views."""
    counts: list[int] = []
    one, other = place.hub.view("one"), place.hub.view("other")
    publisher = await one.create_publisher("/x", STRING)
    publisher.on_demand(counts.append)
    await one.create_subscription("/x", STRING, QoS(), Inbox())
    reader = await other.create_subscription("/x", STRING, QoS(), Inbox())
    network = await place.robot.create_subscription("/x", STRING, QoS(), Inbox())
    wrong = await other.create_subscription("/x", "std_msgs/msg/Int32", QoS(), Inbox())
    assert publisher.subscribers == 2
    for part in (reader, network, wrong):
        await part.close()
    assert publisher.subscribers == 0
    assert counts[0] == counts[-1] == 0
    assert max(counts) == 2


async def test_latched(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """A view that comes late gets what others keep for it: the newest, unless it asked for nothing or it is too old."""
    publisher = await place.hub.view("publisher").create_publisher("/x", STRING, replace(LATCHED, depth=2))
    for value in ("a", "b", "c"):
        publisher.publish(sample(value))
    for qos, expected in ((LATCHED, ["b", "c"]), (None, ["b", "c"]), (QoS(), [])):
        inbox = Inbox()
        await place.hub.view("late").create_subscription("/x", STRING, qos, inbox)
        assert inbox.payloads == [text(v) for v in expected]
    short = replace(LATCHED, lifespan_s=PATIENCE_S)
    kept_shortly = await place.hub.view("publisher").create_publisher("/y", STRING, short)
    kept_shortly.publish(sample("soon gone"))
    in_time, late = Inbox(), Inbox()
    await place.hub.view("in time").create_subscription("/y", STRING, None, in_time)
    later_ns = time.time_ns() + int(2 * PATIENCE_S * 1e9)
    monkeypatch.setattr(history, "time", SimpleNamespace(time_ns=lambda: later_ns))
    await place.hub.view("late").create_subscription("/y", STRING, None, late)
    assert (len(in_time.samples), len(late.samples)) == (1, 0)


async def test_adopts(place: Place) -> None:
    """A subscription without a profile follows the publishers of the network and of the other views."""
    profiles: list[QoS] = []
    view, other = place.hub.view("reader"), place.hub.view("other")
    subscription = await view.create_subscription("/x", STRING, None, Inbox())
    subscription.on_qos(profiles.append)
    latched = await other.create_publisher("/x", STRING, LATCHED)
    assert profiles[-1].transient_local
    sensor = await place.robot.create_publisher("/x", STRING, SENSOR_DATA)
    assert (profiles[-1].reliable, profiles[-1].transient_local) == (False, False)
    await sensor.close()
    await latched.close()
    own = await view.create_publisher("/x", STRING, LATCHED)
    await own.close()
    asked = await view.create_subscription("/x", STRING, QoS(depth=3), Inbox())
    await place.robot.create_publisher("/x", STRING, SENSOR_DATA)
    assert asked.qos == QoS(depth=3)


async def test_what_is_ours(place: Place) -> None:
    """Each view calls local only what it created itself."""
    one, other = place.hub.view("one"), place.hub.view("other")
    await one.create_publisher("/x", STRING)
    await place.robot.create_subscription("/x", STRING, QoS(), Inbox())
    assert [p.local for p in one.topics()["/x"].publishers] == [True]
    assert [p.local for p in other.topics()["/x"].publishers] == [False]
    assert [s.local for s in one.topics()["/x"].subscriptions] == [False]
    assert one.types("/x") == (STRING,)
    assert one.types("/nothing") == ()
    assert "/robot" in one.nodes()


async def test_changes(place: Place) -> None:
    """A view is told what the network and the other views do, not what it does itself."""
    one, other = place.hub.view("one"), place.hub.view("other")
    told: list[tuple[str, str, bool]] = []

    async def listen() -> None:
        async for event in one.changes():
            if event.kind != "node":
                told.append((event.kind, event.name, event.discovered))

    task = asyncio.create_task(listen())
    await asyncio.sleep(0)
    await one.create_publisher("/own", STRING)
    publisher = await other.create_publisher("/theirs", STRING)
    await place.robot.create_publisher("/network", STRING)
    await publisher.close()
    await until(lambda: len(told) == 3)
    await asyncio.sleep(0.01)
    assert sorted(told) == [
        ("publisher", "/network", True),
        ("publisher", "/theirs", False),
        ("publisher", "/theirs", True),
    ]
    await one.close()
    await asyncio.sleep(0)
    task.cancel()
    await asyncio.wait([task])


async def test_closing_a_view(place: Place) -> None:
    """A closed view takes back what it created and makes nothing new; the others live on."""
    leaving, staying = place.hub.view("leaving"), place.hub.view("staying")
    inbox = Inbox()
    await leaving.create_publisher("/x", STRING)
    await leaving.create_subscription("/y", STRING, QoS(), Inbox())
    publisher = await staying.create_publisher("/y", STRING)
    await place.robot.create_subscription("/y", STRING, QoS(), inbox)
    await leaving.close()
    await leaving.close()
    assert "/x" not in place.robot.topics()
    assert publisher.subscribers == 1
    publisher.publish(sample("still"))
    await inbox.wait(1)
    with pytest.raises(GraphUnavailable, match="leaving has closed"):
        await leaving.create_publisher("/z", STRING)


async def test_leaves_nothing_behind(place: Place) -> None:
    """Topics and views that come and go leave nothing in the hub."""
    for i in range(50):
        view, other = place.hub.view(f"view {i}"), place.hub.view(f"other {i}")
        publisher = await view.create_publisher(f"/t{i}", STRING, LATCHED)
        await other.create_subscription(f"/t{i}", STRING, None, Inbox())
        publisher.publish(sample("x"))
        await other.close()
        await view.close()
    hub = place.hub
    assert not hub.views
    assert not hub.publishers
    assert not hub.subscriptions
    assert not hub._seen
    assert not hub.retired
    assert [t for t in place.robot.topics() if t.startswith("/t")] == []
