"""A bridge between two graphs within a program: what ``ropeway.open_bridge`` gives."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from contextlib import AsyncExitStack
from functools import partial
from pathlib import Path
from typing import Any

from ropeway.api.discovery import type_of
from ropeway.api.graph import OPEN_TIMEOUT_S, new_name, open_network, profile_of, registry_of
from ropeway.api.opening import Closing, Opening
from ropeway.bridge.action import ActionBridge
from ropeway.bridge.options import BridgeOptions
from ropeway.bridge.service import ServiceBridge
from ropeway.bridge.topic import TopicBridge
from ropeway.errors import GraphUnavailable
from ropeway.graph.base import NO_HINTS, Delivery, resolve_name
from ropeway.graph.calls import DEFAULT_TIMEOUT_S
from ropeway.hub.hub import Hub, View
from ropeway.networks.factory import make_graph
from ropeway.qos import QoS

__all__ = ["AsyncBridge", "open_bridge"]

_Bridge = TopicBridge | ServiceBridge | ActionBridge


def open_bridge(
    left: str,
    right: str,
    *,
    name: str = "",
    types: Iterable[str | Path] = (),
    timeout_s: float | None = OPEN_TIMEOUT_S,
) -> Opening[AsyncBridge]:
    """Open two graphs by their URLs, to join names on them: ``async with ropeway.open_bridge("dds:0", "dds:5") as b``.

    Others see a gateway on both, so that messages do not go in circles where several bridges join the same networks.
    ``name`` and ``types`` as for ``ropeway.open``; ``timeout_s`` is for each graph. Raises ``GraphUnavailable`` or
    ``ConnectFailed``.
    """
    return Opening(_open((left, right), name or new_name(), types, timeout_s))


async def _open(urls: tuple[str, str], node: str, types: Iterable[str | Path], timeout_s: float | None) -> AsyncBridge:
    registry = registry_of(types)
    gateway_id = os.urandom(8).hex()
    async with AsyncExitStack() as stack:
        views = []
        for url in urls:
            graph = make_graph(url, registry=registry, name=node, gateway_id=gateway_id)
            await open_network(graph, timeout_s)
            stack.push_async_callback(graph.close)
            hub = Hub(graph, gateway_id=gateway_id)
            await hub.open()
            stack.push_async_callback(hub.close)
            views.append(hub.view(node))
            stack.push_async_callback(views[-1].close)
        return AsyncBridge(views[0], views[1], stack.pop_all())


class AsyncBridge(Closing):
    """Joins names on two graphs of a program.

    ``left`` is the source and ``right`` the target of what is joined, unless ``reverse`` is true: messages go from
    source to target, and what is served on the source is offered on the target. ``rename`` is the name on the target
    where that is another one. Whatever fails is tried again; ``status`` tells.
    """

    def __init__(self, left: View, right: View, stack: AsyncExitStack) -> None:
        self._left, self._right = left, right
        self._stack = stack
        self._bridges: list[tuple[str, _Bridge]] = []
        self._closed = False

    async def topic(
        self,
        name: str,
        type: str = "",
        *,
        rename: str = "",
        reverse: bool = False,
        qos: QoS | str | None = None,
        delivery: Delivery = NO_HINTS,
        timeout_s: float | None = DEFAULT_TIMEOUT_S,
    ) -> None:
        """Publish on the target what is published on the source.

        Without ``qos`` the publishers' profile is adopted and followed. ``delivery`` limits rate and age, and says how
        a link treats the topic. Without ``type`` a publisher is waited for, up to ``timeout_s``. Raises
        ``WaitTimeout``.
        """
        make = partial(TopicBridge, options=BridgeOptions(qos=profile_of(qos), delivery=delivery))
        await self._join("topic", make, name, type, rename, reverse, timeout_s)

    async def service(
        self,
        name: str,
        type: str = "",
        *,
        rename: str = "",
        reverse: bool = False,
        call_timeout_s: float | None = None,
        timeout_s: float | None = DEFAULT_TIMEOUT_S,
    ) -> None:
        """Offer on the target the service of the source, while it is served there.

        A call may take ``call_timeout_s``, a minute unless given. Without ``type`` a server is waited for, up to
        ``timeout_s``. Raises ``WaitTimeout``.
        """
        make = partial(ServiceBridge, options=BridgeOptions(timeout_s=call_timeout_s))
        await self._join("service", make, name, type, rename, reverse, timeout_s)

    async def action(
        self,
        name: str,
        type: str = "",
        *,
        rename: str = "",
        reverse: bool = False,
        goal_timeout_s: float | None = None,
        timeout_s: float | None = DEFAULT_TIMEOUT_S,
    ) -> None:
        """Offer on the target the action of the source, while it is served there.

        A goal may take ``goal_timeout_s``, any time unless given. Without ``type`` a server is waited for, up to
        ``timeout_s``. Raises ``WaitTimeout``.
        """
        make = partial(ActionBridge, options=BridgeOptions(timeout_s=goal_timeout_s))
        await self._join("action", make, name, type, rename, reverse, timeout_s)

    def status(self) -> list[dict[str, Any]]:
        """Return each name that is joined: its state and why it failed, and what has crossed, as JSON."""
        return [_row(kind, bridge) for kind, bridge in self._bridges]

    async def close(self) -> None:
        """Take everything back and leave both networks."""
        self._closed = True
        await self._stack.aclose()

    async def _join(
        self,
        kind: str,
        make: Callable[[View, View, str, str, str], _Bridge],
        name: str,
        type: str,
        rename: str,
        reverse: bool,
        timeout_s: float | None,
    ) -> None:
        """Start what ``make`` gives for the source and the target, both names, and the type."""
        if self._closed:
            raise GraphUnavailable(self._left.name, "the bridge is closed")
        source, target = (self._right, self._left) if reverse else (self._left, self._right)
        here, there = resolve_name(name), resolve_name(rename or name)
        bridge = make(source, target, here, there, await type_of(source, kind, here, type, timeout_s))
        await bridge.start()
        self._stack.push_async_callback(bridge.close)
        self._bridges.append((kind, bridge))


def _row(kind: str, bridge: _Bridge) -> dict[str, Any]:
    row = {"kind": kind, "type": bridge.type, "source": bridge.source.name, "target": bridge.target.name}
    if isinstance(bridge, TopicBridge):
        names = {"name": bridge.source_topic, "rename": bridge.target_topic}
        passed = {"messages": bridge.meter.messages, "drops": {why.value: n for why, n in bridge.drops.items()}}
    else:
        names = {"name": bridge.source_name, "rename": bridge.target_name}
        passed = {"calls": dict(bridge.counts)}
    return {**row, **names, "state": bridge.state, "error": bridge.error, **passed}
