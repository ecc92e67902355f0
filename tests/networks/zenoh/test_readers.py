"""ropeway.networks.zenoh.readers: what we read of a topic, from Ropeways and strangers."""

from __future__ import annotations

import pytest

from ropeway.graph.base import Undelivered
from ropeway.networks.zenoh.attachment import pack
from ropeway.networks.zenoh.tokens import NO_HASH, ZenohToken, data_key
from ropeway.qos import LATCHED, SENSOR_DATA, QoS
from tests.support.inbox import Inbox
from tests.support.messages import STRING, joined, sample, text
from tests.support.until import until

from .network import foreign_session, open_pair

_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


async def test_heard_once() -> None:
    """Where an endpoint shows itself under two hashes, another Ropeway hears each message once."""
    async with open_pair() as (near, far, where):
        inbox = Inbox()
        await far.create_subscription("/t", STRING, QoS(depth=100), inbox)
        publisher = await near.create_publisher("/t", STRING)
        session = foreign_session(where)
        token = ZenohToken(0, str(session.info.zid()), "0", "1", "subscription", "/old", "/", "/t", STRING, NO_HASH)
        shown = session.liveliness().declare_token(str(token))
        await until(lambda: publisher.subscribers == 2 and len(far.topics()["/t"].publishers) == 2)
        for number in range(20):
            publisher.publish(sample(f"{number}"))
        publisher.publish(sample("end"))
        await until(lambda: inbox.texts[-1:] == ["end"])
        assert inbox.texts == [*map(str, range(20)), "end"]
        shown.undeclare()
        session.close()


async def test_shared() -> None:
    """Volatile subscriptions of one profile share a reader, which is gone with the last of them."""
    async with open_pair() as (near, far, _):
        inboxes = [Inbox() for _ in range(3)]
        reading = [await far.create_subscription("/t", STRING, QoS(), inbox) for inbox in inboxes]
        publisher = await near.create_publisher("/t", STRING)
        await joined(publisher)
        assert publisher.subscribers == 1
        publisher.publish(sample("all"))
        for inbox in inboxes:
            assert [one.payload for one in await inbox.wait(1)] == [text("all")]
        for subscription in reading:
            await subscription.close()
        await until(lambda: publisher.subscribers == 0)


@pytest.mark.parametrize("offered", [QoS(depth=7), SENSOR_DATA, LATCHED])
async def test_adopts(offered: QoS) -> None:
    """A subscription without a profile shows itself with that of the publishers."""
    async with open_pair() as (near, far, _):
        inbox = Inbox()
        await far.create_subscription("/t", STRING, None, inbox)
        publisher = await near.create_publisher("/t", STRING, offered)

        def shown() -> bool:
            profiles = {token.qos for token in near.discovery.others("subscription", "/t", STRING)}
            return {(qos.reliability, qos.durability) for qos in profiles} == {
                (offered.reliability, offered.durability)
            }

        await until(shown)
        publisher.publish(sample("hello"))
        await inbox.wait(1)
        assert inbox.texts == ["hello"]


async def test_latched_of_two_publishers() -> None:
    """A late subscription gets what each of two publishers keeps, of each no more than its depth."""
    async with open_pair() as (near, far, _):
        for count in (1, 2):
            publisher = await near.create_publisher("/t", STRING, QoS(durability="transient_local", depth=count))
            for number in range(3):
                publisher.publish(sample(f"{count}.{number}"))
        inbox = Inbox()
        await far.create_subscription("/t", STRING, QoS(durability="transient_local", depth=10), inbox)
        await inbox.wait(3)
        assert sorted(inbox.texts) == ["1.2", "2.1", "2.2"]


async def test_malformed() -> None:
    """A message without an attachment, or without CDR, is counted, and what is good is given on."""
    async with open_pair() as (near, _, where):
        inbox = Inbox()
        await near.create_subscription("/t", STRING, QoS(depth=100), inbox)
        session = foreign_session(where)
        key = data_key(0, "/t", STRING, _HASH)
        session.put(key, text("bare"))
        session.put(key, b"\0", attachment=pack(1, 1, bytes(16)))
        session.put(key, text("good"), attachment=pack(2, 77, bytes(range(16))))
        (got,) = await inbox.wait(1)
        assert (got.seq, got.origin, bytes(got.payload)) == (77, bytes(range(16)), text("good"))
        assert near.drops["/t", Undelivered.DECODE] == 2
        session.close()
