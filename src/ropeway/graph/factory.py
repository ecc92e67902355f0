"""Graphs by URL: ``dds:0``, ``dds:5?interface=lo``, ``ws://host:9090``, ``memory:name``."""

from __future__ import annotations

from typing import TYPE_CHECKING
from urllib.parse import parse_qsl, urlsplit

from ropeway.errors import GraphUnavailable

if TYPE_CHECKING:
    from ropeway.graph.base import Graph
    from ropeway.types import TypeRegistry

__all__ = ["make_graph", "open_graph"]


def make_graph(
    url: str, *, registry: TypeRegistry | None = None, name: str = "ropeway", gateway_id: str = "", **options: object
) -> Graph:
    """A graph that is not open yet. Raises ``GraphUnavailable`` for a URL of no known kind.

    ``options`` go to graphs of the ``ws`` kind (``ssl_context``, ``limits``, ``wait``, ``watch``, ``headers``).
    """
    parts = urlsplit(url)
    scheme = parts.scheme
    query = dict(parse_qsl(parts.query))
    if scheme == "dds":
        from ropeway.graph.dds import DdsGraph  # loads the DDS library, which a rosbridge client does not need

        domain = parts.path or parts.netloc or "0"
        if not domain.isdigit() or int(domain) > 232:
            raise GraphUnavailable(url, f"{domain!r} is not a DDS domain; write dds:0 to dds:232")
        interface = query.pop("interface", None)
        _no_more(url, query)
        return DdsGraph(int(domain), name=name, interface=interface, gateway_id=gateway_id, registry=registry)
    if scheme in ("ws", "wss"):
        from ropeway.graph.rosbridge import RosbridgeGraph

        return RosbridgeGraph(url, registry=registry, gateway_id=gateway_id, name=name, **options)  # type: ignore[arg-type]
    if scheme == "memory":
        from ropeway.graph.memory import MemoryGraph

        return MemoryGraph(parts.path or "default", node=f"/{name}", registry=registry)
    raise GraphUnavailable(url, "is no graph; write dds:0, dds:5?interface=lo, ws://host:9090 or wss://host")


async def open_graph(
    url: str, *, registry: TypeRegistry | None = None, name: str = "ropeway", gateway_id: str = "", **options: object
) -> Graph:
    """Make a graph and open it; the caller closes it. Raises ``GraphUnavailable`` or ``ConnectFailed``."""
    graph = make_graph(url, registry=registry, name=name, gateway_id=gateway_id, **options)
    await graph.open()
    return graph


def _no_more(url: str, query: dict[str, str]) -> None:
    if query:
        raise GraphUnavailable(url, f"{next(iter(query))!r} is no option of this kind of graph; known is interface")
