"""The dds graph among real participants."""

from __future__ import annotations

import asyncio
import os
import threading
import time
from typing import Any

import pytest

from ropeway import aio
from ropeway.errors import GraphUnavailable, InvalidName, InvalidTypeName
from ropeway.graph.base import SEQ_NONE, Sample, Undelivered
from ropeway.networks.dds import DdsGraph
from ropeway.networks.dds.raw import check, lib
from ropeway.qos import LATCHED, SENSOR_DATA, QoS
from ropeway.types import TypeRegistry
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample, text
from tests.support.threads import new_threads
from tests.support.until import PATIENCE_S, until

from .conftest import Join
from .helpers import process

KEEP_ALL = QoS(history="keep_all")
_WITHOUT_TURN = 900  # what comes in 15 ms of 60,000 messages a second


# Typed peers ----------------------------------------------------------------------------------------------------


async def test_typed_writer(join: Join, domain: int) -> None:
    """An ordinary DDS writer with type information is heard, byte for byte."""
    from .typed import Peer, String

    graph = await join()
    inbox = Inbox()
    await graph.create_subscription("/chatter", STRING, QoS(), inbox)
    peer = Peer(domain)
    writer = peer.writer("rt/chatter")
    await until(lambda: graph.topics().get("/chatter") and graph.topics()["/chatter"].publishers)
    for i in range(5):
        writer.write(String(f"hello {i}"))
    got = await inbox.wait(5)
    assert [s.payload[: len(text(f"hello {i}"))] for i, s in enumerate(got)] == [text(f"hello {i}") for i in range(5)]
    assert all(s.seq > 0 and not s.relayed and s.type == STRING for s in got)
    (publisher,) = graph.topics()["/chatter"].publishers
    assert {s.origin for s in got} == {publisher.gid}
    assert abs(got[-1].stamp_ns - time.time_ns()) < 5e9


async def test_typed_reader(join: Join, domain: int) -> None:
    """An ordinary DDS reader with type information hears us."""
    from .typed import Peer

    graph = await join()
    peer = Peer(domain)
    reader = peer.reader("rt/chatter")
    publisher = await graph.create_publisher("/chatter", STRING)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample("hello"))
    texts: list[str] = []
    await until(lambda: texts.extend(peer.texts(reader)) or texts)
    assert texts == ["hello"]


