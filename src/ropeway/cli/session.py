"""Provides what every verb on a graph shares: options, opening the graph, and a bounded wait for discovery."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, TypeVar

import typer

from ropeway import aio
from ropeway.cli.console import complain, fail
from ropeway.cli.credentials import graph_credentials
from ropeway.cli.patience import patiently
from ropeway.errors import GraphUnavailable, InvalidName
from ropeway.graph.base import Graph, NodeInfo, TopicInfo, resolve_name
from ropeway.graph.calls import ActionInfo, ServiceInfo
from ropeway.graph.peer_answer import Settling, Telling
from ropeway.graph.type_inquiry import Learning
from ropeway.qos import DEFAULT, PROFILES, QoS
from ropeway.tasks import end
from ropeway.types import TypeRegistry

__all__ = [
    "GraphOption",
    "JsonOption",
    "OpenGraph",
    "QosDepth",
    "QosDurability",
    "QosHistory",
    "QosProfile",
    "QosReliability",
    "SpinOption",
    "TypesOption",
    "discover",
    "find_topic",
    "full_name",
    "known_types",
    "open_session",
    "qos_of",
    "settle",
    "settle_actions",
    "settle_nodes",
    "settle_services",
    "topic_name",
]

T = TypeVar("T")
P = TypeVar("P", ServiceInfo, ActionInfo)

_LEARN_S: Final = 1.0  # who can tell a definition is discovered within this time
_LOOK_S: Final = 0.1
_QUIET_S: Final = 0.3  # no news for so long: what is there has been discovered
_LINK_S: Final = 5.0  # a link with a router is there within this time, or not at all

GraphOption = Annotated[
    str,
    typer.Option(
        "--graph",
        "-g",
        envvar="ROPEWAY_GRAPH",
        help="The network: dds:0, ros2, auto, ros1, zenoh, ws://host:9090, iort://host:7410, mqtt://host:1883, "
        "overlay:NAME.ropeway. "
        "Without it, DDS on ROS_DOMAIN_ID.",
        show_default=False,
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON, one value per line.")]
SpinOption = Annotated[
    float,
    typer.Option("--spin-time", min=0.0, help="Seconds to wait for discovery at most; less once everything is found."),
]
TypesOption = Annotated[
    list[Path] | None,
    typer.Option("--types", help="More definitions: a .msg file or a directory of them.", show_default=False),
]
QosProfile = Annotated[str, typer.Option("--qos-profile", help=f"A profile: {', '.join(PROFILES)}.")]
QosDepth = Annotated[int | None, typer.Option("--qos-depth", min=0, help="How many messages are kept.")]
QosHistory = Annotated[str, typer.Option("--qos-history", help="keep_last or keep_all.")]
QosReliability = Annotated[str, typer.Option("--qos-reliability", help="reliable or best_effort.")]
QosDurability = Annotated[str, typer.Option("--qos-durability", help="volatile or transient_local.")]


@dataclass(frozen=True)
class OpenGraph:
    """An open graph and the types known to it."""

    graph: Graph
    registry: TypeRegistry

    async def know(self, type: str, spin_time_s: float = _LEARN_S) -> None:
        """Ask the network for the definition of a type that is not known here, for a moment."""
        if self.registry.has(type) or not isinstance(self.graph, Learning):
            return
        loop = asyncio.get_running_loop()
        deadline = loop.time() + spin_time_s
        known = await self.graph.learn(type)
        while not known and loop.time() < deadline:
            await asyncio.sleep(_LOOK_S)
            known = await self.graph.learn(type)


def default_graph(environ: Mapping[str, str] = os.environ) -> str:
    """Return ``dds:`` with the domain that ROS is told to use."""
    domain = environ.get("ROS_DOMAIN_ID", "").strip() or "0"
    if not domain.isdigit():
        fail(f"ROS_DOMAIN_ID is {domain!r}; set it to a number, or name the network with --graph dds:0", 2)
    return f"dds:{int(domain)}"


def known_types(more: list[Path] | None = None) -> TypeRegistry:
    """Return the types that are known here: bundled ones, those of a sourced ROS 2, and those of ``more`` files."""
    registry = TypeRegistry()
    registry.add_ament_prefix_path()
    for path in more or []:
        registry.add_path(path)
    return registry


@asynccontextmanager
async def open_session(url: str = "", types: list[Path] | None = None) -> AsyncIterator[OpenGraph]:
    """Open the graph at ``url`` with a node of its own, and close it at the end."""
    from ropeway.networks import open_graph

    registry = known_types(types)
    address = url or default_graph()
    options = graph_credentials().options(address)
    async with patiently(lambda: f"waiting for {address} to answer"):
        graph = await open_graph(address, registry=registry, name=f"ropeway_{os.getpid()}", **options)
    try:
        if graph.kind == "overlay":
            from ropeway.networks.overlay.graph import OverlayGraph

            assert isinstance(graph, OverlayGraph)
            async with patiently(lambda: f"waiting for a router, {_LINK_S:g} s at most"):
                await graph.node.links.wait(_LINK_S)  # without one nothing is there, and nobody would say why
        yield OpenGraph(graph, registry)
    finally:
        await graph.close()


def topic_name(name: str) -> str:
    """Return an absolute topic name, or exit with a sentence."""
    return full_name(name)


def full_name(name: str) -> str:
    """Return the absolute name of a topic, service, action or node, or exit with a sentence."""
    try:
        return resolve_name(name)
    except InvalidName as error:
        fail(str(error), 2)


def qos_of(
    profile: str, depth: int | None, history: str, reliability: str, durability: str, *, base: QoS = DEFAULT
) -> QoS | None:
    """Return the profile that the options ask for; ``None`` if they ask for nothing.

    What they leave out is that of ``profile``, or of ``base``.
    """
    if profile and profile not in PROFILES:
        fail(f"{profile!r} is not a QoS profile; use one of {', '.join(PROFILES)}", 2)
    given = {"history": history, "depth": depth, "reliability": reliability, "durability": durability}
    policies = {key: value for key, value in given.items() if value not in ("", None)}
    if not profile and not policies:
        return None
    try:
        return QoS.parse(policies, PROFILES.get(profile, base))
    except ValueError as error:
        fail(str(error), 2)


async def discover(
    graph: Graph,
    spin_time_s: float,
    look: Callable[[], dict[str, T]],
    done: Callable[[dict[str, T]], bool] | None = None,
) -> dict[str, T]:
    """Return what ``look`` finds on the graph once ``done`` says so, or at the latest after ``spin_time_s``.

    Without ``done``, once something is there, nothing new came for a while, and the graph expects nothing more.
    """
    news = asyncio.Event()

    async def listen() -> None:
        async for _ in graph.changes():
            news.set()

    listener = asyncio.create_task(listen())
    loop = asyncio.get_running_loop()
    deadline = loop.time() + spin_time_s
    try:
        while True:
            found = look()
            if done is not None and done(found):
                return found
            left = deadline - loop.time()
            if left <= 0:
                if done is None and not found:
                    _found_nothing(graph, spin_time_s)
                return found
            news.clear()
            try:
                async with aio.timeout(min(left, _QUIET_S)):
                    await news.wait()
            except TimeoutError:
                if done is None and found and (not isinstance(graph, Settling) or graph.settled):
                    return found
    finally:
        await end(listener)


def _found_nothing(graph: Graph, spin_time_s: float) -> None:
    """Say that there is nothing, so that nobody takes it for a fault; fail where nobody would tell if there were."""
    if isinstance(graph, Telling) and graph.untold:
        raise GraphUnavailable(graph.name, graph.untold)
    complain(f"nothing was discovered on {graph.name} within {spin_time_s:g} s; wait longer with --spin-time")


async def settle(
    graph: Graph, spin_time_s: float, done: Callable[[dict[str, TopicInfo]], bool] | None = None
) -> dict[str, TopicInfo]:
    """Return the topics that others publish or read; see ``discover``."""

    def topics() -> dict[str, TopicInfo]:
        return {name: info for name, info in graph.topics().items() if not _only_own(info)}

    return await discover(graph, spin_time_s, topics, done)


async def settle_services(
    graph: Graph, spin_time_s: float, done: Callable[[dict[str, ServiceInfo]], bool] | None = None
) -> dict[str, ServiceInfo]:
    """Return the services that others serve or call; see ``discover``."""
    return await discover(graph, spin_time_s, lambda: _of_others(graph.services()), done)


async def settle_actions(
    graph: Graph, spin_time_s: float, done: Callable[[dict[str, ActionInfo]], bool] | None = None
) -> dict[str, ActionInfo]:
    """Return the actions that others serve or use; see ``discover``."""
    return await discover(graph, spin_time_s, lambda: _of_others(graph.actions()), done)


async def settle_nodes(
    graph: Graph, spin_time_s: float, done: Callable[[dict[str, NodeInfo]], bool] | None = None
) -> dict[str, NodeInfo]:
    """Return the nodes of others; see ``discover``."""

    def nodes() -> dict[str, NodeInfo]:
        return {name: info for name, info in graph.nodes().items() if not info.local}

    return await discover(graph, spin_time_s, nodes, done)


async def find_topic(graph: Graph, topic: str, spin_time_s: float, *, published: bool = False) -> TopicInfo | None:
    """Return the topic as soon as it is discovered (with a publisher, if ``published``), ``None`` if it is not."""

    def found(topics: dict[str, TopicInfo]) -> bool:
        return topic in topics and (not published or bool(topics[topic].publishers))

    return (await settle(graph, spin_time_s, found)).get(topic)


def _of_others(infos: dict[str, P]) -> dict[str, P]:
    return {
        name: info
        for name, info in infos.items()
        if not (ends := info.servers + info.clients) or not all(end.local for end in ends)
    }


def _only_own(info: TopicInfo) -> bool:
    ends = info.publishers + info.subscriptions
    return bool(ends) and all(end.local for end in ends)
