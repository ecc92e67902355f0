"""What attackers can do: nothing but what is counted.

The attacker here is a router, or whoever runs one: it sees everything that passes and may put whatever it likes.
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
import zenoh

from ropeway.errors import CallFailed, GraphUnavailable, IdentityError
from ropeway.graph.calls import Request
from ropeway.networks.overlay.data_key import data_key
from ropeway.networks.overlay.fabric import Fabric
from ropeway.networks.overlay.graph import OverlayGraph
from ropeway.networks.overlay.names import global_name
from ropeway.networks.overlay.refusal import Refusal
from ropeway.networks.overlay.rights import Rights
from ropeway.networks.overlay.zenoh_config import gateway_config, gateway_id
from ropeway.qos import QoS
from tests.networks.overlay.conftest import Site
from tests.networks.overlay.fleet import fleet, member
from tests.support.inbox import Inbox
from tests.support.messages import STRING
from tests.support.messages import sample as text
from tests.support.services import ADD
from tests.support.until import PATIENCE_S, until


def refusals(graph: OverlayGraph) -> set[Refusal]:
    return {reason for _, reason in graph.node.refusals}


class Attacker:
    """A router that records everything, and puts what it likes."""

    def __init__(self, fabric: Fabric) -> None:
        self.fabric = fabric
        self.seen: list[tuple[str, bytes]] = []

    def of(self, part: str) -> list[tuple[str, bytes]]:
        return [(key, raw) for key, raw in self.seen if key.startswith(part)]

    async def put(self, key: str, raw: bytes) -> None:
        await asyncio.to_thread(self.fabric.put, 4, key, raw)


@asynccontextmanager
async def attacker(site: Site) -> AsyncIterator[Attacker]:
    identity = member("evil-router", role="router")
    gateway = gateway_id()
    fabric = Fabric(gateway_config(identity, gateway=gateway, connect=[site.endpoint], listen=()), gateway)
    await fabric.open()
    made = Attacker(fabric)
    end = fabric.hear("rw/**", lambda key, raw: made.seen.append((key, raw)))
    try:
        assert await fabric.linked(10)
        await until(lambda: made.of("rw/h/"))
        yield made
    finally:
        end()
        await fabric.close()


async def test_what_a_router_sees(site: Site) -> None:
    """A router sees global names, sizes and times; neither a topic's name nor a byte of its messages."""
    near, far = await site.join(), await site.join()
    async with attacker(site) as evil:
        inbox = Inbox()
        await far.create_subscription("/very_secret_topic", STRING, QoS(), inbox)
        publisher = await near.create_publisher("/very_secret_topic", STRING)
        await until(lambda: publisher.subscribers)
        publisher.publish(text("a very secret payload"))
        await inbox.wait(1)
        await until(lambda: evil.of("rw/d/") and evil.of("rw/a/"))
        for key, raw in evil.seen:
            for word in (b"secret", b"String", b"std_msgs", near.node.identity.name.encode()):
                assert word not in raw
                assert word.decode() not in key


async def test_packets_of_an_attacker(site: Site) -> None:
    """Altered, cut, replayed, re-addressed and invented packets are refused and counted; the stream goes on."""
    near, far = await site.join(), await site.join()
    async with attacker(site) as evil:
        inbox, other = Inbox(), Inbox()
        await far.create_subscription("/a", STRING, QoS(), inbox)
        await far.create_subscription("/b", STRING, QoS(), other)
        publisher = await near.create_publisher("/a", STRING)
        second = await near.create_publisher("/b", STRING)
        await until(lambda: publisher.subscribers and second.subscribers)
        publisher.publish(text("1"))
        await inbox.wait(1)
        await until(lambda: evil.of("rw/d/"))
        key, packet = evil.of("rw/d/")[0]
        altered = packet[:-1] + bytes([packet[-1] ^ 1])
        await evil.put(key, altered)
        await evil.put(key, packet)
        await evil.put(key, packet[:30])
        await evil.put(key, b"\xff" * 100)
        await evil.put(second.key, packet)
        await evil.put(data_key(publisher.advert.global_name, bytes(16)), packet)
        await evil.put(key + "/deeper", packet)
        wanted = {Refusal.REPLAYED, Refusal.TRUNCATED, Refusal.MALFORMED}
        await until(lambda: wanted <= refusals(far))
        forged = bytearray(packet)
        forged[15] = 9  # a counter that was not used yet
        await evil.put(key, bytes(forged))
        await until(lambda: Refusal.BAD_SIGNATURE in refusals(far))
        publisher.publish(text("2"))
        second.publish(text("3"))
        await inbox.wait(2)
        await other.wait(1)
        assert [len(box.samples) for box in (inbox, other)] == [2, 1]