async def test_foreign_domain_is_kept(domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A domain that another part of the process made is shared, and outlives the graph."""
    from ropeway.networks.dds.profile import make_profile

    from .typed import SEPARATE, Peer

    if SEPARATE:
        pytest.skip("a domain is shared within a library only")
    with monkeypatch.context() as patch:
        patch.setenv("CYCLONEDDS_URI", make_profile("dds:0", "lo").xml)
        peer = Peer(domain)
        reader = peer.reader("rt/shared")
    graph = DdsGraph(domain, interface="lo")
    await graph.open()
    publisher = await graph.create_publisher("/shared", STRING)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample("hello"))
    texts: list[str] = []
    await until(lambda: texts.extend(peer.texts(reader)) or texts)
    await graph.close()
    assert peer.participant.get_qos() is not None


async def test_foreign_topics(join: Join, domain: int) -> None:
    """Topics that are not of ROS are left out, unless they are asked for."""
    from .typed import Foreign, Peer

    plain, all_topics = await join("plain"), await join("all", foreign=True)
    peer = Peer(domain)
    peer.writer("company_topic", type=Foreign)
    await until(lambda: "company_topic" in all_topics.topics())
    assert all_topics.topics()["company_topic"].type == "company::Foreign"
    assert "company_topic" not in plain.topics()


# Delivery -------------------------------------------------------------------------------------------------------


async def test_late_joiner(join: Join, domain: int) -> None:
    """Each transient local subscription gets the history of all publishers, once, however late it comes."""
    from .typed import LATCHED as TYPED_LATCHED
    from .typed import Peer, String

    graph = await join()
    peers = [Peer(domain) for _ in range(3)]
    for i, peer in enumerate(peers):
        peer.writer("rt/tf_static", *TYPED_LATCHED).write(String(f"robot {i}"))
    await until(lambda: len(graph.topics()["/tf_static"].publishers) == 3 if graph.topics() else False)
    for _ in range(3):
        inbox = Inbox()
        await graph.create_subscription("/tf_static", STRING, LATCHED, inbox)
        await inbox.wait(3)
        assert sorted(p[8:15] for p in inbox.payloads) == [f"robot {i}".encode() for i in range(3)]


async def test_settled(join: Join) -> None:
    """The graph has settled once it knows the nodes of every participant that it found."""
    graph = await join("here")
    assert graph.settled
    await join("there")
    await until(lambda: "/there" in graph.nodes())
    assert graph.settled


async def test_shared_reader(join: Join) -> None:
    """Volatile subscriptions of one profile get the same objects from one reader; others have their own."""
    near, far = await join("near"), await join("far")
    inboxes = [Inbox() for _ in range(4)]
    for inbox in inboxes[:3]:
        await far.create_subscription("/image", STRING, SENSOR_DATA, inbox)
    await far.create_subscription("/image", STRING, QoS(), inboxes[3])
    publisher = await near.create_publisher("/image", STRING)
    await until(lambda: publisher.subscribers == 2)
    publisher.publish(sample("frame"))
    for inbox in inboxes:
        await inbox.wait(1)
    first, second, third, other = (inbox.samples[0] for inbox in inboxes)
    assert first is second is third
    assert other is not first


async def test_closing_one_of_a_shared_reader(join: Join) -> None:
    """A subscription that closes takes nothing from those that share its reader."""
    near, far = await join("near"), await join("far")
    stays, goes = Inbox(), Inbox()
    await far.create_subscription("/image", STRING, QoS(), stays)
    going = await far.create_subscription("/image", STRING, QoS(), goes)
    publisher = await near.create_publisher("/image", STRING)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample("1"))
    await goes.wait(1)
    await going.close()
    publisher.publish(sample("2"))
    await stays.wait(2)
    assert goes.payloads == [text("1")]
    assert publisher.subscribers == 1


async def test_a_burst_beyond_the_depth_waits_for_the_thread(join: Join) -> None:
    """What comes while the thread of a participant has no turn is kept, although the publisher's depth is ten."""
    near, far = await join("near"), await join("far")
    inbox = Inbox()
    await far.create_subscription("/t", STRING, None, inbox)
    publisher = await near.create_publisher("/t", STRING, QoS(depth=10))
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample("first"))
    await inbox.wait(1)
    assert far._participant is not None
    has_turn = threading.Event()
    stalled = far._participant.pump.call(has_turn.wait)
    for number in range(_WITHOUT_TURN):
        publisher.publish(sample(str(number)))
        if number % 100 == 99:
            await asyncio.to_thread(_wait_for_acknowledgements, publisher)
    has_turn.set()
    await stalled
    await inbox.wait(1 + _WITHOUT_TURN)
    assert inbox.payloads[1:] == [text(str(number)) for number in range(_WITHOUT_TURN)]


def _wait_for_acknowledgements(publisher: Any) -> None:
    check(lib.wait_for_acks(publisher._writer.entity, int(PATIENCE_S * 1e9)), "wait_for_acks")


@pytest.mark.parametrize("options", [0, 3])
@pytest.mark.parametrize("length", [8, 9, 10, 11])
async def test_a_message_of_any_length(join: Join, length: int, options: int) -> None:
    """A message arrives with the length it was written with, whatever its header says of padding."""
    near, far = await join("near"), await join("far")
    inbox = Inbox()
    await far.create_subscription("/t", STRING, QoS(), inbox)
    publisher = await near.create_publisher("/t", STRING)
    await until(lambda: publisher.subscribers == 1)
    body = bytes(range(1, length - 3))
    publisher.publish(Sample(bytes((0, 1, 0, options)) + body, STRING, 0, bytes(16), SEQ_NONE))
    await inbox.wait(1)
    assert inbox.payloads == [b"\0\1\0\0" + body]


