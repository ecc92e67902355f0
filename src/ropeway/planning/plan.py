"""Models what is planned: hosts, the links between them, and the topics that cross."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from ropeway.planning.equations import Load

__all__ = ["MBIT_BPS", "PlannedLink", "PlannedTopic", "TrafficPlan", "Way"]

MBIT_BPS: Final = 1e6

Way = tuple[str, str]
"""The host that sends, and the host that receives."""


@dataclass(frozen=True, slots=True)
class PlannedTopic:
    """A topic: its size, its rate at each publisher, and how many publishers and readers it has on which host.

    ``ratios`` are compression ratios by encoding: the bytes of a message over those that travel.
    """

    name: str
    size_bytes: float
    published_hz: float
    publishers: dict[str, int]
    readers: dict[str, int]
    type: str = ""
    encoding: str = "auto"
    ratios: dict[str, float] = field(default_factory=dict)

    def copies(self, way: Way, *, gateways: bool) -> int:
        """Return how many copies of a message go that way.

        Plain DDS sends one per publisher and reader (Np * Ns). A gateway sends one per publisher, however many read
        (Ep * Es; the paper counts a host once that has several publishers, but each of them has messages of its own).
        """
        here, there = self.publishers.get(way[0], 0), self.readers.get(way[1], 0)
        return here * min(there, 1) if gateways else here * there

    def load(self, copies: int, ratio: float = 1.0) -> Load:
        """Return what this topic asks of a link."""
        return Load(self.size_bytes, self.published_hz, copies, ratio)


@dataclass(frozen=True, slots=True)
class PlannedLink:
    """A link: its rate in bits per second, its delay one way, and whether both ways have that rate at once."""

    rate_bps: float
    delay_s: float = 0.0
    hosts: frozenset[str] = frozenset()
    """The hosts that it joins; empty: all of them share it."""
    duplex: bool = True

    def carries(self, way: Way) -> bool:
        """Return whether traffic of these hosts goes over this link."""
        return not self.hosts or self.hosts.issuperset(way)


@dataclass(frozen=True, slots=True)
class TrafficPlan:
    """Hosts, links and topics."""

    topics: tuple[PlannedTopic, ...]
    links: tuple[PlannedLink, ...]

    def ways(self) -> list[Way]:
        """Return the ways that any topic goes, each once, in the order of topics."""
        found = (
            (here, there)
            for topic in self.topics
            for here in topic.publishers
            for there in topic.readers
            if here != there and topic.copies((here, there), gateways=True)
        )
        return list(dict.fromkeys(found))

    def shares(self) -> Iterator[tuple[PlannedLink, list[Way]]]:
        """Yield every link with the ways that share its rate.

        A link that joins two hosts and has its rate both ways at once is yielded once per way.
        """
        left = self.ways()
        for link in self.links:
            carried = [way for way in left if link.carries(way)]
            left = [way for way in left if way not in carried]
            if link.duplex and link.hosts:
                yield from ((link, [way]) for way in carried)
            elif carried:
                yield link, carried
