"""Groups of members of the overlay that are processes, and end as processes do."""

from __future__ import annotations

import asyncio
import itertools
import signal
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from ropeway.graph.calls import Request
from ropeway.group.bound import LatencyBound
from ropeway.group.graph import Group
from ropeway.networks.overlay.crypto.identity import write_private
from ropeway.networks.overlay.graph import OverlayGraph
from ropeway.networks.overlay.graph.pool import OverlayPool
from ropeway.networks.overlay.node import OverlayNode
from tests.networks.overlay.conftest import Site
from tests.networks.overlay.conftest import site as site
from tests.networks.overlay.fleet import member
from tests.support.messages import STRING, sample
from tests.support.services import ADD, addends
from tests.support.until import until

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[4]


class Machines:
    """Processes by the names of their members."""

    def __init__(self, site: Site, directory: Path) -> None:
        self.site, self.directory = site, directory
        self.processes: dict[str, asyncio.subprocess.Process] = {}

    async def start(self) -> str:
        identity = member("edge")
        bundle = self.directory / f"{identity.name}.ropeway"
        write_private(bundle, identity.to_text())
        self.processes[identity.name] = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "tests.networks.overlay.graph.pool_member",
            str(bundle),
            self.site.endpoint,
            cwd=ROOT,
            stdin=asyncio.subprocess.PIPE,
        )
        return identity.name

    async def end(self) -> None:
        for process in self.processes.values():
            if process.returncode is None:
                process.kill()
            await process.wait()


@pytest.fixture
async def machines(site: Site, tmp_path: Path) -> AsyncIterator[Machines]:
    made = Machines(site, tmp_path)
    yield made
    await made.end()


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
async def test_the_machine_in_use_ends(site: Site, machines: Machines, how: signal.Signals) -> None:
    """A machine that is killed, or stops without its links being closed, is left; every later call is answered, and so
    are messages.
    """
    names = [await machines.start(), await machines.start()]
    common = OverlayGraph(OverlayNode(member("robot"), routers=[site.endpoint], listen=()))
    exchanges = {"/input": "/output"}
    bound = LatencyBound.of({"median": 0.5})
    group = Group({}, roster=OverlayPool(common, ("*",), exchanges), exchanges=exchanges, bound=bound, stateless=True)
    await group.open()
    site.stack.push_async_callback(group.close)
    heard: list[str] = []
    input = await group.create_publisher("/input", STRING)
    await group.create_subscription(
        "/output", STRING, None, lambda batch: heard.extend(one.payload[8:-1].decode() for one in batch)
    )
    client = await group.create_client("/add", ADD)
    await until(lambda: set(group.scheduler.here) == set(names))
    await client.call(Request(addends(1)))
    numbers = itertools.count()

    def ask() -> bool:
        input.publish(sample(str(next(numbers))))
        return len(heard) > before

    before = 5
    await until(ask)
    current = group.scheduler.current
    machines.processes[current].send_signal(how)
    before = len(heard)
    for _ in range(5):
        await client.call(Request(addends(1)), 20.0)
    await until(ask)
    await until(lambda: group.scheduler.current not in ("", current))
    assert len(heard) == len(set(heard))
