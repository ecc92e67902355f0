"""Holds which topics of a group are asked on, and which are answered on, by the names that the members know.

A configuration pairs topics by their names at the robot. What they are called at the members is for the routes to say,
which come, go and change while the group runs: a pair stays what it is, whatever becomes of its routes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ropeway.graph.base import Sample, Undelivered, resolve_name
from ropeway.group.exchange import Exchange
from ropeway.group.scheduler import Scheduler
from ropeway.group.stamp import StampReader

__all__ = ["Judge", "Pairs"]

Judge = Callable[[str, Sequence[Sample], float], "Sequence[Undelivered | None]"]
"""Says of each message of a member that came at a time why it is dropped, ``None`` to deliver it."""


class Pairs:
    """The pairs of topics of a group: ``responses`` has what each topic is answered on."""

    def __init__(self, scheduler: Scheduler, responses: Mapping[str, str]) -> None:
        self._scheduler = scheduler
        self._responses = {resolve_name(asked): resolve_name(answered) for asked, answered in responses.items()}
        self._exchanges = {answered: Exchange(scheduler) for answered in self._responses.values()}
        self._there: dict[str, str] = {}  # what a topic is called at the members, where it differs
        self._here: dict[str, str] = {}

    def crosses(self, names: Mapping[str, str]) -> set[str]:
        """Take over what topics are called at the members; return those whose answers come on another one now."""
        before = {topic: self.answers(topic) for topic in self.asked()}
        self._there = {here: there for here, there in names.items() if here != there}
        self._here = {there: here for here, there in names.items()}
        return {topic for topic in self.asked() if before.get(topic, "") != self.answers(topic)}

    def asked(self) -> list[str]:
        """Return the topics that are asked on, as the members call them."""
        return [self._there.get(topic, topic) for topic in self._responses]

    def answers(self, topic: str) -> str:
        """Return the topic on which ``topic`` is answered, both as the members call them; ``""`` if it is not."""
        answered = self._responses.get(self._at_the_robot(topic), "")
        return self._there.get(answered, answered)

    def asked_on(self, topic: str) -> Exchange | None:
        """Return the exchange whose requests go out on ``topic`` of the members."""
        return self._exchanges.get(self._responses.get(self._at_the_robot(topic), ""))

    def answered_on(self, topic: str) -> Exchange | None:
        """Return the exchange whose answers come on ``topic`` of the members."""
        return self._exchanges.get(self._at_the_robot(topic))

    def judge(self, topic: str, stamp: StampReader) -> Judge:
        """Return what says which messages on ``topic`` of the members count."""
        exchange = self.answered_on(topic)
        if exchange is None:  # nothing is asked for: who speaks is all that counts
            speaker = Exchange(self._scheduler)
            return lambda member, batch, _: (speaker.unasked(member),) * len(batch)
        came = exchange.came
        return lambda member, batch, now_s: [came(member, stamp(sample.payload), now_s) for sample in batch]

    def _at_the_robot(self, topic: str) -> str:
        """Return what a topic of the members is called at the robot; ``""`` for one that none of its is."""
        return self._here.get(topic, "" if topic in self._there else topic)

    def forget(self, name: str) -> None:
        """Forget a member that is gone, and its requests."""
        for exchange in self._exchanges.values():
            exchange.forget(name)

    def status(self) -> dict[str, Any]:
        """Return how answers were paired with their requests, as JSON."""
        return {
            self._there.get(answered, answered): dict(exchange.how()) for answered, exchange in self._exchanges.items()
        }
