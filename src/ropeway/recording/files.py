"""Writes MCAP files, one after the other where they would become too large or too long. All methods block."""

from __future__ import annotations

import time
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from ropeway import __version__
from ropeway.errors import RecordingFailed
from ropeway.recording.channel import Recorded, RecordingChannel
from ropeway.recording.kept_files import KeptFiles
from ropeway.recording.mcap_writer import McapWriter

__all__ = ["CHUNK_S", "McapFiles"]

CHUNK_S: Final = 2.0
"""Seconds after which what came is in the file, so that a process that is killed loses no more, even of little."""

_SUFFIX: Final = ".mcap"


class McapFiles:
    """The files of one recording: ``NAME.mcap``, or ``NAME_0.mcap``, ``NAME_1.mcap`` and so on where it is split.

    Every file stands alone: it has the definitions and the QoS of what is in it. None that is there is written over.
    ``kept`` removes older files before each new one. ``messages`` and ``bytes`` count what is in the files, or will be
    with their next chunk. Raises ``RecordingFailed``, as for a full disk; what was written before stays, and can be
    read.
    """

    def __init__(
        self,
        path: Path,
        *,
        compression: str = "none",
        split_bytes: int = 0,
        split_s: float = 0.0,
        kept: KeptFiles | None = None,
    ) -> None:
        self.paths: list[Path] = []
        self.messages = self.bytes = 0
        self._base = path.with_suffix("") if path.suffix == _SUFFIX else path
        self._compression = compression
        self._split_bytes, self._split_ns = split_bytes, int(split_s * 1e9)
        self._kept = kept
        self._writer: McapWriter | None = None
        self._known: dict[RecordingChannel, tuple[int, int]] = {}
        self._first_ns = 0
        self._pending_since_s = 0.0

    def write(self, messages: Iterable[Recorded]) -> None:
        """Write messages, the oldest first."""
        try:
            for message in messages:
                writer = self._writer
                if writer is None or self._is_full(writer, message.time_ns):
                    writer = self._next(message.time_ns)
                channel, sequence = self._known.get(message.channel) or self._register(writer, message.channel)
                self._known[message.channel] = channel, sequence + 1
                payload = message.payload
                self.messages += 1
                self.bytes += len(payload)
                writer.add_message(channel, message.time_ns, sequence, payload)
        except OSError as error:
            raise self._failed(error) from error

    def flush(self, *, everything: bool = False) -> None:
        """Hand what has waited for long to the operating system, or ``everything``."""
        writer, now_s = self._writer, time.monotonic()
        if writer is None or not writer.pending:
            self._pending_since_s = now_s
        elif everything or now_s - self._pending_since_s >= CHUNK_S:
            self._pending_since_s = now_s
            try:
                writer.end_chunk()
            except OSError as error:
                raise self._failed(error) from error

    @property
    def pending(self) -> bool:
        """Whether messages wait for the end of their chunk."""
        return self._writer is not None and self._writer.pending

    def close(self) -> None:
        """End the file; an empty recording has none."""
        writer = self._writer
        if writer is None:
            return
        try:
            writer.finish()
        except OSError as error:
            raise self._failed(error) from error
        self._writer = None

    def _is_full(self, writer: McapWriter, time_ns: int) -> bool:
        long = self._split_ns and time_ns - self._first_ns >= self._split_ns
        return bool(long or (self._split_bytes and writer.size >= self._split_bytes))

    def _next(self, time_ns: int) -> McapWriter:
        """Begin the next file."""
        self.close()
        split = self._split_bytes or self._split_ns
        path = self._base.with_name(f"{self._base.name}{f'_{len(self.paths)}' if split else ''}{_SUFFIX}")
        path.parent.mkdir(parents=True, exist_ok=True)
        if self._kept is not None:
            self._kept.make_room(self._split_bytes)
        file = path.open("xb", buffering=0)
        self.paths.append(path)
        self._writer = McapWriter(file, compression=self._compression, library=f"ropeway {__version__}")
        self._known.clear()
        self._first_ns = time_ns
        return self._writer

    def _register(self, writer: McapWriter, channel: RecordingChannel) -> tuple[int, int]:
        schema = channel.type, channel.schema_encoding, channel.schema
        return writer.add_channel(channel.topic, channel.encoding, schema, channel.metadata), 0

    def _failed(self, error: OSError) -> RecordingFailed:
        """Let go of a file that cannot be written, and return what to raise."""
        writer, self._writer = self._writer, None
        if writer is not None:
            lost = writer.rescue()
            self.messages -= lost.messages
            self.bytes -= lost.payload_bytes
        place = error.filename or (self.paths[-1] if self.paths else self._base)
        if isinstance(error, FileExistsError):
            return RecordingFailed(str(place), "is there already; choose another name")
        return RecordingFailed(str(place), error.strerror or str(error))
