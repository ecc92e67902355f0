"""A member that was revoked learns nothing new, by whatever way it links, and is told why."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from pathlib import Path

import pytest

from ropeway.errors import ProviderLost, SealError
from ropeway.networks.overlay.announcement import NoteKey, note_key_id
from ropeway.networks.overlay.crypto.channel import Initiator
from ropeway.networks.overlay.crypto.identity import Identity
from ropeway.networks.overlay.fabric import Fabric
from ropeway.networks.overlay.fleet import Fleet
from ropeway.networks.overlay.graph import OverlayGraph
from ropeway.networks.overlay.node import OverlayNode
from ropeway.networks.overlay.refusal import Refusal
from ropeway.networks.overlay.router import Router, push_crl
from ropeway.networks.overlay.zenoh_config import gateway_config, gateway_id
from ropeway.qos import QoS
from tests.support.inbox import Inbox
from tests.support.messages import STRING
from tests.support.messages import sample as text
from tests.support.ports import free_endpoint
from tests.support.until import until


class Place:
    """A fleet of its own, with a router and members that listen for direct links."""

    def __init__(self, stack: AsyncExitStack, directory: Path) -> None:
        self.stack = stack
        self.fleet = Fleet.create("acme", directory / "acme")
        self.endpoint = free_endpoint()
        self.operator = self.fleet.issue("operator")

    async def start(self) -> None:
        self.router = Router(self.fleet.issue("router", role="router"), listen=[self.endpoint], look_s=0.2)
        await self.stack.enter_async_context(self.router)

    async def join(self, name: str, *, listen: str | None = None) -> OverlayGraph:
        node = OverlayNode(self.fleet.issue(name), routers=[self.endpoint], listen=(listen,) if listen else ())
        graph = OverlayGraph(node)
        await graph.open()
        self.stack.push_async_callback(graph.close)
        return graph

    async def revoke(self, name: str, *graphs: OverlayGraph) -> None:
        """Revoke a member; the others, the router included, have acted on it when this returns."""
        self.fleet.revoke(name)
        await push_crl(self.operator, self.fleet.crl_der(), routers=[self.endpoint])
        await until(lambda: name in self.router.status()["denied"])
        for graph in graphs:
            await until(lambda: name in graph.node.trust.denied, 30)  # noqa: B023
            if graph.node.listen:
                await until(lambda: name in graph.node.links.denied and graph.node.fabric.links(), 30)  # noqa: B023


@pytest.fixture
async def place(tmp_path: Path) -> AsyncIterator[Place]:
    async with AsyncExitStack() as stack:
        made = Place(stack, tmp_path)
        await made.start()
        yield made


class Spy:
    """A member that does not care whether it was revoked; it hears all that comes over its link."""

    def __init__(self, identity: Identity, where: str) -> None:
        self.id = gateway_id()
        self.fabric = Fabric(gateway_config(identity, gateway=self.id, connect=[where], listen=()), self.id)
        self.heard: list[str] = []

    async def open(self, stack: AsyncExitStack) -> None:
        await self.fabric.open()
        stack.push_async_callback(self.fabric.close)
        for part in "adghmx":
            self.fabric.hear(f"rw/{part}/**", lambda key, _: self.heard.append(key))
        self.fabric.watch("rw/l/*", lambda key, _: self.heard.append(key))
        self.fabric.hear("rw/crl", lambda key, _: None)


async def test_by_no_way(place: Place) -> None:
    """Neither over the router nor over a direct link does a revoked member hear who is there and what each has."""
    listens = free_endpoint()
    alice, carol = await place.join("alice", listen=listens), await place.join("carol")
    bob = place.fleet.issue("bob")
    inbox = Inbox()
    await carol.create_subscription("/before", STRING, QoS(), inbox)
    publisher = await alice.create_publisher("/before", STRING)
    await until(lambda: publisher.subscribers)
    await place.revoke("bob", alice, carol)
    spies = [Spy(bob, place.endpoint), Spy(bob, listens)]
    for spy in spies:
        await spy.open(place.stack)
    await alice.create_publisher("/vault/door", STRING)
    await until(lambda: "/vault/door" in carol.topics())
    await until(lambda: publisher.subscribers)
    publisher.publish(text("goes on"))
    await inbox.wait(1, 30)
    gateway = alice.node.gateway
    for spy in spies:
        assert await spy.fabric.ask(f"rw/m/{gateway.hex()}", b"", 1.0) == []
        hello = b"\x01" + Initiator(bob, gateway).hello
        assert await spy.fabric.ask(f"rw/g/{gateway.hex()}", hello, 1.0) == []
        assert spy.heard == []


async def test_a_way_that_knows_nothing_of_it(place: Place) -> None:
    """Where a revoked member hears notes all the same, it cannot read them, gets no list and no channel."""
    alice, carol = await place.join("alice"), await place.join("carol")
    bob = place.fleet.issue("bob")
    seen: list[tuple[str, bytes]] = []
    for key in ("rw/h/*", "rw/a/*"):
        carol.node.fabric.hear(key, lambda key, raw: seen.append((key, raw)))  # carol gives bob all she hears
    await place.revoke("bob", alice, carol)
    seen.clear()
    await alice.create_publisher("/vault/door", STRING)
    await until(lambda: "/vault/door" in carol.topics())
    await alice.create_publisher("/vault/window", STRING)  # links stand again: this is told as a change
    await until(lambda: {key[:4] for key, _ in seen} == {"rw/h", "rw/a"})
    assert bob.name_secret is not None
    fleets = NoteKey(bob.name_secret)
    for key, raw in seen:
        assert note_key_id(raw)
        gateway = bytes.fromhex(key.rsplit("/", 1)[1])
        for kind in ("heartbeat", "delta"):
            with pytest.raises(SealError):
                fleets.open(raw, gateway, kind, {}, lambda _: bob.certificate)
    answers = await carol.node.fabric.ask(f"rw/m/{alice.node.gateway.hex()}", b"", 2.0)
    assert answers == [b"rw-list2"]
    spy = OverlayNode(bob, routers=[place.endpoint], listen=())
    spy.rpc._fabric = carol.node.fabric  # as if nobody kept its link shut
    with pytest.raises(ProviderLost, match="was revoked"):
        await spy.rpc.ask(alice.node.gateway, {"op": "list"}, 3.0)
    assert ("a gateway that greets", Refusal.REVOKED) in alice.node.refusals


async def test_keys_turn_over_with_each_revocation(place: Place) -> None:
    """Each revocation gives every gateway a new key for its notes, and those in good standing read on."""
    alice, carol = await place.join("alice"), await place.join("carol")
    await place.join("bob")
    await place.join("dave")
    await until(lambda: len(alice.node.membership.gateways()) == 3)
    keys = {alice.node.membership._notes.id}
    assert keys == {b""}
    for name, topic in (("bob", "/one"), ("dave", "/two")):
        await place.revoke(name, alice, carol)
        keys.add(alice.node.membership._notes.id)
        await alice.create_publisher(topic, STRING)
        await until(lambda: topic in carol.topics(), 30)  # noqa: B023
    assert len(keys) == 3
    late = await place.join("erin")
    await until(lambda: {"/one", "/two"} <= late.topics().keys())


async def test_who_is_revoked_is_told(place: Place, caplog: pytest.LogCaptureFixture) -> None:
    """A member that was revoked says so in its log and its status, whether it ran or starts afterwards."""
    alice, bob = await place.join("alice"), await place.join("bob")
    await until(lambda: alice.node.membership.gateways())
    await place.revoke("bob", alice)
    await until(lambda: bob.node.trouble)
    assert "was revoked" in bob.node.status()["trouble"]
    assert "keys issue" in bob.node.status()["trouble"]
    assert sum("our own certificate is no longer valid" in message for message in caplog.messages) == 1
    again = OverlayGraph(OverlayNode(bob.node.identity, routers=[place.endpoint], listen=()))
    await again.open()
    place.stack.push_async_callback(again.close)
    await until(lambda: again.node.trouble)
    assert not alice.node.trouble


async def test_a_stream_goes_on(place: Place) -> None:
    """A reliable stream between others loses nothing when a revocation makes their links anew."""
    alice, carol = await place.join("alice", listen=free_endpoint()), await place.join("carol")
    inbox = Inbox()
    await carol.create_subscription("/x", STRING, QoS(depth=1000), inbox)
    publisher = await alice.create_publisher("/x", STRING, QoS(depth=1000))
    await until(lambda: publisher.subscribers)
    place.fleet.issue("bob")
    sent = 0

    async def publish() -> None:
        nonlocal sent
        while True:
            sent += 1
            publisher.publish(text(str(sent)))
            await asyncio.sleep(0.02)

    task = asyncio.create_task(publish())
    await place.revoke("bob", alice, carol)
    began = sent
    await until(lambda: sent > began + 20)
    task.cancel()
    await inbox.wait(sent, 30)
    assert [sample.payload for sample in inbox.samples] == [text(str(n)).payload for n in range(1, sent + 1)]
