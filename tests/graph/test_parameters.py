"""Parameters of nodes through their services."""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import AsyncIterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.errors import InvalidName, NotServed, UnknownType, ValueMismatch
from ropeway.graph.parameters import (
    ParameterType,
    ParameterValue,
    delete_parameters,
    describe_parameters,
    from_message,
    get_parameters,
    list_parameters,
    nodes_with_parameters,
    parse_value,
    set_parameters,
    to_message,
    type_of,
)
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.types import TypeRegistry
from tests.graph.parameter_node import REGISTRY, ParameterNode
from tests.support.until import until

pytestmark = pytest.mark.jumping

_numbers = itertools.count()

VALUES: dict[str, ParameterValue] = {
    "use_sim_time": False,
    "width": 640,
    "rate": 2.5,
    "frame": "map",
    "mask": b"\x01\x02",
    "flags": [True, False],
    "sizes": [1, 2, 3],
    "gains": [0.5, 1.5],
    "plugins.names": ["a", "b"],
}


@pytest.fixture
async def graph() -> AsyncIterator[MemoryGraph]:
    """A network with the node ``/camera``; ``graph.node`` asks it."""
    network = f"parameters-{next(_numbers)}"
    near, far = MemoryGraph(network, node="/near"), MemoryGraph(network, node="/camera")
    await near.open()
    await far.open()
    near.camera = await ParameterNode(dict(VALUES), read_only=("width",)).serve(far, "/camera")  # type: ignore[attr-defined]
    yield near
    await near.close()
    await far.close()


async def test_list(graph: MemoryGraph) -> None:
    """The names of a node's parameters are listed, sorted."""
    assert await list_parameters(graph, REGISTRY, "/camera") == sorted(VALUES)


async def test_list_below(graph: MemoryGraph) -> None:
    """A prefix selects the names below it; the slash before the node may be left out."""
    assert await list_parameters(graph, REGISTRY, "camera", prefixes=["plugins"]) == ["plugins.names"]


async def test_get(graph: MemoryGraph) -> None:
    """Values of every type arrive as they are."""
    got = await get_parameters(graph, REGISTRY, "/camera", VALUES)
    assert got == VALUES
    assert {name: type(value) for name, value in got.items()} == {name: type(v) for name, v in VALUES.items()}


async def test_get_unknown(graph: MemoryGraph) -> None:
    """A parameter that a node does not have is ``None``, and hides no other."""
    assert await get_parameters(graph, REGISTRY, "/camera", ["rate", "what", "width"]) == {
        "rate": 2.5,
        "what": None,
        "width": 640,
    }
    assert await get_parameters(graph, REGISTRY, "/camera", ["what"]) == {"what": None}


async def test_get_nothing(graph: MemoryGraph) -> None:
    """Asking for nothing asks nobody."""
    assert await get_parameters(graph, REGISTRY, "/camera", []) == {}
    assert graph.camera.calls == []  # type: ignore[attr-defined]


async def test_set(graph: MemoryGraph) -> None:
    """Each parameter is set or refused on its own, with the reason of the node."""
    done = await set_parameters(graph, REGISTRY, "/camera", {"rate": 5.0, "width": 1, "what": "x"})
    assert done == {"rate": None, "width": "width is read-only", "what": "what was not declared"}
    assert (await get_parameters(graph, REGISTRY, "/camera", ["rate"])) == {"rate": 5.0}


async def test_set_nonsense(graph: MemoryGraph) -> None:
    """A list of unlike items is no value."""
    with pytest.raises(ValueMismatch, match="one type"):
        await set_parameters(graph, REGISTRY, "/camera", {"rate": [1, "a"]})


async def test_delete(graph: MemoryGraph) -> None:
    """A parameter that is deleted is there no more."""
    assert await delete_parameters(graph, REGISTRY, "/camera", ["rate", "what"]) == {
        "rate": None,
        "what": "what was not declared",
    }
    assert "rate" not in await list_parameters(graph, REGISTRY, "/camera")


