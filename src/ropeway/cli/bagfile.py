"""Reads recordings as a stream of CDR messages: MCAP (ROS 2 and ROS 1), rosbag2 directories and files, ROS 1 bags.

Messages come in the order of their log times, one at a time; the file is never loaded as a whole. Definitions found
in the recording become known to the registry, and ROS 1 messages are converted on the way.
"""

from __future__ import annotations

import logging
import struct
import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Final, NamedTuple, Protocol, Self

import apsw
import yaml
import zstandard
from mcap.exceptions import McapError
from mcap.reader import make_reader
from rosbags.rosbag1 import Reader as Rosbag1Reader
from rosbags.rosbag1 import ReaderError as Rosbag1Error
from rosbags.rosbag2 import Reader as Rosbag2Reader
from rosbags.rosbag2 import ReaderError as Rosbag2Error

from ropeway.errors import BagUnreadable, InvalidName, TypeConflict, TypesError
from ropeway.graph.base import resolve_name
from ropeway.qos import DEFAULT, LATCHED, QoS, common_qos
from ropeway.types import TypeRegistry

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd  # what rosbags takes before it is in the standard library

__all__ = ["Bag", "BagTopic", "Record"]

log = logging.getLogger("ropeway.bag")

# What the readers raise for a damaged file: they check little, so a wrong length shows as any of these.
_DAMAGED: Final = (
    McapError,
    Rosbag1Error,
    Rosbag2Error,
    AssertionError,
    ArithmeticError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    apsw.Error,
    struct.error,
    yaml.YAMLError,
    zstandard.ZstdError,
    zstd.ZstdError,
)


class Record(NamedTuple):
    """One recorded message: when it was logged, where, and its CDR."""

    time_ns: int
    topic: BagTopic
    payload: bytes


