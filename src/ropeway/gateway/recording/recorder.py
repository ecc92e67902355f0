"""Carries out one recorder of a configuration: its files, its ring, what it reads of a graph."""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ropeway.errors import RecordingFailed
from ropeway.gateway.config.record_model import RecordConfig
from ropeway.recording.channel import Recorded
from ropeway.recording.clips import ClipRecorder, stamped
from ropeway.recording.condition import Condition
from ropeway.recording.files import McapFiles
from ropeway.recording.graph_recorder import GraphRecorder, TopicChoice
from ropeway.recording.kept_files import KeptFile, KeptFiles
from ropeway.recording.ring import Ring
from ropeway.recording.writer import FAILED, RecordingWriter
from ropeway.tasks import Supervised, describe, end

if TYPE_CHECKING:
    from ropeway.hub.hub import Hub, View
    from ropeway.types import TypeRegistry

__all__ = ["Recorder"]

log = logging.getLogger("ropeway.record")

_AGAIN_S: Final = 10.0
"""A recording that has failed begins again after so long, in another file: somebody may have made room."""


class Recorder:
    """A recorder, running or not. ``directory`` is its own; ``part`` tells the files of workers apart."""

    def __init__(
        self,
        config: RecordConfig,
        directory: Path,
        hubs: Mapping[str, Hub],
        registry: TypeRegistry,
        *,
        part: str = "",
        again_s: float = _AGAIN_S,
    ) -> None:
        self.config, self.directory = config, directory
        self.kept = KeptFiles(directory, config.keep_bytes)
        self.error = ""
        self.last = ""
        """The last file or clip that was begun, and the last clip that is whole."""
        self._hubs, self._registry, self._part, self._again_s = hubs, registry, part, again_s
        self._writer: RecordingWriter | None = None
        self._clips: ClipRecorder | None = None
        self._failed = asyncio.Event()
        self._task: Supervised | None = None
        self._view: View | None = None
        self._graph: GraphRecorder | None = None
        self._ended: Counter[str] = Counter()  # what was lost in recordings that are over

    @property
    def _stem(self) -> str:
        """The beginning of the names of its files: workers share a directory."""
        return self._part or self.config.name

    def files(self) -> list[KeptFile]:
        """Return the files of this recorder, the oldest first. Blocks."""
        return [one for one in self.kept.listed() if one.path.name.startswith(f"{self._stem}_")]

    # ── what it takes ──────────────────────────────────────────────────────────────────────────────────────────

    @property
    def running(self) -> bool:
        """Whether it takes messages."""
        return self._task is not None or self._clips is not None

    def takes(self, route_name: str) -> bool:
        """Return whether what crosses a route of this local name is recorded now."""
        config = self.config
        return (
            self.running
            and any(fnmatchcase(route_name, pattern) for pattern in config.routes)
            and not any(fnmatchcase(route_name, pattern) for pattern in config.exclude)
        )

    def put(self, message: Recorded) -> None:
        """Take a message; nobody waits for the disk."""
        if self._clips is not None:
            self._clips.put(message)
        elif self._writer is not None:
            self._writer.put(message)
        else:
            self._ended[FAILED] += 1

    # ── what may be asked of it ────────────────────────────────────────────────────────────────────────────────

    async def start(self) -> None:
        """Begin; what is wrong with the disk is told by ``error``, and tried again."""
        if self.running:
            return
        config = self.config
        self.error = ""
        if config.ring_s is not None:
            ring = Ring(config.ring_s, config.ring_bytes)
            self._clips = ClipRecorder(ring, config.after_s, self._files, on_clip=self._whole)
        else:
            self._begin_writer()
            self._task = Supervised(self._write, f"recorder {config.name}").start()
        conditions = [Condition(text) for text in config.when]
        if config.topics or conditions:
            hub = self._hubs[config.graph or next(iter(self._hubs))]
            self._view = hub.view(f"recorder {config.name}")
            choice = TopicChoice(names=config.topics, excluded=config.exclude)
            self._graph = GraphRecorder(
                self._view, self._registry, choice, self.put, conditions=conditions, triggered=self._triggered
            ).start()

    async def stop(self) -> None:
        """End what is being written, and take nothing more."""
        graph, view, self._graph, self._view = self._graph, self._view, None, None
        if graph is not None:
            await graph.close()
        if view is not None:
            await view.close()
        clips, self._clips = self._clips, None
        if clips is not None:
            await clips.close()
            self._ended += clips.dropped
        task, self._task = self._task, None
        if task is not None:
            await end(task)
            await self._end_writer()

    def trigger(self, why: str) -> bool:
        """Write a clip of what was and of what comes; return whether there is a ring that can be written."""
        if self._clips is None:
            return False
        self._triggered(why)
        return True

    @property
    def state(self) -> str:
        """The state in one word: ``stopped``, ``recording``, ``waiting`` for a trigger, ``writing`` a clip, or
        ``failed``.
        """
        if not self.running:
            return "stopped"
        if self._clips is not None:
            return "writing" if self._clips.writing else "failed" if self._clips.error else "waiting"
        return "failed" if self.error else "recording"

    def status(self) -> dict[str, Any]:
        """Return how it is, as JSON."""
        clips, writer = self._clips, self._writer
        dropped = Counter(self._ended)
        found: dict[str, Any] = {
            "name": self.config.name,
            "state": self.state,
            "error": self.error or ("" if clips is None else clips.error),
            "directory": str(self.directory),
            "last": self.last,
            "removed": self.kept.removed,
        }
        if clips is not None:
            dropped += clips.dropped
            ring = clips.ring
            found["ring"] = {"messages": len(ring), "bytes": ring.bytes, "cut": ring.cut}
            found |= {"clips": clips.clips, "failures": clips.failures, "triggers": clips.triggers}
        if writer is not None:
            dropped += writer.dropped
            found |= {"messages": writer.files.messages, "bytes": writer.files.bytes}
        if self._graph is not None:
            found["refused"] = dict(self._graph.refused)
        return {**found, "dropped": dict(dropped), **({"part": self._part} if self._part else {})}

    # ── the disk ───────────────────────────────────────────────────────────────────────────────────────────────

    def _files(self) -> McapFiles:
        """Make the files of the next recording, or clip."""
        config = self.config
        path = stamped(self.directory / self._stem)
        self.last = str(path)
        return McapFiles(
            path,
            compression=config.compression,
            split_bytes=config.file_bytes,
            split_s=config.split_s or 0.0,
            kept=self.kept,
        )

    async def _write(self) -> None:
        """Write all the time; begin again after a failure, for as long as the recorder runs."""
        while True:
            await self._failed.wait()
            writer = self._writer
            self.error = describe(writer.failure) if writer is not None and writer.failure is not None else ""
            log.error("recorder %s: %s; it is tried again in %g s", self.config.name, self.error, self._again_s)
            await self._end_writer()
            await asyncio.sleep(self._again_s)
            self.error = ""
            self._begin_writer()

    def _begin_writer(self) -> None:
        self._failed.clear()
        self._writer = RecordingWriter(self._files(), on_failure=self._failed.set)

    async def _end_writer(self) -> None:
        writer, self._writer = self._writer, None
        if writer is None:
            return
        with suppress(RecordingFailed):  # it is in the state of the recorder already
            await writer.close()
        self._ended += writer.dropped

    def _triggered(self, why: str) -> None:
        if self._clips is not None:
            self._clips.trigger(why)

    def _whole(self, clip: McapFiles) -> None:
        if clip.paths:
            self.last = str(clip.paths[-1])
        log.info("recorder %s: %s, %d messages", self.config.name, self.last, clip.messages)