async def test_describe(graph: MemoryGraph) -> None:
    """A description tells the type, what it is for and its limits."""
    found = await describe_parameters(graph, REGISTRY, "/camera", ["rate", "width", "what"])
    rate, width = found["rate"], found["width"]
    assert rate is not None
    assert width is not None
    assert (rate.type, rate.range, rate.read_only) == (ParameterType.DOUBLE, (0.0, 9.0, 0.5), False)
    assert (width.name, width.type, width.range, width.read_only) == ("width", ParameterType.INTEGER, None, True)
    assert width.description == "what width is for"
    assert found["what"] is None


async def test_no_such_node(graph: MemoryGraph) -> None:
    """A node without parameter services is told by its service."""
    with pytest.raises(NotServed, match="/nobody/list_parameters"):
        await list_parameters(graph, REGISTRY, "/nobody", timeout_s=0.05)
    with pytest.raises(InvalidName):
        await list_parameters(graph, REGISTRY, "/no body", timeout_s=0.05)


async def test_a_node_that_comes_late(graph: MemoryGraph) -> None:
    """A node that is not discovered yet is waited for, within the time."""
    asking = asyncio.create_task(get_parameters(graph, REGISTRY, "/late", ["rate"], timeout_s=30))
    await until(lambda: bool(graph.network.clients))
    late = MemoryGraph(graph.name.removeprefix("memory:"), node="/late")
    await late.open()
    await ParameterNode({"rate": 1.5}).serve(late, "/late")
    assert await asking == {"rate": 1.5}
    await late.close()


async def test_other_distribution(graph: MemoryGraph) -> None:
    """A registry of ROS 1 does not know parameters of ROS 2."""
    with pytest.raises(UnknownType):
        await get_parameters(graph, TypeRegistry("noetic"), "/camera", ["rate"])


async def test_clients_are_closed(graph: MemoryGraph) -> None:
    """Nothing is left open after a question."""
    await list_parameters(graph, REGISTRY, "/camera")
    assert not graph.network.clients


async def test_nodes_with_parameters(graph: MemoryGraph) -> None:
    """Nodes with parameter services are found among the services."""
    assert nodes_with_parameters(graph.services()) == ["/camera"]
    await graph.create_client("/ghost/list_parameters", "rcl_interfaces/srv/ListParameters")
    assert nodes_with_parameters(graph.services()) == ["/camera"]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("true", True),
        ("off", False),
        ("640", 640),
        ("-1", -1),
        ("2.5", 2.5),
        ("1.0e+3", 1000.0),
        ("map", "map"),
        ("'640'", "640"),
        ('""', ""),
        ("", ""),
        ("[1, 2]", [1, 2]),
        ("[1.5]", [1.5]),
        ("[true, false]", [True, False]),
        ("[a, b]", ["a", "b"]),
        ("[]", []),
        ("[1, a]", "[1, a]"),
        ("{a: 1}", "{a: 1}"),
        ("a: b: c", "a: b: c"),
        ("2024-01-01", "2024-01-01"),
        ("2024-99-99", "2024-99-99"),
        ("[", "["),
    ],
)
def test_parse_value(text: str, value: ParameterValue) -> None:
    """A text stands for the value that ``ros2 param set`` takes it for."""
    got = parse_value(text)
    assert (got, type(got)) == (value, type(value))


@given(st.text(max_size=40))
def test_parse_any_text(text: str) -> None:
    """Every text stands for a value."""
    type_of(parse_value(text))


@given(
    st.one_of(
        st.none(),
        st.booleans(),
        st.integers(-(2**63), 2**63 - 1),
        st.floats(allow_nan=False),
        st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"])),
        st.binary(),
        st.lists(st.booleans()),
        st.lists(st.integers(-(2**63), 2**63 - 1), min_size=1),
        st.lists(st.floats(allow_nan=False), min_size=1),
        st.lists(st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"])), min_size=1),
    )
)
def test_values_survive(value: ParameterValue) -> None:
    """A value comes out of the message that it goes into, through CDR."""
    codec = REGISTRY.codec("rcl_interfaces/msg/ParameterValue")
    assert from_message(codec.decode(codec.encode(to_message(value)))) == value


def test_type_labels() -> None:
    """Types are written as ``ros2 param`` writes them."""
    assert ParameterType.INTEGER_ARRAY.label == "integer array"
    assert type_of([math.nan]).label == "double array"


def test_unknown_value_type() -> None:
    """A value of a type that ROS does not have counts as not set."""
    assert from_message({"type": 77}) is None
