"""ropeway.networks.zenoh.sender: messages go to Zenoh without holding up the loop."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator

import pytest

from ropeway.limits import ZENOH_UNSENT_BYTES
from ropeway.networks.zenoh.sender import Sender, ZenohLane
from tests.support.until import until

_LARGE = 1 << 20


@pytest.fixture
async def sender() -> AsyncIterator[Sender]:
    """A sender of its own."""
    made = Sender("zenoh")
    yield made
    await made.close()


class Gate:
    """What holds up whoever goes through it until it is opened."""

    def __init__(self) -> None:
        self.open = threading.Event()
        self.reached = threading.Event()

    def __call__(self) -> None:
        self.reached.set()
        assert self.open.wait(60)


async def test_small_at_once(sender: Sender) -> None:
    """A small message is handed over at once, in the loop's thread."""
    threads: list[int] = []
    sender.send(ZenohLane(lambda _: None), lambda: threads.append(threading.get_ident()), 10)
    assert threads == [threading.get_ident()]


async def test_large_in_thread(sender: Sender) -> None:
    """A large message goes through the thread, and small ones after it stay behind it."""
    gate, sent = Gate(), list[int]()
    lane = ZenohLane(lambda _: None)
    sender.send(lane, gate, _LARGE)
    for number in range(5):
        sender.send(lane, lambda number=number: sent.append(number), 10)
    assert sent == []
    gate.open.set()
    await until(lambda: sent == list(range(5)))


async def test_depth(sender: Sender) -> None:
    """Of a lane with a depth, the newest wait, and those that had to go are told."""
    gate, sent, lost = Gate(), list[int](), list[int]()
    lane = ZenohLane(lost.append, depth=2)
    sender.send(lane, gate, _LARGE)
    await asyncio.to_thread(gate.reached.wait, 60)
    for number in range(5):
        sender.send(lane, lambda number=number: sent.append(number), 10)
    gate.open.set()
    await until(lambda: sent == [3, 4])
    assert sum(lost) == 3


async def test_bytes(sender: Sender) -> None:
    """However much is sent while a link takes nothing, no more waits than the limit, and the oldest goes."""
    gate, lost = Gate(), list[int]()
    lane = ZenohLane(lost.append)
    sender.send(lane, gate, _LARGE)
    await asyncio.to_thread(gate.reached.wait, 60)
    for _ in range(2 * ZENOH_UNSENT_BYTES // _LARGE):
        sender.send(lane, lambda: None, _LARGE)
        assert lane.bytes <= ZENOH_UNSENT_BYTES
    assert sum(lost) == ZENOH_UNSENT_BYTES // _LARGE
    gate.open.set()
    await sender.finish(lane)
    assert (lane.bytes, len(lane.waiting)) == (0, 0)


async def test_lanes_in_turn(sender: Sender) -> None:
    """Lanes that wait are sent from in turn, so that one that has much holds up none that has little."""
    gate, sent = Gate(), list[str]()
    sender.send(ZenohLane(lambda _: None), gate, _LARGE)
    await asyncio.to_thread(gate.reached.wait, 60)
    much, little = ZenohLane(lambda _: None), ZenohLane(lambda _: None)
    for _ in range(4):
        sender.send(much, lambda: sent.append("much"), _LARGE)
    sender.send(little, lambda: sent.append("little"), _LARGE)
    gate.open.set()
    await until(lambda: len(sent) == 5)
    assert sent.index("little") == 1


async def test_failure(sender: Sender, caplog: pytest.LogCaptureFixture) -> None:
    """A message that Zenoh refuses is told as lost, and the next one is sent."""
    lost, sent = list[int](), list[int]()
    lane = ZenohLane(lost.append)

    def fail() -> None:
        raise RuntimeError("closed")

    for size in (10, _LARGE):
        sender.send(lane, fail, size)
        sender.send(lane, lambda: sent.append(1), size)
    await until(lambda: lost == [1, 1] and sent == [1, 1])
    assert "a message was not sent" in caplog.text


async def test_finish(sender: Sender) -> None:
    """A lane that is finished has sent what waited."""
    sent: list[int] = []
    lane = ZenohLane(lambda _: None)
    for number in range(20):
        sender.send(lane, lambda number=number: sent.append(number), _LARGE)
    await sender.finish(lane)
    assert sent == list(range(20))
