"""What crosses routes, and what nodes send, is in the audit log where the configuration asks for it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ropeway.audit.files import AuditFiles
from ropeway.audit.trail import AuditTrail
from ropeway.gateway.config import config
from ropeway.gateway.gateway import Gateway
from ropeway.gateway.process.supervisor import Supervisor
from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Outcome, Request, ServerGoal
from ropeway.qos import QoS
from tests.iort.servers import Raw
from tests.support.inbox import Inbox
from tests.support.messages import STRING, joined, sample, text
from tests.support.ports import free_port
from tests.support.services import ADD, add, addends
from tests.support.until import PATIENCE_S, until
from tests.support.websocket import Client
from tests.support.world import World

FIBONACCI = "example_interfaces/action/Fibonacci"
GOAL = b"\0\1\0\0\3\0\0\0"


class Log:
    """An audit log in a file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.trail = AuditTrail(AuditFiles(path, file_bytes=1 << 20, files=2, file_days=1.0, keep_days=1.0))

    def commands(self) -> list[dict[str, Any]]:
        """Return the commands that are written down by now."""
        lines = self.path.read_text().splitlines() if self.path.exists() else []
        return [entry for entry in map(json.loads, lines) if entry["kind"] == "command"]


@pytest.fixture
def log(tmp_path: Path) -> Iterator[Log]:
    """Begin a log."""
    log = Log(tmp_path / "audit")
    yield log
    log.trail.close()


def digest(payload: bytes) -> str:
    """Return the hash that stands for a payload."""
    return hashlib.sha256(payload).hexdigest()


async def begin(world: World, log: Log, remotes: list[dict[str, Any]], **settings: Any) -> Gateway:
    """Begin a gateway that tells the log."""
    given = {"name": "robot", "graphs": [f"memory:{world.network('robot')}"], "listen": [], **settings}
    gateway = Gateway(config.parse({"gateway": given, "remotes": remotes}), audit=log.trail)
    return await world.stack.enter_async_context(gateway)


async def test_topics_calls_and_goals_of_routes(world: World, log: Log) -> None:
    """What crosses a route with ``audit`` is written down with its hash, and nothing of the routes beside it."""
    cloud = await world.gateway("cloud", [])
    topics = [{"name": "/cmd", "type": STRING, "audit": True}, {"name": "/chatter", "type": STRING}]
    routes = {
        "subscribe": topics,
        "expose-service": [{"name": "/add", "type": ADD, "audit": True}],
        "expose-action": [{"name": "/fib", "type": FIBONACCI, "audit": True}],
    }
    url = f"ws://127.0.0.1:{cloud.servers[0].listeners[0].port}"
    await begin(world, log, [{"address": url, **routes}])
    here, there = await world.robot("robot"), await world.robot("cloud")
    inbox = Inbox()
    for name in ("/cmd", "/chatter"):
        subscription = await here.create_subscription(name, STRING, QoS(), inbox)
        publisher = await there.create_publisher(name, STRING)
        await joined(publisher)
        publisher.publish(sample(name))
        await inbox.wait(1)
        await subscription.close()
    await here.create_service("/add", ADD, add)

    async def execute(goal: ServerGoal) -> Outcome:
        return Outcome(GoalStatus.SUCCEEDED, b"\0\1\0\0\0\0\0\0")

    await here.create_action_server("/fib", FIBONACCI, ActionHandlers(execute))
    client, user = await there.create_client("/add", ADD), await there.create_action_client("/fib", FIBONACCI)
    assert await client.wait_available(PATIENCE_S)
    assert await user.wait_available(PATIENCE_S)
    await client.call(Request(addends(40, 2)), PATIENCE_S)
    await (await user.send_goal(Goal(GOAL), timeout_s=PATIENCE_S)).result(PATIENCE_S)
    await until(lambda: len(log.commands()) == 3)
    found = {(entry["operation"], entry["name"]): entry for entry in log.commands()}
    assert {key: entry["sha256"] for key, entry in found.items()} == {
        ("publish", "/cmd"): digest(text("/cmd")),
        ("call_service", "/add"): digest(addends(40, 2)),
        ("send_action_goal", "/fib"): digest(GOAL),
    }
    assert {entry["where"] for entry in found.values()} == {url}
    assert found["publish", "/cmd"]["details"] == {"route": "subscribe /cmd"}


async def test_packets_of_nodes(world: World, log: Log) -> None:
    """What a node publishes is written down where its role and the name ask for it."""
    settings = {
        "listen": ["iort://127.0.0.1:0"],
        "iort": {"maps": ["turtlesim"]},
        "store": {"path": "memory:"},
        "audit": {"commands": [{"names": ["/TURTLESIM/*"]}]},
    }
    gateway = await begin(world, log, [], **settings)
    assert gateway.nodes is not None
    node = await Raw.connect(gateway.nodes.server.listeners[0].port)
    node.send(b"%01/PEPPER/cmd_vel/p/9,9%")
    node.send(b"%01/TURTLESIM/cmd_vel/p/0.2,0,0,0,0,0%")
    await until(lambda: log.commands())
    await node.close()
    [entry] = log.commands()
    assert (entry["operation"], entry["name"]) == ("publish", "/TURTLESIM/cmd_vel")
    assert entry["sha256"] == digest(b"0.2,0,0,0,0,0")


@pytest.mark.timeout(180)
async def test_workers_tell_the_one_that_writes(log: Log) -> None:
    """What clients of any worker command and are denied is in the one log."""
    port = free_port()
    role = {"publish": ["/cmd"]}
    settings = {
        "name": "workers",
        "graphs": ["memory:audited-workers"],
        "listen": [f"ws://127.0.0.1:{port}"],
        "workers": 2,
        "auth": {"default_role": "driver", "roles": {"driver": role}},
        "audit": {"commands": [{"roles": ["driver"]}]},
    }
    supervisor = Supervisor(config.parse({"gateway": settings, "remotes": []}), log_level="WARNING", audit=log.trail)
    async with supervisor, Client(port) as driver:
        for topic in ("/cmd", "/forbidden"):
            driver.send({"op": "advertise", "topic": topic, "type": STRING})
            driver.send({"op": "publish", "topic": topic, "msg": {"data": topic}})
        await until(lambda: log.commands() and "denied" in log.path.read_text())
    assert [(entry["name"], entry["sha256"]) for entry in log.commands()] == [("/cmd", digest(text("/cmd")))]