async def test_source_time_is_kept(join: Join) -> None:
    """The sequence number travels as the source timestamp, to the nanosecond."""
    near, far = await join("near"), await join("far")
    inbox = Inbox()
    await far.create_subscription("/t", STRING, QoS(depth=100), inbox)
    publisher = await near.create_publisher("/t", STRING)
    await until(lambda: publisher.subscribers == 1)
    stamps = [1, 999_999_999, 1_700_000_000_123_456_789, 1_700_000_000_000_000_001, 2**31 * 10**9 - 1]
    for stamp in stamps:
        publisher.publish(sample("x", seq=stamp))
    got = await inbox.wait(len(stamps))
    assert [s.seq for s in got] == stamps
    assert len({s.origin for s in got}) == 1


@pytest.mark.parametrize("seq", [0, 2**63 - 1, 2**31 * 10**9])
async def test_other_sequence_numbers(join: Join, seq: int) -> None:
    """A sequence number that is no time on the wire is replaced by the time of now."""
    near, far = await join("near"), await join("far")
    inbox = Inbox()
    await far.create_subscription("/t", STRING, QoS(), inbox)
    publisher = await near.create_publisher("/t", STRING)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample("x", seq=seq))
    (got,) = await inbox.wait(1)
    assert abs(got.seq - time.time_ns()) < 5e9


async def test_lifespan_counts_from_now(join: Join) -> None:
    """With a lifespan an old sequence number is not the source timestamp, or the message would be born dead."""
    near, far = await join("near"), await join("far")
    inbox = Inbox()
    await far.create_subscription("/t", STRING, QoS(), inbox)
    publisher = await near.create_publisher("/t", STRING, QoS(lifespan_s=5.0))
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample("x", seq=1_600_000_000_000_000_000))
    (got,) = await inbox.wait(1)
    assert abs(got.seq - time.time_ns()) < 5e9


@pytest.mark.parametrize("payload", [b"", b"\0", b"\0\1\0", b"\0\1\0\0", b"\xff\xff\0\0abcd"])
async def test_no_cdr_is_refused(join: Join, payload: bytes) -> None:
    """Bytes that are no CDR are counted and sent to nobody."""
    graph = await join()
    publisher = await graph.create_publisher("/t", STRING)
    publisher.publish(Sample(payload, STRING, 0, bytes(16), 0))
    assert graph.drops == {("/t", Undelivered.ENCODE): 1}


async def test_after_close(join: Join) -> None:
    """What is published on a closed publisher is counted."""
    graph = await join()
    publisher = await graph.create_publisher("/t", STRING)
    await publisher.close()
    publisher.publish(sample("x"))
    assert graph.drops == {("/t", Undelivered.CLOSED): 1}


def parse(inbox: Inbox, known: list[int]) -> list[int]:
    """The numbers of the messages that came since."""
    return [int(s.payload[8:20].split(b"\0")[0]) for s in inbox.samples[len(known) :]]


async def test_loop_behind(join: Join) -> None:
    """While the loop is busy the newest messages survive, within the bounds, and the lost ones are counted."""
    near, far = await join("near"), await join("far")
    inbox = Inbox()
    await far.create_subscription("/big", STRING, QoS(depth=5), inbox)
    publisher = await near.create_publisher("/big", STRING, QoS(depth=100))
    await until(lambda: publisher.subscribers == 1)
    payload = bytes(4 << 20)
    count = 60
    for i in range(count):
        publisher.publish(Sample(text(str(i)) + payload, STRING, 0, bytes(16), 0))
        time.sleep(0.002)  # noqa: ASYNC251 - the loop is blocked, as by a slow callback
    numbers: list[int] = []
    await until(lambda: numbers.extend(parse(inbox, numbers)) or numbers[-1:] == [count - 1])
    assert numbers == sorted(numbers)
    assert numbers[-5:] == list(range(count - 5, count))
    await until(lambda: far.drops)
    assert (
        len(numbers) + far.drops["/big", Undelivered.BACKLOG] <= count
    )  # DDS itself keeps the last five for a thread that is late
    assert not near.drops


