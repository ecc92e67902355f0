"""Verbs on services, actions, nodes and parameters as a user runs them: processes on a DDS network of this machine."""

from __future__ import annotations

import asyncio
import json
import signal
import struct
import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable

import pytest
import yaml
from typer.testing import CliRunner

from ropeway import aio
from ropeway.cli import app
from ropeway.graph.calls import ActionHandlers, GoalStatus, Outcome, Request, ServerGoal
from ropeway.networks.dds import DdsGraph
from tests.graph.parameter_node import ParameterNode
from tests.support.actions import FIBONACCI, sequence
from tests.support.services import ADD
from tests.support.until import PATIENCE_S

NODE = "/robot"

Run = Callable[..., Awaitable[subprocess.CompletedProcess[str]]]


async def add(request: Request) -> bytes:
    """Add the two numbers."""
    return b"\0\1\0\0" + struct.pack("<q", sum(struct.unpack("<qq", request.payload[4:20])))


async def count(goal: ServerGoal) -> Outcome:
    """Count to the order; below zero wait for the cancellation."""
    order = struct.unpack("<i", goal.payload[4:8])[0]
    goal.feedback(sequence(0))
    if order < 0:
        await goal.cancelled.wait()
        return Outcome(GoalStatus.CANCELED, sequence(order))
    return Outcome(GoalStatus.SUCCEEDED, sequence(*range(order)))


async def unless_seven(goal: ServerGoal) -> bool:
    """Take every goal but 7."""
    return goal.payload[4:8] != struct.pack("<i", 7)


