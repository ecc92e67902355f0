"""Workers: slices of a configuration in processes of their own, started again when they fall.

The supervisor only places slices, starts workers and adds up what they tell; no message passes through it.
"""

from __future__ import annotations

import asyncio
import logging
import os
import signal
from collections.abc import Iterable, Mapping
from typing import Any, Final

from ropeway import aio
from ropeway.errors import GraphUnavailable
from ropeway.gateway.config.config import Config
from ropeway.gateway.process.counts import summed
from ropeway.gateway.process.ports import check_free
from ropeway.gateway.process.questions import Question
from ropeway.gateway.process.worker_process import Spare, WorkerProcess
from ropeway.tasks import Supervised, end, failing

__all__ = ["Supervisor", "slices"]

log = logging.getLogger("ropeway.gateway")

_START_S: Final = 60.0  # for the next worker: 1 s, but many that start on a busy computer slow each other
_ASK_S: Final = 30.0  # a worker that is busy with images answers within one
_STEADY_S: Final = 5.0  # several times what a worker takes to start and to fail for a reason of its own


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

    async def ask(self, question: Question, params: Mapping[str, Any], *, timeout_s: float = _ASK_S) -> list[Any]:
        """Return the answers of all workers to a question. Raises what one of them raises."""
        return list(await asyncio.gather(*(w.ask(question, params, timeout_s=timeout_s) for w in self.workers)))

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
