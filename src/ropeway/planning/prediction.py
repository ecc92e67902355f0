"""Predicts rate, bandwidth and delay of each topic on each link, for plain DDS and for gateways by encoding."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

from ropeway.planning.equations import Load, bandwidth_bps, received_rate_hz, shared_rates_hz
from ropeway.planning.plan import PlannedLink, PlannedTopic, TrafficPlan, Way

__all__ = ["CONFIGURED", "DDS", "Prediction", "encodings_of", "predict"]

DDS: Final = "dds"
"""Stands for a network without gateways: a copy per reader, not compressed."""
CONFIGURED: Final = "gateway"
"""Stands for gateways with the encoding that each topic has."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """Predicted figures of one topic one way.

    ``rate_hz`` is equation (4): every topic loses the same part where a link is too narrow. ``shared_hz`` is the rate
    of gateways that share a link by bytes (for plain DDS the same as ``rate_hz``). ``link_bps`` is what all topics
    together ask of the link. ``delay_s`` and ``most_delay_s`` are how long a message travels: alone, and behind one of
    every other topic; they hold for gateways, which keep no queue; ``None`` for DDS where the link is too narrow,
    because there a queue grows.
    """

    topic: str
    way: Way
    encoding: str
    published_hz: float
    rate_hz: float
    shared_hz: float
    bandwidth_bps: float
    link_bps: float
    rate_of_link_bps: float
    delay_s: float | None
    most_delay_s: float | None

    @property
    def fits(self) -> bool:
        """Whether the link carries all that is asked of it."""
        return self.link_bps <= self.rate_of_link_bps

    def to_json(self) -> dict[str, Any]:
        """Return the prediction as JSON, with the unit in every key."""
        return {**asdict(self), "way": {"from": self.way[0], "to": self.way[1]}, "fits": self.fits}


def encodings_of(plan: TrafficPlan) -> list[str]:
    """Return what can be compared: plain DDS, the configured encodings, and each for which a ratio is known."""
    known = dict.fromkeys(encoding for topic in plan.topics for encoding in topic.ratios)
    return [
        DDS,
        CONFIGURED,
        *(encoding for encoding in known if all(encoding in topic.ratios for topic in plan.topics)),
    ]


def predict(plan: TrafficPlan, encodings: Sequence[str] = ()) -> list[Prediction]:
    """Return a row per encoding, link, way and topic, in this order; without ``encodings``, of all that are known."""
    chosen = encodings or encodings_of(plan)
    shares = list(plan.shares())
    return [row for encoding in chosen for link, ways in shares for row in _rows(plan, encoding, link, ways)]


def _rows(plan: TrafficPlan, encoding: str, link: PlannedLink, ways: list[Way]) -> Iterator[Prediction]:
    """Yield the rows of one link; the load of every topic and way counts once."""
    found = [
        (topic, way, load) for way in ways for topic in plan.topics if (load := _load(topic, way, encoding)).copies
    ]
    loads = [load for *_, load in found]
    needed_bps = bandwidth_bps(loads)
    shared = shared_rates_hz(loads, link.rate_bps)
    times_s = [load.size_bytes * 8 / load.ratio / link.rate_bps for load in loads]
    plain = encoding == DDS
    grows = plain and needed_bps > link.rate_bps
    for (topic, way, load), shared_hz, wire_s in zip(found, shared, times_s, strict=True):
        rate_hz = received_rate_hz(load.published_hz, link.rate_bps, needed_bps)
        yield Prediction(
            topic=topic.name,
            way=way,
            encoding=encoding,
            published_hz=load.published_hz,
            rate_hz=rate_hz,
            shared_hz=rate_hz if plain else shared_hz,
            bandwidth_bps=load.bandwidth_bps,
            link_bps=needed_bps,
            rate_of_link_bps=link.rate_bps,
            delay_s=None if grows else link.delay_s + wire_s,
            most_delay_s=None if grows else link.delay_s + sum(times_s),
        )


def _load(topic: PlannedTopic, way: Way, encoding: str) -> Load:
    if encoding == DDS:
        return topic.load(topic.copies(way, gateways=False))
    return topic.load(
        topic.copies(way, gateways=True), _ratio(topic, topic.encoding if encoding == CONFIGURED else encoding)
    )


def _ratio(topic: PlannedTopic, encoding: str) -> float:
    """Return the ratio of an encoding; ``auto`` has the best of those known, and what nobody knows counts as 1."""
    if encoding == "auto":
        return max(topic.ratios.values(), default=1.0)
    return topic.ratios.get(encoding, 1.0)
