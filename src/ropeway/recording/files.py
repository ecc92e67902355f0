"""Writes MCAP files, one after the other where they would become too large or too long. All methods block."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any, Final

from mcap.writer import CompressionType, IndexType, Writer

from ropeway import __version__
from ropeway.errors import RecordingFailed
from ropeway.recording.channel import Recorded, RecordingChannel

__all__ = ["COMPRESSIONS", "McapFiles"]

COMPRESSIONS: Final = {"none": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}
_CHUNK_BYTES: Final = 1 << 20  # what a crash loses at most, and what a reader decompresses at once
_SUFFIX: Final = ".mcap"


class McapFiles:
    """The files of one recording: ``NAME.mcap``, or ``NAME_0.mcap``, ``NAME_1.mcap`` and so on where it is split.

    Every file stands alone: it has the definitions and the QoS of what is in it. None that is there is written over.
    Raises ``RecordingFailed``, as for a full disk; what was written before stays, and can be read.
    """

    def __init__(self, path: Path, *, compression: str = "none", split_bytes: int = 0, split_s: float = 0.0) -> None:
        self.paths: list[Path] = []
        self.messages = self.bytes = 0
        self._base = path.with_suffix("") if path.suffix == _SUFFIX else path
        self._compression = COMPRESSIONS[compression]
        self._split_bytes, self._split_ns = split_bytes, int(split_s * 1e9)
        self._file: IO[bytes] | None = None
        self._writer: Writer | None = None
        self._known: dict[RecordingChannel, tuple[int, int]] = {}
        self._in_file, self._first_ns = 0, 0

    def write(self, messages: Iterable[Recorded]) -> None:
        """Write messages, the oldest first."""
        try:
            for message in messages:
                writer = self._writer
                if writer is None or self._is_full(message.time_ns):
                    writer = self._next(message.time_ns)
                channel, sequence = self._known.get(message.channel) or self._register(writer, message.channel)
                self._known[message.channel] = channel, sequence + 1
                payload = message.payload
                writer.add_message(channel, message.time_ns, payload, message.time_ns, sequence)
                self._in_file += len(payload)
                self.messages += 1
                self.bytes += len(payload)
        except OSError as error:
            self._abandon()
            raise self._failed(error) from error

    def flush(self) -> None:
        """Hand what is complete to the operating system."""
        if self._file is not None:
            try:
                self._file.flush()
            except OSError as error:
                self._abandon()
                raise self._failed(error) from error

    def close(self) -> None:
        """End the file; an empty recording has none."""
        writer, file, self._writer, self._file = self._writer, self._file, None, None
        if writer is None or file is None:
            return
        try:
            with file:
                writer.finish()  # type: ignore[no-untyped-call]
        except OSError as error:
            raise self._failed(error) from error

    def _is_full(self, time_ns: int) -> bool:
        long = self._split_ns and time_ns - self._first_ns >= self._split_ns
        return bool(long or (self._split_bytes and self._in_file >= self._split_bytes))

    def _next(self, time_ns: int) -> Writer:
        """Begin the next file."""
        self.close()
        split = self._split_bytes or self._split_ns
        path = self._base.with_name(f"{self._base.name}{f'_{len(self.paths)}' if split else ''}{_SUFFIX}")
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("xb")
        self.paths.append(path)
        index = IndexType.CHUNK | IndexType.MESSAGE
        self._writer = writer = Writer(
            self._file, chunk_size=_CHUNK_BYTES, compression=self._compression, index_types=index
        )
        writer.start(profile="ros2", library=f"ropeway {__version__}")
        self._known.clear()
        self._in_file, self._first_ns = 0, time_ns
        return writer

    def _register(self, writer: Writer, channel: RecordingChannel) -> tuple[int, int]:
        schema = writer.register_schema(channel.type, channel.schema_encoding, channel.schema.encode())
        return writer.register_channel(channel.topic, channel.encoding, schema, dict(channel.metadata)), 0

    def _abandon(self) -> None:
        """Let go of a file that cannot be written; what is on the disk stays."""
        file, self._file, self._writer = self._file, None, None
        if file is not None:
            raw: Any = file
            try:
                raw.raw.close()  # without the buffer, whose writing would fail again
            except OSError:
                return

    def _failed(self, error: OSError) -> RecordingFailed:
        place = self.paths[-1] if self._in_file and self.paths else (error.filename or self._base)
        if isinstance(error, FileExistsError):
            return RecordingFailed(str(place), "is there already; choose another name")
        return RecordingFailed(str(place), error.strerror or str(error))
