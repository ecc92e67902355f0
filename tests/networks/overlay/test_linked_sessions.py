"""Two sessions with one router as one data plane."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack
from functools import partial
from typing import Any

import pytest

from ropeway.group.link_choice import LinkChoice
from ropeway.networks.overlay.asked import Asked
from ropeway.networks.overlay.fabric import Fabric
from ropeway.networks.overlay.linked_sessions import LinkedSessions
from ropeway.networks.overlay.packet_mark import Mark
from ropeway.networks.overlay.zenoh_config import client_config, gateway_config, gateway_id
from tests.networks.overlay.conftest import Site
from tests.networks.overlay.conftest import site as site
from tests.networks.overlay.fleet import member
from tests.support.until import PATIENCE_S, until

KEY = "rw/d/test"


class Pair:
    """A member with links ``a`` and ``b``, and another one with one link."""

    def __init__(self, site: Site) -> None:
        self._site = site
        self.far = self._gateway(member())
        self.a = self.b = self.far

    def _gateway(self, identity: Any) -> Fabric:
        id = gateway_id()
        where = [self._site.endpoint]
        return Fabric(gateway_config(identity, gateway=id, connect=where, listen=()), id, routers=where)

    async def open(
        self, stack: AsyncExitStack, *, duplicate: bool, on_doubt: Callable[[], None] = lambda: None
    ) -> LinkedSessions:
        """Return the links of the first, both of them up and known."""
        identity, where = member(), [self._site.endpoint]
        self.a = self._gateway(identity)
        config = client_config(identity, id=gateway_id(), connect=where)
        self.b = Fabric(config, self.a.gateway, routers=where, way=1)
        several = LinkedSessions({"a": self.a, "b": self.b}, duplicate=duplicate, on_doubt=on_doubt)
        for plane in (self.far, several):
            await plane.open()
            stack.push_async_callback(plane.close)
        assert await several.linked(PATIENCE_S)
        await until(lambda: all(link["rtt_ms"] for link in several.status()["members"].values()))
        return several

    async def put(self, payload: bytes) -> None:
        await asyncio.to_thread(self.far.put, 4, KEY, payload, Mark(4, 1).to_bytes())


@pytest.fixture
async def stack() -> AsyncIterator[AsyncExitStack]:
    async with AsyncExitStack() as made:
        yield made


@pytest.fixture
def pair(site: Site) -> Pair:
    return Pair(site)


class Told(LinkChoice):
    """Chooses the link that it is told, and doubts none."""

    def sent(self, name: str, now_s: float) -> None:
        pass

    def step(self, now_s: float) -> str:
        return self.best


def use(several: LinkedSessions, name: str) -> None:
    """Have this link be the one in use from now on, whatever probes say."""
    if not isinstance(several.choice, Told):
        several.choice = Told(several._fabrics)
        for other in several._fabrics:
            several.choice.up(other, True)
    several.choice.best = name
    several._use(name, "", time.monotonic())


async def test_copies_of_data(pair: Pair, stack: AsyncExitStack) -> None:
    """With duplicates what is subscribed to comes by each link, and what is put goes by each, with its number."""
    several = await pair.open(stack, duplicate=True)
    came: list[int] = []
    several.subscribe(KEY, lambda key, payload, mark, way: came.append(way))
    heard: list[Mark | None] = []
    pair.far.subscribe("rw/d/back", lambda key, payload, mark, way: heard.append(Mark.read(bytes(mark or b""))))

    async def both() -> bool:
        await pair.put(b"1")
        await asyncio.to_thread(several.put, 4, "rw/d/back", b"2", Mark(4, 7).to_bytes(), copies=True)
        return {0, 1} <= set(came) and {0, 1} <= {mark.way for mark in heard if mark is not None}

    while not await both():  # a subscription takes a moment to be known
        pass
    assert {(mark.lane, mark.number) for mark in heard if mark is not None} == {(4, 7)}


async def test_who_tells_no_copies(pair: Pair, stack: AsyncExitStack) -> None:
    """For readers that take copies for replays everything goes by one link, and as from one link."""
    several = await pair.open(stack, duplicate=True)
    heard: list[bytes] = []
    pair.far.subscribe("rw/d/back", lambda key, payload, mark, way: heard.append(bytes(mark or b"")))
    sent = 0
    while not heard:
        sent += 1
        await asyncio.to_thread(several.put, 4, "rw/d/back", b"2", Mark(4, sent).to_bytes())
    await asyncio.to_thread(several.put, 4, "rw/d/back", b"2", Mark(4, sent + 1).to_bytes())
    await until(lambda: Mark(4, sent + 1).to_bytes() in heard)
    assert len(heard) == len(set(heard))


async def test_notes_come_once(pair: Pair, stack: AsyncExitStack) -> None:
    """A note that comes by both links is told once."""
    several = await pair.open(stack, duplicate=True)
    heard: list[bytes] = []
    several.hear("rw/h/test", lambda key, payload: heard.append(payload))
    number = 0
    while several._copies.count < 3:
        number += 1
        pair.far.tell("rw/h/test", b"%d" % number)
        await asyncio.sleep(0)
    await until(lambda: heard and heard[-1] == b"%d" % number)
    assert len(heard) == len(set(heard))


async def test_a_query_by_both_links(pair: Pair, stack: AsyncExitStack) -> None:
    """A query that comes by both links is told once, and answered."""
    several = await pair.open(stack, duplicate=True)
    told: list[bytes] = []

    def take(asked: Asked) -> None:
        told.append(asked.payload)
        asked.answer(b"answer")

    several.serve("rw/g/test", take)
    number = 0
    while several._copies.count < 3:
        number += 1
        found = await pair.far.ask("rw/g/test", b"%d" % number, PATIENCE_S, first=True)
        assert not found or found[0] == b"answer"
    assert len(told) == len(set(told))


async def test_alive_by_one_link(pair: Pair, stack: AsyncExitStack) -> None:
    """A member is there while one of its links is, and sees others while one link does."""
    several = await pair.open(stack, duplicate=False)
    alive: list[bool] = []
    seen: list[bool] = []
    pair.far.watch("rw/l/test", lambda key, there: alive.append(there))
    several.watch("rw/l/far", lambda key, there: seen.append(there))
    several.token("rw/l/test")
    pair.far.token("rw/l/far")
    await until(lambda: alive and seen)
    await pair.b.close()
    again = pair.far.token("rw/l/third")
    third: list[bool] = []
    several.watch("rw/l/third", lambda key, there: third.append(there))
    await until(lambda: third)
    again()
    await until(lambda: len(third) == 2)
    assert alive == [True]
    assert seen == [True]


async def test_a_change(pair: Pair, stack: AsyncExitStack) -> None:
    """With the best link alone, a change loses nothing; the link before is heard for a moment, and then let go."""
    several = await pair.open(stack, duplicate=False)
    came: list[tuple[bytes, int]] = []
    several.subscribe(KEY, lambda key, payload, mark, way: came.append((bytes(payload), way)))
    first = several.using
    use(several, first)
    number = 0

    async def go_on(until_way: int) -> None:
        nonlocal number
        while not came or came[-1][1] != until_way:
            number += 1
            await pair.put(b"%d" % number)

    await go_on({"a": 0, "b": 1}[first])
    began = came[0][0]
    second = "b" if first == "a" else "a"
    use(several, second)
    await go_on({"a": 0, "b": 1}[second])
    await until(lambda: all(first not in declared.on for declared in several._declared if not declared.everywhere))
    await pair.put(b"last")
    await until(lambda: (b"last", {"a": 0, "b": 1}[second]) in came)
    assert [way for payload, way in came if payload == b"last"] == [{"a": 0, "b": 1}[second]]
    numbers = {int(payload) for payload, _ in came if payload != b"last"}
    assert numbers == set(range(int(began), number + 1))


async def test_a_doubt(pair: Pair, stack: AsyncExitStack) -> None:
    """What may be lost on a link in doubt goes again by the other one, in order and once, with its number."""
    doubts: list[str] = []
    several = await pair.open(stack, duplicate=False, on_doubt=lambda: doubts.append(""))
    heard: list[Mark | None] = []
    pair.far.subscribe("rw/d/back", lambda key, payload, mark, way: heard.append(Mark.read(bytes(mark or b""))))
    first = several.using
    use(several, first)
    other, way = ("b", 1) if first == "a" else ("a", 0)

    async def put(number: int) -> None:
        await asyncio.to_thread(several.put, 4, "rw/d/back", b"2", Mark(4, number).to_bytes(), copies=True)

    number = 0
    while not heard:  # a subscription takes a moment to be known
        number += 1
        await put(number)
    doubts.clear()
    await until(lambda: heard[-1] == Mark(4, number, way=1 - way))
    for _ in range(3):  # doubted again and again
        several._use(first, other, time.monotonic())
        several._use(first, "", time.monotonic())
    await until(lambda: Mark(4, number, way=way) in heard)
    assert len(doubts) == 3
    again = [mark.number for mark in heard if mark is not None and mark.way == way]
    assert again == sorted(set(again))


async def test_asking_by_a_link_that_falls_silent(pair: Pair, stack: AsyncExitStack) -> None:
    """Whoever waits for an answer by a link that falls silent may ask again at once, by the other one."""
    several = await pair.open(stack, duplicate=False)
    kept: list[Asked] = []
    pair.far.serve("rw/g/test", kept.append)
    first = several.using
    use(several, first)
    asking = asyncio.create_task(several.ask("rw/g/test", b"", PATIENCE_S))
    while not kept:  # until the way to it is known
        await asyncio.sleep(0.01)
        if asking.done():
            asking = asyncio.create_task(several.ask("rw/g/test", b"", PATIENCE_S))
    several.choice.up(first, False)
    use(several, "b" if first == "a" else "a")
    assert await asking == []
    again = asyncio.create_task(several.ask("rw/g/test", b"", PATIENCE_S, first=True))
    await until(lambda: len(kept) > 1)
    kept[-1].answer(b"answer")
    assert await again == [b"answer"]


async def test_no_router_by_one_link(site: Site, stack: AsyncExitStack) -> None:
    """A link by which no router is reached keeps the others from nothing, and the state says that it is down."""
    identity, where = member(), [site.endpoint]
    id = gateway_id()
    first = Fabric(gateway_config(identity, gateway=id, connect=where, listen=()), id, routers=where)
    nowhere = ["tls/127.0.0.1:1"]
    second = Fabric(client_config(identity, id=gateway_id(), connect=nowhere), id, routers=nowhere, way=1)
    several = LinkedSessions({"a": first, "b": second}, duplicate=True)
    await several.open()
    stack.push_async_callback(several.close)
    assert await several.linked(PATIENCE_S)
    await until(partial(linked, several))
    assert not several.status()["members"]["b"]["up"]
    assert several.using == "a"
    assert several.linked_with(["router.test"]) is first.linked_with(["router.test"])


def linked(several: LinkedSessions) -> bool:
    """Return whether the first link has answered a probe."""
    return several.status()["members"]["a"]["rtt_ms"] is not None
