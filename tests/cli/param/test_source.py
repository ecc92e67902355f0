"""Parameters of a node, and of a ROS 1 master."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path
from xmlrpc.client import ServerProxy

import pytest
import typer

from ropeway.cli.param.list_ import list_all, list_one
from ropeway.cli.param.source import AtMaster, AtNode, Parameters, label_of, parameters_of, place_name
from ropeway.cli.session import OpenGraph
from ropeway.networks.ros1 import Ros1Graph
from ropeway.types import TypeRegistry
from tests.graph.parameter_node import ParameterNode
from tests.networks.ros1.network import HAS_MASTER, RosMaster


@pytest.fixture
async def ros1(tmp_path: Path, registry: TypeRegistry) -> AsyncIterator[OpenGraph]:
    """A session on a master that keeps some parameters."""
    if not HAS_MASTER:
        pytest.skip("needs rosmaster, which .ci/run installs on Debian")
    master = RosMaster(tmp_path)
    master.start()
    with ServerProxy(master.uri) as proxy:
        for name, value in (("/robot/speed", 1.5), ("/robot/gains/p", 0.5), ("/robots", 2), ("/name", "bob")):
            proxy.setParam("/test", name, value)
    graph = Ros1Graph(master.uri, name="tool")
    await graph.open()
    yield OpenGraph(graph, registry)
    await graph.close()
    master.kill()


async def values(asked: Parameters) -> dict[str, object]:
    return await asked.get(await asked.list())


async def test_a_master_lists_what_it_keeps(ros1: OpenGraph) -> None:
    """The names below a namespace are absolute, all stand under ``/``; a name that begins alike is no child."""
    names = ["/name", "/robot/gains/p", "/robot/speed", "/robots"]
    assert await list_all(ros1, [], 5.0, 2.0, types=True) == ({"/": dict.fromkeys(names, "")}, {})
    assert list(await list_one(ros1, "/robot", [], 5.0, types=True)) == ["/robot/gains/p", "/robot/speed"]
    assert list(await list_one(ros1, "/robot", ["gains"], 5.0, types=False)) == ["/robot/gains/p"]


async def test_a_master_is_read_and_written(ros1: OpenGraph) -> None:
    """Values are got, set and deleted below a namespace, and dumped as ``rosparam`` has them."""
    robot, top = parameters_of(ros1, "/robot", 5.0), parameters_of(ros1, "/", 5.0)
    assert isinstance(robot, AtMaster)
    assert await robot.get(["speed", "gains", "gains/p", "nothing"]) == {
        "speed": 1.5,
        "gains": {"p": 0.5},
        "gains/p": 0.5,
        "nothing": None,
    }
    assert await robot.set({"speed": 2, "new/one": [1, "a"], "long": 1 << 40}) == {
        "speed": None,
        "new/one": None,
        "long": "cannot be written as XML-RPC: int exceeds XML-RPC limits",
    }
    assert await robot.delete(["gains", "nothing"]) == {"gains": None, "nothing": "it is not set"}
    assert await robot.dump() == {"speed": 2, "new": {"one": [1, "a"]}}
    assert await parameters_of(ros1, "/name", 5.0).dump() == {"name": "bob"}
    assert await parameters_of(ros1, "/nothing", 5.0).dump() == {}
    assert (await top.get(["name"])) == {"name": "bob"}


async def test_a_master_describes_nothing(ros1: OpenGraph, capsys: pytest.CaptureFixture[str]) -> None:
    """ROS 1 has no descriptions, and that is said."""
    with pytest.raises(typer.Exit):
        await parameters_of(ros1, "/robot", 5.0).describe(["speed"])
    assert "the ROS 1 master keeps no descriptions of parameters" in capsys.readouterr().err


async def test_a_node_is_asked_through_its_services(pair: tuple[OpenGraph, OpenGraph]) -> None:
    """On ROS 2 the node itself is asked."""
    here, there = pair
    await ParameterNode({"rate": 1.5, "on": True}).serve(there.graph, "/a")
    asked = parameters_of(here, "/a", 5.0)
    assert isinstance(asked, AtNode)
    assert await values(asked) == await asked.dump() == {"rate": 1.5, "on": True}
    assert await asked.set({"rate": 2.5}) == {"rate": None}
    described = (await asked.describe(["rate"]))["rate"]
    assert described is not None
    assert described.description == "what rate is for"


def test_names_and_types() -> None:
    """The root is a place in ROS 1; values that only its masters keep have a type in words."""
    assert [place_name(name) for name in ("/", "robot", "/robot")] == ["/", "/robot", "/robot"]
    assert [label_of(value) for value in (1, {"a": 1}, [1, "a"])] == ["integer", "dictionary", "list"]
