"""A real ROS 1 master and real peers of it, as processes of Debian's Python on the loopback interface."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import subprocess
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from ropeway import aio
from tests.support.ports import free_port
from tests.support.until import PATIENCE_S

PYTHON = "/usr/bin/python3"
MASTER = "/usr/bin/rosmaster"


def _has(module: str) -> bool:
    try:
        found = subprocess.run([PYTHON, "-c", f"import {module}"], capture_output=True, timeout=PATIENCE_S, check=False)
    except OSError:
        return False
    return found.returncode == 0


HAS_MASTER = Path(MASTER).exists()
HAS_TOOLS = all(Path(f"/usr/bin/{tool}").exists() for tool in ("rostopic", "rosservice", "rosnode"))
HAS_ROSPY = HAS_MASTER and _has("rospy, std_msgs.msg, std_srvs.srv, sensor_msgs.msg, actionlib")


class RosMaster:
    """Debian's master, the one that roscore runs, on a port of its own."""

    def __init__(self, home: Path) -> None:
        self.home = home
        self.port = free_port()
        self.uri = f"http://127.0.0.1:{self.port}"
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def env(self) -> dict[str, str]:
        keep = {name: value for name, value in os.environ.items() if not name.startswith(("ROS_", "PYTHON"))}
        return keep | {
            "ROS_MASTER_URI": self.uri,
            "ROS_IP": "127.0.0.1",
            "ROS_HOME": str(self.home),
            "ROS_LOG_DIR": str(self.home / "log"),
            "PYTHONUNBUFFERED": "1",
        }

    def start(self) -> None:
        """Start it and wait until it listens."""
        command = [PYTHON, MASTER, "--core", "-p", str(self.port)]
        self._process = subprocess.Popen(
            command, env=self.env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
        ends = time.monotonic() + PATIENCE_S
        while time.monotonic() < ends:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
                return
            time.sleep(0.02)
        self.kill()
        raise TimeoutError("the master does not listen")

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None


class Peer:
    """A program that speaks ROS 1; ``lines`` is what it has printed."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process
        self.lines: list[str] = []
        self.errors: list[str] = []
        self._readers = [
            asyncio.create_task(self._read(process.stdout, self.lines)),
            asyncio.create_task(self._read(process.stderr, self.errors)),
        ]

    async def _read(self, stream: Any, lines: list[str]) -> None:
        while line := await stream.readline():
            lines.append(line.decode(errors="replace").rstrip("\n"))

    def tell(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(line.encode() + b"\n")

    async def wait_for(self, text: str, timeout_s: float = PATIENCE_S) -> str:
        """The first line printed that has ``text`` in it."""
        try:
            async with aio.timeout(timeout_s):
                while True:
                    for line in self.lines:
                        if text in line:
                            return line
                    await asyncio.sleep(0.02)
        except TimeoutError:
            raise AssertionError(f"no {text!r} in {self.lines} {self.errors[-20:]}") from None

    async def kill(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        await self.process.wait()
        await asyncio.gather(*self._readers)


@contextlib.asynccontextmanager
async def running(master: RosMaster, *command: str) -> AsyncIterator[Peer]:
    """A program with the environment of ``master``, until the block ends."""
    process = await asyncio.create_subprocess_exec(
        *command,
        env=master.env,
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        start_new_session=True,
    )
    peer = Peer(process)
    try:
        yield peer
    finally:
        await peer.kill()


def rospy(master: RosMaster, script: str) -> contextlib.AbstractAsyncContextManager[Peer]:
    """A rospy program."""
    return running(master, PYTHON, "-c", script)
