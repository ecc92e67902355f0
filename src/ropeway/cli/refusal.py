"""Ends a verb as soon as a peer refuses what the verb needs: nothing would ever come, and silence says nothing."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from ropeway import aio
from ropeway.cli.console import complain
from ropeway.errors import Refused
from ropeway.graph.base import Graph, Publisher, Subscription
from ropeway.graph.peer_answer import Answering
from ropeway.tasks import Interruptible

__all__ = ["taken", "unless_refused"]

_ANSWER_S: Final = 5.0  # a gateway answers within the link's round trip


@contextmanager
def unless_refused(graph: Graph, part: Publisher | Subscription) -> Iterator[None]:
    """Raise ``Refused`` in the block once the peer refuses the part, or lets us in no more."""
    with Interruptible() as block:

        def answered(reason: str) -> None:
            if reason:
                block.interrupt(Refused(graph.name, part.topic, reason))

        for asked in (graph, part):
            if isinstance(asked, Answering):
                asked.on_answer(answered)
        yield


async def taken(graph: Graph, part: Publisher) -> None:
    """Wait until the peer takes the part, in ``unless_refused``: what is sent sooner may go nowhere."""
    if not isinstance(part, Answering):
        return
    answered = asyncio.Event()
    part.on_answer(lambda _: answered.set())
    try:
        async with aio.timeout(_ANSWER_S):
            await answered.wait()
    except TimeoutError:
        complain(f"{graph.name} has not said within {_ANSWER_S:g} s whether it takes {part.topic}")
