"""All kinds of a megabyte: what is sent to which listener, and how the gateway is set up that gets it."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple

from ropeway import aio
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY_SUBPROTOCOL
from tests.soak.megabytes import GATEWAY, PLAIN, SENT_BYTES, Make, a_megabyte, operation
from tests.soak.nodes import PACKETS
from tests.soak.overlay import MEMBERS, TO_ROUTERS, Attack, Overlay, a_gateway, a_router, attacked
from tests.soak.strangers import AT_ROUTERS, STRANGERS, Strangers, abort
from tests.support.authority import Authority
from tests.support.websocket import Client

__all__ = ["CLIENTS", "KINDS", "NODES", "ON_DDS", "OVERLAY", "UNREAD", "VISITORS", "Kind"]

_WARM_UP_BYTES: Final = 2_000  # before it is measured: what is made for the first visitor stays

Visit = Callable[[list[int], AsyncExitStack, bool], Awaitable[None]]
"""Sends a megabyte to the listeners at these ports, or if the last is true a little of it; the stack leaves."""

Prepare = Callable[[AsyncExitStack], Awaitable[dict[str, Any]]]
"""Makes what a gateway needs, and gives its configuration."""


class Kind(NamedTuple):
    """One kind."""

    name: str
    prepare: Prepare
    visit: Visit


def _config(graph: str) -> dict[str, Any]:
    return {
        "gateway": {
            "name": "memory",
            "graphs": [graph],
            "listen": ["ws://127.0.0.1:0"],
            "clients": {"unregister_timeout_s": 0.2},
        }
    }


def _serving(config: dict[str, Any]) -> Prepare:
    async def prepare(stack: AsyncExitStack) -> dict[str, Any]:
        return config

    return prepare


def _client(make: Make, subprotocol: str = "", reads: bool = True) -> Visit:
    """A client of the WebSocket listener, that reads what it is told unless it does not."""

    async def visit(ports: list[int], stack: AsyncExitStack, first: bool) -> None:
        client = await stack.enter_async_context(Client(ports[0], subprotocol=subprotocol))
        if reads or first:
            reading = asyncio.create_task(_read_all(client.reader))
            stack.callback(reading.cancel)
        try:
            for data in a_megabyte(make, _WARM_UP_BYTES if first else SENT_BYTES):
                client.raw(data)
                async with aio.timeout(20):
                    await client.writer.drain()
        except (ConnectionError, TimeoutError):
            pass  # closed with a reason, or not read any more, which are as good

    return visit


async def _read_all(reader: asyncio.StreamReader) -> None:
    while await reader.read(1 << 20):
        pass


def _strangers(visit: Strangers) -> Visit:
    async def come(ports: list[int], stack: AsyncExitStack, first: bool) -> None:
        await visit(ports[-1], stack, first)

    return come


def _node(make: Make, reads: bool = True, connections: int = 1) -> Visit:
    """A node of the IoRT listener, with so many connections in turn."""

    async def visit(ports: list[int], stack: AsyncExitStack, first: bool) -> None:
        writers: list[asyncio.StreamWriter] = []
        for _ in range(connections):
            reader, writer = await asyncio.open_connection("127.0.0.1", ports[-1])
            stack.callback(abort, writer)
            writers.append(writer)
            if reads or first:
                reading = asyncio.create_task(_read_all(reader))
                stack.callback(reading.cancel)
        packets = a_megabyte(make, _WARM_UP_BYTES if first else SENT_BYTES)
        try:
            for data, writer in zip(packets, itertools.cycle(writers), strict=False):
                writer.write(data)
                async with aio.timeout(20):
                    await writer.drain()
        except (ConnectionError, TimeoutError):
            pass  # closed, or not read any more, which are as good

    return visit


def _listening(scheme: str) -> Prepare:
    """A gateway with a store and a listener of this scheme."""

    async def prepare(stack: AsyncExitStack) -> dict[str, Any]:
        config = _config("memory:memory")
        gateway: dict[str, Any] = config["gateway"]
        gateway |= {"listen": [f"{scheme}://127.0.0.1:0"], "store": {"path": "memory:"}}
        if scheme == "wss":
            directory = Path(stack.enter_context(TemporaryDirectory()))
            gateway["tls"] = Authority(directory, "soak").sign("gateway")
        return config

    return prepare


_FROM_MANY: Final = 10  # connections, each of which may write some thousand topics


def _overlay(name: str, attack: Attack, *, gateway: bool) -> Kind:
    """What a member of an overlay does to a gateway or to a router."""
    made: list[Overlay] = []

    async def prepare(stack: AsyncExitStack) -> dict[str, Any]:
        made[:] = [Overlay(Path(stack.enter_context(TemporaryDirectory())))]
        return await (a_gateway if gateway else a_router)(made[0], stack)

    async def visit(ports: list[int], stack: AsyncExitStack, first: bool) -> None:
        if gateway:
            reader = await stack.enter_async_context(Client(ports[0]))
            reader.raw(operation("subscribe", topic="/soak", type="std_msgs/String"))
            reading = asyncio.create_task(_read_all(reader.reader))
            stack.callback(reading.cancel)
        await attacked(made[0], attack, stack, _WARM_UP_BYTES if first else SENT_BYTES, gateway=gateway)

    return Kind(f"{'member' if gateway else 'router'}-{name}", prepare, visit)


async def _a_router(stack: AsyncExitStack) -> dict[str, Any]:
    return await a_router(Overlay(Path(stack.enter_context(TemporaryDirectory()))), stack)


_MEMORY: Final = _serving(_config("memory:memory"))
_DDS: Final = _serving(_config("dds:77?interface=lo"))
_SENT_ON_DDS: Final = (
    "advertise",
    "advertise_deep",
    "subscribe_many",
    "advertise_service",
    "advertise_action",
    "send_action_goal",
    "send_own_goal",
    "call_own_service",
    "call_typed",
)
_ANSWERED: Final = ("call_", "rosapi_", "send_", "subscribe", "advertise", "publish")

CLIENTS: Final = [
    *(Kind(name, _MEMORY, _client(make)) for name, make in PLAIN.items()),
    *(Kind(name, _MEMORY, _client(make, ROPEWAY_SUBPROTOCOL)) for name, make in GATEWAY.items()),
]
UNREAD: Final = [
    Kind(f"{name}-unread", _MEMORY, _client(make, reads=False))
    for name, make in PLAIN.items()
    if name.startswith(_ANSWERED)
]
VISITORS: Final = [Kind(name, _listening(scheme), _strangers(visit)) for name, (scheme, visit) in STRANGERS.items()]
NODES: Final = [
    *(Kind(f"node-{name}", _listening("iort"), _node(make)) for name, make in PACKETS.items()),
    *(Kind(f"node-{name}-unread", _listening("iort"), _node(make, False)) for name, make in PACKETS.items()),
    *(
        Kind(f"nodes-{name}", _listening("iort"), _node(PACKETS[name], connections=_FROM_MANY))
        for name in ("plain", "systems", "brought", "subscriptions", "advertisements")
    ),
]
OVERLAY: Final = [
    *(_overlay(name, attack, gateway=True) for name, attack in MEMBERS.items()),
    *(_overlay(name, attack, gateway=False) for name, attack in TO_ROUTERS.items()),
    *(Kind(f"router-{name}", _a_router, _strangers(visit)) for name, visit in AT_ROUTERS.items()),
]
ON_DDS: Final = [Kind(f"{name}-dds", _DDS, _client(PLAIN[name])) for name in _SENT_ON_DDS]

KINDS: Final = [*CLIENTS, *UNREAD, *VISITORS, *NODES, *OVERLAY, *ON_DDS]
"""All of them, as ``python -m tests.soak.measure`` measures them."""
