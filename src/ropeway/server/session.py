"""One client of the server: its operations, in order, on our graph."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from ropeway.errors import GraphError, RopewayError, TypeConflict, TypesError
from ropeway.graph.base import resolve_name
from ropeway.link.peer import Peer
from ropeway.qos import QoS
from ropeway.server.topics import TopicIn, TopicOut, topic_status
from ropeway.server.watch import Watch
from ropeway.wire import ops
from ropeway.wire.dialect import ROPEWAY, ROSGW
from ropeway.wire.fragment import Defragmenter
from ropeway.wire.records import Arrival

if TYPE_CHECKING:
    from ropeway.graph.hub import Hub
    from ropeway.link.connection import Connection
    from ropeway.types import TypeRegistry

__all__ = ["Session"]

log = logging.getLogger("ropeway.server")

_PAUSE_AT: Final = 256  # operations that wait; above, the socket is not read
_RESUME_AT: Final = 32
_NO_ID: Final = "\0none"


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
        self._lingering: dict[str, asyncio.TimerHandle] = {}
        self._paused = False
        self._watch: Watch | None = None
        self._defragmenter = Defragmenter()
        self._gone = False
        if self.gateway:
            self.peer.send({"op": "hello", "gateway": gateway_id, "name": name})

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
                    if self._paused and len(self._waiting) <= _RESUME_AT:
                        self._paused = False
                        self.peer.connection.resume_reading()
        finally:
            await self._withdraw()

    async def _withdraw(self) -> None:
        if self._watch is not None:
            await self._watch.close()
        for handle in self._lingering.values():
            handle.cancel()
        for output in list(self.outputs.values()) + list(self._outputs_by_channel.values()):
            await output.close()
        for channel in self._input_channels.values():
            await channel.close()
        for topic in self.inputs.values():
            await topic.close()
        await self.view.close()

    # ── what the peer says ─────────────────────────────────────────────────────────────────────────────────────

    def operation(self, op: ops.Op) -> None:
        """An operation came; publishing on a known topic is done at once, all else waits for its turn."""
        if isinstance(op, ops.Publish) and not self._waiting:
            known = self.inputs.get(op.topic)
            if known is not None and known.publisher is not None:
                known.published(op)
                return
        if isinstance(op, ops.Fragment):
            text = self._defragmenter.add(op)
            if text is not None:
                self.peer.feed_text(text)
            return
        self._waiting.append(op)
        self._wake.set()
        if len(self._waiting) > _PAUSE_AT and not self._paused:
            self._paused = True
            self.peer.connection.pause_reading()

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
                    topic_status(t.topic, "in", t.type, t.encoding, t.meter, {})
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
                    name = op.service if op.service.startswith("/") else f"/{op.service}"
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
        type = self.registry.canonical(op.type)
        extra = op.ropeway or {}
        self._learn(type, extra)
        name = resolve_name(op.topic)
        number = extra.get("channel") if self.gateway else None
        if isinstance(number, int):
            topic: TopicIn | None = self._input_channels.get(number)
            if topic is None:
                topic = self._input_channels[number] = TopicIn(self, op.topic, type, op.compression)
                topic.number = number
        else:
            topic = self.inputs.get(op.topic)
            if topic is None:
                topic = self.inputs[op.topic] = TopicIn(self, op.topic, type, op.compression)
        if topic.type != type:
            raise TypeConflict(op.topic, topic.type, type)
        topic.ids.add(_key(op.id))
        handle = self._lingering.pop(op.topic, None)
        if handle is not None:
            handle.cancel()
        if topic.publisher is None:
            self._check_type(name, type)
            try:
                topic.ready(await self.view.create_publisher(name, type, self._publisher_qos(op)))
            except (RopewayError, ValueError):
                self.inputs.pop(op.topic, None)
                if isinstance(number, int):
                    self._input_channels.pop(number, None)
                raise

    def _publisher_qos(self, op: ops.Advertise | ops.Publish) -> QoS:
        if op.qos is not None:
            return QoS.parse(op.qos)
        if self.peer.dialect is ROSGW or self.gateway:
            return QoS()
        depth = op.queue_size or 100
        if op.latch:
            return QoS(durability="transient_local", depth=1)
        return QoS(durability="transient_local", depth=depth, lifespan_s=1.0)

    def _check_type(self, name: str, type: str) -> None:
        known = self.view.topics().get(name)
        if known is not None and known.types and type not in known.types:
            raise TypeConflict(name, known.type, type)

    def _learn(self, type: str, extra: Mapping[str, Any]) -> None:
        text = extra.get("definition")
        if isinstance(text, str) and not self.registry.has(type):
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
            self._lingering[op.topic] = loop.call_later(self._unregister_timeout_s, self._expire, op.topic)

    def _expire(self, name: str) -> None:
        self._lingering.pop(name, None)
        self._waiting.append(_Retire(name))
        self._wake.set()

    async def _retire(self, name: str) -> None:
        topic = self.inputs.get(name)
        if topic is not None and not topic.ids:
            del self.inputs[name]
            await topic.close()

    async def _publish(self, op: ops.Publish) -> None:
        topic = self.inputs.get(op.topic)
        if topic is None or topic.publisher is None:
            type = op.type or self._inferred(op.topic)
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
        known = self.view.topics().get(resolve_name(topic))
        if known is None or not known.types:
            raise UnknownTopicError(topic)
        return known.type

    async def _subscribe(self, op: ops.Subscribe) -> None:
        extra = op.ropeway or {}
        name = resolve_name(op.topic)
        type = self.registry.canonical(op.type) if op.type else self._inferred(op.topic)
        self._learn(type, extra)
        number = extra.get("channel") if self.gateway else None
        if isinstance(number, int):
            output = TopicOut(self, op.topic, type, number)
            self._outputs_by_channel[number] = output
        else:
            if op.topic not in self.outputs:
                self._numbers += 1
                self.outputs[op.topic] = TopicOut(self, op.topic, type, self._numbers)
            output = self.outputs[op.topic]
            type = output.type
        output.requests[_key(op.id)] = op
        qos = QoS.parse(op.qos) if op.qos is not None else None
        try:
            self._check_type(name, type)
            output.settle()
            if output.subscription is None:
                output.subscription = await self.view.create_subscription(name, type, qos, output.deliver)
                output.subscription.on_qos(output.follow)
        except (RopewayError, ValueError):
            await self._drop_output(output)
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


def _key(id: object) -> str:
    return repr(id) if ops.present(id) else _NO_ID
