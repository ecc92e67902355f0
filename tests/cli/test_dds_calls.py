"""Verbs on services, actions, nodes and parameters as a user runs them: processes on a DDS network of this machine."""

from __future__ import annotations

import asyncio
import json
import signal
import struct
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from ropeway import aio
from ropeway.cli import app
from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.graph.calls import ActionHandlers, GoalStatus, Outcome, Request, ServerGoal
from ropeway.networks.dds import DdsGraph
from ropeway.qos import LATCHED
from ropeway.types import TypeRegistry
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
async def graph(environment: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[DdsGraph]:
    """A participant on the network of the processes."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", environment["ROS_AUTOMATIC_DISCOVERY_RANGE"])
    graph = DdsGraph(int(environment["ROS_DOMAIN_ID"]), name="robot")
    await graph.open()
    yield graph
    await graph.close()


@pytest.fixture
async def robot(graph: DdsGraph) -> ParameterNode:
    """A node with a service, an action and parameters on the network of the processes."""
    await graph.create_service("/add", ADD, add)
    await graph.create_action_server("/count", FIBONACCI, ActionHandlers(count, unless_seven))
    return await ParameterNode({"rate": 2.5, "plugins.name": "x"}, read_only=("rate",)).serve(graph, NODE)


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


async def test_parameters_of_a_file(robot: ParameterNode, run: Run, tmp_path: Path) -> None:
    """What a file has for a node is set, each parameter on its own; one that is refused is told."""
    (tmp_path / "p.yaml").write_text(f"{NODE}: {{ros__parameters: {{plugins: {{name: y}}, rate: 3.0}}}}")
    ended = await run("param", "load", NODE, str(tmp_path / "p.yaml"), "--timeout", "60")
    assert ended.stderr == "Setting parameter rate failed: rate is read-only\n"
    assert ended.stdout == "Set parameter plugins.name successful\n"
    assert (ended.returncode, robot.values["plugins.name"]) == (1, "y")


async def test_events_of_a_service(graph: DdsGraph, robot: ParameterNode, run: Run) -> None:
    """The calls of a service are printed as its nodes tell of them; where none does, it is said how they would."""
    event = f"{ADD}_Event"
    publisher = await graph.create_publisher("/add/_service_event", event, LATCHED)
    codec = TypeRegistry().codec(event)
    payload = codec.from_json({"info": {"event_type": 1}, "request": [{"a": 1, "b": 2}]})
    publisher.publish(Sample(payload, event, time.time_ns(), bytes(16), SEQ_NONE))
    shown, silent = await asyncio.gather(
        run("service", "echo", "/add", "--once", "--json"),
        run("service", "echo", "/other", ADD, "--once", "--timeout", "0.5"),
    )
    message = json.loads(shown.stdout)["msg"]
    assert (message["info"]["event_type"], message["request"], message["response"]) == (1, [{"a": 1, "b": 2}], [])
    assert silent.returncode == 1
    assert "configure_introspection" in silent.stderr


class Managed:
    """A managed node: unconfigured at first; it can be configured, but never activated."""

    def __init__(self) -> None:
        self.label, self.number = "unconfigured", 1
        self.registry = TypeRegistry()

    async def serve(self, graph: DdsGraph, node: str) -> None:
        """Offer the services of a managed node."""
        for name, type, answer in (
            ("get_state", "GetState", self._state),
            ("get_available_transitions", "GetAvailableTransitions", self._transitions),
            ("get_transition_graph", "GetAvailableTransitions", self._graph),
            ("change_state", "ChangeState", self._change),
        ):
            await self._offer(graph, f"{node}/{name}", f"lifecycle_msgs/srv/{type}", answer)

    async def _offer(self, graph: DdsGraph, name: str, type: str, answer: Callable[..., dict[str, Any]]) -> None:
        async def handle(request: Request) -> bytes:
            asked = self.registry.codec(f"{type}_Request").decode(request.payload)
            return self.registry.codec(f"{type}_Response").from_json(answer(asked))

        await graph.create_service(name, type, handle)

    def _state(self, asked: dict[str, Any]) -> dict[str, Any]:
        return {"current_state": {"id": self.number, "label": self.label}}

    def _transitions(self, asked: dict[str, Any]) -> dict[str, Any]:
        known = (1, "configure", "inactive") if self.number == 1 else (3, "activate", "active")
        return {
            "available_transitions": [
                {
                    "transition": {"id": known[0], "label": known[1]},
                    "start_state": {"label": self.label},
                    "goal_state": {"label": known[2]},
                }
            ]
        }

    def _graph(self, asked: dict[str, Any]) -> dict[str, Any]:
        return {"available_transitions": self._transitions(asked)["available_transitions"] * 3}

    def _change(self, asked: dict[str, Any]) -> dict[str, Any]:
        if asked["transition"]["id"] != 1:
            return {"success": False}
        self.label, self.number = "inactive", 2
        return {"success": True}


async def test_managed_nodes(graph: DdsGraph, run: Run) -> None:
    """Managed nodes are listed, tell their state, and change it if they can."""
    await Managed().serve(graph, "/arm")
    listed, state, of_all, possible, every, unmanaged, wrong = await asyncio.gather(
        run("lifecycle", "nodes"),
        run("lifecycle", "get", "/arm"),
        run("lifecycle", "get", "--json"),
        run("lifecycle", "list", "/arm"),
        run("lifecycle", "list", "/arm", "-a", "--json"),
        run("lifecycle", "get", "/nobody", "--timeout", "0.3"),
        run("lifecycle", "set", "/arm", "fly"),
    )
    assert listed.stdout == "/arm\n"
    assert state.stdout == "unconfigured [1]\n"
    assert json.loads(of_all.stdout) == {"node": "/arm", "state": "unconfigured", "id": 1}
    assert possible.stdout == "- configure [1]\n\tStart: unconfigured\n\tGoal: inactive\n"
    assert len(json.loads(every.stdout)) == 3
    assert (unmanaged.returncode, "lifecycle nodes" in unmanaged.stderr) == (1, True)
    assert "possible are: configure [1]" in wrong.stderr
    done = await run("lifecycle", "set", "/arm", "1")
    assert done.stdout == "Transitioning successful\n"
    failed = await run("lifecycle", "set", "/arm", "activate", "--json")
    assert failed.returncode == 1
    assert json.loads(failed.stdout) == {"node": "/arm", "transition": "activate", "success": False}


async def test_topics_by_type(graph: DdsGraph, robot: ParameterNode, run: Run) -> None:
    """The type of a topic is told, and the topics of a type are found."""
    await graph.create_publisher("/chatter", "std_msgs/msg/String")
    typed, found, counted, unknown = await asyncio.gather(
        run("topic", "type", "chatter"),
        run("topic", "find", "std_msgs/String", "--json"),
        run("topic", "find", "std_msgs/msg/Bool", "-c"),
        run("topic", "type", "/nothing", "--spin-time", "0.2"),
    )
    assert typed.stdout == "std_msgs/msg/String\n"
    assert json.loads(found.stdout) == [{"name": "/chatter", "types": ["std_msgs/msg/String"]}]
    assert counted.stdout == "0\n"
    assert (unknown.returncode, unknown.stderr.split(";")[0]) == (1, "ropeway: Unknown topic '/nothing'")
