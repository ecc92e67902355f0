"""Writes a recording while messages come: a bounded queue, and a thread that takes what waits in one go."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Final

from ropeway import aio
from ropeway.errors import RecordingFailed
from ropeway.limits import RECORDED_MESSAGE_BYTES, RECORDING_WAITING_BYTES
from ropeway.recording.channel import Recorded
from ropeway.recording.files import CHUNK_S, McapFiles
from ropeway.tasks import Supervised, end

__all__ = ["RecordingWriter"]

_TOGETHER_S: Final = 0.05  # what comes within is written in one go
_TOGETHER_BYTES: Final = 4 << 20  # more does not wait
_CLOSE_S: Final = 30.0  # for what waits, when the recording ends

SLOW: Final = "the disk is slower than what comes"
FAILED: Final = "the recording has failed"


class RecordingWriter:
    """Writes what ``put`` is given, in order. ``dropped`` counts what could not be, by reason; ``failure`` says why it
    has failed, ``None`` while it works; ``on_failure`` is told when it does.
    """

    def __init__(
        self,
        files: McapFiles,
        *,
        most_waiting_bytes: int = RECORDING_WAITING_BYTES,
        on_failure: Callable[[], None] = lambda: None,
    ) -> None:
        self.files = files
        self.dropped: Counter[str] = Counter()
        self.failure: RecordingFailed | None = None
        self._on_failure = on_failure
        self._waiting: list[Recorded] = []
        self._taken = 0
        self._waiting_bytes = self._new_bytes = 0
        self._most = most_waiting_bytes
        self._wake, self._soon = asyncio.Event(), asyncio.Event()
        self._closing = False
        self._thread = ThreadPoolExecutor(1, "ropeway-record")  # one, so that a file is never used by two
        self._task = Supervised(self._run, "recording").start()

    def put(self, message: Recorded) -> None:
        """Take a message; it is written soon. What comes too fast for the disk is dropped and counted."""
        size = len(message.payload) + RECORDED_MESSAGE_BYTES
        if self.failure is not None:
            self.dropped[FAILED] += 1
        elif self._waiting_bytes + size > self._most:
            self.dropped[SLOW] += 1
        else:
            self._waiting.append(message)
            self._taken += 1
            self._waiting_bytes += size
            self._new_bytes += size
            self._wake.set()
            if self._new_bytes > _TOGETHER_BYTES:
                self._soon.set()

    async def close(self) -> None:
        """Write what waits, and end the file. Raises ``RecordingFailed``."""
        if self._closing:
            return
        self._closing = True
        self._wake.set()
        self._soon.set()
        try:
            async with aio.timeout(_CLOSE_S):
                await self._task.wait()
                if self.failure is None:
                    await self._in_thread(self.files.close)
        except RecordingFailed as error:
            self._fail(error)
        except TimeoutError:
            self._fail(
                RecordingFailed(str(self.files.paths[-1] if self.files.paths else ""), "the disk does not answer")
            )
        finally:
            await end(self._task)
            self._thread.shutdown(wait=False)
        if self.failure is not None:
            raise self.failure

    async def _run(self) -> None:
        while self.failure is None and not (self._closing and not self._waiting):
            await self._woken()
            batch, self._waiting, written = self._waiting, [], self._new_bytes
            self._new_bytes = 0
            self._wake.clear()
            if self._closing:
                self._wake.set()
            else:
                self._soon.clear()
            try:
                await self._in_thread(self._write, batch)
            except RecordingFailed as error:
                self._fail(error)
            self._waiting_bytes -= written

    async def _woken(self) -> None:
        """Wait until there is something to write, and for what comes soon after it."""
        try:
            async with aio.timeout(CHUNK_S if self.files.pending else None):
                await self._wake.wait()
            async with aio.timeout(_TOGETHER_S):
                await self._soon.wait()
        except TimeoutError:
            return

    def _write(self, batch: list[Recorded]) -> None:
        self.files.write(batch)
        self.files.flush(everything=not batch)

    def _fail(self, error: RecordingFailed) -> None:
        """Take nothing more; what was taken and is in no file is lost, and counted."""
        self.failure = error
        self.dropped[FAILED] += self._taken - self.files.messages
        self._waiting.clear()
        self._on_failure()

    async def _in_thread(self, work: object, *args: object) -> None:
        await asyncio.get_running_loop().run_in_executor(self._thread, work, *args)  # type: ignore[arg-type]
