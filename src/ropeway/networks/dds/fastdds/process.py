"""The helper process as the gateway sees it: started, watched, and started again when it ends."""

from __future__ import annotations

import asyncio
import json
import logging
import socket
import sys
import time
from collections.abc import Callable
from typing import Any, Final

from ropeway import aio
from ropeway.networks.dds.fastdds.frames import BadFrame, HelperFrame, Op, Splitter, encode
from ropeway.processor_queue import ProcessorQueue
from ropeway.tasks import Supervised, describe, end

__all__ = ["HelperProcess", "Unfit"]

log = logging.getLogger("ropeway.dds")

_READY_S: Final = 60.0  # of which the self-test takes 20 at most; the rest is for a small machine that is busy
_PING_S: Final = 2.0
_SILENCE_S: Final = 10.0  # a helper that answers no ping for so long, while the machine lets it run, hangs
_STOP_S: Final = 2.0
_PAUSE_S: Final = 0.1
_LONGEST_PAUSE_S: Final = 10.0
_STEADY_S: Final = 30.0  # one that lived for so long did not fall by itself
_RECEIVE_BYTES: Final = 1 << 20
_UNSENT_LIMIT_BYTES: Final = 256 << 20


class Unfit(Exception):
    """The helper says why it cannot work on this machine."""


class HelperProcess:
    """Keeps a helper process up. ``order`` is what it is told at the start, as JSON.

    ``on_up`` is called when it is ready, after which ``send`` reaches it; ``on_frame`` with what it says; ``on_down``
    when it has ended. All are called on the loop.
    """

    def __init__(
        self,
        name: str,
        order: dict[str, Any],
        on_up: Callable[[], None],
        on_frame: Callable[[HelperFrame], None],
        on_down: Callable[[], None],
    ) -> None:
        self.starts = 0
        self.pid = 0
        self.guid = b""
        self._name, self._order = name, order
        self._on_up, self._on_frame, self._on_down = on_up, on_frame, on_down
        self._writer: asyncio.StreamWriter | None = None
        self._heard = 0.0
        self._first: asyncio.Future[None] | None = None
        self._task: Supervised | None = None

    @property
    def up(self) -> bool:
        """Whether the helper process is ready."""
        return self._writer is not None

    async def start(self) -> None:
        """Start it and wait until it is ready. Raises ``Unfit``."""
        self._first = asyncio.get_running_loop().create_future()
        name = f"{self._name}: helper for Fast DDS"
        self._task = Supervised(self._keep_up, name, on_failure=self._broke).start()
        try:
            await asyncio.shield(self._first)
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """End it."""
        task, self._task = self._task, None
        await end(task)

    def send(self, frame: HelperFrame) -> bool:
        """Tell it something; false where it is not up, or takes nothing in any more."""
        writer = self._writer
        if writer is None or writer.transport.get_write_buffer_size() > _UNSENT_LIMIT_BYTES:
            return False
        writer.write(encode(frame))
        return True

    def _broke(self, error: BaseException) -> None:
        """Report an unforeseen failure to whoever waits for the first start."""
        if self._first is not None and not self._first.done():
            self._first.set_exception(Unfit(describe(error)))

    async def _keep_up(self) -> None:
        assert self._first is not None
        falls = 0
        while True:
            began = time.monotonic()
            self.starts += 1
            try:
                reason = await self._once()
            except (Unfit, OSError) as error:
                if not self._first.done():
                    self._first.set_exception(error if isinstance(error, Unfit) else Unfit(str(error)))
                    return
                reason = str(error)
            if not self._first.done():
                self._first.set_exception(Unfit(f"its process ended at once: {reason}"))
                return
            falls = falls + 1 if time.monotonic() - began < _STEADY_S else 1
            pause = min(_PAUSE_S * 2 ** (falls - 1), _LONGEST_PAUSE_S)
            log.warning("%s: the helper for Fast DDS has ended (%s); it is started again", self._name, reason)
            await asyncio.sleep(pause)

    async def _once(self) -> str:
        """Run the process once and return why it ended. Raises ``Unfit``, ``OSError``."""
        ours, theirs = socket.socketpair()
        with theirs:
            try:
                process = await asyncio.create_subprocess_exec(
                    sys.executable,
                    "-m",
                    "ropeway.networks.dds.fastdds.worker",
                    str(theirs.fileno()),
                    stdin=asyncio.subprocess.DEVNULL,
                    pass_fds=(theirs.fileno(),),
                )
            except BaseException:
                ours.close()
                raise
        self.pid = process.pid
        try:
            try:
                reader, writer = await asyncio.open_connection(sock=ours)
            except BaseException:
                ours.close()
                raise
            try:
                reason = await self._talk(reader, writer)
            finally:
                writer.close()
        finally:
            was_up, self._writer = self._writer is not None, None
            if was_up:
                self._on_down()
            code = await _ended(process)
        return reason or (f"signal {-code}" if code < 0 else f"exit code {code}")

    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> str:
        """Exchange frames until it ends, which gives ``""``, or has to be ended, which gives why."""
        loop = asyncio.get_running_loop()
        # What was found fit once is so for good; a test would only keep those waiting who call.
        order = {**self._order, "test": self.starts == 1}
        writer.write(encode(HelperFrame(Op.CONFIGURE, body=json.dumps(order).encode())))
        splitter = Splitter()
        until = loop.time() + _READY_S
        queue = ProcessorQueue(lambda: self.pid)
        while True:
            try:
                async with aio.timeout_at(until):
                    data = await reader.read(_RECEIVE_BYTES)
            except TimeoutError:
                late_s = queue.lap()
                if not self.up and until + late_s > loop.time():
                    until += late_s
                    continue
                self._heard += late_s
                if not self.up or loop.time() - self._heard > _SILENCE_S:
                    return "it hung"
                writer.write(encode(HelperFrame(Op.PING)))
                until = loop.time() + _PING_S
                continue
            except ConnectionError:
                return ""
            if not data:
                return ""
            self._heard = loop.time()
            if self.up:
                until = self._heard + _PING_S
            try:
                for frame in splitter.feed(data):
                    if self._hear(frame, writer):
                        until = loop.time() + _PING_S
            except BadFrame as error:
                return str(error)

    def _hear(self, frame: HelperFrame, writer: asyncio.StreamWriter) -> bool:
        """Take in a frame; true for the one that says that it is ready."""
        if frame.op == Op.UNFIT:
            raise Unfit(frame.body.decode(errors="replace"))
        if frame.op != Op.READY:
            if frame.op != Op.PONG:
                self._on_frame(frame)
            return False
        self.guid = frame.body
        self._writer = writer
        self._on_up()
        assert self._first is not None
        if not self._first.done():
            self._first.set_result(None)
        return True


async def _ended(process: asyncio.subprocess.Process) -> int:
    """Return the exit code of a process that was hung up on; it is killed if it does not end by itself."""
    try:
        async with aio.timeout(_STOP_S):
            return await process.wait()
    except TimeoutError:
        process.kill()
        return await process.wait()
    except asyncio.CancelledError:
        process.kill()
        raise
