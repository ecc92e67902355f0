"""Database files of rosbag2, of every version of its schema."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import apsw

from ropeway.recording.offered_qos import PROFILES_KEY, profiles_in, recorded_qos
from ropeway.recording.sources.source import DEFINITIONS, RecordedChannel

if TYPE_CHECKING:
    from typing_extensions import Self


__all__ = ["SqliteSource"]


_COUNTS: Final = """
SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp) FROM messages
WHERE typeof(timestamp) = 'integer' AND typeof(data) = 'blob' GROUP BY topic_id
"""
_UNUSABLE: Final = "SELECT COUNT(*) FROM messages WHERE typeof(timestamp) <> 'integer' OR typeof(data) <> 'blob'"


class SqliteSource:
    """A ``.db3`` file. One that is cut short is read as far as it goes, in the order in which it was written."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._db: apsw.Connection
        self.channels: list[RecordedChannel] = []
        self.start_ns = self.end_ns = 0
        self.notes: list[str] = []
        self._damaged = False

    def __enter__(self) -> Self:
        journal = self._path.with_name(self._path.name + "-wal")  # what a recorder that was killed has left
        mode = "mode=ro" if journal.exists() and journal.stat().st_size else "immutable=1"
        self._db = apsw.Connection(
            f"{self._path.absolute().as_uri()}?{mode}", flags=apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI
        )
        try:
            self._db.execute("PRAGMA writable_schema=ON")  # lets a file that is shorter than it says be read
            if not {"topics", "messages"} <= {row[0] for row in self._db.execute("SELECT name FROM sqlite_master")}:
                raise ValueError("this database is not a rosbag2 recording: it has no tables of topics and messages")
            self._list()
        except BaseException:
            self._db.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._db.close()

    def messages(self, ids: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        """Yield the messages of these topics."""
        wanted = frozenset(ids)
        order = "" if self._damaged else " ORDER BY timestamp, id"
        try:
            for topic, time_ns, data in self._db.execute(f"SELECT topic_id, timestamp, data FROM messages{order}"):  # noqa: S608
                if topic in wanted and isinstance(time_ns, int) and isinstance(data, bytes):
                    yield topic, time_ns, data
        except apsw.Error:
            if not self._damaged:
                raise

    def _list(self) -> None:
        columns = self._columns("topics")
        definitions: dict[str, str] = {}
        if self._columns("message_definitions"):
            rows = self._db.execute("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
            definitions = {type: text for type, encoding, text in rows if encoding in DEFINITIONS}
        counts = self._counts()
        names = ["id", "name", "type", "serialization_format"]
        profiles = PROFILES_KEY if PROFILES_KEY in columns else "''"
        for id, topic, type, encoding, qos in self._db.execute(f"SELECT {', '.join(names)}, {profiles} FROM topics"):  # noqa: S608
            self.channels.append(
                RecordedChannel(
                    id=id,
                    topic=str(topic),
                    type=str(type),
                    definition=definitions.get(type),
                    encoding=str(encoding),
                    count=counts.get(id, 0),
                    qos=recorded_qos(str(topic), profiles_in(qos)),
                )
            )
        if lost := sum(counts.values()) - sum(channel.count for channel in self.channels):
            self.notes.append(f"{lost} of its messages are of no topic that it names, and left out")

    def _counts(self) -> dict[Any, int]:
        """Return how many messages each topic has, counting them one by one if the file is damaged."""
        counts: dict[Any, int] = {}
        times: list[int] = []
        try:
            for topic, count, first, last in self._db.execute(_COUNTS):
                counts[topic] = count
                times += (first, last)
            ((odd,),) = self._db.execute(_UNUSABLE)
            if odd:
                self.notes.append(f"{odd} of its messages have no time or no bytes, and are left out")
        except apsw.Error:
            self._damaged = True
            self.notes.append("it is cut short or damaged; what is whole is played")
            counts, times = {}, []
            try:
                for topic, time_ns, kind in self._db.execute("SELECT topic_id, timestamp, typeof(data) FROM messages"):
                    if kind != "blob" or not isinstance(time_ns, int):
                        continue
                    counts[topic] = counts.get(topic, 0) + 1
                    times = [min(time_ns, *times[:1]), max(time_ns, *times[1:])] if times else [time_ns, time_ns]
            except apsw.Error as error:
                if not counts:
                    raise ValueError(f"the recording is cut short or damaged: {error}") from None
        if times:
            self.start_ns, self.end_ns = min(times), max(times)
        return counts

    def _columns(self, table: str) -> set[str]:
        return {row[1] for row in self._db.execute(f"PRAGMA table_info({table})")}
