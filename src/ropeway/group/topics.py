"""Topics of a group: where a message goes, and which messages count."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from ropeway.graph.base import SEQ_NONE, Publisher, Sample, SampleCallback, Subscription, Undelivered, new_origin
from ropeway.graph.parts import numbered
from ropeway.group.chooser import Chooser
from ropeway.group.exchange import Exchange
from ropeway.group.late_watch import LateWatch
from ropeway.group.pairs import Judge
from ropeway.group.part import GroupPart
from ropeway.group.scheduler import Phase
from ropeway.group.stamp import StampReader
from ropeway.limits import HEDGED_BYTES
from ropeway.qos import QoS, common_qos

__all__ = ["GroupPublisher", "GroupSubscription"]

_KEYS: Final = itertools.count()  # of requests, whichever publisher they go through


class GroupPublisher(GroupPart[Publisher]):
    """A topic, announced to every member, so that each stands ready."""

    def __init__(
        self,
        group: Chooser,
        topic: str,
        type: str,
        qos: QoS,
        parts: Mapping[str, Publisher],
        exchange: Exchange | None,
        stamp: StampReader | None,
    ) -> None:
        super().__init__(group, parts)
        first = next(iter(parts.values()), None)
        self.topic = topic
        self.type, self.qos = (type, qos) if first is None else (first.type, first.qos)
        self._exchange, self._stamp = exchange, stamp
        self._demand: list[Callable[[int], None]] = []
        self._closed = False
        self._held: dict[int, tuple[asyncio.TimerHandle, Callable[[], None]]] = {}  # what a second member may get, too
        self._held_bytes = 0
        self._watch = LateWatch(group, self._hurry)
        self._origin, self._seq = new_origin(), 0

    def publish(self, sample: Sample) -> None:
        """Give the message to whoever is in use, and to a second where the policy says so."""
        if self._closed:
            self._group.drops[self.topic, Undelivered.CLOSED] += 1
            return
        group, now_s = self._group, self._group.now()
        alone = group.alone(now_s)
        part = self._parts.get(alone)
        names = self._due() if part is None or part.subscribers == 0 else (alone,)
        if not names:
            group.drops[self.topic, Undelivered.NOBODY] += 1
            return
        if sample.seq == SEQ_NONE:  # on all members it is the same message
            sample = numbered(sample, self.type, self._origin, self._seq)
            self._seq = sample.seq
        if self._exchange is not None and self._stamp is not None:
            key = next(_KEYS)
            stamp = self._stamp(sample.payload)
            self._exchange.asked(names, key, stamp, now_s)
            second = "" if alone or not self._exchange.read else group.second()
            if second and second not in names:
                self._hedge(names, sample, key, stamp)
            if self._watch.idle:
                self._watch.begin()
        for name in names:
            self._parts[name].publish(sample)

    def _due(self) -> tuple[str, ...]:
        """Return who gets the next message: of the others the most promising, where those in use do not read it."""
        names = tuple(name for name in self._group.targets() if name in self._parts)  # one that has come has none yet
        if any(map(self._reads, names)):
            return names
        return next(((name,) for name in self._group.ranked() if self._reads(name)), names)

    def _reads(self, name: str) -> bool:
        return name in self._parts and self._parts[name].subscribers != 0

    def _hedge(self, asked: tuple[str, ...], sample: Sample, key: int, stamp: bytes | None) -> None:
        """Have one more asked if the answer is late; not while as much as may be held waits for that already."""
        exchange, size = self._exchange, len(sample.payload)
        assert exchange is not None
        if self._held_bytes and self._held_bytes + size > HEDGED_BYTES:
            return
        self._held_bytes += size

        def late() -> None:
            del self._held[key]
            self._held_bytes -= size
            name = next((n for n in self._group.ranked() if n not in asked and n in self._parts), "")
            if name and exchange.is_open(key):
                exchange.asked((name,), key, stamp, self._group.now())
                self._parts[name].publish(sample)

        timer = asyncio.get_running_loop().call_later(self._group.hedge_after_s(), late)
        self._held[key] = timer, late

    def _hurry(self) -> None:
        """Have all asked of a second member at once that the first has not answered, as it is late for one of them."""
        if self._group.scheduler.phase is Phase.COMPARING:
            for timer, late in list(self._held.values()):
                timer.cancel()
                late()

    @property
    def subscribers(self) -> int | None:
        """Return how many read it on the member that has most; standby readers count, so that they are kept warm."""
        known = [n for part in self._parts.values() if (n := part.subscribers) is not None]
        return max(known) if known else None if self._parts else 0

    def on_demand(self, callback: Callable[[int], None]) -> None:
        """See ``Publisher``."""
        told: list[int | None] = [None]

        def changed(_: int) -> None:
            if (n := self.subscribers) != told[0] and n is not None:
                told[0] = n
                callback(n)

        self._demand.append(changed)
        for part in self._parts.values():
            part.on_demand(changed)
        if not self._parts:
            changed(0)

    def add(self, name: str, part: Publisher) -> None:
        """Take the part on a member that has come."""
        super().add(name, part)
        for changed in self._demand:
            part.on_demand(changed)

    async def remove(self, name: str) -> None:
        """Close the part on a member that has left."""
        await super().remove(name)
        for changed in self._demand:
            changed(0)

    async def replace(self, name: str, part: Publisher) -> None:
        """Send to a member through another part, from the next message on."""
        before = self._parts[name]
        self.add(name, part)
        await before.close()

    async def close(self) -> None:
        """See ``Publisher``."""
        self._watch.close()
        for timer, _ in self._held.values():
            timer.cancel()
        self._held.clear()
        self._held_bytes = 0
        self._demand.clear()
        self._closed = True
        await super().close()


class GroupSubscription(GroupPart[Subscription]):
    """A topic, read from every member; answers come on it if it has an ``exchange``."""

    def __init__(
        self,
        group: Chooser,
        topic: str,
        type: str,
        callback: SampleCallback,
        judge: Judge,
        exchange: Exchange | None,
    ) -> None:
        super().__init__(group, {})
        self.topic, self.type = topic, type
        self._callback, self._judge = callback, judge
        self._exchange = exchange
        self._qos_callbacks: list[Callable[[QoS], None]] = []

    def add(self, name: str, part: Subscription) -> None:
        """Take the part on a member that has come: answers are read from now on, and requests count."""
        super().add(name, part)
        if self._exchange is not None:
            self._exchange.read_by(self)
        self.type = part.type
        for changed in self._qos_callbacks:
            part.on_qos(changed)

    def arrived(self, name: str, batch: Sequence[Sample]) -> None:
        """Hand on what counts of what a member has published."""
        verdicts = self._judge(name, batch, self._group.now())
        if not any(verdicts):
            self._callback(batch)
            return
        self._group.drops.update((self.topic, why) for why in verdicts if why is not None)
        if wanted := [sample for sample, why in zip(batch, verdicts, strict=True) if why is None]:
            self._callback(wanted)

    async def close(self) -> None:
        """See ``Subscription``: requests whose answers nobody reads tell nothing."""
        if self._exchange is not None:
            self._exchange.unread_by(self)
        await super().close()

    @property
    def qos(self) -> QoS:
        """Return what every member's publishers meet."""
        return common_qos(part.qos for part in self._parts.values())

    def on_qos(self, callback: Callable[[QoS], None]) -> None:
        """See ``Subscription``."""
        told: list[QoS | None] = [None]

        def changed(_: QoS) -> None:
            if (qos := self.qos) != told[0]:
                told[0] = qos
                callback(qos)

        self._qos_callbacks.append(changed)
        for part in self._parts.values():
            part.on_qos(changed)
        if not self._parts:
            changed(self.qos)
