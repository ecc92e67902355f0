"""A graph that a program has opened: what ``ropeway.open`` gives."""

from __future__ import annotations

import asyncio
import itertools
import os
import ssl
from collections import Counter
from collections.abc import AsyncIterator, Iterable, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Final, TypeVar

from ropeway import aio
from ropeway.api.actions import (
    AcceptGoal,
    AsyncActionClient,
    AsyncActionServer,
    ExecuteGoal,
    action_messages,
)
from ropeway.api.callbacks import MessageCallback
from ropeway.api.discovery import type_of
from ropeway.api.inbox import QUEUE_BYTES, QUEUE_MESSAGES, Inbox
from ropeway.api.message import MessageType, TypedMessage
from ropeway.api.opening import Closing, Opening
from ropeway.api.part import Part
from ropeway.api.services import AsyncClient, AsyncService, RequestHandler, service_messages
from ropeway.api.topics import AsyncPublisher, AsyncSubscription
from ropeway.errors import GraphUnavailable
from ropeway.graph.base import NO_HINTS, Delivery, Graph, Undelivered, resolve_name
from ropeway.graph.calls import DEFAULT_TIMEOUT_S
from ropeway.graph.kept import Kept
from ropeway.hub.hub import Hub, View
from ropeway.networks.factory import make_graph
from ropeway.qos import PROFILES, QoS
from ropeway.types import TypeRegistry
from ropeway.types.definition import canonical_name

__all__ = ["OPEN_TIMEOUT_S", "AsyncGraph", "new_name", "open", "open_network", "profile_of", "registry_of"]

_Part = TypeVar("_Part", bound=Part)

_names: Final = itertools.count(1)
OPEN_TIMEOUT_S: Final = 10.0  # a WebSocket over a slow link, with TLS and a name to look up


def open(
    url: str,
    *,
    name: str = "",
    types: Iterable[str | Path] = (),
    ssl_context: ssl.SSLContext | None = None,
    headers: Mapping[str, str] | None = None,
    timeout_s: float | None = OPEN_TIMEOUT_S,
) -> Opening[AsyncGraph]:
    """Open the graph at ``url``: ``async with ropeway.open("dds:0") as graph``, or ``graph = await ropeway.open(...)``.

    ``url`` is one of ``dds:0`` (a DDS domain), ``ros2``, ``ros1``, ``ws://host:9090``, ``wss://host``,
    ``iort://host:7410``, ``overlay:NAME.ropeway``, ``memory:NAME`` (a network within the process), or ``auto``.

    ``name`` is the node that others see, ``ropeway_PID`` unless given. ``types`` are message definitions beside the
    standard ones and those of a sourced workspace: ``.msg``, ``.srv`` and ``.action`` files, or directories of them.
    ``ssl_context`` and ``headers`` are for ``wss://`` and ``ws://``, such as ``{"Authorization": "Bearer TOKEN"}``.

    Raises ``GraphUnavailable`` or ``ConnectFailed``, which say what to do about it.
    """
    return Opening(_open(url, name or new_name(), types, ssl_context, headers, timeout_s))


async def _open(
    url: str,
    node: str,
    types: Iterable[str | Path],
    ssl_context: ssl.SSLContext | None,
    headers: Mapping[str, str] | None,
    timeout_s: float | None,
) -> AsyncGraph:
    registry = registry_of(types)
    graph = make_graph(url, registry=registry, name=node, ssl_context=ssl_context, headers=headers)
    await open_network(graph, timeout_s)
    return AsyncGraph(graph, url, registry, node)


def new_name() -> str:
    """Return a name for a node that no other of this machine has: ``ropeway_PID``, with a number from the second on."""
    number = next(_names)
    return f"ropeway_{os.getpid()}" if number == 1 else f"ropeway_{os.getpid()}_{number}"


async def open_network(graph: Graph, timeout_s: float | None) -> None:
    """Open a graph within a time; leave nothing open if that fails. Raises ``GraphUnavailable``."""
    try:
        async with aio.timeout(timeout_s):
            await graph.open()
    except TimeoutError:
        await graph.close()
        raise GraphUnavailable(
            graph.name, f"it did not open within {timeout_s:g} s; give it more with timeout_s"
        ) from None
    except BaseException:
        await graph.close()
        raise


def registry_of(types: Iterable[str | Path]) -> TypeRegistry:
    """Return the standard definitions with those of a sourced workspace and of ``types``.

    Raises ``InvalidDefinition``.
    """
    registry = TypeRegistry()
    registry.add_ament_prefix_path()
    for path in types:
        registry.add_path(path)
    return registry