async def test_failing_subscriber(join: Join) -> None:
    """A callback that fails is counted for its whole batch, and others of the same reader get theirs."""
    near, far = await join("near"), await join("far")
    inbox = Inbox()

    def fail(batch: Any) -> None:
        raise ValueError("no")

    await far.create_subscription("/t", STRING, QoS(), fail)
    await far.create_subscription("/t", STRING, QoS(), inbox)
    publisher = await near.create_publisher("/t", STRING)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample("x"))
    await inbox.wait(1)
    assert far.drops == {("/t", Undelivered.CALLBACK): 1}


# Gateways -------------------------------------------------------------------------------------------------------


async def test_own_gateway_is_ignored(join: Join) -> None:
    """Two processes of one gateway do not hear each other, and are no demand for each other; other gateways are."""
    worker1 = await join("worker1", gateway_id="gw")
    worker2 = await join("worker2", gateway_id="gw")
    other = await join("other", gateway_id="elsewhere")
    ignored, heard = Inbox(), Inbox()
    await worker2.create_subscription("/t", STRING, QoS(), ignored)
    await worker2.create_subscription("/t", STRING, None, ignored)
    await other.create_subscription("/t", STRING, QoS(), heard)
    publisher = await worker1.create_publisher("/t", STRING)
    counts: list[int] = []
    publisher.on_demand(counts.append)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample("x"))
    (got,) = await heard.wait(1)
    assert got.relayed
    await until(lambda: len(worker2.topics()["/t"].publishers) == 1)
    (endpoint,) = worker2.topics()["/t"].publishers
    assert endpoint.gateway == "gw"
    assert not endpoint.local
    stranger = await other.create_publisher("/t", STRING)
    await until(lambda: stranger.subscribers == 1)
    stranger.publish(sample("later"))
    await ignored.wait(2)
    assert ignored.texts == ["later", "later"]
    assert max(counts) == 1


async def test_own_samples(join: Join) -> None:
    """A participant neither hears itself nor counts itself as demand."""
    graph, other = await join(), await join("other")
    inbox = Inbox()
    await graph.create_subscription("/t", STRING, QoS(), inbox)
    publisher = await graph.create_publisher("/t", STRING)
    await until(lambda: len(graph.topics()["/t"].publishers) == 1)
    publisher.publish(sample("x"))
    stranger = await other.create_publisher("/t", STRING)
    await until(lambda: stranger.subscribers == 1)
    stranger.publish(sample("later"))
    await inbox.wait(1)
    assert inbox.texts == ["later"]
    assert publisher.subscribers == 0


# Adopted profiles -----------------------------------------------------------------------------------------------


async def test_adopts_the_weakest(join: Join) -> None:
    """With publishers of different profiles the subscription asks for what all of them offer."""
    near, far = await join("near"), await join("far")
    await near.create_publisher("/t", STRING, LATCHED)
    await near.create_publisher("/t", STRING, QoS(depth=30))
    await until(lambda: len(far.topics()["/t"].publishers) == 2 if "/t" in far.topics() else False)
    subscription = await far.create_subscription("/t", STRING, None, lambda _: None)
    assert subscription.qos == QoS(depth=30)
    await near.create_publisher("/t", STRING, SENSOR_DATA)
    await until(lambda: not subscription.qos.reliable)


