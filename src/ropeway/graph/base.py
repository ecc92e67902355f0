"""The one idea: everything that has topics, services and actions is a ``Graph``.

A ROS 2 network, a remote rosbridge server, a fleet of robots that do not use ROS: each is a ``Graph``, and a bridge
joins one name on two of them. This module holds what all kinds share: the ``Sample`` that travels, the
protocol of a graph and its parts, and the events of discovery.

Rules that hold for every kind (``tests/contract`` checks them):

* a payload is CDR as ROS 2 sends it (XCDR1 little-endian behind its 4-byte header); a graph of another encoding
  converts at its own edge;
* callbacks run on the event loop of ``open()`` and get batches, oldest first; a graph with threads hands over in
  batches; a callback that raises is logged and counted, and costs nobody else a message;
* ``publish`` never blocks and never awaits; what cannot be sent is dropped by the freshness rules and counted;
* a graph does not deliver its own messages to its own subscriptions;
* ``close`` of any part is idempotent.
"""

from __future__ import annotations

import enum
import functools
import os
from collections import Counter
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, Protocol, overload, runtime_checkable

from ropeway.errors import InvalidName
from ropeway.graph.calls import (
    ActionClient,
    ActionHandlers,
    ActionInfo,
    ActionServer,
    Client,
    Service,
    ServiceHandler,
    ServiceInfo,
)
from ropeway.limits import NAME_CHARACTERS
from ropeway.qos import QoS

__all__ = [
    "NO_HINTS",
    "SEQ_NONE",
    "Delivery",
    "EndpointInfo",
    "Graph",
    "GraphEvent",
    "NodeInfo",
    "Publisher",
    "Sample",
    "SampleCallback",
    "Subscription",
    "TopicInfo",
    "Undelivered",
    "look_up",
    "new_origin",
    "resolve_name",
]

SEQ_NONE: Final = 0


class Sample:
    """A message on its way.

    ``payload``: CDR bytes with their 4-byte header. ``type``: ``pkg/msg/Name``. ``stamp_ns``: when this gateway
    received it (``time.time_ns``). ``origin``: 16 bytes that name who published it first; ``seq``: a number that
    the origin never gives twice on one topic (the source timestamp in nanoseconds where the network has one).
    ``relayed``: it was read from another gateway's publisher on a network that carries no origin, so only ``seq``
    is the first publisher's. ``sent_ns``: when the previous gateway received it, by this machine's clock, or 0.
    ``frames`` caches encodings, so that many readers cost one encoding; it lives and dies with the sample.
    """

    __slots__ = ("frames", "origin", "payload", "relayed", "sent_ns", "seq", "stamp_ns", "type")

    def __init__(
        self,
        payload: bytes,
        type: str,
        stamp_ns: int,
        origin: bytes,
        seq: int,
        relayed: bool = False,
        sent_ns: int = 0,
    ) -> None:
        self.payload = payload
        self.type = type
        self.stamp_ns = stamp_ns
        self.origin = origin
        self.seq = seq
        self.relayed = relayed
        self.sent_ns = sent_ns
        self.frames: dict[Any, Any] | None = None

    def cached(self, key: object, make: Callable[[], Any]) -> Any:
        """Return ``frames[key]``, which the first call makes with ``make()``."""
        frames = self.frames
        if frames is None:
            frames = self.frames = {}
        elif key in frames:
            return frames[key]
        made = frames[key] = make()
        return made

    def carrying(self, payload: bytes) -> Sample:
        """Return the same message with its ``payload`` in another layout, or itself if the payload is the
        same object.
        """
        if payload is self.payload:
            return self
        return Sample(payload, self.type, self.stamp_ns, self.origin, self.seq, self.relayed, self.sent_ns)

    def __repr__(self) -> str:
        return f"<Sample {self.type} {len(self.payload)} B origin={self.origin.hex()[:8]} seq={self.seq}>"


SampleCallback = Callable[[Sequence[Sample]], None]


def new_origin() -> bytes:
    """Return 16 random bytes that name a publisher on a network without GUIDs."""
    return os.urandom(16)


@dataclass(frozen=True, slots=True)
class Delivery:
    """Says how the far side of a link should treat a topic; graphs without a link ignore what they cannot do.

    ``encoding``: one of rosbridge's ``ENCODINGS`` or ``auto``. ``priority``: lanes, 0 is sent first (commands), 4 is
    the default, 7 last. ``weight``: the topic's share of the link in bytes, beside others of its lane; one that needs
    less than its share gets all it asks for. ``rate_hz``: at most so many per second. ``lifespan_s``: older messages
    are not sent. ``depth``: how many may wait on the link, ``None`` takes the QoS's (1 for best effort, so that the
    newest replaces the one that waits). ``None`` anywhere means no limit. ``metadata``: what goes into the global name
    in the overlay beside the name and the type, as pairs of a key and a text.
    """

    encoding: str = "auto"
    priority: int = 4
    rate_hz: float | None = None
    lifespan_s: float | None = None
    depth: int | None = None
    weight: float = 1.0
    metadata: tuple[tuple[str, str], ...] = ()


