"""What can be done on the pages, as the role allows: driving, topics, the configuration, clients."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from ropeway.control.record import ChangeRecord
from ropeway.gateway.journal import Journal
from ropeway.graph.base import SEQ_NONE, Sample, new_origin
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.qos import LATCHED
from ropeway.types import TypeRegistry
from tests.control.conftest import Begin, Controlled
from tests.dashboard.conftest import Dashboard, Open, Serve
from tests.support.inbox import Inbox
from tests.support.until import until
from tests.support.websocket import Client

STRING, TWIST = "std_msgs/msg/String", "geometry_msgs/msg/Twist"
EVIL = "<img src=x onerror=alert(1)>"
REGISTRY = TypeRegistry()


async def node(running: Controlled) -> MemoryGraph:
    """A node on the network of a gateway; it ends with the test."""
    graph = MemoryGraph(running.gateway.config.gateway.graphs[0].removeprefix("memory:"), node="/node")
    await graph.open()
    return graph


async def on(page: Any, dashboard: Dashboard, path: str) -> Any:
    await page.goto(dashboard.root + path)
    await page.locator(".q-header").wait_for()
    return page


async def grasp(page: Any) -> None:
    """Push the joystick forward, and hold it."""
    pad = page.locator(".joystick")
    await pad.scroll_into_view_if_needed()
    box = await pad.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    await page.mouse.move(x, y)
    await page.mouse.down()
    await page.mouse.move(x, y - box["height"])


def speeds(inbox: Inbox) -> list[float]:
    return [REGISTRY.codec(TWIST).decode(payload)["linear"]["x"] for payload in inbox.payloads]


@pytest.mark.parametrize("end", ["let go", "browser gone"])
async def test_driving(begin: Begin, serve: Serve, open_page: Open, end: str) -> None:
    """A robot moves while the joystick is held, and is stopped when it is let go, or the browser is gone."""
    robot = await begin()
    graph, inbox = await node(robot), Inbox()
    await graph.create_subscription("/cmd_vel", TWIST, None, inbox)
    dashboard = await serve(robot)
    page = await on(await open_page(dashboard.url, width=390, height=844), dashboard, "/drive")
    await page.get_by_text("No gateway that is shown here guards this topic", exact=False).wait_for()
    await grasp(page)
    await until(lambda: len(speeds(inbox)) > 3)
    assert 0.29 < speeds(inbox)[-1] <= 0.3
    if end == "let go":
        await page.mouse.up()
        assert page.faults == []
    else:
        await page.context.close()
    await until(lambda: speeds(inbox)[-1] == 0.0)
    await graph.close()


async def test_a_lease_is_shown(begin: Begin, serve: Serve, open_page: Open) -> None:
    """Whoever drives a topic that a gateway guards sees that it is guarded."""
    robot = await begin(safety=[{"topic": "/cmd_vel", "type": TWIST, "lease_s": 0.5}])
    dashboard = await serve(robot)
    page = await on(await open_page(dashboard.url), dashboard, "/drive")
    await page.get_by_text("guards this topic: nobody drives", exact=False).wait_for()


async def test_a_topic(begin: Begin, serve: Serve, open_page: Open) -> None:
    """A message is shown as text, also one that holds markup; numbers are plotted under their paths."""
    robot = await begin()
    graph = await node(robot)
    for name, type, value in (("/text", STRING, {"data": EVIL}), ("/cmd_vel", TWIST, {"linear": {"x": 0.25}})):
        publisher = await graph.create_publisher(name, type, LATCHED)
        publisher.publish(Sample(REGISTRY.codec(type).from_json(value), type, 1, new_origin(), SEQ_NONE))
    dashboard = await serve(robot)
    page = await on(await open_page(dashboard.url), dashboard, "/topics")
    await page.get_by_role("link", name="/text").click()
    await page.get_by_text(EVIL, exact=False).wait_for()
    assert await page.locator("img[src=x]").count() == 0
    await on(page, dashboard, "/topic?name=/cmd_vel")
    await page.locator("svg[role=img] text").filter(has_text="linear.x: 0.25").wait_for()
    assert page.faults == []
    await graph.close()


async def test_a_topic_that_is_not_there(begin: Begin, serve: Serve, open_page: Open) -> None:
    """A name that nobody publishes, and one that is markup, are answered with a sentence."""
    dashboard = await serve(await begin())
    page = await on(await open_page(dashboard.url), dashboard, "/topic?name=/nothing")
    await page.get_by_text("nobody publishes it", exact=False).wait_for()
    await on(page, dashboard, "/topic?name=%3Cimg+src%3Dx+onerror%3Dalert(1)%3E")
    await page.get_by_text("has a character other than", exact=False).wait_for()
    assert page.faults == []


async def test_a_configuration_is_planned_applied_and_taken_back(
    begin: Begin, serve: Serve, open_page: Open, tmp_path: Path
) -> None:
    """The editor's text is planned and applied, what is wrong with it is said by its path, and history leads back."""
    robot = await begin()
    robot.manager.record = ChangeRecord(Journal(tmp_path / "robot.journal"))
    before = robot.manager.config.etag
    dashboard = await serve(robot)
    page = await on(await open_page(dashboard.url), dashboard, "/configuration")
    await page.locator(".cm-content").wait_for()
    said = page.locator(".wraps")

    async def write(*remotes: dict[str, Any]) -> None:
        graph = robot.gateway.config.gateway.graphs[0]
        gateway = {"name": robot.control.name, "graphs": [graph], "listen": []}
        await page.locator(".cm-content").fill(json.dumps({"gateway": gateway, "remotes": remotes}))

    await write({"address": "ws://127.0.0.1:9", "publsh": []})
    await page.get_by_role("button", name="Plan").click()
    await said.filter(has_text="remotes[0].publsh").first.wait_for()
    await write({"address": "ws://127.0.0.1:9", "publish": [{"name": "/a", "type": STRING}]})
    await page.get_by_role("button", name="Plan").click()
    await said.filter(has_text="What would be done").first.wait_for()
    assert robot.manager.config.etag == before
    await page.get_by_role("button", name="Apply").click()
    await said.filter(has_text="This was done").first.wait_for()
    assert [route.name for route in robot.manager.config.routes()] == ["/a"]
    await write()
    await page.get_by_role("button", name="Apply").click()
    await until(lambda: not robot.manager.config.routes())
    await page.get_by_role("button", name="go back to it").nth(1).click()
    await until(lambda: robot.manager.config.routes())


