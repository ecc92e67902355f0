"""The two gateways of the demo: processes of ``ropeway run`` with configurations in a directory of their own."""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import socket
import sys
from collections import Counter
from collections.abc import AsyncIterator, Iterable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from ropeway import aio
from ropeway.cli.demo.scene import DemoTopic
from ropeway.errors import RopewayError

__all__ = ["GatewayProcess", "configurations", "dashboard", "figures", "free_port", "running"]

_STOP_S: Final = 5.0
_STATUS_S: Final = "0.25"
_LINE_BYTES: Final = 4 << 20


def free_port() -> int:
    """Return a TCP port of this machine that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def configurations(
    parts: Iterable[DemoTopic], robot_graph: str, cloud_graph: str, port: int
) -> dict[str, dict[str, Any]]:
    """Return the configurations of both: the robot dials, as robots behind a firewall do."""
    listed = list(parts)

    def items(side: str) -> list[dict[str, Any]]:
        return [
            {"name": part.topic, "type": part.type, **({"priority": "command"} if "Twist" in part.type else {})}
            for part in listed
            if part.side == side
        ]

    address = f"ws://127.0.0.1:{port}"
    return {
        "cloud": {"gateway": {"name": "cloud", "graphs": [cloud_graph], "listen": [address]}},
        "robot": {
            "gateway": {"name": "robot", "graphs": [robot_graph], "listen": []},
            "remotes": [{"title": "cloud", "address": address, "publish": items("robot"), "subscribe": items("cloud")}],
        },
    }


@dataclass
class GatewayProcess:
    """A gateway process, with its last status."""

    name: str
    process: asyncio.subprocess.Process
    log: Path
    status: dict[str, Any] = field(default_factory=dict)
    news: asyncio.Event = field(default_factory=asyncio.Event)

    async def listen(self) -> None:
        """Keep ``status`` up to date. Raises ``RopewayError`` when the process ends by itself."""
        assert self.process.stdout is not None
        async for line in self.process.stdout:
            with contextlib.suppress(json.JSONDecodeError):
                self.status = json.loads(line)
                self.news.set()
        code = await self.process.wait()
        tail = self.log.read_text(errors="replace").strip().splitlines()[-5:]
        raise RopewayError(f"the gateway of the {self.name} has ended with status {code}: {' | '.join(tail)}")

    async def connected(self) -> None:
        """Wait until every remote of it is connected."""
        while True:
            remotes = self.status.get("remotes", [])
            if remotes and all(remote["state"] == "connected" for remote in remotes):
                return
            self.news.clear()
            await self.news.wait()

    async def stop(self) -> None:
        """End it in order, or at once where it does not."""
        if self.process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                self.process.send_signal(signal.SIGINT)
        try:
            async with aio.timeout(_STOP_S):
                await self.process.wait()
        except TimeoutError:
            self.process.kill()
            await self.process.wait()


def figures(gateways: Mapping[str, GatewayProcess]) -> dict[str, dict[str, Any]]:
    """Return what the gateways report on each topic: state, encoding, and the drops of both added up."""
    out: dict[str, dict[str, Any]] = {}
    for route in gateways["robot"].status.get("routes", []):
        out[route["name"]] = {"state": route["state"], "encoding": route["encoding"], "drops": Counter(route["drops"])}
    for session in gateways["cloud"].status.get("sessions", []):
        for topic in session["topics"]:
            known = out.get(topic["name"])
            if known is None:
                continue
            known["drops"].update(topic.get("drops", {}))
            if known["encoding"] == "auto":  # the robot only receives it; the sender knows
                known["encoding"] = topic.get("encoding", "auto")
    return out


@asynccontextmanager
async def dashboard() -> AsyncIterator[None]:
    """Show the gateways of this machine in a browser for the length of the block."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "ropeway", "dashboard", "--open"),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=sys.stderr,  # the address; stdout is for the figures
        start_new_session=True,
    )
    try:
        yield
    finally:
        await GatewayProcess("dashboard", process, Path()).stop()


@asynccontextmanager
async def running(configs: dict[str, dict[str, Any]], directory: Path) -> AsyncIterator[dict[str, GatewayProcess]]:
    """Run both gateways for the length of the block; their configurations and logs stand in ``directory``."""
    gateways: dict[str, GatewayProcess] = {}
    try:
        for name, config in configs.items():
            file = directory / f"{name}.json"
            file.write_text(json.dumps(config, indent=2) + "\n")
            log = directory / f"{name}.log"
            with log.open("wb") as errors:
                process = await asyncio.create_subprocess_exec(
                    *(sys.executable, "-m", "ropeway", "run", str(file), "--json", "--period", _STATUS_S),
                    stdin=asyncio.subprocess.DEVNULL,
                    stdout=asyncio.subprocess.PIPE,
                    stderr=errors,
                    limit=_LINE_BYTES,
                    start_new_session=True,  # Ctrl-C is ours, and we end them in order
                )
            gateways[name] = GatewayProcess(name, process, log)
        yield gateways
    finally:
        for gateway in gateways.values():
            await gateway.stop()
