"""Says what a verb waits for once that takes longer than people expect: silence looks like a fault."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Final

from ropeway import aio
from ropeway.cli.console import complain
from ropeway.gateway.config.suggest import did_you_mean
from ropeway.graph.base import EndpointInfo, Graph, TopicInfo
from ropeway.graph.calls import ActionClient, Client
from ropeway.qos import QoS, unmet
from ropeway.tasks import end

__all__ = ["Patience", "patiently", "served_within", "why_silent"]

_LEAST_S: Final = 0.001  # of a call whose time is over: it says why
_PATIENCE_S: Final = 2.0  # what is there has answered by then, also over a slow link


class Patience:
    """Tells the user what is being waited for. ``over`` ends the waiting, while whoever waited goes on with something
    else.
    """

    def __init__(self, waiting_for: Callable[[], str]) -> None:
        self._waiting_for = waiting_for
        self._over = asyncio.Event()

    def over(self) -> None:
        """Stop telling: the awaited thing has come."""
        self._over.set()

    async def watch(self) -> None:
        """Say what is waited for after a while, and again whenever that is something else."""
        said = ""
        while True:
            try:
                async with aio.timeout(_PATIENCE_S):
                    await self._over.wait()
                return
            except TimeoutError:
                text = self._waiting_for()
                if text != said:
                    complain(text)
                said = text


@asynccontextmanager
async def patiently(waiting_for: Callable[[], str]) -> AsyncIterator[Patience]:
    """Say what the block waits for while it does; ``waiting_for`` gives the sentence as things stand then."""
    patience = Patience(waiting_for)
    watching = asyncio.create_task(patience.watch(), name="patience")
    try:
        yield patience
    finally:
        await end(watching)


async def served_within(client: Client | ActionClient, timeout_s: float) -> float:
    """Wait until somebody serves what ``client`` uses; return what is left of the time for the call itself."""
    loop = asyncio.get_running_loop()
    deadline = loop.time() + timeout_s
    await client.wait_available(timeout_s)
    return max(deadline - loop.time(), _LEAST_S)


def why_silent(graph: Graph, topic: str, type: str, qos: QoS | None) -> str:
    """Return the sentence that says why no message of a topic comes, as far as the graph shows it."""
    topics = graph.topics()
    waiting = f"waiting for a message on {topic}"
    offers = [end for end in _published(topics.get(topic)) if not end.local]
    if not offers:
        others = [name for name, info in topics.items() if _published(info) and name != topic]
        near = did_you_mean(topic, others)
        return f"{waiting}: nobody publishes it on {graph.name}{near}"
    types = sorted({end.type for end in offers if end.type})
    if types and type not in types:
        return f"{waiting}: it is published as {', '.join(types)}, and {type} was asked for"
    misfits = {policy for end in offers for policy in unmet(end.qos, qos)}
    if misfits and all(unmet(end.qos, qos) for end in offers):
        policies = ", ".join(sorted(misfits)).upper()
        return f"{waiting}: its publishers offer incompatible QoS ({policies}); leave out the --qos options to adopt it"
    count = f"{len(offers)} publisher{'s' if len(offers) > 1 else ''}"
    return f"{waiting}: {count} on {graph.name}, none of which has sent anything"


def _published(info: TopicInfo | None) -> tuple[EndpointInfo, ...]:
    return info.publishers if info is not None else ()