@pytest.fixture
async def robot(environment: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[ParameterNode]:
    """A node with a service, an action and parameters on the network of the processes."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", environment["ROS_AUTOMATIC_DISCOVERY_RANGE"])
    graph = DdsGraph(int(environment["ROS_DOMAIN_ID"]), name="robot")
    await graph.open()
    try:
        await graph.create_service("/add", ADD, add)
        await graph.create_action_server("/count", FIBONACCI, ActionHandlers(count, unless_seven))
        yield await ParameterNode({"rate": 2.5, "plugins.name": "x"}, read_only=("rate",)).serve(graph, NODE)
    finally:
        await graph.close()


@pytest.fixture
def start(environment: dict[str, str]) -> Callable[..., Awaitable[asyncio.subprocess.Process]]:
    """Starts the command."""

    async def start(*arguments: str) -> asyncio.subprocess.Process:
        return await asyncio.create_subprocess_exec(
            sys.executable, "-m", "ropeway", *arguments, stdout=-1, stderr=-1, env=environment
        )

    return start


@pytest.fixture
def run(start: Callable[..., Awaitable[asyncio.subprocess.Process]]) -> Run:
    """Runs the command to its end."""

    async def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        process = await start(*arguments)
        async with aio.timeout(PATIENCE_S):
            out, err = await process.communicate()
        assert process.returncode is not None
        return subprocess.CompletedProcess(arguments, process.returncode, out.decode(), err.decode())

    return run


async def test_services(robot: ParameterNode, run: Run) -> None:
    """Services are listed, described and called."""
    listed, typed, told, found, called, as_json, wrong = await asyncio.gather(
        run("service", "list", "-t"),
        run("service", "type", "add"),
        run("service", "info", "/add"),
        run("service", "find", "example_interfaces/AddTwoInts"),
        run("service", "call", "/add", ADD, "{a: 40, b: 2}"),
        run("service", "call", "/add", ADD, '{"a": 1}', "--json"),
        run("service", "call", "/add", ADD, "{c: 1}"),
    )
    assert f"/add [{ADD}]\n" in listed.stdout
    assert "_action" not in listed.stdout
    assert (typed.stdout, typed.returncode) == (f"{ADD}\n", 0)
    assert told.stdout.startswith(f"Type: {ADD}\nClients count: ")
    assert told.stdout.endswith("\nServices count: 1\n")
    assert found.stdout == "/add\n"
    assert called.stdout == (
        "requester: making request: example_interfaces.srv.AddTwoInts_Request(a=40, b=2)\n\n"
        "response:\nexample_interfaces.srv.AddTwoInts_Response(sum=42)\n\n"
    )
    assert json.loads(as_json.stdout) == {"service": "/add", "type": ADD, "response": {"sum": 1}}
    assert (wrong.returncode, wrong.stdout) == (1, "")
    assert "c" in wrong.stderr


async def test_actions(robot: ParameterNode, run: Run) -> None:
    """Actions are listed, described and used."""
    listed, typed, told, found, sent, rejected = await asyncio.gather(
        run("action", "list", "-t"),
        run("action", "type", "/count"),
        run("action", "info", "/count", "--json"),
        run("action", "find", FIBONACCI, "-c"),
        run("action", "send_goal", "/count", FIBONACCI, "{order: 3}", "--feedback"),
        run("action", "send_goal", "/count", FIBONACCI, "{order: 7}"),
    )
    assert listed.stdout == f"/count [{FIBONACCI}]\n"
    assert typed.stdout == f"{FIBONACCI}\n"
    assert len(json.loads(told.stdout)["servers"]) == 1
    assert found.stdout == "1\n"
    assert sent.stdout.startswith("Goal accepted with ID: ")
    assert "Feedback:\n    sequence:\n    - 0\n\n" in sent.stdout
    assert sent.stdout.endswith(
        "Result:\n    sequence:\n    - 0\n    - 1\n    - 2\n\nGoal finished with status: SUCCEEDED\n"
    )
    assert sent.returncode == 0
    assert rejected.returncode == 1
    assert rejected.stderr.splitlines()[-1] == "ropeway: the server of /count rejected the goal"  # it may have waited


async def test_interrupted_goal(
    robot: ParameterNode, start: Callable[..., Awaitable[asyncio.subprocess.Process]]
) -> None:
    """Ctrl-C cancels the goal, prints how it ends, and ends with 130."""
    process = await start("action", "send_goal", "/count", FIBONACCI, "{order: -5}", "--json")
    assert process.stdout is not None
    async with aio.timeout(PATIENCE_S):
        assert json.loads(await process.stdout.readline())["accepted"]
        process.send_signal(signal.SIGINT)
        out, err = await process.communicate()
    assert json.loads(out) == {"status": "CANCELED", "code": 5, "result": {"sequence": [-5]}, "text": ""}
    assert (err, process.returncode) == (b"Canceling goal...\n", 130)


async def test_nodes(robot: ParameterNode, run: Run) -> None:
    """Nodes are listed and described."""
    listed, told, unknown = await asyncio.gather(
        run("node", "list"), run("node", "info", NODE), run("node", "info", "/nobody", "--spin-time", "0.2")
    )
    assert NODE in listed.stdout.splitlines()
    assert told.stdout.startswith(f"{NODE}\n  Subscribers:\n")
    assert f"  Service Servers:\n    /add: {ADD}\n" in told.stdout
    assert f"  Action Servers:\n    /count: {FIBONACCI}\n" in told.stdout
    assert (unknown.returncode, unknown.stderr) == (
        1,
        "ropeway: Unknown node '/nobody'; see `ropeway node list`, or wait longer with --spin-time\n",
    )


async def test_parameters(robot: ParameterNode, run: Run) -> None:
    """Parameters are listed, shown, set, described, dumped and deleted."""
    listed, of_node, got, described, dumped = await asyncio.gather(
        run("param", "list", "--param-type"),
        run("param", "list", NODE, "--json"),
        run("param", "get", NODE, "rate"),
        run("param", "describe", NODE, "rate", "--json"),
        run("param", "dump", NODE),
    )
    assert listed.stdout == f"{NODE}:\n  plugins.name (type: string)\n  rate (type: double)\n"
    assert json.loads(of_node.stdout) == {"node": NODE, "parameters": ["plugins.name", "rate"]}
    assert got.stdout == "Double value is: 2.5\n"
    assert json.loads(described.stdout)["range"] == [0.0, 9.0, 0.5]
    assert yaml.safe_load(dumped.stdout) == {NODE: {"ros__parameters": {"rate": 2.5, "plugins": {"name": "x"}}}}
    done, refused = await asyncio.gather(
        run("param", "set", NODE, "plugins.name", "[1, 2]"), run("param", "set", NODE, "rate", "5.0")
    )
    assert (done.stdout, robot.values["plugins.name"]) == ("Set parameter successful\n", [1, 2])
    assert refused.returncode == 1
    assert refused.stderr == f"ropeway: setting rate of {NODE} to 5.0 (double) failed: rate is read-only\n"
    gone, unset = await asyncio.gather(
        run("param", "delete", NODE, "plugins.name"), run("param", "get", NODE, "nothing")
    )
    assert (gone.stdout, list(robot.values)) == ("Deleted parameter successfully\n", ["rate"])
    assert (unset.returncode, "parameter nothing of /robot is not set" in unset.stderr) == (1, True)


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("service", "type", "/no", "--spin-time", "0.2"), 1, "Unknown service '/no'; see `ropeway service list`"),
        (("service", "info", "a b"), 2, "is not a valid name"),
        (("service", "call", "/no", ADD, "--timeout", "0.2"), 1, "nobody serves /no within 0.2 s"),
        (("service", "call", "/no", "example_interfaces/srv/AddTwoInt"), 1, f"did you mean {ADD}?"),
        (("service", "call", "/no", ADD, "{a: "), 2, "the values cannot be read"),
        (("service", "call", "/no", ADD, "[1]"), 2, "need to be a mapping"),
        (("service", "find", "AddTwoInts"), 1, "is not a type name"),
        (("action", "info", "/no", "--spin-time", "0.2"), 1, "Unknown action '/no'; see `ropeway action list`"),
        (("action", "send_goal", "/no", FIBONACCI, "--timeout", "0.2"), 1, "nobody serves /no within 0.2 s"),
        (("param", "get", "/no", "x", "--timeout", "0.2"), 1, "node /no has no parameter services, or is not there"),
        (("param", "set", "/no"), 2, "Missing argument"),
    ],
)
def test_mistakes_become_sentences(
    environment: dict[str, str], arguments: tuple[str, ...], code: int, words: str
) -> None:
    """A mistake gives one sentence on stderr, nothing on stdout and the code that fits; never a traceback."""
    result = CliRunner().invoke(app, arguments, env={**environment, "COLUMNS": "200"})
    assert isinstance(result.exception, SystemExit)
    assert result.exit_code == code, result.stderr
    assert words in result.stderr
    assert "Traceback" not in result.stderr
