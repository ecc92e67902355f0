"""Joins one topic on two graphs: what is published on the source is published on the target.

The bridge keeps three things right while both networks change: the publisher on the target has the source's QoS,
the subscription on the source exists only while somebody on the target reads (where the target can tell), and
every message takes one way, ``Passage``.
"""

from __future__ import annotations

import asyncio
from dataclasses import replace

from ropeway.bridge.handover import Overlap, drained, matched
from ropeway.bridge.options import AS_IT_COMES, BridgeOptions
from ropeway.bridge.upkeep import RETRY_S, Upkeep
from ropeway.delivery.passage import Passage
from ropeway.delivery.pipeline import Step, build, tapped, witnessed
from ropeway.graph.base import Graph, Publisher, Subscription, look_up
from ropeway.graph.link_parts import is_departing
from ropeway.qos import DEFAULT, QoS, common_qos

__all__ = ["TopicBridge"]


class TopicBridge:
    """Passes a topic from ``source`` to ``target``.

    ``options`` say how; a side that refuses is asked again after ``retry_s``.
    """

    def __init__(
        self,
        source: Graph,
        target: Graph,
        source_topic: str,
        target_topic: str,
        type: str,
        options: BridgeOptions = AS_IT_COMES,
        *,
        retry_s: float = RETRY_S,
    ) -> None:
        self.source, self.target = source, target
        self.source_topic, self.target_topic, self.type = source_topic, target_topic, type
        self.options = options
        self.publisher: Publisher | None = None
        self.subscription: Subscription | None = None
        self.passage = Passage(self._steps(), keep=options.keep)
        self.meter, self.drops = self.passage.meter, self.passage.drops
        self._turn = asyncio.Lock()  # either side is changed by one at a time
        label = f"{source_topic} to {target.name}"
        self._upkeep = Upkeep(self._set_right, source, "publisher", source_topic, label=label, retry_s=retry_s)

    async def start(self) -> None:
        """Bring the bridge up; what fails now is tried again until it works."""
        self._upkeep.start()

    def _steps(self) -> list[Step]:
        options = self.options
        steps = build(options.delivery) if options.limit else []
        if options.frames is not None:
            steps.append(options.frames)
        steps += witnessed(options.witness)
        if options.tap is not None and not is_departing(self.publisher):
            steps.append(tapped(options.tap))
        return steps

    async def change(self, options: BridgeOptions) -> None:
        """Treat the topic in another way from now on: what reads and publishes is replaced, and no message is lost.

        Both the old and the new are there for a moment; what comes over both is passed on once.
        """
        async with self._turn:
            before, self.options = self.options, options
            elsewhere = options.delivery != before.delivery
            self.passage.keep = options.keep
            self.passage.steps = self._steps()
            if is_departing(self.publisher):
                self.publisher.on_gone(options.tap)
            if elsewhere and options.limit and self.publisher is not None:
                await self._publish_anew(self.publisher, self._wanted_qos())
            if (options.qos != before.qos or (elsewhere and not options.limit)) and self.subscription is not None:
                await self._read_anew(self.subscription)
        self._upkeep.wake()

    async def finish(self, limit_s: float) -> None:
        """Stop reading, and let what waits be sent, for ``limit_s`` at most; ``close`` is to follow."""
        await self._upkeep.close()
        await self._stop_reading()
        if self.publisher is not None:
            await drained(self.publisher, limit_s)

    async def close(self) -> None:
        """Take the topic back on both sides."""
        await self._upkeep.close()
        if self.subscription is not None:
            await self.subscription.close()
        if self.publisher is not None:
            await self.publisher.close()
        self.subscription = self.publisher = self.passage.sink = None

    @property
    def error(self) -> str:
        """The reason why the two sides cannot be maintained, ``""`` while they can."""
        return self._upkeep.error

    @property
    def state(self) -> str:
        """The state in one word: ``active``, ``idle`` (nobody reads), ``waiting`` or ``failed``."""
        return "failed" if self.error else self.progress

    @property
    def progress(self) -> str:
        """The state but for a failure: ``active``, ``idle`` or ``waiting``."""
        if self.publisher is None:
            return "waiting"
        return "active" if self.subscription is not None else "idle"

    # ── keeping both sides right ───────────────────────────────────────────────────────────────────────────────

    def _wanted_qos(self) -> QoS:
        qos = self._source_qos()
        if self.options.keep is not None and not qos.transient_local:
            qos = replace(qos, reliability="reliable", durability="transient_local", history="keep_last", depth=1)
        return qos

    def _source_qos(self) -> QoS:
        if self.options.qos is not None:
            return self.options.qos
        known = look_up(self.source, "topic", self.source_topic)
        offered = [p.qos for p in known.publishers if not p.local] if known is not None else []
        if offered:
            qos = common_qos(offered)
            if any(q.lifespan_s is not None for q in offered):
                # kept for late joiners only for a time (rosbridge's clients: 1 s): a publisher whose lifespan nobody
                # can tell from the first one's time stamps would keep it for ever, and replay old commands
                qos = replace(qos, durability="volatile")
            if self.publisher is not None and replace(self.publisher.qos, depth=qos.depth) == qos:
                qos = replace(qos, depth=max(qos.depth, self.publisher.qos.depth))  # a shallower one would gain nothing
        elif self.publisher is not None:
            qos = self.publisher.qos
        elif self.subscription is not None:
            qos = self.subscription.qos
        else:
            qos = DEFAULT
        return replace(qos, deadline_s=None, lifespan_s=None)

    async def _publish_anew(self, old: Publisher, qos: QoS) -> None:
        """Publish through a new publisher once it has the readers of the old one, which sends what waits."""
        new = await self.target.create_publisher(self.target_topic, self.type, qos, delivery=self.options.delivery)
        await matched(new, old)
        self._use(new)
        await drained(old)
        await old.close()

    async def _read_anew(self, old: Subscription) -> None:
        """Read through a new subscription once something has come through it, or would have."""
        overlap = Overlap(self.passage)
        try:
            new = await self.source.create_subscription(
                self.source_topic, self.type, self.options.qos, overlap.first, delivery=self.options.delivery
            )
            new.on_qos(lambda _: self._upkeep.wake())
            await overlap.wait()
            self.subscription = new
            await old.close()
        finally:
            overlap.end()

    def _use(self, publisher: Publisher) -> None:
        self.publisher = publisher
        self.passage.sink = publisher.publish
        if self.options.tap is not None and is_departing(publisher):
            publisher.on_gone(self.options.tap)
            self.passage.steps = self._steps()
        publisher.on_demand(lambda _: self._upkeep.wake())

    async def _set_right(self) -> None:
        async with self._turn:
            await self._set_both_right()

    async def _set_both_right(self) -> None:
        qos = self._wanted_qos()
        if self.publisher is None or self.publisher.qos != qos:
            old = self.publisher
            delivery = self.options.delivery
            self._use(await self.target.create_publisher(self.target_topic, self.type, qos, delivery=delivery))
            assert self.publisher is not None
            if old is not None:
                await old.close()
            last = self.options.keep.last() if self.options.keep is not None else None
            if last is not None:
                self.publisher.publish(last)
            if old is not None and (old.qos.transient_local or qos.transient_local):
                await self._stop_reading()  # read again, so that the new publisher gets what is latched
        readers = self.publisher.subscribers
        wanted = readers is None or readers > 0 or qos.transient_local
        if wanted and self.subscription is None:
            self.subscription = await self.source.create_subscription(
                self.source_topic, self.type, self.options.qos, self.passage.pass_on, delivery=self.options.delivery
            )
            self.subscription.on_qos(lambda _: self._upkeep.wake())
        elif not wanted:
            await self._stop_reading()

    async def _stop_reading(self) -> None:
        if self.subscription is not None:
            subscription, self.subscription = self.subscription, None
            await subscription.close()
