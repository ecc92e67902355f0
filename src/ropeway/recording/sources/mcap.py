"""MCAP files, with every optional record or without, whole or cut short."""

from __future__ import annotations

import heapq
import logging
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from mcap.reader import make_reader
from mcap.records import Channel as McapChannel
from mcap.records import Chunk, ChunkIndex, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.summary import Summary

from ropeway.recording.offered_qos import PROFILES_KEY, profiles_in, recorded_qos
from ropeway.recording.sources.mcap_chunks import chunk_records
from ropeway.recording.sources.source import DAMAGED, DEFINITIONS, RecordedChannel, reason_of

if TYPE_CHECKING:
    from typing_extensions import Self


__all__ = ["McapSource"]

log = logging.getLogger("ropeway.bag")

_LIMIT: Final = 1 << 30  # a length above is damage; writers close a chunk at some MiB


class McapSource:
    """An MCAP file, of either profile.

    A summary that tells everything makes reading it fast and in order. Else the file is read through once, to know
    what it has, and then played in its own order: to sort it, all of it would have to be held.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        self.channels: list[RecordedChannel] = []
        self.start_ns = self.end_ns = 0
        self.notes: list[str] = []
        self._indexed = False
        self._chunks: list[ChunkIndex] = []

    def __enter__(self) -> Self:
        try:
            summary = self._summary()
            if summary is not None and summary.statistics is not None:
                self._chunks = summary.chunk_indexes
                self._indexed = bool(self._chunks)
                self.start_ns = summary.statistics.message_start_time
                self.end_ns = summary.statistics.message_end_time
                self._list(summary.channels, summary.schemas, summary.statistics.channel_message_counts)
            else:
                self._scan()
        except BaseException:
            self._file.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def messages(self, ids: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        """Yield the messages of these channels."""
        wanted = frozenset(ids)
        if not self._indexed:
            for record in self._records():
                if isinstance(record, Message) and record.channel_id in wanted:
                    yield record.channel_id, record.log_time, record.data
            return
        yield from self._in_order(wanted)

    def _in_order(self, wanted: frozenset[int]) -> Iterator[tuple[int, int, bytes]]:
        """Yield messages by the index, sorted by time: what a later chunk may have before them is read first."""
        held: list[tuple[int, int, int, bytes]] = []
        count = 0
        chunks = [one for one in self._chunks if not wanted.isdisjoint(one.message_index_offsets)]
        for place in sorted(chunks, key=lambda one: (one.message_start_time, one.chunk_start_offset)):
            while held and held[0][0] < place.message_start_time:
                time_ns, _, channel, data = heapq.heappop(held)
                yield channel, time_ns, data
            try:
                for record in self._chunk_at(place.chunk_start_offset):
                    if isinstance(record, Message) and record.channel_id in wanted:
                        count += 1
                        heapq.heappush(held, (record.log_time, count, record.channel_id, record.data))
            except DAMAGED as error:
                log.warning("a chunk cannot be read, and the rest of it is left out: %s", reason_of(error))
        while held:
            time_ns, _, channel, data = heapq.heappop(held)
            yield channel, time_ns, data

    def _chunk_at(self, offset: int) -> Iterator[McapRecord]:
        self._file.seek(offset)
        chunk = next(StreamReader(self._file, skip_magic=True, emit_chunks=True, record_size_limit=_LIMIT).records)
        if not isinstance(chunk, Chunk):
            raise ValueError("the index leads to something that is no chunk")
        return chunk_records(chunk)

    def _summary(self) -> Summary | None:
        """Return the summary, if it is all that is needed to find every message."""
        try:
            summary = make_reader(self._file).get_summary()
        except DAMAGED:
            return None
        if summary is None or summary.statistics is None:
            return None
        statistics, chunks = summary.statistics, summary.chunk_indexes
        channels = summary.channels.values()
        indexed = sum(len(chunk.message_index_offsets) > 0 for chunk in chunks)
        whole = (
            statistics.channel_count == len(channels)
            and statistics.chunk_count == len(chunks) == indexed
            and all(channel.schema_id in summary.schemas for channel in channels if channel.schema_id)
            and sum(statistics.channel_message_counts.values()) == statistics.message_count
        )
        return summary if whole else None

    def _scan(self) -> None:
        """Learn what there is by reading all of it."""
        channels: dict[int, McapChannel] = {}
        schemas: dict[int, Schema] = {}
        counts: Counter[int] = Counter()
        for record in self._records(self.notes):
            if isinstance(record, Schema):
                schemas.setdefault(record.id, record)
            elif isinstance(record, McapChannel):
                channels.setdefault(record.id, record)
            elif isinstance(record, Message):
                self.start_ns = min(self.start_ns, record.log_time) if counts else record.log_time
                self.end_ns = max(self.end_ns, record.log_time)
                counts[record.channel_id] += 1
        if self.notes and not channels:
            raise ValueError("the recording is cut short or damaged, and nothing in it is whole")
        self._list(channels, schemas, counts)

    def _records(self, notes: list[str] | None = None) -> Iterator[McapRecord]:
        """Yield all records that are whole; ``notes`` is told of the others."""
        self._file.seek(0)
        damaged = 0
        try:
            reader = StreamReader(self._file, emit_chunks=True, record_size_limit=_LIMIT)
            for record in reader.records:
                if not isinstance(record, Chunk):
                    yield record
                    continue
                try:
                    yield from chunk_records(record)
                except DAMAGED:
                    damaged += 1
        except DAMAGED:
            if notes is not None:
                notes.append(
                    "it is cut short or damaged; what is whole is played, and `mcap recover` makes a whole file of it"
                )
        if damaged and notes is not None:
            notes.append(f"{damaged} of its chunks cannot be read, and what they hold is left out")

    def _list(
        self, channels: dict[int, McapChannel], schemas: dict[int, Schema], counts: dict[int, int] | Counter[int]
    ) -> None:
        for channel in channels.values():
            schema = schemas.get(channel.schema_id)
            known = schema is not None and schema.encoding in DEFINITIONS
            self.channels.append(
                RecordedChannel(
                    id=channel.id,
                    topic=channel.topic,
                    type=schema.name if schema else "",
                    definition=schema.data.decode(errors="replace") if known and schema else None,
                    encoding=channel.message_encoding,
                    count=counts.get(channel.id, 0),
                    qos=recorded_qos(
                        channel.topic,
                        profiles_in(channel.metadata.get(PROFILES_KEY, "")),
                        latched=channel.metadata.get("latching") == "1",
                    ),
                )
            )
