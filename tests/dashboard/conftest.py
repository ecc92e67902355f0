"""Dashboards as processes of their own, gateways in this one, and a browser."""

from __future__ import annotations

import asyncio
import sys
from asyncio.subprocess import PIPE
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

import pytest

from ropeway import aio
from tests.control.conftest import Controlled, begin
from tests.networks.rosbridge.server.browser import CHROMIUM
from tests.support.until import PATIENCE_S

__all__ = ["Dashboard", "Open", "Serve", "begin", "open_page", "serve"]

KEY = "a key of the tests, which is long"


@dataclass
class Dashboard:
    """A dashboard that serves at ``root``; ``url`` logs in with its key."""

    root: str
    url: str
    process: asyncio.subprocess.Process

    @property
    def port(self) -> int:
        return urlsplit(self.root).port or 0


Serve = Callable[..., Awaitable[Dashboard]]
Open = Callable[..., Awaitable[Any]]


@pytest.fixture
async def serve(tmp_path: Any) -> AsyncIterator[Serve]:
    """Start dashboards of gateways, each given as ``Controlled`` or as the command line has it."""
    key = tmp_path / "key"
    key.write_text(KEY)
    async with AsyncExitStack() as stack:

        async def serve(*gateways: Controlled | str, options: tuple[str, ...] = ()) -> Dashboard:
            named = [each if isinstance(each, str) else str(each.target.socket) for each in gateways]
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-W", "ignore", "-m", "ropeway", "dashboard", "--port", "0"),
                *("--key-file", str(key), *options, *named),
                stdout=PIPE,
            )

            async def stop() -> None:
                process.terminate()
                await process.wait()

            stack.push_async_callback(stop)
            assert process.stdout is not None
            async with aio.timeout(PATIENCE_S):
                url = (await process.stdout.readline()).decode().strip()
            root = url.partition("/login")[0].rstrip("/")
            return Dashboard(root, url, process)

        yield serve


@pytest.fixture
async def open_page() -> AsyncIterator[Open]:
    """Open pages in Chromium, each in a browser of its own cookies; ``faults`` of a page are errors of its scripts."""
    if CHROMIUM is None:
        pytest.skip("needs Chromium, which .ci/run installs on Debian")
    playwright = pytest.importorskip("playwright.async_api")
    async with playwright.async_playwright() as driver:
        browser = await driver.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--disable-dev-shm-usage"]
        )

        async def open_page(url: str, *, width: int = 1100, height: int = 760) -> Any:
            context = await browser.new_context(viewport={"width": width, "height": height})
            context.set_default_timeout(PATIENCE_S * 1000)
            page = await context.new_page()
            page.faults = []
            page.on("pageerror", lambda error: page.faults.append(str(error)))
            page.on("dialog", lambda dialog: page.faults.append(f"a dialog: {dialog.message}"))
            await page.goto(url)
            return page

        yield open_page
        await browser.close()
