"""Reads recordings as a stream of CDR messages: MCAP (ROS 2 and ROS 1), rosbag2 directories and files, ROS 1 bags.

Messages come in the order of their log times, one at a time; the file is never loaded as a whole. Definitions found
in the recording become known to the registry, and ROS 1 messages are converted on the way.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, NamedTuple

from ropeway.errors import BagUnreadable, InvalidName, TypeConflict, TypesError
from ropeway.graph.base import resolve_name
from ropeway.qos import DEFAULT, QoS, common_qos
from ropeway.recording.sources import DAMAGED, RecordedChannel, Recording, open_recording, reason_of
from ropeway.types import TypeRegistry
from ropeway.types.told_types import check_text
from ropeway.types.variant import Variant

if TYPE_CHECKING:
    from typing_extensions import Self


__all__ = ["Bag", "BagTopic", "Record"]

log = logging.getLogger("ropeway.bag")


class Record(NamedTuple):
    """A recorded message: when it was logged, its topic, and its CDR."""

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


class Bag:
    """An open recording; a context manager.

    ``topics`` are by name and type; one that cannot be played stands there with its ``problem``. ``dropped`` counts
    messages that could not be converted, by topic; ``notes`` say what of the file is not whole or does not agree.
    """

    def __init__(self, path: str | Path, registry: TypeRegistry) -> None:
        self.path = Path(path)
        self.registry = registry
        self.topics: list[BagTopic] = []
        self.dropped: Counter[str] = Counter()
        self._stack = ExitStack()
        self._source: Recording
        self._by_channel: dict[int, BagTopic] = {}

    def __enter__(self) -> Self:
        """Open the file and read what it says of itself. Raises ``BagUnreadable``."""
        if not self.path.exists() and not self.path.is_symlink():
            raise BagUnreadable(str(self.path), "there is no such file or directory")
        try:
            self._source = self._stack.enter_context(open_recording(self.path))
        except DAMAGED as error:
            self._stack.close()
            raise BagUnreadable(str(self.path), reason_of(error)) from error
        self._learn()
        for note in self.notes:
            log.warning("%s: %s", self.path, note)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Close the file."""
        self._stack.close()

    @property
    def start_ns(self) -> int:
        """Log time of the first message."""
        return self._source.start_ns

    @property
    def notes(self) -> list[str]:
        """Remarks on the recording as a whole."""
        return self._source.notes

    @property
    def duration_s(self) -> float:
        """The time from the first to the last message."""
        return max(self._source.end_ns - self._source.start_ns, 0) / 1e9

    def records(self, topics: Collection[str] = ()) -> Iterator[Record]:
        """Yield the messages of ``topics`` (all that can be played, without), in order. Raises ``BagUnreadable``."""
        chosen = {
            id: topic
            for id, topic in self._by_channel.items()
            if not topic.problem and (not topics or topic.name in topics)
        }
        found = 0
        for id, time_ns, raw in self._raw(list(chosen)) if chosen else ():
            topic = chosen[id]
            found += 1
            try:
                payload = topic.convert(raw)
            except TypesError as error:
                if not self.dropped[topic.name]:
                    log.warning("%s: %s: a message was left out: %s", self.path, topic.name, error)
                self.dropped[topic.name] += 1
                continue
            yield Record(time_ns, topic, payload)
        expected = sum(topic.count for topic in set(chosen.values()))
        if found < expected:
            log.warning("%s: it lists %d messages, but only %d are there", self.path, expected, found)

    def _raw(self, ids: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        try:
            yield from self._source.messages(ids)
        except DAMAGED as error:
            raise BagUnreadable(str(self.path), reason_of(error)) from error

    def _learn(self) -> None:
        groups: dict[tuple[str, str, str], list[RecordedChannel]] = {}
        for channel in self._source.channels:
            groups.setdefault((channel.topic, channel.type, channel.encoding), []).append(channel)
        for (_, type, _), channels in groups.items():
            topic = self._topic(type, channels)
            self.topics.append(topic)
            self._by_channel.update((channel.id, topic) for channel in channels)

    def _topic(self, type: str, channels: list[RecordedChannel]) -> BagTopic:
        first = channels[0]
        topic = BagTopic(first.topic, type, sum(c.count for c in channels), common_qos(c.qos for c in channels))
        if first.encoding not in ("cdr", "ros1"):
            encoding = first.encoding or "of an unknown encoding"
            return replace(topic, problem=f"its messages are {encoding}, not CDR or ROS 1")
        try:
            full = self.registry.canonical(type)
            topic = replace(topic, name=resolve_name(first.topic), type=full)
            if first.encoding == "ros1":
                return replace(topic, convert=_from_ros1(self.registry, full, first.definition))
            return replace(topic, convert=self._from_ros2(full, first.definition))
        except (TypesError, InvalidName) as error:
            return replace(topic, problem=str(error))

    def _from_ros2(self, type: str, definition: str | None) -> Callable[[bytes], bytes]:
        """Return what brings messages from the layout that the recording defines into ours; without, the bytes play.

        An empty definition is that of a message without fields, unless the type is known to have some.
        """
        registry = self.registry
        if definition or (definition is not None and not registry.has(type)):
            recorded = Variant(registry, label=self.path.name)
            try:
                check_text(type, definition)
                recorded.add_full_text(type, definition)
                registry.add_unknown(type, definition)
                return recorded.inward(type) or bytes
            except TypesError as error:
                log.warning("%s: the definition of %s in it is not used: %s", self.path, type, error)
        others = registry.others
        return _fitting(registry, type) if others is not None and others.touches(type) else bytes


def _fitting(registry: TypeRegistry, type: str) -> Callable[[bytes], bytes]:
    """Return a function that converts a message of any distribution to our layout; others are played unchanged."""
    codec = registry.codec(type)

    def convert(raw: bytes) -> bytes:
        try:
            return codec.fitting(raw)
        except TypesError:
            return raw

    return convert


def _from_ros1(registry: TypeRegistry, type: str, definition: str | None) -> Callable[[bytes], bytes]:
    """Convert bytes of ROS 1 to CDR, as this network defines the type, or else as the recording does.

    Where both differ, fields of the same name (case apart) are carried over.
    """
    check_text(type, definition or "")
    try:
        if definition or (definition is not None and not registry.has(type)):
            registry.add_full_text(type, definition)
        return registry.codec(type).from_ros1
    except TypeConflict:
        log.info("%s differs between ROS 1 and ROS 2, so its fields are converted by name", type)
    theirs = TypeRegistry(registry.distro)
    theirs.add_full_text(type, definition or "", replace=True)
    old, new = theirs.codec(type), registry.codec(type)
    names = {name.lower(): name for name in new.fields}

    def convert(raw: bytes) -> bytes:
        message = old.decode(old.from_ros1(raw))
        return new.encode({names.get(key.lower(), key): value for key, value in message.items()})

    return convert
