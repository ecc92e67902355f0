"""Reads the topics of a graph that are to be recorded, those that come later, too."""

from __future__ import annotations

import logging
import re
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from ropeway.errors import DecodeError, RopewayError
from ropeway.graph.base import Graph, Sample, Subscription, TopicInfo
from ropeway.recording.channel import Recorded, RecordingChannel, cdr_channel
from ropeway.recording.condition import Condition
from ropeway.tasks import Supervised, end
from ropeway.types import TypeRegistry

__all__ = ["GraphRecorder", "TopicChoice"]

log = logging.getLogger("ropeway.record")


@dataclass(frozen=True)
class TopicChoice:
    """Chooses topics: by name or shell pattern, by a regular expression, or all; never those of ``excluded``.

    Hidden ones, with a part that begins with ``_``, are chosen only by name or pattern, or with ``hidden``.
    """

    names: Sequence[str] = ()
    regex: re.Pattern[str] | None = None
    everything: bool = False
    excluded: Sequence[str] = ()
    hidden: bool = False

    def takes(self, name: str) -> bool:
        """Return whether the topic is to be recorded."""
        if any(fnmatchcase(name, pattern) for pattern in self.excluded):
            return False
        if any(fnmatchcase(name, pattern) for pattern in self.names):
            return True
        if not self.hidden and "/_" in name:
            return False
        return self.everything or (self.regex is not None and self.regex.search(name) is not None)


async def _nobody_knows(type: str) -> None:
    """Leave a type unknown."""


class GraphRecorder:
    """Gives every message of the chosen topics to ``sink``; ``triggered`` hears of conditions that become true.

    A topic has the QoS that its publishers offer. One that cannot be read is told in ``refused`` with the reason, and
    asked for again when something changes. ``know`` asks the network for the definition of a type.
    """

    def __init__(
        self,
        graph: Graph,
        registry: TypeRegistry,
        choice: TopicChoice,
        sink: Callable[[Recorded], None],
        *,
        conditions: Sequence[Condition] = (),
        triggered: Callable[[str], None] = lambda why: None,
        know: Callable[[str], Awaitable[None]] | None = None,
    ) -> None:
        self.topics: dict[str, Subscription] = {}
        self.messages = 0
        self.refused: dict[str, str] = {}
        self._graph, self._registry, self._choice, self._sink = graph, registry, choice, sink
        self._conditions, self._triggered = conditions, triggered
        self._know = know or _nobody_knows
        self._watch = Supervised(self._follow, "topics to record")

    def start(self) -> GraphRecorder:
        """Begin; return the object itself."""
        self._watch.start()
        return self

    async def close(self) -> None:
        """Read no more."""
        await end(self._watch)
        for subscription in self.topics.values():
            await subscription.close()
        self.topics.clear()

    async def _follow(self) -> None:
        changes = self._graph.changes()
        await self._look()
        async for event in changes:
            if event.kind == "publisher" and event.discovered:
                await self._look()

    async def _look(self) -> None:
        for name, info in self._graph.topics().items():
            wanted = self._choice.takes(name) or any(one.topic == name for one in self._conditions)
            if name in self.topics or not wanted or not any(not end.local for end in info.publishers):
                continue
            try:
                await self._read(name, info)
            except RopewayError as error:
                if self.refused.get(name) != str(error):
                    log.warning("%s is not recorded: %s", name, error)
                self.refused[name] = str(error)
            else:
                self.refused.pop(name, None)

    async def _read(self, name: str, info: TopicInfo) -> None:
        if len(info.types) != 1:
            raise RopewayError(f"it has several types: {', '.join(info.types) or 'none that is known'}")
        type = info.types[0]
        await self._know(type)
        channel = cdr_channel(self._registry, name, type, [end.qos for end in info.publishers if not end.local])
        take = self._taking(channel) if self._choice.takes(name) else (lambda batch: None)
        conditions = [condition for condition in self._conditions if condition.topic == name]
        if conditions:
            take = self._watching(take, type, conditions)
        self.topics[name] = await self._graph.create_subscription(name, type, None, take)

    def _taking(self, channel: RecordingChannel) -> Callable[[Sequence[Sample]], None]:
        def take(batch: Sequence[Sample]) -> None:
            self.messages += len(batch)
            for sample in batch:
                self._sink(Recorded(channel, sample.stamp_ns, sample.payload))

        return take

    def _watching(
        self, take: Callable[[Sequence[Sample]], None], type: str, conditions: list[Condition]
    ) -> Callable[[Sequence[Sample]], None]:
        codec = self._registry.codec(type)

        def look(batch: Sequence[Sample]) -> None:
            take(batch)
            for sample in batch:
                try:
                    message = codec.decode(sample.payload)
                except DecodeError:
                    continue
                for condition in conditions:
                    if condition.becomes_true(message):
                        self._triggered(condition.text)

        return look
