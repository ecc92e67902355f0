"""Writes clips: what came some seconds before a trigger, and some seconds after."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Final

import orjson

from ropeway.errors import RecordingFailed
from ropeway.limits import RECORDED_CLIP_S, RECORDING_WAITING_BYTES
from ropeway.recording.channel import Recorded, json_channel
from ropeway.recording.files import McapFiles
from ropeway.recording.ring import Ring
from ropeway.recording.writer import RecordingWriter
from ropeway.tasks import Supervised, end

__all__ = ["NOTED_TRIGGERS", "TRIGGERS", "ClipRecorder", "stamped"]

log = logging.getLogger("ropeway.record")

TRIGGERS: Final = json_channel("/ropeway/triggers", "ropeway.Trigger", why="string")
"""The channel that says why a clip was begun and went on."""


NOTED_TRIGGERS: Final = 1000
"""Triggers that are written into a clip; all are counted."""


def stamped(path: Path, at_s: float | None = None) -> Path:
    """Return the path with date and time behind its name, to the millisecond, so that no clip has another's name."""
    now_s = time.time() if at_s is None else at_s
    text = time.strftime("%Y%m%d-%H%M%S", time.localtime(now_s))
    stem = path.with_suffix("") if path.suffix == ".mcap" else path
    return stem.with_name(f"{stem.name}_{text}-{int(now_s * 1000) % 1000:03d}.mcap")


class ClipRecorder:
    """Keeps a ring, and turns it into a file at each trigger; what comes within ``after_s`` goes there, too.

    A trigger within a clip makes it longer, up to ``RECORDED_CLIP_S``. While a clip is brought to an end on the disk,
    the next one waits for it, so that no storm of triggers has many rings in memory. ``make`` makes the files of a
    clip; ``on_clip`` is told of each that is whole.
    """

    def __init__(
        self, ring: Ring, after_s: float, make: Callable[[], McapFiles], *, on_clip: Callable[[McapFiles], None]
    ) -> None:
        self.ring, self.after_s = ring, after_s
        self.triggers = self.clips = self.failures = 0
        self.error = ""
        """Why the last clip could not be written."""
        self.dropped: Counter[str] = Counter()
        self._make, self._on_clip = make, on_clip
        self._writer: RecordingWriter | None = None
        self._until_s = self._latest_s = 0.0
        self._noted = 0
        self._ends: asyncio.TimerHandle | None = None
        self._waiting = ""  # the trigger of the next clip
        self._ended: asyncio.Queue[RecordingWriter | None] = asyncio.Queue()  # of one writer at most
        self._closing = False
        self._closer = Supervised(self._close_clips, "clips").start()

    @property
    def writing(self) -> bool:
        """Whether a clip is being written."""
        return self._writer is not None or self._closing

    def put(self, message: Recorded) -> None:
        """Take a message."""
        self.ring.add(message)
        if self._writer is not None:
            self._writer.put(message)

    def trigger(self, why: str) -> None:
        """Begin a clip, or make the one that is being written longer."""
        self.triggers += 1
        self._begin_or_go_on(why)

    def _begin_or_go_on(self, why: str) -> None:
        if self._writer is None:
            if self._closing:
                self._waiting = self._waiting or why
                return
            self._begin(why)
        loop = asyncio.get_running_loop()
        self._until_s = min(loop.time() + self.after_s, self._latest_s)
        if self._writer is not None and self._noted < NOTED_TRIGGERS:
            self._noted += 1
            self._writer.put(Recorded(TRIGGERS, time.time_ns(), orjson.dumps({"why": why})))
        if self._ends is None:
            self._ends = loop.call_at(self._until_s, self._look)

    def _begin(self, why: str) -> None:
        ring = self.ring
        room = ring.bytes + ring.latched_bytes + RECORDING_WAITING_BYTES  # the ring counts as held already
        self._writer = RecordingWriter(self._make(), most_waiting_bytes=room)
        self._latest_s, self._noted = asyncio.get_running_loop().time() + RECORDED_CLIP_S, 0
        for message in ring.snapshot():
            self._writer.put(message)
        log.info("a clip begins: %s", why)

    def _look(self) -> None:
        """End the clip, unless there were triggers meanwhile."""
        loop = asyncio.get_running_loop()
        self._ends = loop.call_at(self._until_s, self._look) if loop.time() < self._until_s else None
        if self._ends is None:
            self._finish()

    def _finish(self) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            self._closing = True
            self._ended.put_nowait(writer)

    async def _close_clips(self) -> None:
        while (writer := await self._ended.get()) is not None:
            await self._close_clip(writer)
            self._closing = False
            why, self._waiting = self._waiting, ""
            if why:
                self._begin_or_go_on(why)

    async def _close_clip(self, writer: RecordingWriter) -> None:
        try:
            await writer.close()
        except RecordingFailed as error:
            self.failures += 1
            self.error = str(error)
            log.error("a clip could not be written: %s", error)
        else:
            self.clips += 1
            self.error = ""
            self._on_clip(writer.files)
        self.dropped += writer.dropped

    async def close(self) -> None:
        """End the clip that is being written, if any."""
        if self._ends is not None:
            self._ends.cancel()
        self._waiting = ""
        self._finish()
        self._ended.put_nowait(None)
        await self._closer.wait()
        await end(self._closer)