async def test_follows_without_loss(join: Join) -> None:
    """While a subscription changes its profile, nothing is lost and nothing comes twice."""
    near, far = await join("near"), await join("far")
    inbox, profiles = Inbox(), list[QoS]()
    subscription = await far.create_subscription("/t", STRING, None, inbox)
    subscription.on_qos(profiles.append)
    steady = await near.create_publisher("/t", STRING, QoS(depth=1000))
    await until(lambda: bool(steady.subscribers))
    sent = 0
    weak = None
    for step in range(300):
        steady.publish(sample(f"steady {sent}"))
        sent += 1
        if step == 100:
            weak = await near.create_publisher("/t", STRING, SENSOR_DATA)
        if step == 250 and weak is not None:
            await weak.close()
        await asyncio.sleep(0.01)
    await inbox.wait(sent)
    await asyncio.sleep(0.1)
    assert inbox.payloads == [text(f"steady {i}") for i in range(sent)]
    assert [p.reliable for p in profiles if p.depth != 10 or p.reliable][-1]
    assert False in [p.reliable for p in profiles]
    await until(lambda: steady.subscribers == 1)


async def test_adopts_latched_late(join: Join) -> None:
    """When only transient local publishers are left, their history comes without what was heard before."""
    near, far = await join("near"), await join("far")
    inbox = Inbox()
    subscription = await far.create_subscription("/map", STRING, None, inbox)
    volatile = await near.create_publisher("/map", STRING, QoS())
    latched = await near.create_publisher("/map", STRING, QoS(durability="transient_local", depth=3))
    await until(lambda: bool(latched.subscribers and volatile.subscribers))
    await until(lambda: not subscription.qos.transient_local)
    latched.publish(sample("a"))
    await inbox.wait(1)
    await volatile.close()
    await until(lambda: subscription.qos.transient_local)
    assert subscription.qos.depth == 3
    latched.publish(sample("b"))
    await inbox.wait(2)
    latched.publish(sample("c"))
    await inbox.wait(3)
    assert inbox.texts == ["a", "b", "c"]


async def test_close_while_following(join: Join) -> None:
    """A subscription that is closed during a change of profile leaves no reader behind."""
    near, far = await join("near"), await join("far")
    subscription = await far.create_subscription("/t", STRING, None, lambda _: None)
    publisher = await near.create_publisher("/t", STRING, SENSOR_DATA)
    await until(lambda: not subscription.qos.reliable)
    await subscription.close()
    await until(lambda: publisher.subscribers == 0)
    await until(lambda: not far.topics()["/t"].subscriptions)


# Discovery ------------------------------------------------------------------------------------------------------


async def test_endpoints(join: Join) -> None:
    """An endpoint shows its profile, type hash, gateway and node, on both sides."""
    registry = TypeRegistry()
    near = await join("near", namespace="/robot1", gateway_id="gw7", registry=registry)
    far = await join("far")
    qos = QoS(depth=7, deadline_s=0.5, lifespan_s=2.5, durability="transient_local")
    await near.create_publisher("/t", STRING, qos)
    await near.create_subscription("/t", STRING, QoS(reliability="best_effort", depth=3), lambda _: None)
    for graph in (near, far):
        await until(
            lambda graph=graph: (
                "/t" in graph.topics()
                and graph.topics()["/t"].publishers
                and graph.topics()["/t"].subscriptions
                and all(e.node for e in graph.topics()["/t"].publishers + graph.topics()["/t"].subscriptions)
            )
        )
        topic = graph.topics()["/t"]
        (publisher,), (subscription,) = topic.publishers, topic.subscriptions
        assert publisher.qos == qos
        assert publisher.type_hash == registry.hash(STRING)
        assert publisher.gateway == subscription.gateway == "gw7"
        assert publisher.node == subscription.node == "/robot1/near"
        assert publisher.local == subscription.local == (graph is near)
        assert len(publisher.gid) == 16
        assert subscription.qos == QoS(reliability="best_effort", depth=3)


