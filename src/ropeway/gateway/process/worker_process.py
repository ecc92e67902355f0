"""A worker as its supervisor sees it: its process, started again when it falls, its status, and questions to it.

Lines of JSON go to the worker: first its order, then questions. Lines of JSON come back: its status, answers, and
what the audit log is to have.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import logging
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

from ropeway import aio
from ropeway.audit.merging import AuditEntry
from ropeway.errors import ConfigError, ControlRefused, GraphUnavailable
from ropeway.gateway.process.questions import Question, question_name
from ropeway.processor_queue import patience

__all__ = ["LINE_BYTES", "Spare", "WorkerProcess"]

log = logging.getLogger("ropeway.gateway")

LINE_BYTES: Final = 64 << 20
"""A line between a supervisor and its worker: the configuration or the status of many thousand routes."""

_STOP_S: Final = 3.0
_PAUSE_S: Final = 1.0
_LONGEST_PAUSE_S: Final = 10.0


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
            limit=LINE_BYTES,
        )

    async def close(self) -> None:
        """End it."""
        if self._process is not None:
            process, self._process = self._process, None
            await _end(process)


class WorkerProcess:
    """A process and its slice. ``order`` may be replaced: the process that is started next gets the new one."""

    def __init__(
        self,
        name: str,
        order: dict[str, Any],
        spare: Spare,
        *,
        steady_s: float,
        on_audit: Callable[[list[AuditEntry]], None] | None = None,
    ) -> None:
        self.name = name
        self.order = order
        self.status: dict[str, Any] = {}
        self.starts = 0
        self.process: asyncio.subprocess.Process | None = None
        self.ready = asyncio.Event()
        self.error = ""
        self._spare, self._on_audit = spare, on_audit
        self._steady_s = steady_s
        self._numbers = itertools.count(1)
        self._asked: dict[int, asyncio.Future[Any]] = {}

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
            self.ready.clear()
            short_lives = short_lives + 1 if time.monotonic() - began < self._steady_s else 0
            # One accident soon after the start is none of its own fault.
            pause_s = min(_PAUSE_S * 2 ** (short_lives - 2), _LONGEST_PAUSE_S) if short_lives > 1 else 0.0
            why = f" ({self.error})" if self.error else ""
            when = f" in {pause_s:g} s" if pause_s else ""
            log.warning("worker %s ended%s; it is started again%s", self.name, why, when)
            await asyncio.sleep(pause_s)

    @property
    def running(self) -> bool:
        """Whether the process is there and up."""
        return self.process is not None and self.process.returncode is None and self.ready.is_set()

    def pid(self) -> int | None:
        """Return the number of the process; None before the first."""
        return None if self.process is None else self.process.pid

    def kill(self) -> None:
        """End the process at once; it is started again."""
        if self.process is not None and self.process.returncode is None:
            self.process.kill()

    async def ask(self, question: Question, params: Mapping[str, Any], *, timeout_s: float) -> Any:
        """Return the worker's answer.

        Raises what the question raised, and ``GraphUnavailable`` where the worker is not there, ends meanwhile or takes
        longer, not counting the time in which the machine lets it wait.
        """
        process = self.process
        if process is None or process.stdin is None or not self.running:
            raise GraphUnavailable(f"worker {self.name}", "it is not running; it is started again")
        number = next(self._numbers)
        answer: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self._asked[number] = answer
        line = json.dumps({"id": number, "ask": question_name(question), "params": params}).encode() + b"\n"
        try:
            async with patience(timeout_s, self.pid):
                process.stdin.write(line)
                await process.stdin.drain()
                return await answer
        except TimeoutError:
            raise GraphUnavailable(f"worker {self.name}", f"no answer within {timeout_s:g} s") from None
        except (BrokenPipeError, ConnectionResetError):
            raise GraphUnavailable(f"worker {self.name}", "it has ended") from None
        finally:
            del self._asked[number]

    async def _once(self) -> None:
        process = self.process = await self._spare.take()
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            process.stdin.write(json.dumps(self.order).encode() + b"\n")
            await process.stdin.drain()
            async for line in process.stdout:
                await self._told(line)
            await process.wait()
        except (BrokenPipeError, ConnectionResetError):
            await process.wait()
        finally:
            for answer in self._asked.values():
                if not answer.done():
                    answer.set_exception(GraphUnavailable(f"worker {self.name}", "it has ended"))
            await _end(process)

    async def _told(self, line: bytes) -> None:
        try:
            message = json.loads(line)
        except ValueError:
            message = None
        if not isinstance(message, dict):  # a library that prints
            log.info("worker %s: %s", self.name, line.decode(errors="replace").rstrip())
            return
        if "answer" in message:
            self._answered(message)
            return
        if "audit" in message and self._on_audit is not None:
            self._on_audit(message["audit"])
        self.status = message.get("status", self.status)
        self.error = message.get("error", self.error)
        if "ready" in message:
            self.error = ""
            self.ready.set()
            await self._spare.renew()

    def _answered(self, message: Mapping[str, Any]) -> None:
        answer = self._asked.get(message["answer"])
        if answer is None or answer.done():
            return
        if "error" not in message:
            answer.set_result(message["value"])
        elif message.get("problems"):
            answer.set_exception(ConfigError([(path, text) for path, text in message["problems"]]))
        elif message.get("status"):
            answer.set_exception(ControlRefused(message["status"], message["error"]))
        else:
            answer.set_exception(GraphUnavailable(f"worker {self.name}", message["error"]))


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