class AsyncGraph(Closing):
    """A graph that a program has opened; ``url`` is what it was opened with.

    Its parts hear each other and everybody else on the network. All belong to the event loop on which the graph was
    opened; ``ropeway.blocking`` is for threads. Names may be relative: ``chatter`` is ``/chatter``. Where a ``type`` is
    left out, it is that of whoever has the name already, who is waited for up to ``timeout_s``; where it is given, both
    spellings do, ``std_msgs/String`` and ``std_msgs/msg/String``.
    """

    def __init__(self, graph: Graph, url: str, registry: TypeRegistry, node: str) -> None:
        self.url = url
        self.registry = registry
        self._graph, self._node = graph, node
        self._hub = Hub(graph)
        self._parts: Kept[Part] = Kept()
        self._closed = False

    @property
    def drops(self) -> Counter[tuple[str, Undelivered]]:
        """Return how many messages this graph has dropped, by topic and reason."""
        return self._graph.drops

    # ── topics ─────────────────────────────────────────────────────────────────────────────────────────────────

    def publisher(
        self, topic: str, type: str, *, qos: QoS | str | None = None, delivery: Delivery = NO_HINTS
    ) -> Opening[AsyncPublisher]:
        """Publish ``topic``.

        ``qos`` is a profile or the name of one, such as ``"latched"`` or ``"sensor_data"``; ``delivery`` says how a
        link treats the topic. Raises ``InvalidName``, ``UnknownType``, ``TypeConflict`` or ``Refused``.
        """
        return Opening(self._publisher(topic, type, profile_of(qos), delivery))

    async def _publisher(self, topic: str, type: str, qos: QoS | None, delivery: Delivery) -> AsyncPublisher:
        async with self._new_view() as view:
            messages = MessageType(self.registry, canonical_name(type))
            inner = await view.create_publisher(resolve_name(topic), messages.name, qos, delivery=delivery)
            publisher = AsyncPublisher(view, inner, messages)
            await publisher.wait_taken()
            return self._keep(publisher)

    def subscribe(
        self,
        topic: str,
        type: str = "",
        callback: MessageCallback | None = None,
        *,
        qos: QoS | str | None = None,
        delivery: Delivery = NO_HINTS,
        queue_messages: int = QUEUE_MESSAGES,
        queue_bytes: int = QUEUE_BYTES,
        timeout_s: float | None = DEFAULT_TIMEOUT_S,
    ) -> Opening[AsyncSubscription]:
        """Read ``topic``: with ``callback``, which gets each message, or with ``receive`` and ``async for``.

        ``callback`` is a function, which must return soon, or a coroutine function, which gets one message at a time.
        Without ``qos`` the subscription takes what the publishers offer. What the program does not take in time waits,
        at most ``queue_messages`` and ``queue_bytes``; then the oldest go, and ``dropped`` counts them. ``timeout_s``
        bounds the wait for the type. Raises ``WaitTimeout``, ``InvalidName``, ``UnknownType`` or ``TypeConflict``.
        """
        inbox = Inbox(queue_messages, queue_bytes)
        return Opening(self._subscribe(topic, type, callback, profile_of(qos), delivery, inbox, timeout_s))

    async def _subscribe(
        self,
        topic: str,
        type: str,
        callback: MessageCallback | None,
        qos: QoS | None,
        delivery: Delivery,
        inbox: Inbox,
        timeout_s: float | None,
    ) -> AsyncSubscription:
        async with self._new_view() as view:
            name = resolve_name(topic)
            messages = MessageType(self.registry, await type_of(view, "topic", name, type, timeout_s))
            subscription = AsyncSubscription(view, name, messages, inbox, callback)
            try:
                subscription.attach(
                    await view.create_subscription(name, messages.name, qos, subscription.arrived, delivery=delivery)
                )
            except BaseException:
                await subscription.close()
                raise
            return self._keep(subscription)

    # ── services and actions ───────────────────────────────────────────────────────────────────────────────────

    def client(
        self, service: str, type: str = "", *, timeout_s: float | None = DEFAULT_TIMEOUT_S
    ) -> Opening[AsyncClient]:
        """Prepare to call ``service``, which need not be served yet if its type is given. Raises ``WaitTimeout``."""
        return Opening(self._client(service, type, timeout_s))

    async def _client(self, service: str, type: str, timeout_s: float | None) -> AsyncClient:
        async with self._new_view() as view:
            name = resolve_name(service)
            full = await type_of(view, "service", name, type, timeout_s)
            messages = service_messages(self.registry, full)
            return self._keep(AsyncClient(view, await view.create_client(name, full), *messages, self._node))

    async def call(
        self, service: str, request: object = None, type: str = "", *, timeout_s: float = DEFAULT_TIMEOUT_S
    ) -> TypedMessage:
        """Call ``service`` once; see ``AsyncClient.call``. ``timeout_s`` bounds all of it."""
        loop = asyncio.get_running_loop()
        deadline = loop.time() + timeout_s
        async with self.client(service, type, timeout_s=timeout_s) as client:
            return await client.call(request, timeout_s=max(deadline - loop.time(), 0.001))

    def serve(self, service: str, type: str, handler: RequestHandler) -> Opening[AsyncService]:
        """Offer ``service``: ``handler`` gets each request and returns the response.

        It is a function, which must return soon, or a coroutine function; what it raises fails that call alone.
        """
        return Opening(self._serve(service, type, handler))

    async def _serve(self, service: str, type: str, handler: RequestHandler) -> AsyncService:
        async with self._new_view() as view:
            full = canonical_name(type, "srv")
            made = AsyncService(view, *service_messages(self.registry, full), handler)
            made.attach(await view.create_service(resolve_name(service), full, made.answer))
            return self._keep(made)

    def action_client(
        self, action: str, type: str = "", *, timeout_s: float | None = DEFAULT_TIMEOUT_S
    ) -> Opening[AsyncActionClient]:
        """Prepare to use ``action``, which need not be served yet if its type is given. Raises ``WaitTimeout``."""
        return Opening(self._action_client(action, type, timeout_s))

    async def _action_client(self, action: str, type: str, timeout_s: float | None) -> AsyncActionClient:
        async with self._new_view() as view:
            name = resolve_name(action)
            full = await type_of(view, "action", name, type, timeout_s)
            messages = action_messages(self.registry, full)
            inner = await view.create_action_client(name, full)
            return self._keep(AsyncActionClient(view, inner, messages, self._node))

    def serve_action(
        self, action: str, type: str, execute: ExecuteGoal, *, accept: AcceptGoal | None = None
    ) -> Opening[AsyncActionServer]:
        """Offer ``action``: the coroutine function ``execute`` gets each goal and returns its result.

        ``accept`` (a function, or a coroutine function) says whether a goal is taken; left out, every one is. Requests
        to cancel are always agreed to; ``execute`` sees them in ``ExecutingGoal.cancel_requested``.
        """
        return Opening(self._serve_action(action, type, execute, accept))

    async def _serve_action(
        self, action: str, type: str, execute: ExecuteGoal, accept: AcceptGoal | None
    ) -> AsyncActionServer:
        async with self._new_view() as view:
            full = canonical_name(type, "action")
            made = AsyncActionServer(view, action_messages(self.registry, full), execute, accept)
            made.attach(await view.create_action_server(resolve_name(action), full, made.handlers()))
            return self._keep(made)

    # ── what there is ──────────────────────────────────────────────────────────────────────────────────────────

    def topics(self) -> dict[str, tuple[str, ...]]:
        """Return the topics that are discovered now, each with its types. Just opened, a graph knows few of them."""
        return {name: info.types for name, info in self._graph.topics().items()}

    def services(self) -> dict[str, tuple[str, ...]]:
        """Return the services that are discovered now, each with its types."""
        return {name: info.types for name, info in self._graph.services().items()}

    def actions(self) -> dict[str, tuple[str, ...]]:
        """Return the actions that are discovered now, each with its types."""
        return {name: info.types for name, info in self._graph.actions().items()}

    def nodes(self) -> list[str]:
        """Return the full names of the nodes that are discovered now."""
        return sorted(self._graph.nodes())

    # ── the end ────────────────────────────────────────────────────────────────────────────────────────────────

    async def close(self) -> None:
        """Leave the network, with all parts that were made here."""
        if self._closed:
            return
        self._closed = True
        await self._parts.close()
        for view in list(self._hub.views):  # of those that are being made
            await view.close()
        await self._hub.close()
        await self._graph.close()

    def _keep(self, part: _Part) -> _Part:
        self._parts.add(part)
        return part

    @asynccontextmanager
    async def _new_view(self) -> AsyncIterator[View]:
        """Give a part its view of the graph, and take that back if the part cannot be made."""
        if self._closed:
            raise GraphUnavailable(self._graph.name, "it is closed")
        view = self._hub.view(self._node, alone=True)
        try:
            yield view
        except BaseException:
            await view.close()
            raise


def profile_of(qos: QoS | str | None) -> QoS | None:
    """Return a profile that was given itself or by its name. Raises ``ValueError`` for a name that is none."""
    if not isinstance(qos, str):
        return qos
    if qos not in PROFILES:
        raise ValueError(f"{qos!r} is not a QoS profile; use one of {', '.join(PROFILES)}, or a ropeway.QoS")
    return PROFILES[qos]
