"""ropeway.networks.zenoh: two of ours, and what strangers put on their network."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ropeway.errors import GraphUnavailable
from ropeway.graph.base import Undelivered
from ropeway.graph.calls import Request
from ropeway.networks.zenoh import ZenohGraph
from ropeway.networks.zenoh.address import ZenohAddress
from ropeway.networks.zenoh.attachment import pack
from ropeway.networks.zenoh.graph import TOKENS
from ropeway.networks.zenoh.tokens import ZenohToken, data_key, enclave_of, gid_of
from ropeway.qos import LATCHED, QoS
from tests.support.inbox import Inbox
from tests.support.messages import STRING, joined, sample, text
from tests.support.services import ADD, add, addends, total
from tests.support.until import until

from .network import endpoint, foreign_session, open_pair

_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


async def test_shown() -> None:
    """Nodes see each other's endpoints with node, hash and profile."""
    async with open_pair() as (near, far, _):
        await near.create_publisher("/map", STRING, LATCHED)
        await until(lambda: far.topics()["/map"].publishers)
        (publisher,) = far.topics()["/map"].publishers
        assert (publisher.node, publisher.type_hash, publisher.qos) == ("/near", _HASH, LATCHED)
        assert near.topics()["/map"].publishers[0].gid == publisher.gid
        assert far.settled
        assert far.nodes()["/near"].publishers == (("/map", STRING),)


async def test_domains_apart() -> None:
    """A node of another domain on the same network is neither seen nor heard."""
    where = endpoint()
    near = ZenohGraph(ZenohAddress(1, (), (where,), "peer"), name="near")
    far = ZenohGraph(ZenohAddress(2, (where,), (), "peer"), name="far")
    same = ZenohGraph(ZenohAddress(1, (where,), (), "peer"), name="same")
    for graph in (near, far, same):
        await graph.open()
    await until(lambda: "/same" in near.nodes())
    assert "/far" not in near.nodes()
    for graph in (near, far, same):
        await graph.close()


async def test_opens_again() -> None:
    """A graph that was closed can be opened again, as another session."""
    graph = ZenohGraph(ZenohAddress(0, (), (endpoint(),), "peer"))
    await graph.open()
    first = graph.session.id
    await graph.close()
    await graph.open()
    assert graph.session.id != first
    await graph.create_publisher("/t", STRING)
    assert list(graph.topics()) == ["/t"]
    await graph.close()


async def test_bad_configuration() -> None:
    """A configuration that Zenoh does not take is told when the graph opens."""
    with pytest.raises(GraphUnavailable, match=r"missing\.json5"):
        await ZenohGraph(ZenohAddress(0, config="missing.json5")).open()
    taken = endpoint()
    first = ZenohGraph(ZenohAddress(0, (), (taken,), "peer"))
    await first.open()
    with pytest.raises(GraphUnavailable, match="Zenoh cannot start"):
        await ZenohGraph(ZenohAddress(0, (), (taken,), "peer")).open()
    await first.close()


async def test_own_gateway() -> None:
    """Processes of one gateway do not hear each other."""
    where = endpoint()
    first = ZenohGraph(ZenohAddress(0, (), (where,), "peer"), name="first", gateway_id="robot")
    second = ZenohGraph(ZenohAddress(0, (where,), (), "peer"), name="second", gateway_id="robot")
    other = ZenohGraph(ZenohAddress(0, (where,), (), "peer"), name="other", gateway_id="edge")
    for graph in (first, second, other):
        await graph.open()
    inbox = Inbox()
    await first.create_subscription("/t", STRING, QoS(), inbox)
    own, foreign = await second.create_publisher("/t", STRING), await other.create_publisher("/t", STRING)
    await joined(foreign)
    await until(lambda: len(first.topics()["/t"].publishers) == 2)
    assert own.subscribers == 0
    own.publish(sample("own"))
    foreign.publish(sample("foreign"))
    (got,) = await inbox.wait(1)
    assert (bytes(got.payload), got.relayed) == (text("foreign"), True)
    for graph in (first, second, other):
        await graph.close()


async def test_hostile() -> None:
    """Malformed tokens, messages and requests by the thousand are counted, and what is good goes on."""
    async with open_pair() as (near, far, where):
        inbox = Inbox()
        await near.create_subscription("/t", STRING, QoS(), inbox)
        await near.create_service("/add", ADD, add)
        publisher = await far.create_publisher("/t", STRING)
        client = await far.create_client("/add", ADD)
        await joined(publisher)
        session = foreign_session(where)
        tokens = [session.liveliness().declare_token(f"@ros2_lv/0/{number}/x") for number in range(2000)]
        tokens.append(
            session.liveliness().declare_token("@ros2_lv/0/aa/0/1/MP/%/%/evil/%t/no_type/RIHS01_1/::,9:,:,:,,")
        )
        key = data_key(0, "/t", STRING, _HASH)
        for attachment in (None, b"", b"x" * 33, pack(1, 1, bytes(16))[:-1]):
            session.put(key, text("bad"), attachment=attachment)
        session.put(key, b"", attachment=pack(1, 1, bytes(16)))
        for attachment, payload in ((None, addends(1)), (pack(1, 1, bytes(16)), b"\0"), (b"?", addends(1))):
            session.get(data_key(0, "/add", ADD, "RIHS01_1"), payload=payload, attachment=attachment)
        await until(lambda: near.drops[TOKENS, Undelivered.DECODE] == 2001)
        await until(lambda: near.drops["/t", Undelivered.DECODE] == 5)
        await until(lambda: near.drops["/add", Undelivered.DECODE] == 3)
        publisher.publish(sample("good"))
        await inbox.wait(1)
        assert inbox.texts == ["good"]
        assert await client.call(Request(addends(3, 4))) == total(7)
        assert "/evil" not in near.nodes()
        session.close()
        assert len(tokens) == 2001


async def test_many_tokens() -> None:
    """Thousands of endpoints of a stranger are listed, and gone when it leaves."""
    async with open_pair() as (near, _, where):
        session = foreign_session(where)
        node = ZenohToken(0, str(session.info.zid()), "0", "0", "publisher", "/many", "/", "/t", STRING, _HASH)
        shown = [session.liveliness().declare_token(str(replace(node, id=str(number)))) for number in range(3000)]
        await until(lambda: len(near.discovery.others("publisher", "/t", STRING)) == len(shown))
        session.close()
        await until(lambda: "/t" not in near.topics())


def test_identity_of_ours() -> None:
    """The gid of an endpoint is that of its token."""
    token = ZenohToken(0, "aa", "0", "1", "publisher", "/n", enclave_of("x"), "/t", STRING, _HASH)
    assert len(gid_of(str(token))) == 16
    assert gid_of(str(token)) != gid_of(str(replace(token, id="2")))