NO_HINTS: Final = Delivery()


@dataclass(frozen=True, slots=True)
class EndpointInfo:
    """A publisher or subscription that was discovered.

    ``node`` is a full node name (``/camera/driver``) or ``""`` where unknown; ``gateway`` names the Ropeway gateway
    it belongs to, ``""`` for ordinary nodes; ``local`` marks our own.
    """

    kind: str  # "publisher" or "subscription"
    topic: str
    type: str
    qos: QoS
    gid: bytes = b""
    node: str = ""
    type_hash: str = ""
    gateway: str = ""
    local: bool = False


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic as it stands: its types and endpoints."""

    name: str
    types: tuple[str, ...]
    publishers: tuple[EndpointInfo, ...] = ()
    subscriptions: tuple[EndpointInfo, ...] = ()

    @property
    def type(self) -> str:
        """The first type, or ``""``."""
        return self.types[0] if self.types else ""


@dataclass(frozen=True, slots=True)
class NodeInfo:
    """A node: its full name and the names it uses."""

    name: str
    publishers: tuple[tuple[str, str], ...] = ()
    subscriptions: tuple[tuple[str, str], ...] = ()
    services: tuple[tuple[str, str], ...] = ()
    clients: tuple[tuple[str, str], ...] = ()
    local: bool = False


class Undelivered(enum.Enum):
    """The reasons for which a graph drops a message; every drop is counted under one of them."""

    DECODE = "not decodable as its type"
    ENCODE = "not encodable for this network"
    BACKLOG = "the event loop was behind"
    CALLBACK = "a callback failed"
    CLOSED = "the graph was closed"
    WRITE = "the network refused it"
    LATE = "nobody waits for the answer any more"
    ANSWERED = "another member of the group answered first"
    OUTDATED = "a newer request was answered before"
    FOREIGN = "it answers somebody else's request"
    STANDBY = "from a member of the group that is not in use"
    NOBODY = "no member of the group is there"
    COPY = "the same came by another link"


@dataclass(frozen=True, slots=True)
class GraphEvent:
    """A change of what is discovered. ``str(event)`` is a sentence for the log."""

    discovered: bool
    kind: str  # "publisher", "subscription", "node", "service", "action"
    name: str
    type: str = ""
    node: str = ""
    graph: str = ""

    def __str__(self) -> str:
        who = f"node {self.node}" if self.node else "a participant"
        verb = {
            ("publisher", True): "publishes",
            ("publisher", False): "no longer publishes",
            ("subscription", True): "subscribes to",
            ("subscription", False): "no longer subscribes to",
            ("service", True): "offers service",
            ("service", False): "no longer offers service",
            ("action", True): "offers action",
            ("action", False): "no longer offers action",
        }.get((self.kind, self.discovered))
        if verb is None:
            verb = "has appeared" if self.discovered else "has left"
            return f"{self.graph}: {self.kind} {self.name} {verb}"
        return f"{self.graph}: {who} {verb} {self.name}{f' ({self.type})' if self.type else ''}"


@runtime_checkable
class Publisher(Protocol):
    """A topic that we publish on a graph."""

    topic: str
    type: str
    qos: QoS

    def publish(self, sample: Sample) -> None:
        """Send; never blocks."""

    @property
    def subscribers(self) -> int | None:
        """The number of readers now (our own graph's subscriptions not counted), ``None`` if the network
        cannot tell.
        """

    def on_demand(self, callback: Callable[[int], None]) -> None:
        """Call with the number of subscribers at once (where known) and at each change, on the event loop."""

    async def close(self) -> None:
        """Withdraw the topic."""


@runtime_checkable
class Subscription(Protocol):
    """A topic that we read from a graph."""

    topic: str
    type: str

    @property
    def qos(self) -> QoS:
        """The profile in use: as asked, or adopted from the publishers where ``qos=None`` was asked."""

    def on_qos(self, callback: Callable[[QoS], None]) -> None:
        """Call with the profile at once and whenever the adopted one changes."""

    async def close(self) -> None:
        """Stop reading; no callback runs after this returns."""


@runtime_checkable
class Graph(Protocol):
    """A network, or part of one: anything that has topics, services and actions.

    ``create_publisher`` and ``create_subscription`` take ``qos=None`` to mean "whatever fits": a subscription
    adopts what all publishers offer and follows them when they change; a publisher uses ``ropeway.qos.DEFAULT``.
    Names are absolute (``/camera/image``). Errors: ``InvalidName``, ``InvalidTypeName``, ``UnknownType`` where the
    kind needs the definition, ``GraphUnavailable`` before ``open`` and after ``close``.
    """

    kind: str
    name: str  # how it is written as a URL: "dds:0", "ws://host:9090"
    drops: Counter[tuple[str, Undelivered]]

    async def open(self) -> None:
        """Join the network. Raises ``GraphUnavailable`` with what to do about it."""

    async def close(self) -> None:
        """Leave it with everything that was created here."""

    async def create_publisher(
        self, topic: str, type: str, qos: QoS | None = None, *, delivery: Delivery = NO_HINTS
    ) -> Publisher:
        """Publish ``topic``."""

    async def create_subscription(
        self,
        topic: str,
        type: str,
        qos: QoS | None,
        callback: SampleCallback,
        *,
        delivery: Delivery = NO_HINTS,
    ) -> Subscription:
        """Read ``topic``; ``callback`` gets batches, oldest first."""

    async def create_client(self, service: str, type: str, *, delivery: Delivery = NO_HINTS) -> Client:
        """Call ``service`` (of type ``pkg/srv/Name``); it need not be served yet."""

    async def create_service(
        self, service: str, type: str, handler: ServiceHandler, *, delivery: Delivery = NO_HINTS
    ) -> Service:
        """Serve ``service``."""

    async def create_action_client(self, action: str, type: str, *, delivery: Delivery = NO_HINTS) -> ActionClient:
        """Use ``action`` (of type ``pkg/action/Name``); it need not be served yet."""

    async def create_action_server(
        self, action: str, type: str, handlers: ActionHandlers, *, delivery: Delivery = NO_HINTS
    ) -> ActionServer:
        """Serve ``action``."""

    def topics(self) -> dict[str, TopicInfo]:
        """Return the topics discovered so far, by name."""

    def services(self) -> dict[str, ServiceInfo]:
        """Return the services discovered so far, by name; ours too, as ``local``."""

    def actions(self) -> dict[str, ActionInfo]:
        """Return the actions discovered so far, by name; ours too, as ``local``."""

    def nodes(self) -> dict[str, NodeInfo]:
        """Return the nodes discovered so far, by full name."""

    def counts(self) -> tuple[int, int]:
        """Return the numbers of topics and of nodes discovered so far."""

    def count_publishers(self, topic: str) -> tuple[int, int]:
        """Return how many publishers of a topic are others' and how many are our own (``EndpointInfo.local``)."""

    def look_up(self, kind: str, name: str) -> TopicInfo | ServiceInfo | ActionInfo | None:
        """Return what is known of one ``topic``, ``service`` or ``action`` now, ``None`` if it is not there."""

    def types_of(self, kind: str, name: str) -> tuple[str, ...]:
        """Return the types that one ``topic``, ``service`` or ``action`` has now; none if it is not there."""

    def changes(self) -> AsyncIterator[GraphEvent]:
        """Iterate over what is discovered and lost from this call on."""


@overload
def look_up(graph: Graph, kind: Literal["topic"], name: str) -> TopicInfo | None: ...
@overload
def look_up(graph: Graph, kind: Literal["service"], name: str) -> ServiceInfo | None: ...
@overload
def look_up(graph: Graph, kind: Literal["action"], name: str) -> ActionInfo | None: ...
@overload
def look_up(graph: Graph, kind: str, name: str) -> TopicInfo | ServiceInfo | ActionInfo | None: ...
def look_up(graph: Graph, kind: str, name: str) -> TopicInfo | ServiceInfo | ActionInfo | None:
    """Return ``graph.look_up(kind, name)``, typed by the kind."""
    return graph.look_up(kind, name)


def resolve_name(name: str, namespace: str = "/") -> str:
    """Return the absolute form of a ROS name: ``chatter`` in ``/robot1`` is ``/robot1/chatter``.

    Raises ``InvalidName`` with the rule of ROS that it breaks.
    """
    if not isinstance(name, str) or not name:
        raise InvalidName(name, "a name is a non-empty text, as in /camera/image_raw")
    if len(name) > NAME_CHARACTERS:  # before anything is kept or looked at
        raise InvalidName(name, f"a name has at most {NAME_CHARACTERS} characters, not {len(name)}")
    return _resolve(name, namespace)


@functools.lru_cache(maxsize=1024)
def _resolve(name: str, namespace: str) -> str:
    full = name if name.startswith("/") else f"{namespace.rstrip('/')}/{name}"
    if full.startswith("/~") or name.startswith("~"):
        raise InvalidName(name, "private names (~) need a node; write the absolute name")
    if full.endswith("/") or "//" in full:
        raise InvalidName(name, "a name has no empty part (two slashes, or one at the end)")
    for part in full[1:].split("/"):
        if part[:1].isdigit():
            raise InvalidName(name, f"part {part!r} starts with a digit")
        if not all(c == "_" or (c.isascii() and c.isalnum()) for c in part):
            raise InvalidName(name, f"part {part!r} has a character other than letters, digits and _")
    return full
