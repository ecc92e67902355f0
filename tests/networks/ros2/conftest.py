"""ROS 2 graphs of one test run, on the loopback interface; skipped where rclpy is not there."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from ropeway.networks.ros2 import Ros2Graph
from tests.support.ros2 import Peer, need_rclpy, start_peer

from .network import isolated_ros2

PROGRAMS = Path(__file__).parent


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
        env = {"ROS_DOMAIN_ID": str(self.domain if domain is None else domain)}
        return await start_peer(self.stack, PROGRAMS / program, *words, env=env, politely=True)


@pytest.fixture
def isolation() -> Iterator[int]:
    """A domain for nodes that stay on this machine."""
    need_rclpy()
    with isolated_ros2() as domain:
        yield domain


@pytest.fixture
async def world(isolation: int) -> AsyncIterator[World]:
    """Graphs and nodes of one domain; all are ended."""
    async with AsyncExitStack() as stack:
        yield World(isolation, stack)
