"""Graphs by URL: ``dds:0``, ``dds:5?interface=lo``, ``ros2``, ``ros2:5``, ``auto``, ``ros1``, ``ros1:http://host:11311``,
``zenoh``, ``zenoh:tcp/host:7447``, ``ws://host:9090``, ``memory:x``, ``overlay:robot1.ropeway``, ``iort://host:7410``,
``mqtt://host:1883``. Several ``ws://`` addresses with commas between are a group.

``ros2`` goes through the installed rclpy, in the domain of ``ROS_DOMAIN_ID`` unless it names one. ``auto`` is ``ros2``
where rclpy can be imported, because ROS 2 is sourced, and else ``dds`` in the same domain. ``ros1`` is the master of
``ROS_MASTER_URI``, ``ros1://host:11311`` another way to write one.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qsl, urlsplit

from ropeway.errors import GraphUnavailable
from ropeway.extras import require
from ropeway.listener.http import without_token

if TYPE_CHECKING:
    from ropeway.graph.base import Graph
    from ropeway.types import TypeRegistry

__all__ = ["make_graph", "open_graph"]


def make_graph(
    url: str,
    *,
    registry: TypeRegistry | None = None,
    name: str = "ropeway",
    gateway_id: str = "",
    distro: str | None = None,
    types: Sequence[str] = (),
    **options: object,
) -> Graph:
    """Make a graph that is not open yet. Raises ``GraphUnavailable`` for a URL of no known kind.

    ``distro`` and ``types`` are for DDS: whose layouts of types the network has, and files with its own definitions.
    ``options`` go to graphs of the ``ws`` kind (``ssl_context``, ``limits``, ``wait``, ``watch``, ``headers``), of the
    ``iort`` kind (``ssl_context``, ``token``), and of the ``mqtt`` kind (``ssl_context``, ``wait_s``, ``maps``).
    """
    if url == "auto":
        url = _auto()
    if url == "ros2":
        url = f"ros2:{_domain(url)}"
    parts = urlsplit(url)
    scheme = parts.scheme
    query = dict(parse_qsl(parts.query))
    if scheme == "dds":
        from ropeway.networks.dds import DdsGraph  # loads the DDS library, which a rosbridge client does not need

        domain = parts.path or parts.netloc or "0"
        if not domain.isdigit() or int(domain) > 232:
            raise GraphUnavailable(url, f"{domain!r} is not a DDS domain; write dds:0 to dds:232")
        interface, distro = query.pop("interface", None), query.pop("distro", distro)
        _no_more(url, query)
        registry, network = _variant(url, registry, distro, types)
        return DdsGraph(
            int(domain), name=name, interface=interface, gateway_id=gateway_id, registry=registry, network=network
        )
    if scheme == "ros2":
        from ropeway.networks.ros2 import Ros2Graph

        domain = parts.path or parts.netloc
        if not domain.isdigit() or int(domain) > 232:
            raise GraphUnavailable(url, f"{domain!r} is not a ROS domain; write ros2, or ros2:0 to ros2:232")
        _no_more(url, query)
        return Ros2Graph(int(domain), name=name, gateway_id=gateway_id, registry=registry)
    if scheme == "zenoh" or url.partition("?")[0] == "zenoh":
        return _zenoh(url, registry, name, gateway_id, distro, types)
    if scheme == "ros1" or url == "ros1":
        from ropeway.networks.ros1 import Ros1Graph

        master = url.removeprefix("ros1").removeprefix(":")
        return Ros1Graph(master.removeprefix("//"), registry=registry, name=name)
    if scheme in ("ws", "wss"):
        from ropeway.networks.rosbridge.client import RosbridgeGraph

        if "," in url:
            return _group(url, registry=registry, gateway_id=gateway_id, name=name, **options)

        return RosbridgeGraph(url, registry=registry, gateway_id=gateway_id, name=name, **options)  # type: ignore[arg-type]
    if scheme == "memory":
        from ropeway.networks.memory.graph import MemoryGraph

        return MemoryGraph(parts.path or "default", node=f"/{name}", registry=registry)
    if scheme in ("iort", "iorts"):
        return _iort(url, query, name, registry, **options)
    if scheme in ("mqtt", "mqtts"):
        return _mqtt(url, name, registry, **options)
    if scheme == "overlay":
        return _overlay(url, parts.path or parts.netloc, query, registry)
    raise GraphUnavailable(
        url,
        "is not a graph; write dds:0, dds:5?interface=lo, ros2, ros2:5, auto, zenoh, zenoh:tcp/host:7447, ros1, "
        "ros1:http://host:11311, ws://host:9090, wss://host, iort://host:7410, mqtt://host or overlay:NAME.ropeway",
    )


def _group(url: str, **options: Any) -> Graph:
    """Several rosbridge servers or gateways that offer the same."""
    from ropeway.group.graph import Group
    from ropeway.networks.rosbridge.client import RosbridgeGraph

    addresses = url.split(",")
    for address in addresses:
        if not address.startswith(("ws://", "wss://")):
            raise GraphUnavailable(url, f"{address!r} cannot be in a group; write ws://edge1:9090,ws://edge2:9090")
    members = {without_token(address): RosbridgeGraph(address, **options) for address in addresses}
    return Group(members, name=without_token(url), registry=options["registry"])


def _zenoh(
    url: str, registry: TypeRegistry | None, name: str, gateway_id: str, distro: str | None, types: Sequence[str]
) -> Graph:
    """Make the graph of a network of rmw_zenoh; ``zenoh`` alone is that of a router on this machine."""
    require("zenoh", "a network on rmw_zenoh")
    from ropeway.networks.zenoh import ZenohGraph
    from ropeway.networks.zenoh.address import parse_address

    try:
        address = parse_address(url)
    except ValueError as error:
        raise GraphUnavailable(url, str(error)) from None
    registry, network = _variant(url, registry, address.distro or distro, types)
    return ZenohGraph(address, label=url, name=name, gateway_id=gateway_id, registry=registry, network=network)


def _variant(
    url: str, registry: TypeRegistry | None, distro: str | None, types: Sequence[str]
) -> tuple[TypeRegistry | None, TypeRegistry | None]:
    """Return our types, and those of a network where it is told that it has others."""
    if not (distro or types):
        return registry, None
    from ropeway.types import TypeRegistry
    from ropeway.types.variant import make_network

    registry = registry or TypeRegistry()
    try:
        return registry, make_network(registry, distro, types, label=url.partition("?")[0])
    except ValueError as error:
        raise GraphUnavailable(url, str(error)) from None


def _iort(url: str, query: dict[str, str], name: str, registry: TypeRegistry | None, **options: Any) -> Graph:
    """Make the graph of the topics of robots at a server; without a ``token`` it is that of ``ROPEWAY_TOKEN``."""
    from ropeway.networks.iort.graph import IortGraph
    from ropeway.networks.iort.links import RemoteLink

    _no_more(url, query)
    address = url.partition("?")[0]
    token = options.get("token") or os.environ.get("ROPEWAY_TOKEN") or None
    link = RemoteLink(address, name, token=token, ssl_context=options.get("ssl_context"))
    return IortGraph(link, name=address, registry=registry)


def _mqtt(url: str, name: str, registry: TypeRegistry | None, **options: Any) -> Graph:
    """Make the graph of the topics of a broker; all are looked at to list them, unless the address says which."""
    require("mqtt", "an MQTT broker")
    from ropeway.networks.mqtt.address import parse_address, read_password
    from ropeway.networks.mqtt.graph import MqttGraph  # loads paho

    try:
        address = parse_address(url)
        password = read_password(address, os.environ)
    except ValueError as error:
        raise GraphUnavailable(url.partition("?")[0].rpartition("@")[2], str(error)) from None
    known = {key: options[key] for key in ("ssl_context", "wait_s", "maps", "max_message_bytes") if key in options}
    discover = address.discover if address.discover is not None else ("#",)
    return MqttGraph(address, node=name, password=password, discover=discover, registry=registry, **known)


def _overlay(url: str, bundle: str, query: dict[str, str], registry: TypeRegistry | None) -> Graph:
    """Make the graph of the overlay for the owner of a bundle; ``?router=`` and ``?unique=`` stand behind it."""
    require("overlay", "the overlay")
    from ropeway.networks.overlay.crypto.identity import Identity
    from ropeway.networks.overlay.graph import OverlayGraph  # loads Zenoh
    from ropeway.networks.overlay.names import Metadata
    from ropeway.networks.overlay.node import OverlayNode

    bundle = bundle or os.environ.get("ROPEWAY_IDENTITY", "")
    if not bundle:
        raise GraphUnavailable(url, "whose overlay? write overlay:NAME.ropeway, a bundle that ropeway keys issue wrote")
    router, unique = query.pop("router", None), query.pop("unique", "")
    _no_more(url, query)
    node = OverlayNode(Identity.load(bundle), routers=None if router is None else router.split(","), listen=())
    return OverlayGraph(node, metadata=Metadata(unique=unique), registry=registry, label=url)


async def open_graph(
    url: str, *, registry: TypeRegistry | None = None, name: str = "ropeway", gateway_id: str = "", **options: Any
) -> Graph:
    """Make a graph and open it; the caller closes it. Raises ``GraphUnavailable`` or ``ConnectFailed``."""
    graph = make_graph(url, registry=registry, name=name, gateway_id=gateway_id, **options)
    await graph.open()
    return graph


def _auto() -> str:
    from ropeway.networks.ros2 import rclpy_fault

    return f"{'dds' if rclpy_fault() else 'ros2'}:{_domain('auto')}"


def _domain(url: str) -> int:
    from ropeway.networks.ros2.environment import domain_of_environment

    try:
        return domain_of_environment()
    except ValueError as error:
        raise GraphUnavailable(url, str(error)) from error


def _no_more(url: str, query: dict[str, str]) -> None:
    if query:
        known = {"dds": "; known are interface and distro", "overlay": "; known are router and unique"}.get(
            url.partition(":")[0], ""
        )
        raise GraphUnavailable(url, f"{next(iter(query))!r} is not an option of this kind of graph{known}")
