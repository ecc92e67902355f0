"""ropeway.control.resources.anycast and ``ropeway anycast``: groups as people see and command them."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import httpx
from typer.testing import CliRunner

from ropeway.cli import app
from tests.control.conftest import Begin, Controlled
from tests.support.until import until

HEADERS = {"content-type": "application/json"}


def address(edge: Controlled) -> str:
    """Return where a machine's gateway listens."""
    return f"ws://127.0.0.1:{edge.gateway.servers[0].listeners[0].port}"


async def grouped(begin: Begin) -> tuple[Controlled, list[str]]:
    """Begin two machines and a robot that has them as a group; return it and their addresses."""
    edges = [await begin(listen=["ws://127.0.0.1:0"]) for _ in range(2)]
    addresses = [address(edge) for edge in edges]
    remote = {
        "address": addresses,
        "title": "edges",
        "anycast": {"initial_policy": {"robot": "robot", "one": "service", "two": "standby"}},
        "publish": [{"name": "/camera", "type": "std_msgs/msg/String"}],
    }
    robot = await begin([remote])
    await until(lambda: all(m["here"] for m in robot.gateway.status()["remotes"][0]["group"]["members"].values()))
    return robot, addresses


async def post(robot: Controlled, what: str, **body: Any) -> httpx.Response:
    """Command a group."""
    return await robot.client.post(f"/v1/anycast/{what}", content=json.dumps(body), headers=HEADERS)


async def test_switch_and_pause(begin: Begin) -> None:
    """A member is used by its address or its name in the policy, and kept while the scheduler pauses."""
    robot, addresses = await grouped(begin)
    found = (await robot.client.get("/v1/anycast")).json()
    assert [group["current"] for group in found] == [addresses[0]]
    assert (await post(robot, "switch", member="two")).json()["current"] == addresses[1]
    assert (await post(robot, "switch", member=addresses[0], group="edges")).json()["current"] == addresses[0]
    assert (await post(robot, "pause")).json()["held"] is True
    assert (await post(robot, "pause", paused=False)).json()["held"] is False


async def test_mistakes(begin: Begin) -> None:
    """A member or a group that there is not is answered with those that there are, and so is a gateway without one."""
    robot, _ = await grouped(begin)
    answer = await post(robot, "switch", member="tow")
    assert answer.status_code == 409 and 'did you mean "two"?' in answer.json()["error"]
    answer = await post(robot, "switch", member="two", group="clouds")
    assert answer.status_code == 404 and "there are: edges" in answer.json()["error"]
    assert (await post(robot, "switch")).status_code == 422
    alone = await begin()
    assert (await alone.client.get("/v1/anycast")).json() == []
    answer = await post(alone, "profile")
    assert answer.status_code == 409 and answer.json()["error"] == "this gateway has no group"


async def run(*args: str) -> str:
    """Run the command, and return what it prints."""
    result = await asyncio.to_thread(CliRunner().invoke, app, ["anycast", *args])
    assert result.exit_code == 0, result.output
    return result.output


async def test_on_the_command_line(begin: Begin) -> None:
    """The verbs show a table or JSON, and do what they say."""
    robot, addresses = await grouped(begin)
    name = robot.control.name
    table = await run("status", name)
    assert "in use" in table and "standby" in table and "edges" in table
    assert json.loads(await run("status", name, "--json"))["current"] == addresses[0]
    assert json.loads(await run("switch", "two", "-G", name, "--json"))["current"] == addresses[1]
    assert json.loads(await run("pause", name, "--json"))["held"] is True
    assert json.loads(await run("pause", name, "--off", "--json"))["held"] is False
