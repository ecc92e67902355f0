"""Parameters through rosapi: JSON texts, ``/node:parameter`` names, and answers within the time."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator
from typing import Any

import pytest

from ropeway import aio
from ropeway.graph.calls import Request
from ropeway.graph.parameters import ParameterValue
from ropeway.listener.globs import Globs
from tests.graph.parameter_node import ParameterNode

from .conftest import Place

pytestmark = pytest.mark.jumping

VALUES: dict[str, ParameterValue] = {
    "flag": True,
    "width": 640,
    "rate": 2.5,
    "broken": math.nan,
    "frame": "map",
    "mask": b"\x01\x02",
    "sizes": [1, 2],
    "gains": [0.5, math.inf],
    "names": ["a", "ü"],
    "fixed": 1,
}


@pytest.fixture
async def camera(place: Place) -> AsyncIterator[ParameterNode]:
    """The parameters of the node ``/robot``."""
    yield await ParameterNode(dict(VALUES), read_only=("fixed",)).serve(place.robot, "/robot")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("flag", "true"),
        ("width", "640"),
        ("rate", "2.5"),
        ("broken", "null"),
        ("frame", '"map"'),
        ("mask", "[1, 2]"),
        ("sizes", "[1, 2]"),
        ("gains", "[0.5, null]"),
        ("names", '["a", "\\u00fc"]'),
    ],
)
async def test_get(place: Place, camera: ParameterNode, name: str, text: str) -> None:
    """A value of each type is told as a JSON text that every client can parse."""
    answer = await place.ask("get_param", name=f"/robot:{name}")
    assert answer == {"value": text, "successful": True, "reason": ""}
    assert list(answer) == ["value", "successful", "reason"]
    assert await place.ask("has_param", name=f"robot:{name}") == {"exists": True}


@pytest.mark.parametrize(
    ("default", "text"), [("", '""'), ("5", "5"), ('{"a": [1]}', '{"a": [1]}'), ("no JSON", '""'), ("NaN", "null")]
)
@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("/robot:what", "Parameter what not found"),
        ("/nobody:width", "Service /nobody/get_parameters is not available"),
        ("width", "Malformed parameter name: width; expecting <node_name>:<param_name>"),
        ("/robot:", "Malformed"),
        (":width", "Malformed"),
        ("/:x", "Malformed"),
        ("", "Malformed"),
    ],
)
async def test_get_unknown(
    place: Place, camera: ParameterNode, name: str, reason: str, default: str, text: str
) -> None:
    """What is not there has the default, and the reason says what is missing."""
    answer = await place.ask("get_param", name=name, default_value=default)
    assert answer["value"] == text
    assert not answer["successful"]
    assert answer["reason"].startswith(reason)
    assert await place.ask("has_param", name=name) == {"exists": False}


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("flag", "false", False),
        ("width", "7", 7),
        ("width", '"7"', 7),
        ("rate", "5", 5.0),
        ("rate", "1e3", 1000.0),
        ("frame", '"odom"', "odom"),
        ("frame", '"5"', "5"),
        ("frame", "5", "5"),
        ("mask", "[7, 8]", b"\x07\x08"),
        ("sizes", "[3]", [3]),
        ("gains", "[1, 2]", [1.0, 2.0]),
        ("gains", "[1, 2.5]", [1.0, 2.5]),
        ("names", '["x"]', ["x"]),
    ],
)
async def test_set(place: Place, camera: ParameterNode, name: str, text: str, value: Any) -> None:
    """A JSON text sets a parameter, in the type that the parameter has."""
    assert await place.ask("set_param", name=f"/robot:{name}", value=text) == {"successful": True, "reason": ""}
    assert camera.values[name] == value
    assert type(camera.values[name]) is type(value)


async def test_set_an_unknown_type(place: Place, camera: ParameterNode) -> None:
    """A node that does not describe its parameters gets the value in its own type."""
    other = await place.participant("/other")
    node = ParameterNode({"x": 1.0})
    await node._offer(other, "/other/set_parameters", "rcl_interfaces/srv/SetParameters", node._set)
    assert (await place.ask("set_param", name="/other:x", value='"on"'))["successful"]
    assert node.values == {"x": True}


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("/robot:fixed", "2", "fixed is read-only"),
        ("/robot:what", "2", "what was not declared"),
        ("/robot:width", "seven", "JSON"),
        ("/robot:width", "", "JSON"),
        ("/robot:width", "[" * 5000, "JSON"),
        ("/nobody:width", "7", "Service /nobody/set_parameters is not available"),
        ("width", "7", "Malformed"),
        ("/robot:width", "123456789012345678901234567890", ""),
    ],
)
async def test_set_refused(place: Place, camera: ParameterNode, name: str, text: str, reason: str) -> None:
    """What cannot be set is answered with the reason, and changes nothing."""
    answer = await place.ask("set_param", name=name, value=text)
    assert list(answer) == ["successful", "reason"]
    assert not answer["successful"]
    assert reason in answer["reason"]
    assert answer["reason"]
    assert camera.values["width"] == 640


async def test_delete(place: Place, camera: ParameterNode) -> None:
    """A parameter is deleted once, and deleting what is not there succeeds."""
    for _ in range(2):
        assert await place.ask("delete_param", name="/robot:width") == {"successful": True, "reason": ""}
        assert "width" not in camera.values
    assert await place.ask("delete_param", name="/robot:fixed") == {"successful": False, "reason": "fixed is read-only"}
    assert not (await place.ask("delete_param", name="/nobody:x"))["successful"]


async def test_names(place: Place, camera: ParameterNode) -> None:
    """The parameters of all nodes are listed, but for hidden nodes."""
    await ParameterNode({"b": 1}).serve(await place.participant("/arm"), "/arm")
    await ParameterNode({"c": 1}).serve(await place.participant("/_tool"), "/_tool")
    names = (await place.ask("get_param_names"))["names"]
    assert names == ["/arm:b", *(f"/robot:{name}" for name in sorted(VALUES))]


async def silent(request: Request) -> bytes:
    await asyncio.Event().wait()
    raise AssertionError


async def broken(request: Request) -> bytes:
    return b"\0\1\0\0\xff\xff\xff\xff"


async def failing(request: Request) -> bytes:
    raise ValueError("no idea")


@pytest.mark.parametrize("handler", [silent, broken, failing])
async def test_nodes_that_do_not_answer(bare: Place, handler: Any) -> None:
    """Of a node that is silent or broken nothing is told in the given time, of the others everything."""
    await bare.start(params_timeout_s=0.2)
    await ParameterNode({"a": 1}).serve(bare.robot, "/robot")
    other = await bare.participant("/other")
    for name, type in (("list", "List"), ("get", "Get"), ("set", "Set")):
        await other.create_service(f"/other/{name}_parameters", f"rcl_interfaces/srv/{type}Parameters", handler)
    async with aio.timeout(5):
        assert await bare.ask("get_param_names") == {"names": ["/robot:a"]}
        assert await bare.ask("has_param", name="/other:a") == {"exists": False}
        got = await bare.ask("get_param", name="/other:a", default_value="1")
        assert (got["value"], got["successful"]) == ("1", False)
        assert got["reason"]
        assert not (await bare.ask("set_param", name="/other:a", value="1"))["successful"]
        assert not (await bare.ask("delete_param", name="/other:a"))["successful"]
    if handler is silent:
        assert got["reason"] == "Timeout occurred"


async def test_many_silent_nodes(bare: Place) -> None:
    """However many nodes are silent, the names of the others come within the time for all."""
    await bare.start(params_timeout_s=0.3)
    await ParameterNode({"a": 1}).serve(bare.robot, "/a_robot")
    for number in range(40):
        name = f"/other{number}/list_parameters"
        await bare.robot.create_service(name, "rcl_interfaces/srv/ListParameters", silent)
    async with aio.timeout(5):
        assert await bare.ask("get_param_names") == {"names": ["/a_robot:a"]}


@pytest.mark.parametrize(
    ("patterns", "shown"),
    [(["width"], ["width"]), (["/robot:r*"], ["rate"]), ([], []), (["*"], sorted(VALUES))],
)
async def test_globs(bare: Place, patterns: list[str], shown: list[str]) -> None:
    """Parameters that no pattern names, alone or with their node, cannot be seen or changed."""
    await bare.start(globs=Globs(params=patterns))
    node = await ParameterNode(dict(VALUES)).serve(bare.robot, "/robot")
    assert (await bare.ask("get_param_names"))["names"] == [f"/robot:{name}" for name in shown]
    for name in ("width", "rate"):
        assert (await bare.ask("has_param", name=f"/robot:{name}"))["exists"] == (name in shown)
        changed = await bare.ask("set_param", name=f"/robot:{name}", value="3")
        assert changed["successful"] == (name in shown)
        if name not in shown:
            assert changed["reason"] == f"Parameter {name} does not match any of the glob strings"
            assert node.values[name] == VALUES[name]
        assert (await bare.ask("delete_param", name=f"/robot:{name}"))["successful"] == (name in shown)
