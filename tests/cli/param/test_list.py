"""``param list`` over all nodes."""

from __future__ import annotations

import asyncio

from ropeway.cli.param.list_ import list_all
from ropeway.cli.session import OpenGraph
from ropeway.graph.calls import Request
from tests.graph.parameter_node import ParameterNode


async def test_all_nodes(pair: tuple[OpenGraph, OpenGraph]) -> None:
    """Every node with parameters is listed in order, with types where asked for."""
    here, there = pair
    await ParameterNode({"rate": 1.5, "name": "x"}).serve(there.graph, "/b")
    await ParameterNode({"on": True}).serve(there.graph, "/a")
    listed, silent = await list_all(here, [], 5.0, 2.0, types=True)
    assert (listed, silent) == ({"/a": {"on": "boolean"}, "/b": {"name": "string", "rate": "double"}}, {})
    assert list(listed) == ["/a", "/b"]
    listed, _ = await list_all(here, [], 5.0, 2.0, types=False)
    assert listed == {"/a": {"on": ""}, "/b": {"name": "", "rate": ""}}


async def test_silent_nodes(pair: tuple[OpenGraph, OpenGraph]) -> None:
    """A node that does not answer keeps no other from being listed, and the reason is told."""
    here, there = pair

    async def silent_node(request: Request) -> bytes:
        await asyncio.Event().wait()
        raise AssertionError

    await there.graph.create_service("/mute/list_parameters", "rcl_interfaces/srv/ListParameters", silent_node)
    await ParameterNode({"on": True}).serve(there.graph, "/a")
    listed, silent = await list_all(here, [], 0.2, 2.0, types=False)
    assert listed == {"/a": {"on": ""}}
    assert list(silent) == ["/mute"]
