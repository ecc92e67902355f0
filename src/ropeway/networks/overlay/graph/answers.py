"""Sends answers to the gateways that asked: of several robots that use one machine, none gets those of another.

A gateway that publishes a request for one machine names the topic on which it expects the answer. The machine's
publisher of that topic then has a publisher of its own for each of these gateways. An answer goes to the one whose
request it answers, and what nobody asked for goes to all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Protocol

from ropeway.graph.base import Delivery, Publisher, Sample
from ropeway.group.stamp import StampReader, stamp_reader
from ropeway.limits import OVERLAY_POOL_GATEWAYS
from ropeway.networks.overlay.advert import Advertisement
from ropeway.networks.overlay.askers import Askers
from ropeway.networks.overlay.graph.host import OverlayHost
from ropeway.qos import QoS
from ropeway.tasks import Chores
from ropeway.types import TypeRegistry

__all__ = ["AnswerPublishers", "AnsweringHost"]


class AnsweringHost(OverlayHost, Protocol):
    """The services of a graph for those who send answers."""

    closing: Chores

    @property
    def registry(self) -> TypeRegistry:
        """The types whose stamps are read."""
        ...

    def publish_to(self, target: bytes, topic: str, type: str, qos: QoS, delivery: Delivery) -> Publisher:
        """Publish a topic for one gateway alone."""
        ...


class AnswerPublishers:
    """The publishers of one topic for the gateways that expect answers on it; ``changed`` is called when their
    readers come and go.
    """

    def __init__(
        self, graph: AnsweringHost, advert: Advertisement, delivery: Delivery, changed: Callable[[], None]
    ) -> None:
        self._graph, self._advert, self._delivery, self._changed = graph, advert, delivery, changed
        self._to: dict[bytes, Publisher] = {}
        self._stamp: StampReader | None = None

    def __bool__(self) -> bool:
        """Return whether there is such a gateway."""
        return bool(self._to)

    def ready(self) -> Iterator[bytes]:
        """Yield the gateways that read their own, and need not read what goes to everybody."""
        return (gateway for gateway, publisher in self._to.items() if publisher.subscribers)

    def refresh(self) -> None:
        """Publish for those who expect answers now, and no others."""
        advert, graph = self._advert, self._graph
        askers = graph.node.rib.asking(advert.name)
        for gateway in self._to.keys() - askers:
            self._end(gateway)
        assert advert.qos is not None
        for gateway in sorted(askers - self._to.keys())[: OVERLAY_POOL_GATEWAYS - len(self._to)]:
            graph.node.askers.setdefault(advert.name, Askers())
            made = graph.publish_to(gateway, advert.name, advert.type, advert.qos, self._delivery)
            self._to[gateway] = made
            made.on_demand(lambda _: self._changed())

    def publish(self, sample: Sample) -> bytes | None:
        """Send a message to who asked for it, else to all who expect answers; return who asked."""
        if self._stamp is None:
            self._stamp = stamp_reader(self._graph.registry, self._advert.type)
        asked = self._graph.node.askers.get(self._advert.name)
        asker = None if asked is None else asked.answered(self._stamp(sample.payload))
        for gateway, publisher in self._to.items():
            if asker is None or gateway == asker:
                publisher.publish(sample)
        return asker

    def close(self) -> None:
        """Publish for nobody."""
        for gateway in list(self._to):
            self._end(gateway)
        self._graph.node.askers.pop(self._advert.name, None)

    def _end(self, gateway: bytes) -> None:
        publisher = self._to.pop(gateway)
        self._graph.closing.start(publisher.close(), f"end of answers on {self._advert.name}")
        asked = self._graph.node.askers.get(self._advert.name)
        if asked is not None:
            asked.forget(gateway)
