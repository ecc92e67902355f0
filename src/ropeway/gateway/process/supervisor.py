"""Workers: slices of a configuration in processes of their own, started again when they fall.

The supervisor only places slices, starts workers and adds up what they tell; no message passes through it.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import signal
import sys
import time
from collections.abc import Iterable
from typing import Any, Final

from ropeway import aio
from ropeway.errors import GraphUnavailable
from ropeway.gateway.config.config import Config
from ropeway.gateway.process.counts import summed
from ropeway.gateway.process.ports import check_free
from ropeway.tasks import Supervised, end, failing

__all__ = ["Supervisor", "slices"]

log = logging.getLogger("ropeway.gateway")

_START_S: Final = 60.0  # for the next worker: 1 s, but many that start on a busy computer slow each other
_STOP_S: Final = 3.0
_STEADY_S: Final = 5.0  # several times what a worker takes to start and to fail for a reason of its own
_PAUSE_S: Final = 1.0
_LONGEST_PAUSE_S: Final = 10.0


def slices(config: Config) -> list[tuple[str, Config]]:
    """Divide a configuration; return (name, slice) of every worker."""
    active = [index for index, remote in enumerate(config.remotes) if remote.active]
    workers = config.gateway.workers
    if workers == "per-remote":
        parts = [(f"remote{index}", config.slice([index], listen=False)) for index in active]
        if config.gateway.listen:
            parts.insert(0, ("server", config.slice([], listen=True)))
        return parts
    count = max(int(workers), 1)
    return [(f"worker{n}", config.slice(active[n::count], listen=bool(config.gateway.listen))) for n in range(count)]


class Spare:
    """A process that has loaded everything and waits for its order, so that a worker that falls is back at once."""

    def __init__(self) -> None:
        self._process: asyncio.subprocess.Process | None = None
        self._lock = asyncio.Lock()

    @property
    def pid(self) -> int | None:
        """The process that waits; None where there is none yet."""
        return None if self._process is None else self._process.pid

    async def take(self) -> asyncio.subprocess.Process:
        """Return the spare process, or start a new one."""
        async with self._lock:
            process, self._process = self._process, None
        return process if process is not None and process.returncode is None else await self._start()

    async def renew(self) -> None:
        """See that there is a spare."""
        async with self._lock:
            if self._process is None or self._process.returncode is not None:
                self._process = await self._start()

    @staticmethod
    async def _start() -> asyncio.subprocess.Process:
        return await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "ropeway.gateway.process.worker",
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            limit=64 << 20,
        )

    async def close(self) -> None:
        """End it."""
        if self._process is not None:
            process, self._process = self._process, None
            await _end(process)


class WorkerProcess:
    """A process and its slice."""

    def __init__(self, name: str, order: dict[str, Any], spare: Spare, *, steady_s: float) -> None:
        self.name = name
        self.status: dict[str, Any] = {}
        self.starts = 0
        self.process: asyncio.subprocess.Process | None = None
        self.ready = asyncio.Event()
        self.error = ""
        self._order = order
        self._spare = spare
        self._steady_s = steady_s

    async def run(self) -> None:
        """Keep the process running until cancelled."""
        short_lives = 0
        while True:
            began = time.monotonic()
            self.starts += 1
            await self._once()
            if self.error and self.starts == 1:
                self.ready.set()
                return
            self.status = {}
            short_lives = short_lives + 1 if time.monotonic() - began < self._steady_s else 0
            # One accident soon after the start is none of its own fault.
            pause_s = min(_PAUSE_S * 2 ** (short_lives - 2), _LONGEST_PAUSE_S) if short_lives > 1 else 0.0
            why = f" ({self.error})" if self.error else ""
            when = f" in {pause_s:g} s" if pause_s else ""
            log.warning("worker %s ended%s; it is started again%s", self.name, why, when)
            await asyncio.sleep(pause_s)

    async def _once(self) -> None:
        process = self.process = await self._spare.take()
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            process.stdin.write(json.dumps(self._order).encode() + b"\n")
            await process.stdin.drain()
            async for line in process.stdout:
                await self._told(line)
            await process.wait()
        except (BrokenPipeError, ConnectionResetError):
            await process.wait()
        finally:
            await _end(process)

    async def _told(self, line: bytes) -> None:
        try:
            message = json.loads(line)
        except ValueError:
            message = None
        if not isinstance(message, dict):  # a library that prints
            log.info("worker %s: %s", self.name, line.decode(errors="replace").rstrip())
            return
        self.status = message.get("status", self.status)
        self.error = message.get("error", self.error)
        if "ready" in message:
            self.error = ""
            self.ready.set()
            await self._spare.renew()


async def _end(process: asyncio.subprocess.Process) -> None:
    if process.returncode is not None:
        return
    if process.stdin is not None:
        process.stdin.close()  # the worker takes this as the word to stop
    try:
        async with aio.timeout(_STOP_S):
            await process.wait()
    except TimeoutError:
        process.kill()
        await process.wait()


class Supervisor:
    """Runs a configuration in workers; used like ``Gateway``.

    A worker that lived for ``steady_s`` is started again at once, one that falls sooner again and again at growing
    intervals.
    """

    def __init__(self, config: Config, *, log_level: str = "INFO", steady_s: float = _STEADY_S) -> None:
        self.config = config
        self.gateway_id = os.urandom(8).hex()
        parts = slices(config)
        self.spare = Spare()
        self.workers = [
            WorkerProcess(
                name,
                {
                    "config": part.to_json(),
                    "source": config.source,
                    "gateway_id": f"{self.gateway_id}.{name}",
                    "node": f"{config.gateway.name}_{name}",
                    "reuse_port": len(parts) > 1,
                    "log_level": log_level,
                },
                self.spare,
                steady_s=steady_s,
            )
            for name, part in parts
        ]
        self._tasks = [Supervised(worker.run, f"worker {worker.name}") for worker in self.workers]

    async def __aenter__(self) -> Supervisor:
        """Start all workers and wait until each is up.

        Raises ``GraphUnavailable`` if one cannot start, ``ConnectFailed`` if somebody else listens where they would.
        """
        await check_free(self.config.gateway.listen)
        for task in self._tasks:
            task.start()
        try:
            for worker in self.workers:
                async with aio.timeout(_START_S):
                    await worker.ready.wait()
                if worker.error:
                    raise GraphUnavailable(f"worker {worker.name}", worker.error)
        except TimeoutError:
            await self.__aexit__()
            up = sum(worker.ready.is_set() for worker in self.workers)
            text = f"{up} of its {len(self.workers)} workers are up, and none more within {_START_S:g} s"
            raise GraphUnavailable(self.config.gateway.name, text) from None
        except BaseException:
            await self.__aexit__()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        """Stop all workers."""
        await end(*self._tasks)
        await self.spare.close()

    async def wait(self) -> None:
        """Run until cancelled."""
        for task in self._tasks:
            await task.wait()

    def reload(self) -> None:
        """Make every worker read its certificates and tokens again."""
        for worker in self.workers:
            if worker.process is not None and worker.process.returncode is None and worker.ready.is_set():
                worker.process.send_signal(signal.SIGHUP)

    def status(self) -> dict[str, Any]:
        """Return what all workers report, as if they were one gateway."""
        told = [worker.status for worker in self.workers if worker.status]

        def joined(key: str) -> list[Any]:
            return [item for status in told for item in status.get(key, ())]

        return {
            "name": self.config.gateway.name,
            "workers": [
                {"name": w.name, "pid": w.process.pid if w.process is not None else None, "starts": w.starts}
                for w in self.workers
            ],
            "graphs": joined("graphs"),
            "listen": _listeners(joined("listen")),
            "remotes": joined("remotes"),
            "routes": joined("routes"),
            "access": summed(status.get("access", {}) for status in told),
            "sessions": joined("sessions"),
            "failed": [*failing(), *joined("failed")],
        }


def _listeners(listed: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row per address: workers that share a port each count their own clients."""
    out: dict[str, dict[str, Any]] = {}
    for row in listed:
        known = out.setdefault(row["address"], {**row, "clients": 0})
        known["clients"] += row["clients"]
    return list(out.values())
