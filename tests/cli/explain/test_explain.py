"""``ropeway explain``."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from ropeway.cli import app
from ropeway.cli.explain.trial import only_routes_of, try_out
from ropeway.cli.explain.words import lines
from ropeway.gateway.config.config import parse
from ropeway.gateway.explain import Subject
from ropeway.gateway.gateway import Gateway
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.qos import QoS
from tests.support.inbox import Inbox
from tests.support.messages import STRING


def item(name: str) -> dict[str, Any]:
    """Make a route of strings."""
    return {"name": name, "type": STRING}


@pytest.fixture
async def cloud(request: pytest.FixtureRequest) -> AsyncIterator[Gateway]:
    """A gateway in the cloud, with a network of its own."""
    settings = {"name": "cloud", "graphs": [f"memory:cloud-{request.node.name}"], "listen": ["ws://127.0.0.1:0"]}
    async with Gateway(parse({"gateway": settings})) as gateway:
        yield gateway


def robot(directory: Path, request: pytest.FixtureRequest, port: int) -> Path:
    """Write the configuration of a robot's gateway."""
    file = directory / "robot.json"
    remote = {"address": f"ws://127.0.0.1:{port}", "publish": [item("/odom"), item("/other")]}
    settings = {"name": "robot", "graphs": [f"memory:robot-{request.node.name}"]}
    file.write_text(json.dumps({"gateway": settings, "remotes": [remote]}))
    return file


async def test_tries_a_configuration(cloud: Gateway, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """Without a running gateway, the route is tried: it crosses where both ends are there."""
    file = robot(tmp_path, request, cloud.servers[0].listeners[0].port)
    driver = MemoryGraph(f"robot-{request.node.name}", node="/driver")
    rviz = MemoryGraph(f"cloud-{request.node.name}", node="/rviz")
    await driver.open()
    await rviz.open()
    await driver.create_publisher("/odom", STRING)
    await rviz.create_subscription("/odom", STRING, QoS(), Inbox())
    (found,) = await try_out(file, "/odom", "", 60.0)
    assert found.crosses
    (found,) = await try_out(file, "/other", "", 0.5)
    assert {finding.subject for finding in found.findings if finding.ok is False} == {Subject.SOURCE, Subject.READERS}
    await driver.close()
    await rviz.close()


def test_only_the_route_in_question() -> None:
    """What is tried has no other route, no listener, no workers and no store."""
    remotes = [{"address": "ws://a", "publish": [item("/odom"), item("/b")]}, {"address": "ws://b"}]
    config = parse({"gateway": {"store": {}}, "remotes": remotes})
    narrow = only_routes_of(config, "/odom")
    assert [route.name for route in narrow.routes()] == ["/odom"]
    assert narrow.gateway.listen == ()
    assert narrow.gateway.workers == 0
    assert not narrow.stores


def test_a_name_without_a_route(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """A name that no route carries is exit status 1, with the nearest that one does."""
    result = CliRunner().invoke(app, ["explain", "/odmo", str(robot(tmp_path, request, 1))])
    assert result.exit_code == 1
    assert 'no route of the configuration carries /odmo; did you mean "/odom"?' in result.stdout


def test_a_link_that_is_down(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """A remote that cannot be reached is told, and nothing is said of what would be there."""
    file = robot(tmp_path, request, 1)
    result = CliRunner().invoke(app, ["explain", "/odom", str(file), "--spin-time", "0.5", "--json"])
    assert result.exit_code == 1
    (found,) = json.loads(result.stdout)
    failed = [finding["subject"] for finding in found["findings"] if finding["ok"] is False]
    assert failed == ["network", "link"]


def test_words() -> None:
    """An explanation is a heading, a line per step and a verdict."""
    finding = {"ok": True, "text": "1 publisher of /odom"}
    found = {"name": "/odom", "source": "dds:0", "target": "ws://cloud", "path": "remotes[0].publish[0]"}
    assert list(lines([{**found, "findings": [finding]}])) == [
        "/odom dds:0 -> ws://cloud (remotes[0].publish[0])",
        "  ok  1 publisher of /odom",
        "It crosses.",
    ]
    unsure = {"ok": None, "text": "no message has come yet"}
    assert list(lines([{**found, "findings": [finding, unsure]}]))[-2:] == [
        "   ?  no message has come yet",
        "Nothing is known to be in its way.",
    ]
    wrong = {"ok": False, "text": "nobody reads /odom"}
    assert list(lines([{**found, "findings": [wrong]}]))[-1] == "It does not cross: nobody reads /odom"
