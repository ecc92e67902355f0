"""Workers: slices of a configuration in processes of their own, started again when they fall.

The supervisor only places slices, starts workers and adds up what they tell; no message passes through it.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import os
import signal
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from ropeway.audit.trail import AuditTrail
from ropeway.delivery.histogram import added
from ropeway.errors import GraphUnavailable, RopewayError
from ropeway.gateway.config.config import Config
from ropeway.gateway.plan import ConfigPlan, make_plan, remote_keys
from ropeway.gateway.process.changes import abort, commit, prepare
from ropeway.gateway.process.counts import summed
from ropeway.gateway.process.ports import check_free
from ropeway.gateway.process.questions import Question
from ropeway.gateway.process.worker_process import Spare, WorkerProcess
from ropeway.processor_queue import patience
from ropeway.tasks import Supervised, end, failing

__all__ = ["Supervisor", "places", "slices"]

log = logging.getLogger("ropeway.gateway")

NOWHERE: Final[Mapping[str, str]] = {}
_LISTED: Final = ("http", "safety")
_TOLD_ONCE: Final = ("store", "nodes")
"""Parts of the status of a worker that is alone in having it, or that is the same in all."""
_START_S: Final = 60.0  # for the next worker, not counted while it waits for a processor: 1 s where nothing is wrong
_ASK_S: Final = 30.0  # a worker that is busy with images answers within one
_STEADY_S: Final = 5.0  # several times what a worker takes to start and to fail for a reason of its own


def slices(config: Config, before: Mapping[str, str] = NOWHERE) -> list[tuple[str, Config]]:
    """Divide a configuration; return (name, slice) of every worker.

    ``before`` has the workers of remotes by key (``places``): a remote stays with its worker, whatever is inserted
    before it. New ones go to whoever has the fewest.
    """
    parts = _parts(config, before)
    return [parts[0], *((name, part.beside_another()) for name, part in parts[1:])]  # each message is posted once


def _parts(config: Config, before: Mapping[str, str]) -> list[tuple[str, Config]]:
    dealt = _dealt(config, before)
    listens = bool(config.gateway.listen)
    if config.gateway.workers == "per-remote":
        parts = [(name, config.slice(indexes, listen=False)) for name, indexes in dealt.items()]
        if listens:
            parts.insert(0, ("server", config.slice([], listen=True)))
        return parts
    return [(name, config.slice(indexes, listen=listens)) for name, indexes in dealt.items()]


def places(config: Config, before: Mapping[str, str] = NOWHERE) -> dict[str, str]:
    """Return the names of workers by the keys of the remotes that they have."""
    keys = remote_keys(config)
    return {keys[index]: name for name, indexes in _dealt(config, before).items() for index in indexes}


def _dealt(config: Config, before: Mapping[str, str]) -> dict[str, list[int]]:
    keys = remote_keys(config)
    active = [index for index, remote in enumerate(config.remotes) if remote.active]
    if config.gateway.workers == "per-remote":
        used = {before[keys[index]] for index in active if keys[index] in before}
        free = (name for number in itertools.count() if (name := f"remote{number}") not in used)
        if not before:
            return {f"remote{index}": [index] for index in active}
        return {before.get(keys[index]) or next(free): [index] for index in active}
    names = [f"worker{number}" for number in range(max(int(config.gateway.workers), 1))]
    dealt: dict[str, list[int]] = {name: [] for name in names}
    new = [index for index in active if before.get(keys[index]) not in dealt]
    for index in active:
        if index not in new:
            dealt[before[keys[index]]].append(index)
    for index in new:
        dealt[min(names, key=lambda name: len(dealt[name]))].append(index)
    return {name: sorted(indexes) for name, indexes in dealt.items()}


class Supervisor:
    """Runs a configuration in workers; used like ``Gateway``.

    A worker that lived for ``steady_s`` is started again at once, one that falls sooner again and again at growing
    intervals.
    """

    def __init__(
        self,
        config: Config,
        *,
        log_level: str = "INFO",
        steady_s: float = _STEADY_S,
        audit: AuditTrail | None = None,
    ) -> None:
        self._audit = audit
        self.config = config
        self.gateway_id = os.urandom(8).hex()
        self.spare = Spare()
        self.places = places(config)
        self._log_level, self._steady_s = log_level, steady_s
        self.workers = [self._worker(name, part) for name, part in slices(config)]
        self._tasks = {worker.name: Supervised(worker.run, f"worker {worker.name}") for worker in self.workers}
        self._ended = asyncio.Event()

    def _worker(self, name: str, part: Config) -> WorkerProcess:
        on_audit = None if self._audit is None else self._audit.take_entries
        return WorkerProcess(name, self._order(name, part), self.spare, steady_s=self._steady_s, on_audit=on_audit)

    def _order(self, name: str, part: Config) -> dict[str, Any]:
        return {
            "config": part.to_json(),
            "source": part.source,
            "gateway_id": f"{self.gateway_id}.{name}",
            "node": f"{part.gateway.name}_{name}",
            "reuse_port": True,  # there may be more workers soon
            "log_level": self._log_level,
            "audit": self._audit is not None,
        }

    async def __aenter__(self) -> Supervisor:
        """Start all workers and wait until each is up.

        Raises ``GraphUnavailable`` if one cannot start, ``ConnectFailed`` if somebody else listens where they would.
        """
        await check_free(self.config.gateway.listen)
        for task in self._tasks.values():
            task.start()
        try:
            await self._ready(self.workers)
        except BaseException:
            await self.__aexit__()
            raise
        return self

    async def _ready(self, workers: Sequence[WorkerProcess]) -> None:
        """Wait until workers are up. Raises ``GraphUnavailable`` if one cannot start."""
        try:
            for worker in workers:
                async with patience(_START_S, worker.pid):
                    await worker.ready.wait()
                if worker.error:
                    raise GraphUnavailable(f"worker {worker.name}", worker.error)
        except TimeoutError:
            up = sum(worker.ready.is_set() for worker in workers)
            text = f"{up} of its {len(workers)} workers are up, and none more within {_START_S:g} s"
            raise GraphUnavailable(self.config.gateway.name, text) from None

    async def __aexit__(self, *_: object) -> None:
        """Stop all workers."""
        await end(*self._tasks.values())
        await self.spare.close()
        self._ended.set()

    async def wait(self) -> None:
        """Run until cancelled."""
        await self._ended.wait()

    async def apply(self, config: Config, plan: ConfigPlan | None = None) -> ConfigPlan:
        """Go over to another configuration in all workers, or in none; return what was done.

        Raises ``RopewayError`` if that cannot be; then everything is as before.
        """
        plan = plan or make_plan(self.config, config)
        before = self.config
        parts = dict(slices(config, self.places))
        staying = [worker for worker in self.workers if worker.name in parts]
        coming = [self._worker(name, part) for name, part in parts.items() if name not in self._tasks]
        prepared: list[WorkerProcess] = []
        try:
            for worker in staying:
                prepared.append(worker)
                await worker.ask(prepare, _wanted(parts[worker.name]), timeout_s=_START_S)
            await self._start(coming)
        except BaseException:
            await self._stop(coming)
            for worker in prepared:
                with contextlib.suppress(RopewayError):  # one that has fallen comes back as it was
                    await worker.ask(abort, {}, timeout_s=_START_S)
            raise
        try:
            await self._commit(staying, parts)
        except RopewayError:
            await self._stop(coming)
            await self._go_back(staying, dict(slices(before, self.places)))
            raise
        await self._stop([worker for worker in self.workers if worker.name not in parts])
        self.workers = [worker for name in parts for worker in (*staying, *coming) if worker.name == name]
        self.places = places(config, self.places)
        self.config = config
        return plan

    async def _commit(self, workers: Sequence[WorkerProcess], parts: Mapping[str, Config]) -> None:
        """Have all workers swap; one that falls meanwhile comes back with the new configuration."""
        for worker in workers:
            worker.order = self._order(worker.name, parts[worker.name])
        for worker in workers:
            starts = worker.starts
            try:
                await worker.ask(commit, {}, timeout_s=_START_S)
            except GraphUnavailable:
                if worker.running and worker.starts == starts:
                    raise
                log.warning(
                    "worker %s fell while it was changed; it comes back with the new configuration", worker.name
                )

    async def _go_back(self, workers: Sequence[WorkerProcess], parts: Mapping[str, Config]) -> None:
        """Have all workers be as before, whether they had gone over already or not."""
        for worker in workers:
            worker.order = self._order(worker.name, parts[worker.name])
            try:
                await worker.ask(abort, {}, timeout_s=_START_S)
                await worker.ask(prepare, _wanted(parts[worker.name]), timeout_s=_START_S)
                await worker.ask(commit, {}, timeout_s=_START_S)
            except RopewayError as error:
                log.error("worker %s does not go back: %s; it is started again", worker.name, error)
                worker.kill()

    async def _start(self, workers: Sequence[WorkerProcess]) -> None:
        for worker in workers:
            self._tasks[worker.name] = Supervised(worker.run, f"worker {worker.name}").start()
        await self._ready(workers)

    async def _stop(self, workers: Sequence[WorkerProcess]) -> None:
        for worker in workers:
            await end(self._tasks.pop(worker.name, None))

    def reload(self) -> None:
        """Make every worker read its certificates and tokens again."""
        for worker in self.workers:
            if worker.process is not None and worker.process.returncode is None and worker.ready.is_set():
                worker.process.send_signal(signal.SIGHUP)

    async def ask(self, question: Question, params: Mapping[str, Any], *, timeout_s: float = _ASK_S) -> list[Any]:
        """Return the answers of all workers to a question. Raises what one of them raises."""
        return list(await asyncio.gather(*(w.ask(question, params, timeout_s=timeout_s) for w in self.workers)))

    async def ask_one(self, question: Question, params: Mapping[str, Any], *, timeout_s: float = _ASK_S) -> Any:
        """Return the answer of the first worker to a question about the networks, which all of them have joined."""
        return await self.workers[0].ask(question, params, timeout_s=timeout_s)

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
            "memory": _memory(status["memory"] for status in told),
            "codecs": {
                way: added(status.get("codecs", {}).get(way, {}) for status in told) for way in ("encode", "decode")
            },
            **({"recordings": joined("recordings")} if self.config.gateway.record else {}),
            "failed": [*failing(), *joined("failed")],
            **{key: rows for key in _LISTED if (rows := joined(key))},
            **{key: told_once for key in _TOLD_ONCE if (told_once := next((s[key] for s in told if key in s), None))},
        }


def _wanted(part: Config) -> dict[str, Any]:
    return {"config": part.to_json(), "source": part.source}


def _memory(many: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Return what the connections of all workers hold."""
    held, limit, ended = 0, 0, Counter[str]()
    for one in many:
        held, limit = held + one["held_bytes"], limit + one["limit_bytes"]
        ended.update(one["ended"])
    return {"held_bytes": held, "limit_bytes": limit, "ended": dict(ended)}


def _listeners(listed: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row per address: workers that share a port each count their own clients."""
    out: dict[str, dict[str, Any]] = {}
    for row in listed:
        known = out.setdefault(row["address"], {**row, "clients": 0})
        known["clients"] += row["clients"]
    return list(out.values())
