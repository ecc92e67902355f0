"""Turns for TLS handshakes."""

from __future__ import annotations

import asyncio

from ropeway.listener.handshake_turns import HandshakeTurns
from tests.support.until import until


class Peers:
    """Tasks that have a turn until they are told to end."""

    def __init__(self, turns: HandshakeTurns) -> None:
        self.turns = turns
        self.began: list[int] = []
        self.done = asyncio.Event()

    async def shake(self, number: int) -> None:
        async with self.turns.turn():
            self.began.append(number)
            await self.done.wait()


async def test_in_their_order() -> None:
    """So many are under way, and the others have their turns in the order in which they came."""
    peers = Peers(HandshakeTurns(limit=2, turn_s=60.0))
    tasks = [asyncio.create_task(peers.shake(number)) for number in range(6)]
    await until(lambda: len(peers.began) == 2)
    peers.done.set()
    await asyncio.gather(*tasks)
    assert peers.began == [0, 1, 2, 3, 4, 5]
    assert peers.turns.given_up == 0


async def test_long_ones_are_given_up() -> None:
    """One that takes long ends once another waits, and not before."""
    peers = Peers(HandshakeTurns(limit=1, turn_s=0.0))
    slow = asyncio.create_task(peers.shake(0))
    await until(lambda: peers.began == [0])
    for _ in range(10):
        await asyncio.sleep(0)
    assert not slow.done()
    other = asyncio.create_task(peers.shake(1))
    await until(lambda: peers.began == [0, 1])
    assert slow.cancelled()
    assert peers.turns.given_up == 1
    peers.done.set()
    await other


async def test_all_are_long() -> None:
    """Where all take long, each ends in its turn, until nobody waits any more."""
    peers = Peers(HandshakeTurns(limit=1, turn_s=0.0))
    tasks = [asyncio.create_task(peers.shake(number)) for number in range(5)]
    await until(lambda: len(peers.began) == 5)
    assert peers.turns.given_up == 4
    peers.done.set()
    await asyncio.wait(tasks)
    assert [task.cancelled() for task in tasks] == [True] * 4 + [False]


async def test_who_leaves_while_it_waits() -> None:
    """One that is cancelled while it waits takes nobody's turn."""
    peers = Peers(HandshakeTurns(limit=1, turn_s=60.0))
    first, second, third = (asyncio.create_task(peers.shake(number)) for number in range(3))
    await until(lambda: peers.began == [0])
    second.cancel()
    peers.done.set()
    await asyncio.gather(first, third)
    assert peers.began == [0, 2]