async def test_nodes(join: Join) -> None:
    """Nodes are listed with what they publish and read, ours flagged as local."""
    near, far = await join("near"), await join("far", namespace="/ns")
    await near.create_publisher("/a", STRING)
    await near.create_subscription("/b", STRING, QoS(), lambda _: None)
    await until(lambda: far.nodes().get("/near") and far.nodes()["/near"].publishers)
    await until(lambda: far.nodes()["/near"].subscriptions)
    nodes = far.nodes()
    assert set(nodes) == {"/near", "/ns/far"}
    assert nodes["/near"].publishers == (("/a", STRING),)
    assert nodes["/near"].subscriptions == (("/b", STRING),)
    assert nodes["/ns/far"].local
    assert not nodes["/near"].local
    await near.close()
    await until(lambda: set(far.nodes()) == {"/ns/far"})


async def test_services_and_actions_are_recognised(join: Join) -> None:
    """The topics of services and actions show as services of their nodes and as events, not as topics."""
    near, far = await join("near"), await join("far")
    events: list[str] = []
    iterator = far.changes()

    async def listen() -> None:
        async for event in iterator:
            events.append(f"{event.kind} {event.name} {event.type} {event.node}")

    task = asyncio.create_task(listen())
    participant = near.participant
    for topic, type, reads in (
        ("rq/addRequest", "p::srv::dds_::Add_Request_", True),
        ("rq/subRequest", "p::srv::dds_::Sub_Request_", False),
        ("rr/subReply", "p::srv::dds_::Sub_Response_", True),
        ("rq/fly/_action/send_goalRequest", "p::action::dds_::Fly_SendGoal_Request_", True),
        ("rt/fly/_action/feedback", "p::action::dds_::Fly_FeedbackMessage_", True),
    ):
        if reads:
            participant.create_reader((topic, type), "", QoS(), b"", lambda _: None, lambda _: None)
        else:
            participant.create_writer((topic, type), QoS(), b"", print)
    await until(lambda: len(events) >= 3)
    await until(lambda: far.nodes()["/near"].services)
    node = far.nodes()["/near"]
    assert node.services == (("/add", "p/srv/Add"), ("/fly/_action/send_goal", "p/action/Fly_SendGoal"))
    assert node.clients == (("/sub", "p/srv/Sub"),)
    assert sorted(events) == [
        "action /fly p/action/Fly /near",
        "node /near  ",
        "service /add p/srv/Add /near",
    ] or sorted(events) == ["action /fly p/action/Fly /near", "service /add p/srv/Add /near"]
    assert "/add" not in far.topics()
    task.cancel()


async def test_events(join: Join) -> None:
    """Events tell who publishes what, of others only, and end when the graph closes."""
    far = await join("far")
    told: list[str] = []

    async def listen() -> None:
        async for event in far.changes():
            told.append(str(event))

    async with aio.TaskGroup() as group:
        group.create_task(listen())
        await asyncio.sleep(0)
        await far.create_publisher("/own", STRING)
        near = await join("near")
        publisher = await near.create_publisher("/t", STRING)
        await until(lambda: len(told) >= 2)
        await publisher.close()
        await until(lambda: len(told) >= 3)
        await near.close()
        await until(lambda: len(told) >= 4)
        await far.close()
    name = far.name
    assert told == [
        f"{name}: node /near has appeared",
        f"{name}: node /near publishes /t ({STRING})",
        f"{name}: node /near no longer publishes /t ({STRING})",
        f"{name}: node /near has left",
    ]