async def test_notes_of_an_attacker(site: Site) -> None:
    """Altered and replayed notes take nobody's names away, and bring nobody in."""
    near, far = await site.join(), await site.join()
    async with attacker(site) as evil:
        publisher = await near.create_publisher("/a", STRING)
        await until(lambda: "/a" in far.topics() and len(evil.of(f"rw/h/{near.node.gateway.hex()}")) > 1)
        await publisher.close()
        await until(lambda: "/a" not in far.topics())
        for key, raw in list(evil.seen):
            if key.startswith(("rw/a/", "rw/h/")):
                await evil.put(key, raw)
                await evil.put(key, raw[:-1] + bytes([raw[-1] ^ 1]))
                await evil.put(key.rsplit("/", 1)[0] + "/" + gateway_id().hex(), raw)
        await until(lambda: {Refusal.BAD_TAG, Refusal.REPLAYED} <= refusals(far))
        assert "/a" not in far.topics()
        assert len(far.node.membership.gateways()) == 1
        await near.create_publisher("/c", STRING)
        await until(lambda: "/c" in far.topics())


async def test_keys_that_nobody_has(site: Site) -> None:
    """Packets that name keys nobody has are refused, and do not make a reader ask for keys without end."""
    near, far = await site.join(), await site.join()
    async with attacker(site) as evil:
        inbox = Inbox()
        await far.create_subscription("/a", STRING, QoS(), inbox)
        publisher = await near.create_publisher("/a", STRING)
        await until(lambda: publisher.subscribers)
        publisher.publish(text("1"))
        await inbox.wait(1)
        await until(lambda: evil.of("rw/d/"))
        key, packet = evil.of("rw/d/")[0]
        asked = far.node.rpc.counts["key"]
        for number in range(200):
            await evil.put(key, packet[:4] + struct.pack(">I", number) + packet[8:])
        await until(lambda: far.node.refusals[near.node.identity.name, Refusal.NO_KEY] >= 200)
        assert far.node.rpc.counts["key"] - asked < 10
        publisher.publish(text("2"))
        await inbox.wait(2)


async def test_strangers_by_the_hundred(site: Site) -> None:
    """Heartbeats of gateways that there are not cost a bounded number of questions."""
    near = await site.join()
    async with attacker(site) as evil:
        key, raw = evil.of("rw/h/")[0]
        for _ in range(500):
            await evil.put(key.rsplit("/", 1)[0] + "/" + gateway_id().hex(), raw)
        await until(lambda: len(near.node.membership._known) >= 60)
        assert len(near.node.membership._known) <= 64
        far = await site.join(alone=True)
        await far.create_publisher("/late", STRING)
        await until(lambda: "/late" in near.topics())


async def test_requests_of_an_attacker(site: Site) -> None:
    """Requests that are altered, recorded or invented are refused, and calls go on."""
    near, far = await site.join(), await site.join()
    calls: list[Request] = []

    async def add(request: Request) -> bytes:
        calls.append(request)
        return b"\0\1\0\0" + struct.pack("<q", sum(struct.unpack("<qq", request.payload[4:20])))

    await far.create_service("/add", ADD, add)
    client = await near.create_client("/add", ADD)
    assert await client.wait_available(PATIENCE_S)
    payload = b"\0\1\0\0" + struct.pack("<qq", 1, 2)
    await client.call(Request(payload))
    channel = near.node.rpc._channels[far.node.gateway]
    packet = b"\x02" + channel.seal(b"\xa0")
    async with attacker(site) as evil:
        key = f"rw/g/{far.node.gateway.hex()}"
        for raw in (packet, packet, packet[:-1], packet[:9], b"\x01" + bytes(40), b"\x07", b""):
            await evil.fabric.ask(key, raw, 1.0)
        wanted = {Refusal.REPLAYED, Refusal.BAD_TAG, Refusal.TRUNCATED, Refusal.MALFORMED}
        await until(lambda: wanted & refusals(far) >= {Refusal.REPLAYED, Refusal.MALFORMED})
    assert await client.call(Request(payload)) == b"\0\1\0\0" + struct.pack("<q", 3)
    assert len(calls) == 2


@pytest.mark.parametrize("kind", ["none", "stranger", "expired"])
async def test_who_does_not_get_in(site: Site, kind: str) -> None:
    """Without a certificate of the fleet, or with one that has expired, nobody is linked with a router."""
    await site.join()
    if kind == "none":
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("connect/endpoints", f'["{site.endpoint}"]')
        config.insert_json5("connect/timeout_ms", "1000")
        with pytest.raises(zenoh.ZError):
            await asyncio.to_thread(zenoh.open, config)
        return
    identity = fleet("strangers").issue("eve") if kind == "stranger" else member("late", days=-0.001)
    gateway = gateway_id()
    fabric = Fabric(gateway_config(identity, gateway=gateway, connect=[site.endpoint], listen=()), gateway)
    await fabric.open()
    try:
        assert not await fabric.linked(1.5)
    finally:
        await fabric.close()


