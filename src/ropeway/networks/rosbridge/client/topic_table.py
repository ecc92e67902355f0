"""Keeps the topics that go over a link: their numbers, what the peer says of them, and the messages that come."""

from __future__ import annotations

import contextlib
import itertools
import logging
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ropeway.errors import RopewayError
from ropeway.networks.rosbridge.client.echoes import EchoFilter
from ropeway.networks.rosbridge.client.far_figures import read_figures, since
from ropeway.networks.rosbridge.link.calls import OP_CHANNELS
from ropeway.qos import QoS

if TYPE_CHECKING:
    from ropeway.networks.rosbridge.client.parts import RemotePublisher, RemoteSubscription
    from ropeway.networks.rosbridge.link.peer import Peer
    from ropeway.networks.rosbridge.protocol import ops
    from ropeway.networks.rosbridge.protocol.records import Arrival

__all__ = ["TopicTable"]

log = logging.getLogger("ropeway.rosbridge")


class TopicTable:
    """The publishers and subscriptions of the graph ``name``. They outlive connections.

    ``echoes`` has the topics that are both published and read: a plain server sends us what is ours.
    """

    def __init__(self, name: str) -> None:
        self.echoes: dict[str, EchoFilter] = {}
        self._name = name
        self._numbers = itertools.count(1)
        self._publishers: dict[int, RemotePublisher] = {}
        self._subscriptions: dict[int, RemoteSubscription] = {}

    # ── the parts ──────────────────────────────────────────────────────────────────────────────────────────────

    def next_number(self) -> int:
        """Return a free channel number."""
        while True:
            number = next(self._numbers) % OP_CHANNELS.start
            if number and number not in self._publishers and number not in self._subscriptions:
                return number

    def add_publisher(self, publisher: RemotePublisher, peer: Peer | None) -> None:
        """Keep a publisher, and announce it. Raises ``UnknownType`` where the peer cannot take it."""
        self._publishers[publisher.number] = publisher
        self._note_echo(publisher.topic)
        if peer is not None:
            try:
                publisher.connected(peer)
            except RopewayError:
                self.forget(publisher.number, publisher.topic)
                raise

    def add_subscription(self, subscription: RemoteSubscription, peer: Peer | None) -> None:
        """Keep a subscription, and ask for its topic."""
        self._subscriptions[subscription.number] = subscription
        self._note_echo(subscription.topic)
        if peer is not None:
            subscription.connected(peer)

    def forget(self, number: int, topic: str) -> None:
        """Remove a topic that was closed."""
        self._publishers.pop(number, None)
        self._subscriptions.pop(number, None)
        self._note_echo(topic)

    def parts(self) -> list[RemotePublisher | RemoteSubscription]:
        """Return all of them."""
        return [*self._publishers.values(), *self._subscriptions.values()]

    def _note_echo(self, topic: str) -> None:
        published = any(p.topic == topic for p in self._publishers.values())
        read = any(s.topic == topic for s in self._subscriptions.values())
        if published and read:
            self.echoes.setdefault(topic, EchoFilter())
        else:
            self.echoes.pop(topic, None)

    # ── the connection ─────────────────────────────────────────────────────────────────────────────────────────

    def connected(self, peer: Peer) -> None:
        """Announce all on a new connection; one that cannot go to this peer does not hold up the others."""
        for part in self.parts():
            try:
                part.connected(peer)
            except RopewayError as error:
                self._was_refused(part, str(error))

    def disconnected(self) -> None:
        """Let go of the connection, which is gone."""
        for part in self.parts():
            part.disconnected()

    @property
    def channels(self) -> list[Any]:
        """The channels of what is published on the connection."""
        return [p.channel for p in self._publishers.values() if p.channel is not None]

    # ── what the peer says ─────────────────────────────────────────────────────────────────────────────────────

    def published(self, op: ops.Publish, peer: Peer) -> None:
        """Deliver a message that came as a plain ``publish``."""
        found = [subscription for subscription in self._subscriptions.values() if subscription.topic == op.topic]
        for subscription in found:
            subscription.published(op)
        if not found:
            peer.fault_log.note("unknown topic", op.topic, "it was not subscribed to")

    def arrived(self, channel: int, arrivals: Sequence[Arrival], peer: Peer) -> None:
        """Deliver messages that came on a channel."""
        subscription = self._subscriptions.get(channel)
        if subscription is not None:
            subscription.arrived(arrivals)
        else:
            peer.fault_log.note("unknown topic", f"channel {channel}", "nobody subscribed to it")

    def takes(self, channel: int) -> bool:
        """Return whether somebody here reads a channel."""
        return channel in self._subscriptions

    def control(self, message: Mapping[str, Any]) -> None:
        """Take what a gateway says of a topic."""
        op, number = message.get("op"), message.get("channel")
        publisher = self._publishers.get(number) if isinstance(number, int) else None
        subscription = self._subscriptions.get(number) if isinstance(number, int) else None
        if op == "refused":
            self._was_refused(publisher or subscription, str(message.get("reason", "")))
        elif op == "demand" and publisher is not None and isinstance(message.get("count"), int):
            publisher.answers.tell("")
            publisher.set_subscribers(message["count"])
        elif op == "stats" and publisher is not None:
            delay = message.get("delay_ms")
            publisher.remote_delay_s = delay / 1e3 if isinstance(delay, (int, float)) else None
            publisher.far = since(read_figures(message), publisher.far)
        elif op == "stats" and subscription is not None:
            subscription.far = read_figures(message)
        elif op == "adopted" and subscription is not None:
            subscription.answers.tell("")
            if isinstance(message.get("qos"), Mapping):
                with contextlib.suppress(ValueError):
                    subscription.adopted(QoS.parse(message["qos"]))
            subscription.learned(message)

    def _was_refused(self, part: RemotePublisher | RemoteSubscription | None, reason: str) -> None:
        if part is None or part.refused == reason:
            return
        if not part.answers.tell(reason):
            log.warning("%s: %s was refused: %s", self._name, part.topic, reason)
