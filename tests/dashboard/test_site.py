"""The pages in a browser, with gateways that run."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from tests.control.conftest import Begin, Controlled
from tests.dashboard.conftest import Open, Serve

STRING = "std_msgs/msg/String"
EVIL = "<img src=x onerror=alert(1)>"


async def pair(begin: Begin, *routes: dict[str, Any], title: str = "") -> tuple[Controlled, Controlled]:
    """A cloud, and a robot that dials it."""
    cloud = await begin(listen=["ws://127.0.0.1:0"])
    port = cloud.gateway.servers[0].listeners[0].port
    remote = {"address": f"ws://127.0.0.1:{port}", "publish": list(routes), **({"title": title} if title else {})}
    return cloud, await begin([remote])


def drawn(page: Any, text: str) -> Any:
    """A text on the drawing that is seen."""
    return page.locator("svg[role=img]:visible text").filter(has_text=text).first


async def test_a_map_shows_gateways_links_and_routes(begin: Begin, serve: Serve, open_page: Open) -> None:
    """The map names both gateways, and the route between them with its state."""
    cloud, robot = await pair(begin, {"name": "/chatter", "type": STRING})
    dashboard = await serve(robot, cloud)
    page = await open_page(dashboard.url)
    for text in (robot.control.name, cloud.control.name, "/chatter", "connected"):
        await drawn(page, text).wait_for()
    assert page.faults == []


async def test_a_route_says_why_nothing_crosses(begin: Begin, serve: Serve, open_page: Open) -> None:
    """A press on "why?" shows the steps from publisher to reader."""
    _, robot = await pair(begin, {"name": "/chatter", "type": STRING})
    dashboard = await serve(robot)
    page = await open_page(dashboard.url)
    await page.goto(f"{dashboard.root}/routes")
    await page.get_by_text("why?").click()
    await page.get_by_text("/chatter does not cross").wait_for()
    assert page.faults == []


@pytest.mark.parametrize("width", [390, 1100])
async def test_names_are_no_markup(begin: Begin, serve: Serve, open_page: Open, width: int) -> None:
    """A title that holds markup is shown as it is written, on all pages, and nothing of it runs."""
    _, robot = await pair(begin, {"name": "/chatter", "type": STRING}, title=EVIL)
    dashboard = await serve(robot)
    page = await open_page(dashboard.url, width=width)
    await drawn(page, "onerror" if width > 400 else "img").wait_for()
    assert await page.locator("img[src=x]").count() == 0
    assert page.faults == []


async def test_a_gateway_that_goes_and_comes_back(begin: Begin, serve: Serve, open_page: Open) -> None:
    """The page says that a gateway is away, and shows it again once it answers."""
    robot = await begin()
    dashboard = await serve(robot)
    page = await open_page(dashboard.url)
    await drawn(page, robot.control.name).wait_for()
    await robot.control.__aexit__()
    await page.get_by_text("nobody answers there", exact=False).wait_for()
    async with robot.control:
        await page.get_by_text("nobody answers there", exact=False).wait_for(state="hidden")
        await drawn(page, "0 topics").wait_for()
    assert page.faults == []


async def test_a_page_fits_a_phone(begin: Begin, serve: Serve, open_page: Open) -> None:
    """No page is wider than a phone, and a table becomes cards."""
    cloud, robot = await pair(begin, {"name": "/a/rather/long/name/of/a/topic/that/nobody/shortens", "type": STRING})
    dashboard = await serve(robot, cloud)
    page = await open_page(dashboard.url, width=390, height=844)
    await page.locator(".q-header").wait_for()
    for path in ("/", "/routes"):
        await page.goto(dashboard.root + path)
        await page.locator(".q-header").wait_for()
        assert await page.evaluate("document.documentElement.scrollWidth") == 390


async def test_a_stalled_browser_is_sent_nothing_more(begin: Begin, serve: Serve, open_page: Open) -> None:
    """While the scripts of one browser stand still, one update at most waits for it, and another goes on."""
    robot = await begin()
    dashboard = await serve(robot)
    stalled, other = await open_page(dashboard.url), await open_page(dashboard.url)
    received: list[Any] = []
    stalled.on("websocket", lambda socket: socket.on("framereceived", lambda frame: received.append(frame)))
    await stalled.reload()
    await stalled.locator("svg[role=img]:visible").wait_for()
    stalling = asyncio.create_task(
        stalled.evaluate("() => { const end = Date.now() + 4000; while (Date.now() < end); }")
    )
    await other.reload()
    await other.locator("svg[role=img]:visible").wait_for()
    await stalling
    assert len(received) < 30
