"""Genuine ROS 2 nodes in processes of their own, and what tests need for them."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import os
import signal
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import Callable, Mapping
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from ropeway import aio
from tests.support.until import PATIENCE_S, until

__all__ = ["CYCLONE", "FAST", "ZENOH", "Peer", "has_rmw", "need_rclpy", "need_rmw", "need_suite", "start_peer"]

CYCLONE, FAST, ZENOH = "rmw_cyclonedds_cpp", "rmw_fastrtps_cpp", "rmw_zenoh_cpp"


def need_rclpy() -> None:
    """Skip the test, or the module, where no ROS 2 is sourced."""
    _need("rclpy", "a ROS 2 with rclpy: source /opt/ros/<distro>/setup.bash before the tests")


def need_suite() -> None:
    """Skip the test, or the module, where there is no genuine rosbridge server."""
    _need("rosbridge_library", "rosbridge_suite: install ros-<distro>-rosbridge-suite and source that ROS 2")


def _need(module: str, what: str) -> None:
    if importlib.util.find_spec(module) is None:
        pytest.skip(f"needs {what}", allow_module_level=True)


def has_rmw(rmw: str) -> bool:
    """Return whether a middleware is installed beside the sourced ROS 2."""
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return any((Path(prefix) / "lib" / f"lib{rmw}.so").exists() for prefix in prefixes if prefix)


def need_rmw(rmw: str) -> None:
    """Skip the test, or the module, where a middleware is not installed beside ROS 2."""
    if not has_rmw(rmw):
        package = f"ros-<distro>-{rmw.replace('_', '-')}"
        pytest.skip(f"needs {rmw}: install {package} beside the sourced ROS 2", allow_module_level=True)


class Peer:
    """A node that prints objects of JSON, one a line. ``said`` are all of them."""

    def __init__(self, process: Process, *, politely: bool = False) -> None:
        self.process = process
        self.said: list[dict[str, Any]] = []
        self._politely = politely  # a node of some middlewares that is killed leaves its peers waiting for it
        self._reader = asyncio.create_task(self._read())

    async def _read(self) -> None:
        assert self.process.stdout is not None
        async for line in self.process.stdout:
            for text in line.splitlines():
                if text.startswith(b"{"):
                    self.said.append(json.loads(text))

    @property
    def told(self) -> dict[str, Any]:
        """Everything that was said, the latest of each name."""
        return {name: value for each in self.said for name, value in each.items()}

    @property
    def heard(self) -> list[str]:
        """The texts of the messages that it got."""
        return [each["text"] for each in self.said if "text" in each]

    async def wait(self, condition: Callable[[], object], timeout_s: float = PATIENCE_S) -> None:
        """Wait until something holds of what was said."""
        await until(condition, timeout_s)

    async def done(self) -> dict[str, Any]:
        """Wait for the end of the node; return the last that it said."""
        await self.process.wait()
        await self._reader
        return self.said[-1]

    async def end(self) -> None:
        """End the node."""
        if self.process.returncode is None and self._politely:
            self.process.send_signal(signal.SIGINT)
            try:
                async with aio.timeout(5):
                    await self.process.wait()
            except TimeoutError:
                pass
        if self.process.returncode is None:
            self.process.kill()
        await self.process.wait()
        await self._reader


async def start_peer(
    stack: AsyncExitStack, program: Path, *words: object, env: Mapping[str, str], politely: bool = False
) -> Peer:
    """Start a program that prints what it sees; the end of ``stack`` ends it."""
    command = (sys.executable, str(program), *map(str, words))
    peer = Peer(
        await asyncio.create_subprocess_exec(*command, stdout=PIPE, env={**os.environ, **env}), politely=politely
    )
    stack.push_async_callback(peer.end)
    return peer
