"""Parameters that viewers read, set and watch."""

from __future__ import annotations

from typing import Any

import pytest

from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.graph.parameters import to_message
from ropeway.listener.authentication import Door
from ropeway.listener.authorization import Role
from ropeway.networks.foxglove.settings import FoxgloveSettings, patterns
from tests.graph.parameter_node import ParameterNode
from tests.networks.foxglove.viewer import Sight, Viewer
from tests.support.until import until

EVENT = "rcl_interfaces/msg/ParameterEvent"
VALUES: dict[str, Any] = {"on": True, "n": 5, "x": 2.0, "s": "text", "raw": b"\x00\xff", "xs": [1.0, 2.5], "ns": [1, 2]}


async def node(sight: Sight, name: str = "/turtle", **values: Any) -> ParameterNode:
    """Start a node with parameters."""
    return await ParameterNode(dict(values)).serve(await sight.participant(name), name)


async def get(viewer: Viewer, *names: str) -> dict[str, dict[str, Any]]:
    """Ask for parameters, and return them by name."""
    viewer.send({"op": "getParameters", "parameterNames": list(names), "id": "q"})
    answer = await viewer.op("parameterValues")
    assert answer["id"] == "q"
    return {parameter["name"]: parameter for parameter in answer["parameters"]}


async def test_all_types(sight: Sight) -> None:
    """All parameters of all nodes are shown, each with what JSON does not tell of its type."""
    await node(sight, **VALUES)
    viewer = await sight.viewer()
    found = await get(viewer)
    assert found["/turtle.on"] == {"name": "/turtle.on", "value": True}
    assert found["/turtle.n"] == {"name": "/turtle.n", "value": 5}
    assert found["/turtle.x"] == {"name": "/turtle.x", "value": 2.0, "type": "float64"}
    assert found["/turtle.raw"] == {"name": "/turtle.raw", "value": "AP8=", "type": "byte_array"}
    assert found["/turtle.xs"] == {"name": "/turtle.xs", "value": [1.0, 2.5], "type": "float64_array"}
    assert found["/turtle.ns"]["value"] == [1, 2]
    assert await get(viewer, "/turtle.s") == {"/turtle.s": {"name": "/turtle.s", "value": "text"}}
    assert await get(viewer, "/turtle.none") == {"/turtle.none": {"name": "/turtle.none"}}


@pytest.mark.parametrize(
    ("name", "given", "expected"),
    [
        ("on", {"value": False}, False),
        ("n", {"value": 7}, 7),
        ("x", {"value": 7}, 7.0),
        ("n", {"value": 7, "type": "float64"}, 7.0),
        ("s", {"value": "7"}, "7"),
        ("raw", {"value": "AAE=", "type": "byte_array"}, b"\x00\x01"),
        ("xs", {"value": [1, 2]}, [1.0, 2.0]),
        ("ns", {"value": [3, 4], "type": "float64_array"}, [3.0, 4.0]),
        ("ns", {"value": [3, 4.5]}, [3.0, 4.5]),
        ("s", {}, None),
    ],
)
async def test_setting(sight: Sight, name: str, given: dict[str, Any], expected: Any) -> None:
    """A parameter is set in the type that the viewer names, or in its own, and told as it is then."""
    turtle = await node(sight, **VALUES)
    viewer = await sight.viewer()
    full = f"/turtle.{name}"
    viewer.send({"op": "setParameters", "parameters": [{"name": full, **given}], "id": "set"})
    answer = await viewer.op("parameterValues")
    assert (answer["id"], [parameter["name"] for parameter in answer["parameters"]]) == ("set", [full])
    assert turtle.values.get(name) == expected
    assert type(turtle.values.get(name)) is type(expected)