async def test_a_router_is_no_member(site: Site) -> None:
    """A router's certificate does for carrying, and neither for joining nor for being asked."""
    with pytest.raises(IdentityError, match="router"):
        await site.join(member("nosy", role="router"))


async def test_rights_of_members(site: Site) -> None:
    """A member does what its certificate allows, and is refused the rest by itself and by the others."""
    near = await site.join()
    poor = await site.join(member("poor", rights=Rights(subscribe=("/open",), publish=("/mine",))))
    with pytest.raises(GraphUnavailable, match="no right to publish /other"):
        await poor.create_publisher("/other", STRING)
    with pytest.raises(GraphUnavailable, match="no right to subscribe /closed"):
        await poor.create_subscription("/closed", STRING, QoS(), lambda _: None)
    with pytest.raises(GraphUnavailable, match="no right to call"):
        await poor.create_client("/add", ADD)
    with pytest.raises(GraphUnavailable, match="no right to offer"):
        await poor.create_service("/add", ADD, lambda _: None)  # type: ignore[arg-type,return-value]
    publisher = await near.create_publisher("/closed", STRING)
    answer = poor.node.rpc.ask(near.node.gateway, {"op": "key", "of": publisher.advert.endpoint, "for": []}, 5)
    with pytest.raises(Exception, match="may not read /closed"):
        await answer
    history = {"op": "history", "of": publisher.advert.endpoint, "after": 0, "upto": None}
    with pytest.raises(Exception, match="has no key of /closed"):
        await poor.node.rpc.ask(near.node.gateway, history, 5)
    assert Refusal.NO_RIGHT in refusals(near)
    inbox = Inbox()
    await poor.create_subscription("/open", STRING, QoS(), inbox)
    allowed = await near.create_publisher("/open", STRING)
    await until(lambda: allowed.subscribers)
    allowed.publish(text("x"))
    await inbox.wait(1)


async def test_rights_of_a_publisher(site: Site) -> None:
    """What is offered may be kept for members of certain names, whatever their certificates say."""
    near = await site.join(readers=("friend*",), callers=("friend*",))
    friend, other = await site.join(member("friend")), await site.join(member("other"))
    inbox, none = Inbox(), Inbox()

    async def answer(request: Request) -> bytes:
        return request.payload[:12]

    await friend.create_subscription("/a", STRING, QoS(), inbox)
    await other.create_subscription("/a", STRING, QoS(), none)
    publisher = await near.create_publisher("/a", STRING)
    await near.create_service("/add", ADD, answer)
    await until(lambda: publisher.subscribers == 1 and other.node.denials)
    publisher.publish(text("x"))
    await inbox.wait(1)
    assert not none.samples
    payload = b"\0\1\0\0" + bytes(16)
    for graph in (friend, other):
        client = await graph.create_client("/add", ADD)
        assert await client.wait_available(PATIENCE_S)
        if graph is friend:
            await client.call(Request(payload))
        else:
            with pytest.raises(CallFailed, match="may not call /add"):
                await client.call(Request(payload))


async def test_guessing(site: Site) -> None:
    """Who knows a topic and its type but not the fleet's secret cannot tell its global name."""
    near = await site.join()
    publisher = await near.create_publisher("/camera", STRING)
    for secret in (b"", bytes(32), fleet("strangers").name_secret):
        assert global_name(secret, "topic", "/camera", STRING) != publisher.advert.global_name


async def test_losing_the_right(site: Site) -> None:
    """A member that is revoked gets nothing more within a minute; the others go on with new keys."""
    near, keeps, loses = await site.join(), await site.join(), await site.join(member("loser"))
    boxes = [Inbox(), Inbox()]
    for graph, box in zip((keeps, loses), boxes, strict=True):
        await graph.create_subscription("/a", STRING, QoS(), box)
    publisher = await near.create_publisher("/a", STRING)
    await until(lambda: publisher.subscribers == 2)
    publisher.publish(text("1"))
    for box in boxes:
        await box.wait(1)
    epoch = publisher.source.grant(keeps.node.identity.certificate)["g"]
    fleet().revoke(loses.node.identity.name)
    near.node._take_crl(fleet().crl_der())
    await until(lambda: publisher.subscribers == 1)
    assert publisher.source.grant(keeps.node.identity.certificate)["g"] != epoch
    publisher.publish(text("2"))
    await boxes[0].wait(2, 20)
    assert len(boxes[1].samples) == 1
    await until(lambda: not keeps.node._good(loses.node.identity.certificate))