async def test_hostile_discovery_info(join: Join) -> None:
    """Garbage on ros_discovery_info, and nodes told for another participant, change nothing."""
    from ropeway.networks.dds.names import DISCOVERY_TOPIC, DISCOVERY_TYPE
    from ropeway.networks.dds.nodes import NodeEntities, ParticipantEntities, encode

    near, far = await join("near"), await join("far")
    await until(lambda: "/near" in far.nodes())
    writer = near.participant.create_writer(
        (DISCOVERY_TOPIC, DISCOVERY_TYPE), QoS(durability="transient_local", depth=50), b"", print
    )
    forged = ParticipantEntities(far.participant.guid, (NodeEntities("/forged"),))
    for payload in (b"\0\1\0\0\xff", b"\0\1\0\0" + b"\xff" * 64, b"\0\1\0\0" + os.urandom(500), encode(forged)):
        writer.write(payload)
    inbox = Inbox()
    await far.create_subscription("/t", STRING, QoS(), inbox)
    publisher = await near.create_publisher("/t", STRING)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample("alive"))
    await inbox.wait(1)
    await until(lambda: ("/t", STRING) in far.nodes()["/near"].publishers)
    assert set(far.nodes()) == {"/near", "/far"}


async def test_old_gids(join: Join) -> None:
    """Where all others write gids of 24 bytes, as ROS 2 Humble does, so do we; else 16."""
    from ropeway.networks.dds.names import DISCOVERY_TOPIC, DISCOVERY_TYPE
    from ropeway.networks.dds.nodes import NodeEntities, ParticipantEntities, encode, parse

    near, far = await join("near"), await join("far")
    seen: list[int] = []

    def on_message(batch: list[Sample]) -> None:
        for heard in batch:
            found = parse(heard.payload)
            if found is not None and found.guid == far.participant.guid:
                seen.append(found.gid_bytes)

    key, latched = (DISCOVERY_TOPIC, DISCOVERY_TYPE), QoS(durability="transient_local", depth=5)
    near.participant.create_reader(key, DISCOVERY_TYPE, latched, b"", on_message, lambda _: None)
    await until(lambda: seen)
    assert set(seen) == {16}
    writer = near.participant.create_writer(key, latched, b"", print)
    old = ParticipantEntities(near.participant.guid, (NodeEntities("/humble"),), 24)
    await until(lambda: writer.write(encode(old)) or seen[-1] == 24)


# Demand ---------------------------------------------------------------------------------------------------------


async def test_demand_across_processes_of_others(join: Join) -> None:
    """The number of readers follows those of others, at once and at each change."""
    near, far = await join("near"), await join("far")
    publisher = await near.create_publisher("/t", STRING)
    counts: list[int] = []
    publisher.on_demand(counts.append)
    first = await far.create_subscription("/t", STRING, QoS(), lambda _: None)
    second = await far.create_subscription("/t", STRING, SENSOR_DATA, lambda _: None)
    await until(lambda: counts[-1] == 2)
    await first.close()
    await second.close()
    await until(lambda: counts[-1] == 0)
    assert counts[0] == 0


# Lifecycle ------------------------------------------------------------------------------------------------------


LEAKS = """
    import gc, json, threading
    from pathlib import Path

    def footprint():
        everything = Path("/proc/self")
        threads = (threading.active_count(), len(list((everything / "task").iterdir())))
        return (*threads, len(list((everything / "fd").iterdir())))

    def resident_bytes():
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4096

    async def once(domain):
        graph = DdsGraph(domain, interface="lo")
        await graph.open()
        publisher = await graph.create_publisher("/t", STRING)
        await graph.create_subscription("/t", STRING, None, lambda _: None)
        publisher.publish(sample("x"))
        await graph.close()

    async def main(domain):
        for _ in range(5):
            await once(domain)
        gc.collect()
        before, resident = footprint(), resident_bytes()
        for _ in range(50):
            await once(domain)
        gc.collect()
        await until(lambda: all(now <= then for now, then in zip(footprint(), before)))
        print(resident_bytes() - resident, flush=True)

    asyncio.run(main(int(sys.argv[1])))
"""


async def test_open_and_close_leak_nothing(domain: int) -> None:
    """Fifty times opened and closed, a graph leaves no thread, no file and no memory behind."""
    with process(LEAKS, domain) as child:
        grown, _ = await asyncio.to_thread(child.communicate, timeout=4 * PATIENCE_S)
        assert child.returncode == 0
    assert int(grown) < 8 << 20


