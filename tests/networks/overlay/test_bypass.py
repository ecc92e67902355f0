"""The bypass: a second session by which small messages have copies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from ropeway.networks.overlay.gateway_path import Path
from ropeway.networks.overlay.graph import OverlayGraph
from ropeway.networks.overlay.refusal import Refusal
from ropeway.qos import SENSOR_DATA, QoS
from tests.networks.overlay.conftest import Site
from tests.networks.overlay.conftest import site as site
from tests.support.inbox import Inbox
from tests.support.messages import STRING
from tests.support.messages import sample as text
from tests.support.until import until

Packet = tuple[int, Any, bytes, bytes | None]


@pytest.fixture
def distance(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every path is long and carries big messages."""
    monkeypatch.setattr(Path, "far", property(lambda _: True))
    monkeypatch.setattr(Path, "copies", lambda *_: True)


def refusals(graph: OverlayGraph) -> set[Refusal]:
    return {reason for _, reason in graph.node.refusals}


def held_up(graph: OverlayGraph, monkeypatch: pytest.MonkeyPatch) -> tuple[list[Packet], Callable[[], None]]:
    """Hold up what a member sends over its links; return what is held, and what lets it go."""
    held: list[Packet] = []
    put = graph.node.fabric.put

    def hold(lane: int, key: Any, payload: bytes, mark: bytes | None = None, *, copies: bool = False) -> None:
        held.append((lane, key, payload, mark))

    monkeypatch.setattr(graph.node.fabric, "put", hold)

    def let_go() -> None:
        for packet in held:
            put(*packet)

    return held, let_go


async def test_opened_when_wanted(site: Site, distance: None) -> None:
    """The second session is there once small messages go beside big ones, and each arrives once and in order."""
    near, far = await site.join(), await site.join()
    assert not near.node.status()["bypass"]
    inbox = Inbox()
    await far.create_subscription("/cmd", STRING, QoS(depth=1000), inbox)
    publisher = await near.create_publisher("/cmd", STRING, QoS(depth=1000))
    await until(lambda: publisher.subscribers and near.node.receipts.paths)
    sent = 0

    async def some() -> None:
        nonlocal sent
        for _ in range(100):
            publisher.publish(text(str(sent)))
            sent += 1
        await inbox.wait(sent)

    await some()
    await until(lambda: near.node.status()["bypass"])
    connection = near.node.bypass.connection
    await some()
    await some()
    assert near.node.bypass.connection == connection
    assert [sample.payload for sample in inbox.samples] == [text(str(i)).payload for i in range(300)]
    assert not far.node.status()["bypass"]
    assert not refusals(far)


@pytest.mark.parametrize("qos", [QoS(depth=100), SENSOR_DATA])
async def test_links_that_are_held_up(site: Site, distance: None, monkeypatch: pytest.MonkeyPatch, qos: QoS) -> None:
    """Small messages arrive by the bypass while the links are held up; what comes by those later is no replay."""
    near, far = await site.join(), await site.join()
    inbox = Inbox()
    await far.create_subscription("/cmd", STRING, qos, inbox)
    publisher = await near.create_publisher("/cmd", STRING, qos)
    await until(lambda: publisher.subscribers and near.node.receipts.paths)
    near.node.bypass.want()
    await until(lambda: near.node.bypass.connection)
    held, let_go = held_up(near, monkeypatch)
    for number in range(3):
        publisher.publish(text(str(number)))
        await inbox.wait(number + 1)
    let_go()
    monkeypatch.undo()
    publisher.publish(text("3"))
    await inbox.wait(4)
    assert [sample.payload for sample in inbox.samples] == [text(str(i)).payload for i in range(4)]
    assert not refusals(far)
    near.node.fabric.put(*held[0])
    await until(lambda: Refusal.REPLAYED in refusals(far))


async def test_copies_that_come_late(site: Site) -> None:
    """A copy of what has come already, of a name that nobody reads, or of nothing that we know, changes nothing."""
    near, far = await site.join(), await site.join()
    inbox = Inbox()
    await far.create_subscription("/cmd", STRING, QoS(), inbox)
    publisher = await near.create_publisher("/cmd", STRING, QoS())
    await until(lambda: publisher.subscribers)
    seen: list[bytes] = []
    end = site.router._fabric.hear("rw/d/**", lambda _, raw: seen.append(raw)) if site.router._fabric else None
    publisher.publish(text("0"))
    await inbox.wait(1)
    await until(lambda: seen)
    assert end is not None
    end()
    about = publisher.advert.global_name + publisher.advert.endpoint
    near.node.bypass.want()
    await until(lambda: near.node.bypass.connection)
    for beside in (about, bytes(48), b"", publisher.advert.global_name + bytes(16)):
        near.node.bypass.put(4, beside, far.node.gateway, seen[0])
    publisher.publish(text("1"))
    await inbox.wait(2)
    assert not refusals(far)
    near.node.bypass.put(4, about, far.node.gateway, seen[0][:-1] + b"\0")
    near.node.bypass.put(4, about, far.node.gateway, b"\0" * 100)
    await until(lambda: Refusal.MALFORMED in refusals(far))
    publisher.publish(text("2"))
    await inbox.wait(3)


async def test_a_router_that_leaves(site: Site, distance: None) -> None:
    """A bypass that has lost its router, or is made anew, is used again once it is back."""
    near = await site.join()
    bypass = near.node.bypass
    bypass.want()
    await until(lambda: bypass.connection)
    first = bypass.connection
    bypass.want()
    bypass.renew()
    await until(lambda: bypass.connection > first)
    second = bypass.connection
    await site.router._make_links()
    bypass.want()
    await until(lambda: bypass.connection > second, 40)
