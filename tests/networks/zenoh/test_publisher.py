"""ropeway.networks.zenoh.publisher: how we publish a topic, seen by Ropeways and strangers."""

from __future__ import annotations

import zenoh

from ropeway.graph.base import Undelivered
from ropeway.networks.zenoh.attachment import parse
from ropeway.networks.zenoh.tokens import ZenohToken, data_key
from ropeway.qos import LATCHED, QoS
from tests.support.inbox import Inbox
from tests.support.messages import STRING, joined, sample, text
from tests.support.until import until

from .network import foreign_session, open_pair

_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


async def test_numbered() -> None:
    """A message keeps its number as its source timestamp, and comes from the gid of its publisher."""
    async with open_pair() as (near, far, _):
        inbox = Inbox()
        await far.create_subscription("/t", STRING, QoS(), inbox)
        publisher = await near.create_publisher("/t", STRING)
        await joined(publisher)
        message = sample("hello")
        message.seq = 1_234_567
        publisher.publish(message)
        (got,) = await inbox.wait(1)
        assert (got.seq, got.relayed) == (1_234_567, False)
        assert got.origin == near.topics()["/t"].publishers[0].gid


async def test_two_hashes() -> None:
    """Readers that know a type under another hash get the messages under theirs, latched ones too."""
    async with open_pair() as (near, _, where):
        publisher = await near.create_publisher("/t", STRING, LATCHED)
        publisher.publish(sample("kept"))
        session = foreign_session(where)
        token = ZenohToken(
            0, str(session.info.zid()), "0", "1", "subscription", "/other", "/", "/t", STRING, "RIHS01_other"
        )
        got: list[bytes] = []
        key = data_key(0, "/t", STRING, "RIHS01_other")
        history = zenoh.ext.HistoryConfig(detect_late_publishers=True)

        def take(taken: zenoh.Sample) -> None:
            got.append(bytes(taken.payload))

        handler = zenoh.handlers.Callback(take, indirect=False)
        subscriber = zenoh.ext.declare_advanced_subscriber(session, key, handler, history=history)
        shown = session.liveliness().declare_token(str(token))
        await until(lambda: got == [text("kept")])
        assert publisher.subscribers == 1
        assert {end.type_hash for end in near.topics()["/t"].publishers} == {_HASH, "RIHS01_other"}
        publisher.publish(sample("new"))
        await until(lambda: got == [text("kept"), text("new")])
        shown.undeclare()
        await until(lambda: {end.type_hash for end in near.topics()["/t"].publishers} == {_HASH})
        subscriber.undeclare()
        session.close()


async def test_attachments() -> None:
    """Each message of a publisher carries the next number, its time, and the gid that the publisher is known by."""
    async with open_pair() as (near, _, where):
        publisher = await near.create_publisher("/t", STRING)
        session = foreign_session(where)
        got: list[zenoh.Sample] = []
        handler = zenoh.handlers.Callback(got.append, indirect=False)
        subscriber = session.declare_subscriber(data_key(0, "/t", STRING, "*"), handler)

        def send() -> bool:
            if not got:  # until the subscriber is known
                publisher.publish(sample("early"))
            return bool(got)

        await until(send)
        early = len(got)
        for stamp_ns in (5, 6, 7):
            message = sample(str(stamp_ns))
            message.seq = stamp_ns
            publisher.publish(message)
        await until(lambda: got[-1].attachment is not None and bytes(got[-1].payload) == text("7"))
        found = [parse(bytes(one.attachment)) for one in got if one.attachment is not None][-3:]
        numbers = [one.number for one in found if one is not None]
        assert numbers == list(range(numbers[0], numbers[0] + 3))
        assert [one.stamp_ns for one in found if one is not None] == [5, 6, 7]
        assert {one.gid for one in found if one is not None} == {near.topics()["/t"].publishers[0].gid}
        assert early >= 1
        subscriber.undeclare()
        session.close()


async def test_closed() -> None:
    """A publisher that was closed is gone from the network, and what it is given is counted."""
    async with open_pair() as (near, far, _):
        publisher = await near.create_publisher("/t", STRING)
        await until(lambda: "/t" in far.topics())
        await publisher.close()
        await until(lambda: "/t" not in far.topics())
        publisher.publish(sample("late"))
        assert near.drops["/t", Undelivered.CLOSED] == 1
        await publisher.close()