async def test_somebody_was_faster(begin: Begin, serve: Serve, open_page: Open) -> None:
    """A configuration that was read before somebody else changed it is not applied, and the page says so."""
    robot = await begin()
    dashboard = await serve(robot)
    page = await on(await open_page(dashboard.url), dashboard, "/configuration")
    await page.locator(".cm-content").wait_for()
    body = {"remote": "ws://127.0.0.1:9", "operation": "publish", "item": {"name": "/a", "type": STRING}}
    assert (await robot.client.post("/v1/routes", json=body)).status_code == 200
    await page.get_by_role("button", name="Apply").click()
    await page.get_by_text("somebody else has changed the configuration", exact=False).wait_for()
    assert [route.name for route in robot.manager.config.routes()] == ["/a"]


async def test_a_client_is_disconnected(begin: Begin, serve: Serve, open_page: Open) -> None:
    """A press disconnects one client."""
    robot = await begin(listen=["ws://127.0.0.1:0"])
    dashboard = await serve(robot)
    page = await on(await open_page(dashboard.url), dashboard, "/sessions")
    async with Client(robot.gateway.servers[0].listeners[0].port):
        await page.get_by_role("button", name="disconnect").click()
        await until(lambda: not robot.gateway.servers[0].sessions)
    await page.get_by_text("Nobody is connected").wait_for()


async def test_a_role_that_may_only_look(
    begin: Begin, serve: Serve, open_page: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever logs in with a token sees what its role may see, and is told which right a button needs."""
    monkeypatch.setenv("WATCHER", "0123456789abcdef")
    robot = await begin(
        control={"listen": ["http://127.0.0.1:0"]},
        auth={
            "tokens": [{"token": {"env": "WATCHER"}, "role": "watcher"}],
            "roles": {"watcher": {"control": ["observe"], "subscribe": ["*"]}},
        },
    )
    dashboard = await serve(robot.control.addresses[0], str(robot.target.socket))
    page = await open_page(f"{dashboard.root}/login")
    await page.locator("#secret").fill("0123456789abcdef")
    await page.get_by_role("button", name="Log in").click()
    await page.locator(".q-header").wait_for()
    await on(page, dashboard, "/drive")
    await page.get_by_text('role watcher lacks the right "operate"', exact=False).wait_for()
    await on(page, dashboard, "/configuration")
    assert await page.get_by_role("button", name="Apply").is_disabled()
    await page.get_by_text("Log out").click()
    await page.locator("#secret").wait_for()
    assert page.faults == []


async def test_other_pages(begin: Begin, serve: Serve, open_page: Open) -> None:
    """Pages about what a gateway does not have say so, and fit a phone."""
    dashboard = await serve(await begin())
    page = await open_page(dashboard.url, width=390, height=844)
    for path, text in (
        ("/overlay", "a member of no overlay"),
        ("/groups", "has no group"),
        ("/store", "has no store"),
        ("/events", "Nothing has happened"),
        ("/audit", "audit"),
    ):
        await on(page, dashboard, path)
        await page.get_by_text(text, exact=False).first.wait_for()
        assert await page.evaluate("document.documentElement.scrollWidth") == 390
    assert page.faults == []
