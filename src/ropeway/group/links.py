"""Several links to one gateway as one graph: Wi-Fi and 5G at once.

With ``duplicate`` everything goes by all links, both ways, and whichever copy comes first counts; the others are
dropped and counted as copies. Else it goes by the best link, which ``link_choice`` finds from probes, and is fetched
over that one alone. While that one is doubted everything goes by another one as well, which first gets what may have
been lost. A call has one number on all links, so that the gateway at the far end carries it out once.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final, Protocol

from ropeway.graph.base import Graph, Sample, Undelivered
from ropeway.graph.deduplication import Seen
from ropeway.group.graph import Group, Policy
from ropeway.group.link_choice import BREAK_S, LinkChoice
from ropeway.group.link_publisher import LinkPublisher
from ropeway.group.pairs import Judge
from ropeway.group.topics import GroupSubscription
from ropeway.qos import QoS
from ropeway.tasks import Supervised
from ropeway.types import TypeRegistry

__all__ = ["LinkGroup", "ProbedLink"]

_ASK_TWICE_S: Final = 0.2  # without an answer to a call on one link: it is repeated on the other


class ProbedLink(Graph, Protocol):
    """A graph over one link, which can be probed."""

    @property
    def numbers(self) -> bool:
        """Whether messages that come tell who published them first, with a number, so that copies are known."""

    def probe(self) -> None:
        """Ask for a sign of life, if the link is up."""

    def on_probe(self, callback: Callable[[float], None]) -> None:
        """Call with the round trip of each probe, in seconds."""


class LinkGroup(Group):
    """Uses the links of ``members`` to one gateway; with ``duplicate`` all at once, else the best at each moment."""

    kind = "links"

    def __init__(
        self,
        members: Mapping[str, ProbedLink],
        *,
        name: str = "links",
        duplicate: bool = False,
        registry: TypeRegistry | None = None,
    ) -> None:
        policy = Policy.ALL if duplicate else Policy.ONE
        super().__init__(members, name=name, policy=policy, stateless=True, registry=registry)
        self.links = dict(members)
        self.choice = LinkChoice(members)
        self.duplicate = duplicate
        if not duplicate:
            self.publisher_class = LinkPublisher
        self._several = True  # a call goes by another link, too, if there is no answer soon
        self._beside = ""
        self._changed_s = 0.0

    async def open(self) -> None:
        """See ``Group``; the links are probed from now on."""
        await super().open()
        for name, link in self.links.items():
            link.on_probe(partial(self._probed, name))
        self._watchers.append(Supervised(self._keep_probing, f"probes of {self.name}").start())

    def _probed(self, name: str, round_trip_s: float) -> None:
        self.choice.came(name, round_trip_s, self.now())

    async def _keep_probing(self) -> None:
        while True:
            now_s = self.now()
            if self.choice.due(now_s):
                for name in self.scheduler.here:
                    self.links[name].probe()
                    self.choice.sent(name, now_s)
            self._choose(now_s)
            if not self.duplicate:
                await self._read_best(now_s)
            await asyncio.sleep(self.choice.pause_s(self.now()))

    def _choose(self, now_s: float) -> None:
        before = self.scheduler.current
        best = self.choice.step(now_s)
        changed = bool(best) and best != before and best in self.scheduler.here
        if changed:
            self._changed_s = now_s
            self.scheduler.switch(best, now_s, "the better link")
            self.tell()
        if self.duplicate:
            return
        beside = self.choice.beside if self.choice.beside in self.scheduler.here else ""
        if beside and beside != self._beside:
            self._send_again(beside, self.scheduler.current)
        elif changed and not self._beside and self.choice.silent(before, now_s):
            self._send_again(best, before)
        self._beside = beside

    def _send_again(self, name: str, doubted: str) -> None:
        """Send by a link what may not have arrived by another."""
        if self.links[name].numbers and doubted:
            since_s = self.choice.answered_s(doubted)
            for part in self._parts:
                if isinstance(part, LinkPublisher):
                    part.send_again(name, since_s)

    def targets(self) -> tuple[str, ...]:
        """See ``Group``; with a link in doubt they are two, if the far side drops what comes twice."""
        found = super().targets()
        beside = self._beside
        if self.duplicate or not beside or beside in found or not self.links[beside].numbers:
            return found
        return (*found, beside)

    async def _read_best(self, now_s: float) -> None:
        """Read each topic over the links in use, and after a moment over no other."""
        wanted = {name for name in (self.scheduler.current, self._beside) if name}
        for part, make in list(self._parts.items()):
            if not isinstance(part, GroupSubscription) or not wanted or part.on == wanted:
                continue
            async with self._changing:
                if part not in self._parts:
                    continue
                for name in wanted - part.on:
                    part.add(name, await make(name, self._opened[name]))
                if now_s - self._changed_s >= BREAK_S:
                    for name in part.on - wanted:
                        await part.remove(name)

    def _reached(self, name: str, reached: bool) -> None:
        super()._reached(name, reached)
        self.choice.up(name, reached)
        self._choose(self.now())

    def _judge(self, topic: str, type: str, qos: QoS | None) -> Judge:
        """Return what drops the copies of messages that came by another link."""
        seen = Seen()

        def judge(member: str, batch: Sequence[Sample], _: float) -> Sequence[Undelivered | None]:
            if not self.links[member].numbers:
                return (None if member == self.scheduler.current else Undelivered.STANDBY,) * len(batch)
            return [why(sample) for sample in batch]

        def why(sample: Sample) -> Undelivered | None:
            if seen.has(sample):
                return Undelivered.COPY
            seen.add(sample)
            return None

        return judge

    def second(self) -> str:
        """Return the link by which a call goes, too, if there is no answer soon."""
        return next((name for name in self.scheduler.here if name != self.scheduler.current), "")

    def hedge_after_s(self) -> float:
        """Return after how long that is."""
        return _ASK_TWICE_S

    def status(self) -> dict[str, Any]:
        """Return the links as they stand, as JSON."""
        return {
            "links": "duplicate" if self.duplicate else "best",
            "current": self.scheduler.current,
            "beside": self._beside,
            "members": self.choice.status(self.now()),
            "decisions": [str(decision) for decision in list(self.scheduler.decisions)[-8:]],
            "drops": {f"{topic}: {why.value}": n for (topic, why), n in self.drops.items() if n},
        }
