"""A graph that threads use: what ``ropeway.blocking.open`` gives."""

from __future__ import annotations

import ssl
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from ropeway.api import graph as asynchronous
from ropeway.api.graph import OPEN_TIMEOUT_S, AsyncGraph
from ropeway.api.inbox import QUEUE_BYTES, QUEUE_MESSAGES
from ropeway.api.message import TypedMessage
from ropeway.blocking.calls import (
    BlockingActionClient,
    BlockingActionServer,
    BlockingClient,
    BlockingExecutingGoal,
    BlockingService,
    executed_in_thread,
)
from ropeway.blocking.part import BlockingRoot, opened
from ropeway.blocking.portal import portal
from ropeway.blocking.topics import BlockingPublisher, BlockingSubscription
from ropeway.graph.base import NO_HINTS, Delivery, Undelivered
from ropeway.graph.calls import DEFAULT_TIMEOUT_S
from ropeway.qos import QoS

__all__ = ["BlockingGraph", "open"]


def open(
    url: str,
    *,
    name: str = "",
    types: Iterable[str | Path] = (),
    ssl_context: ssl.SSLContext | None = None,
    headers: Mapping[str, str] | None = None,
    timeout_s: float | None = OPEN_TIMEOUT_S,
) -> BlockingGraph:
    """Open the graph at ``url``: ``with ropeway.blocking.open("dds:0") as graph``; see ``ropeway.open``."""

    async def work() -> AsyncGraph:
        return await asynchronous.open(
            url, name=name, types=types, ssl_context=ssl_context, headers=headers, timeout_s=timeout_s
        )

    return BlockingGraph(opened(work, None))


class BlockingGraph(BlockingRoot[AsyncGraph]):
    """A graph that a program has opened; see ``AsyncGraph``. Safe to use from any thread.

    What waits has a time limit. Functions that the program gives (callbacks, handlers) run in threads, so they may wait
    and may use the graph themselves.
    """

    @property
    def url(self) -> str:
        """Return the URL of the graph."""
        return self._inner.url

    @property
    def drops(self) -> Counter[tuple[str, Undelivered]]:
        """Return how many messages this graph has dropped, by topic and reason."""
        return self._inner.drops

    def publisher(
        self, topic: str, type: str, *, qos: QoS | str | None = None, delivery: Delivery = NO_HINTS
    ) -> BlockingPublisher:
        """Publish ``topic``; see ``AsyncGraph.publisher``."""
        return BlockingPublisher(portal.wait(lambda: self._inner.publisher(topic, type, qos=qos, delivery=delivery)))

    def subscribe(
        self,
        topic: str,
        type: str = "",
        callback: Callable[[TypedMessage], None] | None = None,
        *,
        qos: QoS | str | None = None,
        delivery: Delivery = NO_HINTS,
        queue_messages: int = QUEUE_MESSAGES,
        queue_bytes: int = QUEUE_BYTES,
        timeout_s: float | None = DEFAULT_TIMEOUT_S,
    ) -> BlockingSubscription:
        """Read ``topic``; see ``AsyncGraph.subscribe``. ``callback`` runs in a thread, one message at a time."""
        take = None if callback is None else portal.in_thread(callback)
        return BlockingSubscription(
            portal.wait(
                lambda: self._inner.subscribe(
                    topic,
                    type,
                    take,
                    qos=qos,
                    delivery=delivery,
                    queue_messages=queue_messages,
                    queue_bytes=queue_bytes,
                    timeout_s=timeout_s,
                ),
                timeout_s,
            )
        )

    def client(self, service: str, type: str = "", *, timeout_s: float | None = DEFAULT_TIMEOUT_S) -> BlockingClient:
        """Prepare to call ``service``; see ``AsyncGraph.client``."""
        return BlockingClient(portal.wait(lambda: self._inner.client(service, type, timeout_s=timeout_s), timeout_s))

    def call(
        self, service: str, request: object = None, type: str = "", *, timeout_s: float = DEFAULT_TIMEOUT_S
    ) -> TypedMessage:
        """Call ``service`` once; see ``AsyncGraph.call``."""
        return portal.wait(lambda: self._inner.call(service, request, type, timeout_s=timeout_s), timeout_s)

    def serve(self, service: str, type: str, handler: Callable[[TypedMessage], object]) -> BlockingService:
        """Offer ``service``; see ``AsyncGraph.serve``. ``handler`` runs in a thread for each call."""
        return BlockingService(portal.wait(lambda: self._inner.serve(service, type, portal.in_thread(handler))))

    def action_client(
        self, action: str, type: str = "", *, timeout_s: float | None = DEFAULT_TIMEOUT_S
    ) -> BlockingActionClient:
        """Prepare to use ``action``; see ``AsyncGraph.action_client``."""
        made = portal.wait(lambda: self._inner.action_client(action, type, timeout_s=timeout_s), timeout_s)
        return BlockingActionClient(made)

    def serve_action(
        self,
        action: str,
        type: str,
        execute: Callable[[BlockingExecutingGoal], object],
        *,
        accept: Callable[[TypedMessage], bool] | None = None,
    ) -> BlockingActionServer:
        """Offer ``action``; see ``AsyncGraph.serve_action``. ``execute`` and ``accept`` run in threads."""
        carry_out = executed_in_thread(execute)
        decide = None if accept is None else portal.in_thread(accept)
        return BlockingActionServer(
            portal.wait(lambda: self._inner.serve_action(action, type, carry_out, accept=decide))
        )

    def topics(self) -> dict[str, tuple[str, ...]]:
        """Return the topics that are discovered now, each with its types. Just opened, a graph knows few of them."""
        return portal.call(self._inner.topics)

    def services(self) -> dict[str, tuple[str, ...]]:
        """Return the services that are discovered now, each with its types."""
        return portal.call(self._inner.services)

    def actions(self) -> dict[str, tuple[str, ...]]:
        """Return the actions that are discovered now, each with its types."""
        return portal.call(self._inner.actions)

    def nodes(self) -> list[str]:
        """Return the full names of the nodes that are discovered now."""
        return portal.call(self._inner.nodes)