@dataclass(frozen=True)
class BagTopic:
    """A topic of a recording. ``problem`` says why it cannot be played, ``""`` where it can."""

    name: str
    type: str
    count: int
    qos: QoS = DEFAULT
    problem: str = ""
    convert: Callable[[bytes], bytes] = field(default=bytes, compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class _Channel:
    """What a file says of one stream of messages."""

    id: int
    topic: str
    type: str
    definition: str  # "" where the file has none
    encoding: str  # "cdr", "ros1", or something else
    count: int
    qos: QoS


class _Source(Protocol):
    channels: list[_Channel]
    start_ns: int
    end_ns: int

    def messages(self, ids: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        """``(channel, time_ns, raw)`` in the order of time."""


class Bag:
    """An open recording; a context manager.

    ``topics`` are by name and type; one that cannot be played stands there with its ``problem``. ``dropped`` counts
    messages that could not be converted, by topic.
    """

    def __init__(self, path: str | Path, registry: TypeRegistry) -> None:
        self.path = Path(path)
        self.registry = registry
        self.topics: list[BagTopic] = []
        self.dropped: Counter[str] = Counter()
        self._stack = ExitStack()
        self._source: _Source
        self._by_channel: dict[int, BagTopic] = {}

    def __enter__(self) -> Self:
        """Open the file and read what it says of itself. Raises ``BagUnreadable``."""
        if not self.path.exists():
            raise BagUnreadable(str(self.path), "there is no such file or directory")
        try:
            self._source = self._stack.enter_context(_open(self.path))
        except _DAMAGED as error:
            self._stack.close()
            raise BagUnreadable(str(self.path), _reason(error)) from error
        self._learn()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Close the file."""
        self._stack.close()

    @property
    def start_ns(self) -> int:
        """Log time of the first message."""
        return self._source.start_ns

    @property
    def duration_s(self) -> float:
        """From the first to the last message."""
        return max(self._source.end_ns - self._source.start_ns, 0) / 1e9

    def records(self, topics: Collection[str] = ()) -> Iterator[Record]:
        """The messages of ``topics`` (all that can be played, without), in order. Raises ``BagUnreadable``."""
        chosen = {
            id: topic
            for id, topic in self._by_channel.items()
            if not topic.problem and (not topics or topic.name in topics)
        }
        for id, time_ns, raw in self._raw(list(chosen)) if chosen else ():
            topic = chosen[id]
            try:
                payload = topic.convert(raw)
            except TypesError as error:
                if not self.dropped[topic.name]:
                    log.warning("%s: %s: a message was left out: %s", self.path, topic.name, error)
                self.dropped[topic.name] += 1
                continue
            yield Record(time_ns, topic, payload)

    def _raw(self, ids: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        try:
            yield from self._source.messages(ids)
        except _DAMAGED as error:
            raise BagUnreadable(str(self.path), _reason(error)) from error

    def _learn(self) -> None:
        groups: dict[tuple[str, str], list[_Channel]] = {}
        for channel in self._source.channels:
            groups.setdefault((channel.topic, channel.type), []).append(channel)
        for (_, type), channels in groups.items():
            topic = self._topic(type, channels)
            self.topics.append(topic)
            self._by_channel.update((channel.id, topic) for channel in channels)

    def _topic(self, type: str, channels: list[_Channel]) -> BagTopic:
        first = channels[0]
        topic = BagTopic(first.topic, type, sum(c.count for c in channels), common_qos(c.qos for c in channels))
        try:
            full = self.registry.canonical(type)
            topic = replace(topic, name=resolve_name(first.topic), type=full)
            if first.encoding == "ros1":
                return replace(topic, convert=_from_ros1(self.registry, full, first.definition))
            if first.encoding == "cdr":
                self._add(full, first.definition)
                return topic
        except (TypesError, InvalidName) as error:
            return replace(topic, problem=str(error))
        return replace(
            topic, problem=f"its messages are {first.encoding or 'of an unknown encoding'}, not CDR or ROS 1"
        )

    def _add(self, type: str, definition: str) -> None:
        """Take the recording's definition, which tells its bytes better than ours; without, the bytes still play."""
        if not definition:
            return
        try:
            self.registry.add_full_text(type, definition, replace=True)
        except TypesError as error:
            log.warning("%s: the definition of %s in it is not used: %s", self.path, type, error)


def _from_ros1(registry: TypeRegistry, type: str, definition: str) -> Callable[[bytes], bytes]:
    """Bytes of ROS 1 to CDR, as this network defines the type; the recording's definition, where it knows none.

    Where both differ, fields of the same name (case apart) are carried over.
    """
    try:
        if definition:
            registry.add_full_text(type, definition)
        return registry.codec(type).from_ros1
    except TypeConflict:
        log.info("%s differs between ROS 1 and ROS 2, so its fields are converted by name", type)
    theirs = TypeRegistry(registry.distro)
    theirs.add_full_text(type, definition, replace=True)
    old, new = theirs.codec(type), registry.codec(type)
    names = {name.lower(): name for name in new.fields}

    def convert(raw: bytes) -> bytes:
        message = old.decode(old.from_ros1(raw))
        return new.encode({names.get(key.lower(), key): value for key, value in message.items()})

    return convert


# ------------------------------------------------------------------------------------------------------- files


def _open(path: Path) -> Any:
    if path.is_dir():
        if not (path / "metadata.yaml").exists():
            raise ValueError("this directory has no metadata.yaml, so it is no rosbag2 recording")
        return _Rosbags(Rosbag2Reader(path))
    with path.open("rb") as file:
        magic = file.read(16)
    if magic.startswith(b"\x89MCAP0\r\n"):
        return _Mcap(path)
    if magic.startswith(b"#ROSBAG V"):
        return _Rosbags(Rosbag1Reader(path))
    if magic.startswith(b"SQLite format 3"):
        return _Rosbags(Rosbag2Reader(path))
    raise ValueError("this is no recording of a known kind (MCAP, rosbag2 or ROS 1 bag)")


def _reason(error: BaseException) -> str:
    if isinstance(error, AssertionError) or not str(error):
        return f"the file is damaged ({error.__class__.__name__})"
    return " ".join(str(error).split())


def _policy(value: Any, choices: tuple[str, ...], default: str) -> str:
    """A policy from its number in ``rmw``, its name or a member of an enum."""
    name = getattr(value, "name", value)
    if isinstance(name, int):
        return choices[name - 1] if 1 <= name <= len(choices) else default
    return str(name).lower() if str(name).lower() in choices else default


def _recorded_qos(topic: str, profiles: list[dict[str, Any]], *, latched: bool = False) -> QoS:
    """What the publishers of a recorded topic offered."""
    if latched or topic.rpartition("/")[2] == "tf_static":
        return LATCHED
    return common_qos(
        QoS(
            reliability=_policy(profile.get("reliability"), ("reliable", "best_effort"), "reliable"),
            durability=_policy(profile.get("durability"), ("transient_local", "volatile"), "volatile"),
            history=_policy(profile.get("history"), ("keep_last", "keep_all"), "keep_last"),
            depth=depth if isinstance(depth := profile.get("depth"), int) and 0 < depth < 10_000 else DEFAULT.depth,
        )
        for profile in profiles
    )


class _Mcap:
    """An MCAP file, of either profile."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        self.channels: list[_Channel] = []
        self.start_ns = self.end_ns = 0

    def __enter__(self) -> Self:
        try:
            self._reader = make_reader(self._file)
            summary = self._reader.get_summary()
            if summary is None or summary.statistics is None:
                raise ValueError("the recording has no summary (was it cut short?); `mcap recover` makes one")
            self._indexed = bool(summary.chunk_indexes)
            counts = summary.statistics.channel_message_counts
            self.start_ns, self.end_ns = summary.statistics.message_start_time, summary.statistics.message_end_time
            for channel in summary.channels.values():
                schema = summary.schemas.get(channel.schema_id)
                known = schema is not None and schema.encoding in ("ros2msg", "ros2idl", "ros1msg")
                profiles = yaml.safe_load(channel.metadata.get("offered_qos_profiles", "")) or []
                self.channels.append(
                    _Channel(
                        id=channel.id,
                        topic=channel.topic,
                        type=schema.name if schema else "",
                        definition=schema.data.decode() if known and schema else "",
                        encoding=channel.message_encoding,
                        count=counts.get(channel.id, 0),
                        qos=_recorded_qos(
                            channel.topic,
                            [profile for profile in profiles if isinstance(profile, dict)],
                            latched=channel.metadata.get("latching") == "1",
                        ),
                    )
                )
        except BaseException:
            self._file.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def messages(self, ids: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        topics = [channel.topic for channel in self.channels if channel.id in ids]
        wanted = frozenset(ids)
        # An unindexed file is read in its own order: to sort it, all of it would have to be held.
        for _, channel, message in self._reader.iter_messages(topics=topics, log_time_order=self._indexed):
            if channel.id in wanted:
                yield channel.id, message.log_time, message.data


class _Rosbags:
    """What the ``rosbags`` readers read: ROS 1 bags, rosbag2 directories and database files."""

    def __init__(self, reader: Any) -> None:
        self._reader = reader
        self.channels: list[_Channel] = []
        self.start_ns = self.end_ns = 0

    def __enter__(self) -> Self:
        self._reader.open()
        self.start_ns, self.end_ns = self._reader.start_time, self._reader.end_time
        ros1 = isinstance(self._reader, Rosbag1Reader)
        for number, connection in enumerate(self._reader.connections):
            extra = connection.ext
            profiles = [] if ros1 else [profile._asdict() for profile in extra.offered_qos_profiles]
            self.channels.append(
                _Channel(
                    id=number,
                    topic=connection.topic,
                    type=connection.msgtype,
                    definition=connection.msgdef.data,
                    encoding="ros1" if ros1 else extra.serialization_format,
                    count=connection.msgcount,
                    qos=_recorded_qos(connection.topic, profiles, latched=ros1 and extra.latching == 1),
                )
            )
        return self

    def __exit__(self, *_: object) -> None:
        self._reader.close()

    def messages(self, ids: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        chosen = [connection for number, connection in enumerate(self._reader.connections) if number in ids]
        numbers = {(channel.topic, channel.type): channel.id for channel in self.channels}
        for connection, time_ns, raw in self._reader.messages(connections=chosen):
            yield numbers[connection.topic, connection.msgtype], time_ns, bytes(raw)
