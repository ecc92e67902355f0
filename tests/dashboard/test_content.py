"""Pages of a gateway that has something to show: an overlay, a group with latencies, kept values, events, audit."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from ropeway.audit.files import AuditFiles
from ropeway.audit.trail import AuditTrail
from ropeway.graph.base import SEQ_NONE, Publisher, Sample, new_origin
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.overlay.crypto.identity import write_private
from ropeway.qos import QoS
from ropeway.types import TypeRegistry
from tests.control.conftest import Begin, Controlled
from tests.dashboard.conftest import Dashboard, Open, Serve
from tests.networks.overlay.conftest import Site
from tests.networks.overlay.conftest import site as site
from tests.networks.overlay.fleet import member
from tests.support.until import until

POINT = "geometry_msgs/msg/PointStamped"
STRING = "std_msgs/msg/String"
EVIL = "<img src=x onerror=alert(1)>"
REGISTRY = TypeRegistry()
PICTURES = os.environ.get("ROPEWAY_PICTURES", "")
"""A directory for pictures of the pages, for whoever wants to look at them."""


class Full(NamedTuple):
    """A robot that has everything, and a dashboard that shows it."""

    robot: Controlled
    dashboard: Dashboard
    edges: list[str]


async def _graph(stack: AsyncExitStack, running: Controlled, node: str) -> MemoryGraph:
    graph = MemoryGraph(running.gateway.config.gateway.graphs[0].removeprefix("memory:"), node=node)
    await graph.open()
    stack.push_async_callback(graph.close)
    return graph


async def _answering(machine: MemoryGraph) -> None:
    """Answer each question with a message of the same stamp."""
    answers = await machine.create_publisher("/answer", POINT)

    def asked(batch: Sequence[Sample]) -> None:
        for sample in batch:
            answers.publish(Sample(sample.payload, POINT, sample.stamp_ns, new_origin(), SEQ_NONE))

    await machine.create_subscription("/question", POINT, None, asked)


async def _ask(questions: Publisher) -> None:
    """Ask again and again, since latencies are forgotten with time."""
    while True:
        stamp_ns = time.time_ns()
        header = {"stamp": {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}}
        payload = REGISTRY.codec(POINT).encode({"header": header})
        questions.publish(Sample(payload, POINT, stamp_ns, new_origin(), SEQ_NONE))
        await asyncio.sleep(0.05)


@pytest.fixture
async def full(begin: Begin, serve: Serve, site: Site, tmp_path: Path) -> AsyncIterator[Full]:
    """Begin a robot with an overlay, a group that was called, a store, and what happens to them."""
    trail = AuditTrail(AuditFiles(tmp_path / "audit", file_bytes=1 << 20, files=2, file_days=1.0, keep_days=1.0))
    async with AsyncExitStack() as stack:
        stack.callback(trail.close)
        edges = [await begin(listen=["ws://127.0.0.1:0"]) for _ in range(2)]
        for edge in edges:
            await _answering(await _graph(stack, edge, "/planner"))
        addresses = [f"ws://127.0.0.1:{edge.gateway.servers[0].listeners[0].port}" for edge in edges]
        group = {
            "address": addresses,
            "title": "planners",
            "anycast": {"responses": {"question": "answer"}, "latency_bound": {"median": 5.0}},
            "publish": [item("/question", POINT)],
            "subscribe": [item("/answer", POINT)],
        }
        bundle = tmp_path / "robot.ropeway"
        write_private(bundle, member("robot").to_text())
        overlay = {"identity": str(bundle), "routers": [site.endpoint], "listen": []}
        kept = {"address": "overlay", "publish": [item("/note", STRING, store=True)]}
        robot = await begin(
            [group, kept], trail=trail, overlay=overlay, store={"path": str(tmp_path / "store.sqlite")}, insecure=True
        )
        await site.join(member("cloud"), alone=True)
        here = await _graph(stack, robot, "/camera")
        await here.create_subscription("/answer", POINT, None, lambda _: None)
        questions = await here.create_publisher("/question", POINT)
        await until(lambda: questions.subscribers)
        asking = asyncio.create_task(_ask(questions))
        stack.callback(asking.cancel)
        note = await here.create_publisher("/note", STRING, QoS())
        await until(lambda: note.subscribers)
        note.publish(Sample(REGISTRY.codec(STRING).encode({"data": EVIL}), STRING, 1, new_origin(), SEQ_NONE))
        key = robot.gateway.config.routes()[-1].key
        json = {"content-type": "application/json"}
        for what in ("pause", "resume"):
            answer = await robot.client.post(f"/v1/routes/{key}/{what}", headers=json)
            assert answer.status_code == 200, answer.text
        yield Full(robot, await serve(robot), addresses)


def item(name: str, type: str, **more: Any) -> dict[str, Any]:
    """Return a route."""
    return {"name": name, "type": type, **more}


async def shown(page: Any, full: Full, path: str, *texts: str) -> None:
    """Go to a page and wait until it shows these texts; keep a picture of it where pictures are wanted."""
    await page.goto(full.dashboard.root + path)
    for text in texts:
        await page.get_by_text(text, exact=False).locator("visible=true").first.wait_for(timeout=20_000)
    width = page.viewport_size["width"]
    assert await page.evaluate("document.documentElement.scrollWidth") == width, path
    if PICTURES:
        await page.screenshot(path=f"{PICTURES}/{path.strip('/') or 'map'}-{width}.png", full_page=True)


@pytest.mark.timeout(300)
@pytest.mark.parametrize(("width", "height"), [(1100, 760), (390, 844)])
async def test_pages_with_content(full: Full, open_page: Open, width: int, height: int) -> None:
    """Each page shows what the gateway has, readable on a screen and on a phone, and markup of others as text."""
    page = await open_page(full.dashboard.url, width=width, height=height)
    await shown(page, full, "/", "planners")
    await shown(page, full, "/routes", "/question", "/note")
    await shown(page, full, "/overlay", "cloud", "router", "the certificate expires")
    await shown(page, full, "/groups", "policy", "median", "answered")
    assert await page.locator("svg[role=img] rect").count() >= 1
    await shown(page, full, "/store", "note", EVIL, "values: 1")
    assert await page.locator("img[src=x]").count() == 0
    await shown(page, full, "/events", "link", "config", "route pause")
    await shown(page, full, "/audit", "route pause", "route resume", "done")
    await shown(page, full, "/sessions", "Nobody is connected")
    assert page.faults == []


async def test_a_group_is_commanded(full: Full, open_page: Open) -> None:
    """Another member is used, and the scheduler paused, by the buttons of the page; the audit log has both."""
    page = await open_page(full.dashboard.url)
    await page.goto(f"{full.dashboard.root}/groups")
    group = full.robot.gateway.status
    before = group()["remotes"][0]["group"]["current"]
    other = next(edge for edge in full.edges if edge != before)
    await page.get_by_label("Member").click()
    await page.get_by_role("option", name=other).click()
    await page.get_by_role("button", name="Use it").click()
    await until(lambda: group()["remotes"][0]["group"]["current"] == other)
    await page.get_by_role("button", name="Pause or go on").click()
    await page.get_by_text(", paused,", exact=False).wait_for()
    await shown(page, full, "/audit", "anycast switch", "anycast pause")
    assert page.faults == []
