"""ropeway.networks.rosbridge.server.lingering."""

from __future__ import annotations

import asyncio

import pytest

from ropeway.limits import LINGERING_CLIENTS
from ropeway.networks.rosbridge.server.lingering import Lingering
from tests.support.until import until

pytestmark = pytest.mark.jumping


class Left:
    """A client that left behind some topics."""

    def __init__(self, *topics: str) -> None:
        self.topics = set(topics)

    @property
    def lingers(self) -> bool:
        return bool(self.topics)

    async def withdraw(self, name: str | None = None) -> None:
        await asyncio.sleep(0)
        self.topics = set() if name is None else self.topics - {name}


async def test_withdraws_after_a_while() -> None:
    """What a client left behind is withdrawn when its time is over."""
    lingering = Lingering(0.01)
    first, second = Left("/a"), Left("/b")
    lingering.add(first)
    lingering.add(second)
    await until(lambda: not len(lingering))
    assert not first.topics
    assert not second.topics
    await lingering.close()


async def test_advertised_again_in_the_same_turn() -> None:
    """A topic that is published again before anything else happens leaves nothing of the client behind."""
    lingering = Lingering(100)
    for _ in range(3 * LINGERING_CLIENTS):
        lingering.add(Left("/a"))
        await lingering.advertised("/a")
    assert not len(lingering)
    await lingering.close()


async def test_other_topics_stay() -> None:
    """A topic that is published again is withdrawn alone."""
    lingering = Lingering(100)
    left = Left("/a", "/b")
    lingering.add(left)
    await lingering.advertised("/a")
    assert left.topics == {"/b"}
    assert len(lingering) == 1
    await lingering.close()
    assert not left.topics


async def test_too_many() -> None:
    """Of too many clients that linger, those who left first are withdrawn at once."""
    lingering = Lingering(100)
    clients = [Left(f"/t{i}") for i in range(LINGERING_CLIENTS + 10)]
    for client in clients:
        lingering.add(client)
    await until(lambda: len(lingering) == LINGERING_CLIENTS)
    assert [bool(client.topics) for client in clients] == [False] * 10 + [True] * LINGERING_CLIENTS
    await lingering.close()
    assert not any(client.topics for client in clients)


async def test_a_client_that_cannot_be_withdrawn(caplog: pytest.LogCaptureFixture) -> None:
    """A failure with one client is logged, and the others are withdrawn."""

    class Stuck(Left):
        async def withdraw(self, name: str | None = None) -> None:
            raise RuntimeError("no")

    lingering = Lingering(0.0)
    lingering.add(Stuck("/a"))
    lingering.add(left := Left("/b"))
    await until(lambda: not len(lingering))
    assert not left.topics
    assert "could not be withdrawn" in caplog.text
    await lingering.close()
