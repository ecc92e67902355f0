"""One client of the server: its operations, in order, on our graph."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections import deque
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from ropeway.errors import GraphError, InvalidOperation, RopewayError, TypeConflict, TypesError
from ropeway.graph.base import resolve_name
from ropeway.link.peer import Peer
from ropeway.qos import QoS
from ropeway.server.topics import TopicIn, TopicOut, topic_status
from ropeway.server.watch import Watch
from ropeway.wire import ops
from ropeway.wire.dialect import ROPEWAY, ROSGW
from ropeway.wire.records import Arrival

if TYPE_CHECKING:
    from ropeway.graph.hub import Hub
    from ropeway.link.connection import Connection
    from ropeway.types import TypeRegistry

__all__ = ["Session"]

log = logging.getLogger("ropeway.server")

_PAUSE_AT: Final = 256  # operations that wait; above, the socket is not read
_RESUME_AT: Final = 32
_PAUSE_BYTES: Final = 64 << 20  # received while operations wait
_NO_ID: Final = "\0none"
_TOPICS_LIMIT: Final = 4096  # of one client, in both directions
_IDS_LIMIT: Final = 1024  # of one topic of one client
_DEFINITION_LIMIT: Final = 1 << 20  # characters
_DEPTH_LIMIT: Final = 100_000
_RAW: Final = ("cbor-raw", "rawzip")


class Session:
    """What one client does here. Withdrawn as a whole when the client leaves."""

    def __init__(
        self,
        connection: Connection,
        hub: Hub,
        registry: TypeRegistry,
        *,
        gateway_id: str,
        name: str,
        unregister_timeout_s: float,
        on_advertised: Callable[[str], Awaitable[None]],
    ) -> None:
        self.registry = registry
        self.peer = Peer(connection, registry, self)
        self.gateway = self.peer.dialect is ROPEWAY
        self.view = hub.view(connection.peer, echo=not self.gateway)
        self.clock = time.time_ns
        self.remote: dict[str, str] = {}
        self.inputs: dict[str, TopicIn] = {}
        self.outputs: dict[str, TopicOut] = {}
        self._input_channels: dict[int, TopicIn] = {}
        self._outputs_by_channel: dict[int, TopicOut] = {}
        self._numbers = 0
        self._waiting: deque[ops.Op | _Retire] = deque()
        self._wake = asyncio.Event()
        self._unregister_timeout_s = unregister_timeout_s
        self._on_advertised = on_advertised
        self._lingering: dict[str, asyncio.TimerHandle] = {}
        self._paused = False
        self._idle_bytes = 0  # what had been received before operations had to wait
        self._watch: Watch | None = None
        self._definitions = 0
        self._gone = False
        if self.gateway:
            self.peer.hello(gateway_id, name)
            self.peer.ping()

    async def run(self) -> None:
        """Carry out the client's operations until it leaves, then take back what it created."""
        try:
            while not self._gone:
                await self._wake.wait()
                self._wake.clear()
                while self._waiting and not self._gone:
                    op = self._waiting[0]
                    await self._carry_out(op)
                    self._waiting.popleft()
                    if self._paused and len(self._waiting) <= (0 if self._heavy else _RESUME_AT):
                        self._paused = False
                        self.peer.connection.resume_reading()
                    await asyncio.sleep(0)  # others have their turn, however much this client asks for
        finally:
            await self._leave()
            if not self.lingers:
                await self.withdraw()

    async def _leave(self) -> None:
        """Take back everything but the topics that linger; ``withdraw`` takes those back."""
        self._waiting.clear()
        if self._watch is not None:
            await self._watch.close()
        for handle in self._lingering.values():
            handle.cancel()
        for output in list(self.outputs.values()) + list(self._outputs_by_channel.values()):
            await output.close()
        for channel in self._input_channels.values():
            await channel.close()

    @property
    def lingers(self) -> bool:
        """True if the client, which has left, published topics that may still be wanted."""
        return bool(self.inputs) and self._unregister_timeout_s > 0

    async def withdraw(self, name: str | None = None) -> None:
        """The client has left for good: take back its topics, or with ``name`` this one."""
        for topic in [t for t in self.inputs.values() if name is None or t.name == name]:
            self.inputs.pop(topic.topic, None)
            await topic.close()
        if not self.inputs:
            await self.view.close()

    # ── what the peer says ─────────────────────────────────────────────────────────────────────────────────────

    def operation(self, op: ops.Op) -> None:
        """An operation came; publishing on a known topic is done at once, all else waits for its turn."""
        if isinstance(op, ops.Publish) and not self._waiting:
            known = self.inputs.get(op.topic)
            if known is not None and known.publisher is not None and known.ids:
                known.published(op)
                return
        if not self._waiting:
            self._idle_bytes = self.peer.connection.bytes_in
        self._waiting.append(op)
        self._wake.set()
        if not self._paused and (len(self._waiting) > _PAUSE_AT or self._heavy):
            self._paused = True
            self.peer.connection.pause_reading()

    @property
    def _heavy(self) -> bool:
        return self.peer.connection.bytes_in - self._idle_bytes > _PAUSE_BYTES

    def control(self, message: Mapping[str, Any]) -> None:
        """A message of the Ropeway dialect came."""
        op = message.get("op")
        if op == "hello":
            self.remote = {k: message[k] for k in ("gateway", "name") if isinstance(message.get(k), str)}
        elif op == "watch" and self._watch is None:
            self._watch = Watch(self.view, self.peer.send)

    def arrived(self, channel: int, arrivals: Sequence[Arrival]) -> None:
        """Messages came on a channel."""
        topic = self._input_channels.get(channel)
        if topic is not None:
            topic.arrived(arrivals)
            return
        for op in self._waiting:  # its advertise waits for its turn: the topic takes early messages
            if isinstance(op, ops.Advertise) and (op.ropeway or {}).get("channel") == channel:
                with contextlib.suppress(TypesError):
                    topic = self._input_channels[channel] = TopicIn(
                        self, op.topic, self.registry.canonical(op.type), op.compression
                    )
                    topic.number = channel
                    topic.arrived(arrivals)
                return
        self.peer.complaints.note("unknown topic", f"channel {channel}", "it was not advertised")

    def lost(self, code: int, reason: str) -> None:
        """The connection is gone."""
        self._gone = True
        self._wake.set()

    def tick(self) -> None:
        """Bring the meters up to date, and tell a gateway how its topics arrive; called about once a second."""
        for topic in (*self.inputs.values(), *self._input_channels.values()):
            topic.report()
        for output in (*self.outputs.values(), *self._outputs_by_channel.values()):
            output.meter.update()
        if self.gateway:
            self.peer.ping()

    def status(self) -> dict[str, Any]:
        """What the client does here, for people and programs."""
        connection = self.peer.connection
        return {
            "peer": connection.peer,
            "gateway": self.remote.get("name", ""),
            "dialect": self.peer.dialect.name,
            "bytes_in": connection.bytes_in,
            "bytes_out": connection.bytes_out,
            "complaints": {f"{kind} {topic}".strip(): n for (kind, topic), n in self.peer.complaints.counts.items()},
            "topics": [
                *(
                    topic_status(t.topic, "in", t.type, t.encoding, t.meter, t.lost)
                    for t in (*self.inputs.values(), *self._input_channels.values())
                ),
                *(
                    topic_status(
                        t.topic,
                        "out",
                        t.type,
                        t.channel.used if t.channel is not None else "",
                        t.meter,
                        {**t.drops, **(t.channel.queue.lost if t.channel is not None else {})},
                    )
                    for t in (*self.outputs.values(), *self._outputs_by_channel.values())
                ),
            ],
        }

    # ── operations ─────────────────────────────────────────────────────────────────────────────────────────────

    async def _carry_out(self, op: ops.Op | _Retire) -> None:
        try:
            match op:
                case ops.Advertise():
                    await self._advertise(op)
                case ops.Unadvertise():
                    await self._unadvertise(op)
                case _Retire():
                    await self._retire(op.topic)
                case ops.Publish():
                    await self._publish(op)
                case ops.Subscribe():
                    await self._subscribe(op)
                case ops.Unsubscribe():
                    await self._unsubscribe(op)
                case ops.CallService():
                    name = op.name if op.name.startswith("/") else f"/{op.name}"
                    text = f"Service {name} does not exist"
                    self.peer.send(ops.ServiceResponse(service=op.service, values=text, result=False, id=op.id))
                case _:
                    self.peer.complaints.note("operation", "", f"{op.op} is not served here")
        except (RopewayError, ValueError) as error:
            topic = getattr(op, "topic", "")
            self.peer.complaints.note(op.op, topic, error)
            channel = (getattr(op, "ropeway", None) or {}).get("channel")
            if self.gateway and isinstance(channel, int):
                self.peer.send({"op": "refused", "channel": channel, "reason": str(error)})

    async def _advertise(self, op: ops.Advertise) -> None:
        number = self._channel(op.ropeway)
        try:
            await self._make_input(op, number)
        except (RopewayError, ValueError):
            if number is not None and (early := self._input_channels.get(number)) and early.publisher is None:
                del self._input_channels[number]
            raise

    async def _make_input(self, op: ops.Advertise, number: int | None) -> None:
        type = self.registry.canonical(op.type)
        self._learn(type, op.ropeway or {})
        name = resolve_name(op.topic)
        known = self.inputs.get(op.topic) if number is None else self._input_channels.get(number)
        if known is not None and known.publisher is not None and known.topic == op.topic:
            if known.type != type:
                raise TypeConflict(op.topic, known.type, type)
            _add(known.ids, op.id)
            self._stop_linger(op.topic)
            return
        if known is not None and known.publisher is not None:
            raise InvalidOperation("advertise", f"channel {number} is that of {known.topic}")
        self._check_type(name, type)
        if number is None and op.compression not in _RAW:
            self.registry.codec(type)  # what nobody can read is no topic
        qos = self._publisher_qos(op)
        self._check_count()
        early = known is not None and (known.topic, known.type) == (op.topic, type)
        topic = known if known is not None and early else TopicIn(self, op.topic, type, op.compression)
        topic.number = number
        publisher = await self.view.create_publisher(name, type, qos)
        topic.name = publisher.topic
        _add(topic.ids, op.id)
        if number is None:
            self.inputs[op.topic] = topic
        else:
            self._input_channels[number] = topic
        topic.ready(publisher)
        await self._on_advertised(publisher.topic)

    def _channel(self, extra: Mapping[str, Any] | None) -> int | None:
        """The channel number that a gateway gave a topic."""
        number = (extra or {}).get("channel")
        if not self.gateway or number is None:
            return None
        if isinstance(number, bool) or not isinstance(number, int) or not 0 < number < 65536:
            raise InvalidOperation("", f"a channel is a number from 1 to 65535, not {str(number)[:20]}")
        return number

    def _check_count(self) -> None:
        inputs = len(self.inputs) + len(self._input_channels)
        if inputs + len(self.outputs) + len(self._outputs_by_channel) >= _TOPICS_LIMIT:
            raise InvalidOperation("", f"a client may have {_TOPICS_LIMIT} topics at most")

    def _stop_linger(self, topic: str) -> None:
        handle = self._lingering.pop(topic, None)
        if handle is not None:
            handle.cancel()

    def _publisher_qos(self, op: ops.Advertise | ops.Publish) -> QoS:
        if op.qos is not None:
            return QoS.parse(op.qos)
        if self.peer.dialect is ROSGW or self.gateway:
            return QoS()
        depth = min(op.queue_size or 100, _DEPTH_LIMIT)
        if op.latch:
            return QoS(durability="transient_local", depth=1)
        return QoS(durability="transient_local", depth=depth, lifespan_s=1.0)

    def _check_type(self, name: str, type: str) -> None:
        types = self.view.types(name)
        if types and type not in types:
            raise TypeConflict(name, types[0], type)

    def _learn(self, type: str, extra: Mapping[str, Any]) -> None:
        text = extra.get("definition")
        if not self.gateway or not isinstance(text, str) or self.registry.has(type):
            return
        self._definitions += 1
        if self._definitions > _TOPICS_LIMIT or len(text) > _DEFINITION_LIMIT:
            raise InvalidOperation("", f"the definition of {type} is one too many, or too long")
        self.registry.add_full_text(type, text)

    async def _unadvertise(self, op: ops.Unadvertise) -> None:
        if self.gateway:
            for number, topic in list(self._input_channels.items()):
                if topic.topic == op.topic and _key(op.id) in topic.ids:
                    del self._input_channels[number]
                    self.peer.forget_inbound(number)
                    await topic.close()
            return
        known = self.inputs.get(op.topic)
        if known is None:
            return
        if ops.present(op.id):
            known.ids.discard(_key(op.id))
        else:
            known.ids.clear()
        if not known.ids:
            loop = asyncio.get_running_loop()
            self._stop_linger(op.topic)
            self._lingering[op.topic] = loop.call_later(self._unregister_timeout_s, self._expire, op.topic)

    def _expire(self, name: str) -> None:
        self._lingering.pop(name, None)
        self._waiting.append(_Retire(name))
        self._wake.set()

    async def _retire(self, name: str) -> None:
        topic = self.inputs.get(name)
        if topic is not None and not topic.ids and name not in self._lingering:
            del self.inputs[name]
            await topic.close()

    async def _publish(self, op: ops.Publish) -> None:
        topic = self.inputs.get(op.topic)
        if topic is None or not topic.ids:
            type = topic.type if topic is not None else op.type or self._inferred(op.topic)
            await self._advertise(
                ops.Advertise(
                    id=op.id,
                    topic=op.topic,
                    type=type,
                    latch=bool(op.latch),
                    queue_size=op.queue_size or 100,
                    qos=op.qos,
                    compression=op.compression,
                )
            )
            topic = self.inputs[op.topic]
        topic.published(op)

    def _inferred(self, topic: str) -> str:
        types = self.view.types(resolve_name(topic))
        if not types:
            raise UnknownTopicError(topic)
        return types[0]

    async def _subscribe(self, op: ops.Subscribe) -> None:
        name = resolve_name(op.topic)
        type = self.registry.canonical(op.type) if op.type else self._inferred(op.topic)
        self._learn(type, op.ropeway or {})
        self._check_type(name, type)
        qos = QoS.parse(op.qos) if op.qos is not None else None
        number = self._channel(op.ropeway)
        if number is not None:
            output = self._outputs_by_channel.get(number)
            if output is not None:
                await self._drop_output(output)
            self._check_count()
            output = self._outputs_by_channel[number] = TopicOut(self, op.topic, type, number)
        else:
            output = self.outputs.get(op.topic)
            if output is None:
                self._check_count()
                self._numbers += 1
                output = self.outputs[op.topic] = TopicOut(self, op.topic, type, self._numbers)
            elif output.type != type:
                raise TypeConflict(op.topic, output.type, type)
        key = _key(op.id)
        before = output.requests.get(key)
        if before is None and len(output.requests) >= _IDS_LIMIT:
            raise InvalidOperation("", f"a topic may have {_IDS_LIMIT} ids at most")
        output.requests[key] = op
        try:
            output.settle()
            if output.subscription is None:
                output.subscription = await self.view.create_subscription(name, type, qos, output.deliver)
                output.subscription.on_qos(output.follow)
        except (RopewayError, ValueError):
            if output.subscription is None:
                await self._drop_output(output)
            elif before is not None:
                output.requests[key] = before
            else:
                del output.requests[key]
            raise

    async def _drop_output(self, output: TopicOut) -> None:
        if self.outputs.get(output.topic) is output:
            del self.outputs[output.topic]
        if self._outputs_by_channel.get(output.number) is output:
            del self._outputs_by_channel[output.number]
        await output.close()

    async def _unsubscribe(self, op: ops.Unsubscribe) -> None:
        if self.gateway:
            for output in list(self._outputs_by_channel.values()):
                if output.topic == op.topic and _key(op.id) in output.requests:
                    await self._drop_output(output)
            return
        shared = self.outputs.get(op.topic)
        if shared is None:
            return
        if ops.present(op.id):
            shared.requests.pop(_key(op.id), None)
        else:
            shared.requests.clear()
        if shared.requests:
            shared.settle()
        else:
            await self._drop_output(shared)


class UnknownTopicError(GraphError):
    """A topic whose type nobody has told."""

    def __init__(self, topic: str) -> None:
        self.topic = topic
        super().__init__(
            f"Cannot infer topic type for topic {topic} as it is not yet advertised; give its type in the request"
        )


@dataclass(frozen=True)
class _Retire:
    """The time that a withdrawn topic was kept for its client is over."""

    topic: str
    op: str = "unadvertise"


def _add(ids: set[str], id: object) -> None:
    if len(ids) >= _IDS_LIMIT:
        raise InvalidOperation("", f"a topic may have {_IDS_LIMIT} ids at most")
    ids.add(_key(id))


def _key(id: object) -> str:
    return repr(id) if ops.present(id) else _NO_ID
