"""The parameters of our own node, asked for as those of any other."""

from __future__ import annotations

import itertools
from collections.abc import AsyncIterator

import pytest

from ropeway.graph.calls import Request
from ropeway.graph.parameters import (
    ParameterType,
    delete_parameters,
    describe_parameters,
    get_parameters,
    list_parameters,
    nodes_with_parameters,
    set_parameters,
)
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.rosbridge.server.own_parameters import OwnParameter, OwnParameters
from ropeway.types import TypeRegistry

pytestmark = pytest.mark.jumping

REGISTRY = TypeRegistry()
NODE = "/rosbridge_websocket"
_numbers = itertools.count()


@pytest.fixture
async def asking() -> AsyncIterator[MemoryGraph]:
    """The graph of somebody else, while our node serves its parameters."""
    network = f"own-parameters-{next(_numbers)}"
    ours, theirs = MemoryGraph(network, node=NODE), MemoryGraph(network, node="/tool")
    await ours.open()
    await theirs.open()
    port = OwnParameter("port", 9090, "The port", "start the server with --port")
    parameters = (port, OwnParameter("tls.key", "k"), OwnParameter("tls.ca.file", "c"))
    own = OwnParameters(ours, REGISTRY, NODE, parameters)
    await own.open()
    yield theirs
    await own.close()
    assert not any(info.servers for name, info in theirs.services().items() if name.startswith(NODE))
    await theirs.close()
    await ours.close()


async def test_list(asking: MemoryGraph) -> None:
    """The names are listed, all or those below a prefix, down to a depth."""
    assert nodes_with_parameters(asking.services()) == [NODE]
    assert await list_parameters(asking, REGISTRY, NODE) == ["port", "tls.ca.file", "tls.key"]
    assert await list_parameters(asking, REGISTRY, NODE, depth=1) == ["port"]
    assert await list_parameters(asking, REGISTRY, NODE, prefixes=["tls"]) == ["tls.ca.file", "tls.key"]
    assert await list_parameters(asking, REGISTRY, NODE, prefixes=["tls"], depth=1) == ["tls.key"]
    assert await list_parameters(asking, REGISTRY, NODE, prefixes=["tl"]) == []


async def test_values(asking: MemoryGraph) -> None:
    """Values and types are told; a name that is not there has none."""
    assert await get_parameters(asking, REGISTRY, NODE, ["port", "none"]) == {"port": 9090, "none": None}
    described = await describe_parameters(asking, REGISTRY, NODE, ["port", "none"])
    port = described["port"]
    assert port is not None
    assert (port.type, port.read_only, port.description) == (ParameterType.INTEGER, True, "The port")
    assert described["none"] is None


async def test_types(asking: MemoryGraph) -> None:
    """The types alone are told, too."""
    service = "rcl_interfaces/srv/GetParameterTypes"
    client = await asking.create_client(f"{NODE}/get_parameter_types", service)
    request = REGISTRY.codec(f"{service}_Request").encode({"names": ["port", "tls.key"]})
    answer = REGISTRY.codec(f"{service}_Response").decode(await client.call(Request(request), 5))
    assert list(answer["types"]) == [ParameterType.INTEGER, ParameterType.STRING]


async def test_setting_is_refused(asking: MemoryGraph) -> None:
    """None can be set or deleted, and the reason says how to have another value."""
    refused = await set_parameters(asking, REGISTRY, NODE, {"port": 1, "none": 2})
    assert refused["port"] == f"port is read-only while {NODE} runs: start the server with --port"
    assert refused["none"] == f"{NODE} has no parameter none"
    assert (await delete_parameters(asking, REGISTRY, NODE, ["port"]))["port"]
    service = "rcl_interfaces/srv/SetParametersAtomically"
    client = await asking.create_client(f"{NODE}/set_parameters_atomically", service)
    request = REGISTRY.codec(f"{service}_Request").encode({"parameters": [{"name": "port"}]})
    answer = REGISTRY.codec(f"{service}_Response").decode(await client.call(Request(request), 5))
    assert (answer["result"]["successful"], answer["result"]["reason"][:4]) == (False, "port")