async def test_reopen(join: Join) -> None:
    """A graph that was closed can be opened again, and opening or closing twice is harmless."""
    graph = await join()
    await graph.open()
    await graph.close()
    await graph.close()
    with pytest.raises(GraphUnavailable):
        await graph.create_publisher("/t", STRING)
    assert graph.topics() == {}
    await graph.open()
    await graph.create_publisher("/t", STRING)


async def test_close_of_one_of_two(join: Join) -> None:
    """Two graphs share a domain; the one that is left goes on."""
    near, far, third = await join("near"), await join("far"), await join("third")
    await third.close()
    inbox = Inbox()
    await far.create_subscription("/t", STRING, QoS(), inbox)
    publisher = await near.create_publisher("/t", STRING)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample("x"))
    await inbox.wait(1)


async def test_two_domains(join: Join, domain: int) -> None:
    """Graphs of different domains live in one process and hear nothing of each other."""
    here = await join("here")
    there = DdsGraph(domain + 1 if domain < 55 else 40, name="there", interface="lo")
    await there.open()
    inbox = Inbox()
    await there.create_subscription("/t", STRING, QoS(), inbox)
    publisher = await here.create_publisher("/t", STRING)
    publisher.publish(sample("x"))
    await until(lambda: "/t" in here.topics())
    await asyncio.sleep(0.05)
    assert inbox.samples == []
    assert publisher.subscribers == 0
    assert set(there.nodes()) == {"/there"}
    await there.close()


async def test_other_configuration_of_one_domain(join: Join, domain: int) -> None:
    """A domain cannot be open twice with different interfaces, and the error says which one it has."""
    await join()
    second = DdsGraph(domain, interface="127.0.0.1")
    with pytest.raises(GraphUnavailable, match="interface lo"):
        await second.open()


async def test_bad_interface(domain: int) -> None:
    """A bad interface is refused at once, with those there are."""
    graph = DdsGraph(domain, interface="nosuch0")
    with pytest.raises(GraphUnavailable, match="lo"):
        graph.open().send(None)  # before it waits for anything
    assert graph.topics() == {}
    await graph.close()


async def test_bad_configuration(domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A configuration that Cyclone DDS refuses is an error that says where to look, and leaves no thread."""
    monkeypatch.setenv("CYCLONEDDS_URI", "<CycloneDDS><Domain><Nonsense/></Domain></CycloneDDS>")
    started = new_threads()
    with pytest.raises(GraphUnavailable, match="CYCLONEDDS_URI"):
        await DdsGraph(domain, interface="lo").open()
    assert not started()


@pytest.mark.parametrize("domain", [-1, 233])
def test_bad_domain(domain: int) -> None:
    """A number that is no domain is refused."""
    with pytest.raises(GraphUnavailable, match="232"):
        DdsGraph(domain)


async def test_bad_names(join: Join) -> None:
    """Names that ROS would refuse are refused."""
    graph = await join()
    with pytest.raises(InvalidTypeName):
        await graph.create_publisher("/t", "String")
    with pytest.raises(InvalidName):
        DdsGraph(name="a/b")
    with pytest.raises(InvalidName):
        DdsGraph(name="1st")
    with pytest.raises(GraphUnavailable):
        DdsGraph(gateway_id="a;b")


async def test_no_callbacks_after_close(join: Join) -> None:
    """Once close has returned, no callback runs, whatever was on its way."""
    near, far = await join("near"), await join("far")
    inbox = Inbox()
    everything = Inbox()
    subscription = await far.create_subscription("/t", STRING, KEEP_ALL, inbox)
    await (await join("other")).create_subscription("/t", STRING, KEEP_ALL, everything)
    publisher = await near.create_publisher("/t", STRING, KEEP_ALL)
    await until(lambda: publisher.subscribers == 2)
    for _ in range(500):
        publisher.publish(sample("x"))
    await subscription.close()
    had = len(inbox.samples)
    await everything.wait(500)
    assert len(inbox.samples) == had