@pytest.mark.parametrize(
    ("operation", "said"),
    [
        ({"op": "getParameters", "parameterNames": ["nonsense"]}, "names no parameter"),
        ({"op": "getParameters", "parameterNames": ["/nobody.x"]}, "/nobody has no parameter services"),
        ({"op": "getParameters", "parameterNames": ["/tur tle.x"]}, "no parameter services"),
        ({"op": "getParameters", "parameterNames": "x"}, "a list"),
        ({"op": "getParameters", "parameterNames": ["x" * 600]}, "characters"),
        ({"op": "setParameters", "parameters": [{"name": "/turtle.n", "value": {"a": 1}}]}, "not a parameter value"),
        ({"op": "setParameters", "parameters": [{"name": "/turtle.n", "value": [1, "a"]}]}, "not a parameter value"),
        ({"op": "setParameters", "parameters": [{"name": "/turtle.n", "value": 1, "type": "u8"}]}, "not known"),
        (
            {"op": "setParameters", "parameters": [{"name": "/turtle.raw", "value": "?", "type": "byte_array"}]},
            "base64",
        ),
        ({"op": "setParameters", "parameters": [{"value": 1}]}, "name"),
    ],
)
async def test_bad_requests(sight: Sight, operation: dict[str, Any], said: str) -> None:
    """What cannot be read or set is answered with a status that says why, and nothing is changed."""
    turtle = await node(sight, **VALUES)
    viewer = await sight.viewer()
    await viewer.service("/turtle/set_parameters")
    viewer.send(operation)
    assert said in await viewer.complaint()
    assert turtle.values == VALUES


async def test_rights(dark: Sight) -> None:
    """Reading and setting need the right to the node's own services."""
    role = Role("reader", {"call_service": ("/turtle/get_parameters",)})
    await dark.start(door=Door(default=role))
    turtle = await node(dark, n=1)
    await node(dark, "/other", n=1)
    viewer = await dark.viewer()
    assert list(await get(viewer)) == ["/turtle.n"]
    viewer.send({"op": "setParameters", "parameters": [{"name": "/turtle.n", "value": 2}]})
    assert "role reader does not list it" in await viewer.complaint()
    assert turtle.values == {"n": 1}


async def test_whitelist(dark: Sight) -> None:
    """Parameters beside the whitelist are neither shown nor set."""
    await dark.start(FoxgloveSettings(params=patterns((r"/turtle\.shown",))))
    turtle = await node(dark, shown=1, hidden=2)
    viewer = await dark.viewer()
    assert list(await get(viewer)) == ["/turtle.shown"]
    viewer.send({"op": "setParameters", "parameters": [{"name": "/turtle.hidden", "value": 3}]})
    assert "param_whitelist" in await viewer.complaint()
    assert turtle.values["hidden"] == 2


async def test_changes_are_told(sight: Sight) -> None:
    """A viewer is told the changes of the parameters that it watches; nobody reads them while none are watched."""
    events = await sight.robot.create_publisher("/parameter_events", EVENT)
    codec = sight.registry.codec(EVENT)

    def tell(**changed: Any) -> None:
        parameters = [{"name": name, "value": to_message(value)} for name, value in changed.items()]
        gone = [{"name": "gone", "value": to_message(None)}]
        event = {"node": "/turtle", "changed_parameters": parameters, "deleted_parameters": gone}
        events.publish(Sample(codec.encode(event), EVENT, 0, bytes(16), SEQ_NONE))

    viewer, other = await sight.viewer(), await sight.viewer()
    await other.passed()
    assert events.subscribers == 0
    names = ["/turtle.x", "/turtle.gone"]
    viewer.send({"op": "subscribeParameterUpdates", "parameterNames": names})
    await until(lambda: events.subscribers == 1)
    tell(x=1.5, y=2)
    told = await viewer.op("parameterValues")
    first, second = told["parameters"] + (await viewer.op("parameterValues"))["parameters"]
    assert (first, second) == ({"name": "/turtle.x", "value": 1.5, "type": "float64"}, {"name": "/turtle.gone"})
    viewer.send({"op": "unsubscribeParameterUpdates", "parameterNames": names})
    await until(lambda: events.subscribers == 0)
    await other.passed()
    assert not [told for told in other.told if told["op"] == "parameterValues"]
