"""Two machines and the link between them: network namespaces, a process in each, and ways to cut what joins them."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from ropeway import aio
from tests.support.until import PATIENCE_S

ROOT = Path(__file__).parents[2]
_subnets = itertools.cycle(range(81, 90))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """All tests here need root and ``ip``."""
    able = shutil.which("ip") is not None and os.geteuid() == 0 and _allowed()
    for item in items:
        if Path(__file__).parent in item.path.parents and item.get_closest_marker("netns") and not able:
            item.add_marker(pytest.mark.skip(reason="needs root and network namespaces: run as root, with iproute2"))


def _allowed() -> bool:
    name = f"rwt{os.getpid()}"
    with contextlib.suppress(subprocess.CalledProcessError, OSError):
        ip(f"netns add {name}")
        ip(f"netns del {name}")
        return True
    return False


def ip(command: str) -> None:
    subprocess.run(["ip", *command.split()], check=True, capture_output=True)


class Machine:
    """A process in a namespace, and what it told."""

    def __init__(self, namespace: str | None, order: dict[str, Any]) -> None:
        self.namespace, self.order = namespace, order
        self.events: list[dict[str, Any]] = []
        self.log: list[str] = []
        self.process: asyncio.subprocess.Process
        self._tasks: list[asyncio.Task[None]] = []

    async def start(self) -> None:
        prefix = ["ip", "netns", "exec", self.namespace] if self.namespace else []
        self.process = await asyncio.create_subprocess_exec(
            *prefix,
            sys.executable,
            "-m",
            "tests.faults.node",
            json.dumps(self.order),
            cwd=ROOT,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            limit=1 << 24,
        )
        assert self.process.stdout is not None
        assert self.process.stderr is not None
        self._tasks = [
            asyncio.create_task(self._read(self.process.stdout, lambda line: self.events.append(json.loads(line)))),
            asyncio.create_task(self._read(self.process.stderr, lambda line: self.log.append(line.decode()))),
        ]
        await self.until(lambda: any("status" in e for e in self.events))  # told right after ``ready``

    @staticmethod
    async def _read(stream: asyncio.StreamReader, keep: Callable[[bytes], None]) -> None:
        async for line in stream:
            keep(line)

    async def until(self, condition: Callable[[], object], timeout_s: float = PATIENCE_S) -> None:
        """Wait for a condition on what was told."""
        try:
            async with aio.timeout(timeout_s):
                while not condition():
                    await asyncio.sleep(0.01)
        except TimeoutError:
            told = [event for event in self.events if "status" not in event][-20:]
            raise AssertionError(
                f"{self.order['name']}: not within {timeout_s:g} s\n{''.join(self.log[-20:])}\n{told}"
            ) from None

    def kill(self) -> None:
        """End it as a power failure would."""
        self.process.kill()

    async def stop(self) -> None:
        if self.process.returncode is None and self.process.stdin is not None:
            self.process.stdin.close()
            try:
                async with aio.timeout(5):
                    await self.process.wait()
            except TimeoutError:
                self.process.kill()
        await self.process.wait()
        await asyncio.gather(*self._tasks)

    # ── what was told ──────────────────────────────────────────────────────────────────────────────────────────

    def heard(self, topic: str, since: float = 0.0) -> list[tuple[float, int]]:
        """When which messages came."""
        return [(e["t"], e["n"]) for e in self.events if e.get("topic") == topic and e["t"] >= since]

    def first(self, key: str, value: object, since: float) -> float | None:
        """When something was told first after ``since``."""
        return next((e["t"] for e in self.events if e.get(key, ...) == value and e["t"] >= since), None)

    def queued_s(self, since: float, until: float) -> float:
        """How long it waited for a processor in this time, as others of this computer had them."""
        before = max((e["queued"] for e in self.events if e["t"] <= since), default=0.0)
        return max((e["queued"] for e in self.events if e["t"] <= until), default=before) - before

    @property
    def status(self) -> dict[str, Any]:
        return next(e["status"] for e in reversed(self.events) if "status" in e)

    @property
    def memory_bytes(self) -> int:
        return int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def took_s(since: float, until: float, *machines: Machine) -> float:
    """How long something took with these machines, had each had a processor whenever it could use one."""
    return until - since - sum(machine.queued_s(since, until) for machine in machines)


class Pair:
    """Namespaces ``a`` and ``b``, joined by a cable."""

    def __init__(self, stack: AsyncExitStack) -> None:
        self._stack = stack
        self.a, self.b = f"rwf{os.getpid()}a{id(self) % 9973}", f"rwf{os.getpid()}b{id(self) % 9973}"
        self.subnet = next(_subnets)
        self.address_a, self.address_b = f"10.{self.subnet}.0.1", f"10.{self.subnet}.0.2"

    async def open(self) -> None:
        for namespace in (self.a, self.b):
            ip(f"netns add {namespace}")
            self._stack.callback(ip, f"netns del {namespace}")
            ip(f"-n {namespace} link set lo up")
        ip(f"link add wire netns {self.a} type veth peer name wire netns {self.b}")
        for namespace, address in ((self.a, self.address_a), (self.b, self.address_b)):
            ip(f"-n {namespace} addr add {address}/24 dev wire")
            ip(f"-n {namespace} link set wire up")

    async def machine(self, where: str, **order: Any) -> Machine:
        made = Machine({"a": self.a, "b": self.b}[where], order)
        await made.start()
        self._stack.push_async_callback(made.stop)
        return made

    def pull(self, *, back: bool = False) -> None:
        """Pull the plug, or put it back: both sides see it."""
        ip(f"-n {self.a} link set wire {'up' if back else 'down'}")

    def swallow(self, *, back: bool = False) -> None:
        """Lose every packet without a sign, both ways: the next hop has an address that nobody has."""
        for namespace, other in ((self.a, self.address_b), (self.b, self.address_a)):
            if back:
                ip(f"-n {namespace} neigh del {other} dev wire")
            else:
                ip(f"-n {namespace} neigh replace {other} lladdr 02:00:00:00:00:01 nud permanent dev wire")

    def rate(self, mbit: float) -> None:
        """Limit both directions."""
        for namespace in (self.a, self.b):
            subprocess.run(
                f"tc -n {namespace} qdisc add dev wire root tbf rate {mbit}mbit burst 64kb latency 50ms".split(),
                check=True,
                capture_output=True,
            )


@pytest.fixture
def pair(stack: AsyncExitStack) -> Callable[[], Any]:
    """Makes a pair of machines that a cable joins."""

    async def make() -> Pair:
        made = Pair(stack)
        await made.open()
        return made

    return make
