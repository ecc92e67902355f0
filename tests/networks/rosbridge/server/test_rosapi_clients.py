"""rosapi, asked by the client libraries themselves; each is skipped where it is not installed."""

from __future__ import annotations

import importlib.util
import shutil
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from ropeway.graph.calls import ActionHandlers
from tests.graph.parameter_node import ParameterNode
from tests.networks.rosbridge.rosapi.test_rosapi import SET_BOOL, never, nothing
from tests.networks.rosbridge.server.peers import peers
from tests.support.actions import FIBONACCI
from tests.support.messages import STRING
from tests.support.place import Place

JS = Path(__file__).parents[3] / "js"
NODE = shutil.which("node") if (JS / "node_modules").is_dir() else None
PARAMETERS = [f"/robot/{name}_parameters" for name in ("describe", "get", "list", "set")]


async def robot(place: Place) -> ParameterNode:
    """Something to ask for."""
    await place.robot.create_publisher("/chatter", STRING)
    await place.robot.create_service("/lamp", SET_BOOL, nothing)
    await place.robot.create_action_server("/fibonacci", FIBONACCI, ActionHandlers(never))
    return await ParameterNode({"rate": 1.5, "width": 640}).serve(place.robot, "/robot")


async def ask(place: Place, *command: str, plan: list[list[Any]]) -> list[Any]:
    """What the program's client got for each item of the plan."""
    async with peers(*command, str(place.port), plan=plan) as program:  # type: ignore[arg-type]
        await program.wait(lambda: len([s for s in program.said if "ask" in s]) == len(plan), 40)
        got = {s["ask"]: s for s in program.said if "ask" in s}
        return [got[n].get("answer", got[n].get("failed")) for n in range(len(plan))]


@pytest.mark.skipif(NODE is None, reason="needs node and roslibjs: npm ci --prefix tests/js")
@pytest.mark.parametrize("library", ["roslib1", "roslib2"])
async def test_roslibjs(place: Place, library: str) -> None:
    """Every method of roslibjs that asks rosapi gets what it asks for."""
    node = await robot(place)
    plan: list[tuple[list[Any], list[Any]]] = [
        (["getActionServers"], [["/fibonacci"]]),
        (["getTopicsForType", STRING], [["/chatter"]]),
        (["getTopicType", "/chatter"], [STRING]),
        (["getTopicType", "/nothing"], [""]),
        (["getServicesForType", SET_BOOL], [["/lamp"]]),
        (["getServiceType", "/lamp"], [SET_BOOL]),
        (["getNodes"], [["/gateway", "/robot"]]),
        (["getParams"], [["/robot:rate", "/robot:width"]]),
        (["param", "get", "/robot:width"], [640]),
    ]
    more: list[list[Any]] = [
        ["getTopics"],
        ["getServices"],
        ["getTopicsAndRawTypes"],
        ["getMessageDetails", "std_msgs/Header"],
        ["getServiceRequestDetails", SET_BOOL],
        ["getServiceResponseDetails", SET_BOOL],
        ["getNodeDetails", "/robot"],
        ["getNodeDetails", "/nobody"],
        ["param", "get", "/robot:what"],
    ]
    asked = [item for item, _ in plan] + more
    command = (str(NODE), str(JS / "rosapi.mjs"), library)
    answers = await ask(place, *command, plan=asked)
    for (item, expected), answer in zip(plan, answers, strict=False):
        assert answer == expected, item
    changes: list[list[Any]] = [["param", "set", "/robot:rate", 3], ["param", "delete", "/robot:width"]]
    assert await ask(place, *command, plan=changes) == [[{"successful": True, "reason": ""}]] * 2
    assert node.values == {"rate": 3.0}
    topics, services, texts, message, request, response, details, nobody, what = answers[len(plan) :]
    assert "/chatter" in topics[0]["topics"]
    assert "/lamp" in services[0]
    assert texts[0]["typedefs_full_text"][texts[0]["topics"].index("/chatter")] == "string data\n"
    assert [found["type"] for found in message[0]] == ["std_msgs/Header", "builtin_interfaces/Time"]
    assert request[0]["typedefs"][0]["fieldnames"] == ["data"]
    assert response[0]["typedefs"][0]["fieldnames"] == ["success", "message"]
    if library == "roslib1":
        assert details == [[], ["/chatter"], ["/lamp", *PARAMETERS]]
        assert nobody == [[], [], []]
        assert what == [""]
    else:
        assert details == [{"subscribing": [], "publishing": ["/chatter"], "services": ["/lamp", *PARAMETERS]}]
        assert nobody == [{"subscribing": [], "publishing": [], "services": []}]
        assert what == "Parameter what not found"


@pytest.mark.skipif(importlib.util.find_spec("roslibpy") is None, reason="needs roslibpy, which make test installs")
@pytest.mark.parametrize("transport", ["twisted", "asyncio"])
async def test_roslibpy(place: Place, transport: str) -> None:
    """Every method of roslibpy that asks rosapi gets what it asks for, also the time, by its names in ROS 1."""
    node = await robot(place)
    plan: list[tuple[list[Any], Any]] = [
        (["get_topic_type", "/chatter"], STRING),
        (["get_topics_for_type", STRING], ["/chatter"]),
        (["get_service_type", "/lamp"], SET_BOOL),
        (["get_services_for_type", SET_BOOL], ["/lamp"]),
        (["get_params"], ["/robot:rate", "/robot:width"]),
        (["get_nodes"], ["/gateway", "/robot"]),
        (["get_param", "/robot:width"], 640),
        (["set_param", "/robot:rate", 2], None),
        (["delete_param", "/robot:width"], None),
    ]
    more = [["get_time"], ["get_topics"], ["get_services"], ["get_node_details", "/robot"]]
    details = [["get_message_details", "std_msgs/Header"], ["get_service_request_details", SET_BOOL]]
    asked = [item for item, _ in plan] + more + details
    program = str(Path(__file__).with_name("roslibpy_rosapi.py"))
    answers = await ask(place, sys.executable, program, transport, plan=asked)
    expected = [answer for _, answer in plan]
    for item, wanted, answer in zip(asked, expected, answers, strict=False):
        if wanted is not None:
            assert answer == wanted, item
    assert node.values == {"rate": 2.0}
    told, topics, services, robot_node, message, request = answers[len(expected) :]
    assert abs(told["secs"] - time.time()) < 60
    assert "/chatter" in topics
    assert "/lamp" in services
    assert robot_node["publishing"] == ["/chatter"]
    assert message["typedefs"][0]["type"] == "std_msgs/Header"
    assert request["typedefs"][0]["fieldnames"] == ["data"]
