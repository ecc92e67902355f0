"""ROS 2 graphs of one test run, on the loopback interface; skipped where rclpy is not there."""

from __future__ import annotations

import asyncio
import contextlib
import importlib.util
import json
import os
import signal
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from ropeway import aio
from ropeway.networks.ros2 import Ros2Graph

from .network import isolated_ros2

PROGRAMS = Path(__file__).parents[1]


class Peer:
    """A genuine node in a process of its own, and what it said."""

    def __init__(self, process: Process) -> None:
        self.process = process
        self.said: list[dict[str, Any]] = []
        self._reader = asyncio.create_task(self._read())

    async def _read(self) -> None:
        assert self.process.stdout is not None
        async for line in self.process.stdout:
            if line.startswith(b"{"):
                self.said.append(json.loads(line))

    @property
    def heard(self) -> list[str]:
        return [s["text"] for s in self.said if "text" in s]

    async def end(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            self.process.send_signal(signal.SIGINT)  # a node that is killed leaves its peers waiting for it
        try:
            async with aio.timeout(5):
                await self.process.wait()
        except TimeoutError:
            self.process.kill()
            await self.process.wait()
        await self._reader


class World:
    """Our graphs and genuine nodes."""

    def __init__(self, domain: int, stack: AsyncExitStack) -> None:
        self.domain, self.stack = domain, stack

    async def graph(self, name: str = "ours", **options: Any) -> Ros2Graph:
        graph = Ros2Graph(self.domain, name=name, **options)
        await graph.open()
        self.stack.push_async_callback(graph.close)
        return graph

    async def node(self, *words: str, program: str = "ros2_peer.py", domain: int | None = None) -> Peer:
        env = {**os.environ, "ROS_DOMAIN_ID": str(self.domain if domain is None else domain)}
        command = (sys.executable, str(PROGRAMS / program), *words)
        peer = Peer(await asyncio.create_subprocess_exec(*command, stdout=PIPE, env=env))
        self.stack.push_async_callback(peer.end)
        return peer


@pytest.fixture
def isolation() -> Iterator[int]:
    """A domain for nodes that stay on this machine."""
    if importlib.util.find_spec("rclpy") is None:
        pytest.skip("needs a sourced ROS 2 with rclpy")
    with isolated_ros2() as domain:
        yield domain


@pytest.fixture
async def world(isolation: int) -> AsyncIterator[World]:
    """Graphs and nodes of one domain; all are ended."""
    async with AsyncExitStack() as stack:
        yield World(isolation, stack)
