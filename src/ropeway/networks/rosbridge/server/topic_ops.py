"""Carries out a client's operations on topics: advertise, publish, subscribe, and their opposites."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from ropeway.errors import InvalidOperation, RopewayError, TypesError
from ropeway.limits import DEPTH_PER_CLIENT_SAMPLES, IDS_PER_TOPIC, TOPICS_PER_CLIENT
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.protocol.dialect import ROSGW
from ropeway.networks.rosbridge.protocol.records import Arrival
from ropeway.networks.rosbridge.server.bodies import known_type_of
from ropeway.networks.rosbridge.server.registrations import add_id, id_key, remove_request
from ropeway.networks.rosbridge.server.retire import Retire
from ropeway.networks.rosbridge.server.topic_channels import REGISTRATION_BYTES, TopicIn, TopicOut, topic_status
from ropeway.networks.rosbridge.server.topic_errors import TopicTypeConflict, UnknownTopicError
from ropeway.qos import QoS
from ropeway.tasks import Supervised, end

if TYPE_CHECKING:
    from ropeway.graph.base import Sample
    from ropeway.networks.rosbridge.server.host import SessionHost

__all__ = ["TopicOps", "TopicTypeConflict", "UnknownTopicError"]

_SHALLOW_SAMPLES: Final = 100
_RAW: Final = ("cbor-raw", "rawzip")
_POLICIES: Final = ("history", "depth", "reliability", "durability", "deadline", "lifespan")


class TopicOps:
    """The topics of one client.

    ``inputs`` are what it publishes, by the name that it gave; ``outputs`` what it reads. A gateway numbers its
    topics, and has them in tables by number.
    """

    def __init__(
        self, session: SessionHost, *, unregister_timeout_s: float, on_advertised: Callable[[str], Awaitable[None]]
    ) -> None:
        self.session = session
        self.inputs: dict[str, TopicIn] = {}
        self.outputs: dict[str, TopicOut] = {}
        self.input_channels: dict[int, TopicIn] = {}
        self.output_channels: dict[int, TopicOut] = {}
        self.unregister_timeout_s = unregister_timeout_s
        self._on_advertised = on_advertised
        self._numbers = 0
        self._lingering: dict[str, asyncio.TimerHandle] = {}
        self._untyped: dict[str, dict[str, ops.Subscribe]] = {}  # subscriptions that wait until the topic has a type
        self._type_watch: Supervised | None = None

    # ── lifecycle ──────────────────────────────────────────────────────────────────────────────────────────────

    async def leave(self) -> None:
        """Clean up after a client that has left, except topics that linger; ``withdraw`` takes those back."""
        await end(self._type_watch)
        self._untyped.clear()
        for handle in self._lingering.values():
            handle.cancel()
        for output in self._all_outputs():
            await output.close()
        for channel in self.input_channels.values():
            await channel.close()

    @property
    def lingers(self) -> bool:
        """Whether the client, which has left, published topics that may still be wanted."""
        return bool(self.inputs) and self.unregister_timeout_s > 0

    async def withdraw(self, name: str | None = None) -> None:
        """Take back the topics of a client that has left for good, or with ``name`` this one."""
        for topic in [t for t in self.inputs.values() if name is None or t.name == name]:
            self.inputs.pop(topic.topic, None)
            await topic.close()

    @property
    def held_bytes(self) -> int:
        """The bytes kept for the client's topics."""
        waiting = sum(map(len, self._untyped.values()))
        inputs = sum(topic.held_bytes for topic in self._all_inputs())
        outputs = sum(output.held_bytes for output in self._all_outputs())
        return inputs + outputs + REGISTRATION_BYTES * waiting

    def tick(self) -> None:
        """Bring the meters up to date, and tell a gateway how its topics arrive."""
        for topic in self._all_inputs():
            topic.report()
        for output in self._all_outputs():
            output.report()

    def status(self) -> Iterator[dict[str, Any]]:
        """Yield one row per topic."""
        for topic in self._all_inputs():
            yield topic_status(topic.topic, "in", topic.type, topic.used, topic.passage)
        for output in self._all_outputs():
            channel = output.channel
            used = channel.used if channel is not None else ""
            lost = channel.queue.lost if channel is not None else {}
            yield topic_status(output.topic, "out", output.type, used, output.passage, lost)

    def just_sent(self, topic: str) -> list[Sample]:
        """Return the last small messages of a topic that the client got."""
        return [sample for output in self._all_outputs() if output.topic == topic for sample in output.just_sent()]

    def _all_inputs(self) -> list[TopicIn]:
        return [*self.inputs.values(), *self.input_channels.values()]

    def _all_outputs(self) -> list[TopicOut]:
        return [*self.outputs.values(), *self.output_channels.values()]

    # ── messages ───────────────────────────────────────────────────────────────────────────────────────────────

    def published(self, op: ops.Publish) -> bool:
        """Publish a message on a topic that the client has advertised; false if it has not. Raises ``TypesError``."""
        known = self.inputs.get(op.topic)
        if known is None or known.publisher is None or not known.ids:
            return False
        known.published(op)
        return True

    def takes(self, channel: int, waiting: Sequence[object]) -> bool:
        """Return whether a channel is advertised, or about to be by an operation that waits."""
        return channel in self.input_channels or any(
            isinstance(op, ops.Advertise) and (op.ropeway or {}).get("channel") == channel for op in waiting
        )

    def arrived(self, channel: int, arrivals: Sequence[Arrival], waiting: Sequence[object]) -> None:
        """Publish messages that came on a channel; ``waiting`` are the operations that have not had their turn."""
        topic = self.input_channels.get(channel)
        if topic is not None:
            topic.arrived(arrivals)
            return
        for op in waiting:  # its advertise waits for its turn: the topic takes early messages
            if isinstance(op, ops.Advertise) and (op.ropeway or {}).get("channel") == channel:
                with contextlib.suppress(TypesError):
                    type = self.session.registry.canonical(op.type)
                    topic = self.input_channels[channel] = TopicIn(self.session, op.topic, type, op.compression)
                    topic.number = channel
                    topic.arrived(arrivals)
                return
        self.session.complain("unknown topic", f"channel {channel}", "it was not advertised")

    # ── publishing ─────────────────────────────────────────────────────────────────────────────────────────────

    async def advertise(self, op: ops.Advertise) -> None:
        """Advertise a topic for the client."""
        number = self._channel(op.ropeway)
        try:
            await self._make_input(op, number)
        except (RopewayError, ValueError):
            if number is not None and (early := self.input_channels.get(number)) and early.publisher is None:
                del self.input_channels[number]
            raise

    async def _make_input(self, op: ops.Advertise, number: int | None) -> None:
        session = self.session
        name = session.names.resolve(op.topic)
        session.access.check("publish", name)
        type = await known_type_of(session, op.type, "msg")
        session.learn(type, op.ropeway)
        known = self.inputs.get(op.topic) if number is None else self.input_channels.get(number)
        if known is not None and known.publisher is not None and known.topic == op.topic:
            if known.type != type:
                raise TopicTypeConflict(op.topic, known.type, type)
            add_id(known.ids, op.id)
            self._stop_linger(op.topic)
            return
        if known is not None and known.publisher is not None:
            raise InvalidOperation("advertise", f"channel {number} is that of {known.topic}")
        self._check_type(name, type)
        if number is None and op.compression not in _RAW:
            session.codec(type)  # what nobody can read is no topic
        qos = self._affordable(self._publisher_qos(op))
        self._check_count()
        early = known is not None and (known.topic, known.type) == (op.topic, type)
        topic = known if known is not None and early else TopicIn(session, op.topic, type, op.compression)
        topic.number = number
        topic.unique = (op.ropeway or {}).get("unique_ids") is True
        publisher = await session.view.create_publisher(name, type, qos)
        topic.name = publisher.topic
        add_id(topic.ids, op.id)
        if number is None:
            self.inputs[op.topic] = topic
        else:
            self.input_channels[number] = topic
        topic.ready(publisher)
        await self._on_advertised(publisher.topic)

    def _publisher_qos(self, op: ops.Advertise) -> QoS:
        if op.qos is not None:
            qos = self._asked_qos(op.qos)
            if qos.durability == "best_available":  # for a writer, that is the most that it can offer
                qos = replace(qos, durability="transient_local")
            if qos.transient_local and "depth" not in op.qos and not self.session.gateway:
                qos = replace(qos, depth=1)  # ROS 2's default: late readers get the last message, and not ten
            return qos
        if self.session.peer.dialect is ROSGW or self.session.gateway:
            return QoS()
        if op.latch:
            return QoS(durability="transient_local", depth=1)
        depth = max(op.queue_size, 1)  # 0 stands for the least, as in ROS 2
        return QoS(durability="transient_local", depth=depth, lifespan_s=1.0)

    def _affordable(self, qos: QoS) -> QoS:
        """Return a profile no deeper than what is left to the client: DDS takes memory for all of the depth at once."""
        if qos.depth <= _SHALLOW_SAMPLES or qos.history == "keep_all":
            return qos
        depths = (topic.publisher.qos.depth for topic in self._all_inputs() if topic.publisher is not None)
        taken = sum(depth for depth in depths if depth > _SHALLOW_SAMPLES)
        depth = min(qos.depth, max(DEPTH_PER_CLIENT_SAMPLES - taken, _SHALLOW_SAMPLES))
        if depth < qos.depth:
            self.session.complain("qos", "", f"other topics of the client are so deep that this one gets {depth}")
        return replace(qos, depth=depth)

    def _asked_qos(self, asked: Mapping[str, Any]) -> QoS:
        """Return the profile that a client asks for; like rosbridge, ignore policies that are not known."""
        known = {key: value for key, value in asked.items() if key in _POLICIES}
        profile = QoS.parse(known)
        if (asked_depth := known.get("depth", 0)) > profile.depth:
            self.session.complain(
                "qos", "", f"a depth of {asked_depth} is more than anybody gets: it is {profile.depth}"
            )
        if len(known) != len(asked):
            unknown = ", ".join(sorted(str(key)[:40] for key in asked if key not in known))
            self.session.complain("qos", "", f"unknown policies are ignored: {unknown[:200]}")
        return profile

    async def unadvertise(self, op: ops.Unadvertise) -> None:
        """Withdraw a topic that the client publishes no more."""
        if self.session.gateway:
            for number, topic in list(self.input_channels.items()):
                if topic.topic == op.topic and id_key(op.id) in topic.ids:
                    del self.input_channels[number]
                    self.session.peer.forget_inbound(number)
                    await topic.close()
            return
        known = self.inputs.get(op.topic)
        if known is None:
            return
        if ops.present(op.id):
            known.ids.discard(id_key(op.id))
        else:
            known.ids.clear()
        if not known.ids:
            loop = asyncio.get_running_loop()
            self._stop_linger(op.topic)
            self._lingering[op.topic] = loop.call_later(self.unregister_timeout_s, self._expire, op.topic)

    def _stop_linger(self, topic: str) -> None:
        handle = self._lingering.pop(topic, None)
        if handle is not None:
            handle.cancel()

    def _expire(self, name: str) -> None:
        self._lingering.pop(name, None)
        self.session.turns.push(Retire(name))

    async def retire(self, name: str) -> None:
        """Close a withdrawn topic whose time of grace is over."""
        topic = self.inputs.get(name)
        if topic is not None and not topic.ids and name not in self._lingering:
            del self.inputs[name]
            await topic.close()

    async def publish(self, op: ops.Publish) -> None:
        """Publish a message; if its topic was not advertised, this advertises it."""
        topic = self.inputs.get(op.topic)
        if topic is None or not topic.ids:
            type = topic.type if topic is not None else op.type or self._inferred(op.topic)
            await self.advertise(
                ops.Advertise(
                    id=op.id,
                    topic=op.topic,
                    type=type,
                    latch=bool(op.latch),
                    queue_size=100 if op.queue_size is None else op.queue_size,
                    qos=op.qos,
                    compression=op.compression,
                )
            )
            topic = self.inputs[op.topic]
        topic.published(op)

    # ── reading ────────────────────────────────────────────────────────────────────────────────────────────────

    async def subscribe(self, op: ops.Subscribe) -> None:
        """Subscribe the client to a topic."""
        session = self.session
        name = session.names.resolve(op.topic)
        session.access.check("subscribe", name)
        if not op.type and not self._types(name):
            self._wait_for_type(op)
            return
        type = await known_type_of(session, op.type or self._inferred(op.topic), "msg")
        session.learn(type, op.ropeway)
        self._check_type(name, type)
        qos = self._asked_qos(op.qos) if op.qos is not None else None
        number = self._channel(op.ropeway)
        if number is not None:
            output = self.output_channels.get(number)
            if output is not None:
                await self._drop_output(output)
            self._check_count()
            output = self.output_channels[number] = TopicOut(session, op.topic, type, number)
        else:
            output = self.outputs.get(op.topic)
            if output is None:
                self._check_count()
                self._numbers += 1
                output = self.outputs[op.topic] = TopicOut(session, op.topic, type, self._numbers)
            elif output.type != type:
                raise TopicTypeConflict(op.topic, output.type, type)
        key = id_key(op.id)
        before = output.requests.get(key)
        if before is None and len(output.requests) >= IDS_PER_TOPIC:
            raise InvalidOperation("", f"a topic may have {IDS_PER_TOPIC} ids at most")
        output.requests[key] = op
        try:
            output.settle()
            if (op.ropeway or {}).get("again") is True and output.subscription is None:
                for sibling in session.siblings():
                    output.send_again(sibling.topics.just_sent(op.topic))
            await self._read(output, name, qos)
        except (RopewayError, ValueError):
            if output.subscription is None:
                await self._drop_output(output)
            elif before is not None:
                output.requests[key] = before
            else:
                del output.requests[key]
            raise

    async def _read(self, output: TopicOut, name: str, qos: QoS | None) -> None:
        """Read the topic; who asks once more has what is kept for late readers once more, as from rosbridge."""
        old = output.subscription
        if old is not None:
            if not old.qos.transient_local:
                return
            output.subscription = None
            await old.close()  # first, so that nothing comes twice; what comes meanwhile is kept, too
        else:
            output.qos = qos
        output.subscription = await self.session.view.create_subscription(
            name, output.type, output.qos, output.passage.pass_on
        )
        output.subscription.on_qos(output.follow)

    async def unsubscribe(self, op: ops.Unsubscribe) -> None:
        """End the client's subscription to a topic."""
        if self.session.gateway:
            for output in list(self.output_channels.values()):
                if output.topic == op.topic and id_key(op.id) in output.requests:
                    await self._drop_output(output)
            return
        untyped = self._untyped.get(op.topic)
        if untyped is not None:
            remove_request(untyped, op.id)
            if not untyped:
                del self._untyped[op.topic]
        shared = self.outputs.get(op.topic)
        if shared is None:
            return
        remove_request(shared.requests, op.id)
        if shared.requests:
            shared.settle()
        else:
            await self._drop_output(shared)

    async def _drop_output(self, output: TopicOut) -> None:
        if self.outputs.get(output.topic) is output:
            del self.outputs[output.topic]
        if self.output_channels.get(output.number) is output:
            del self.output_channels[output.number]
        await output.close()

    def _wait_for_type(self, op: ops.Subscribe) -> None:
        """Subscribe when the topic appears (rosbridge fails, and the client has to ask again)."""
        if self.session.gateway:
            raise UnknownTopicError(op.topic)
        if op.topic not in self._untyped:
            self._check_count()
        waiting = self._untyped.setdefault(op.topic, {})
        if len(waiting) >= IDS_PER_TOPIC:
            raise InvalidOperation("", f"a topic may have {IDS_PER_TOPIC} ids at most")
        waiting[id_key(op.id)] = op
        if self._type_watch is None:
            view = self.session.view
            self._type_watch = Supervised(
                lambda: self._watch_types(view.changes()), "topics that are waited for"
            ).start()
        text = f"{op.topic} is not advertised yet; it is subscribed to when it appears"
        self.session.inform(text, op.id)

    async def _watch_types(self, changes: Any) -> None:
        async for event in changes:
            if event.kind != "publisher" or not event.discovered:
                continue
            for topic in [t for t in self._untyped if self.session.names.resolve(t) == event.name]:
                for op in self._untyped.pop(topic).values():
                    self.session.turns.push(op)

    # ── checks ─────────────────────────────────────────────────────────────────────────────────────────────────

    def _channel(self, extra: Mapping[str, Any] | None) -> int | None:
        """Return the channel number that a gateway gave a topic."""
        number = (extra or {}).get("channel")
        if not self.session.gateway or number is None:
            return None
        if isinstance(number, bool) or not isinstance(number, int) or not 0 < number < 65536:
            raise InvalidOperation("", f"a channel is a number from 1 to 65535, not {str(number)[:20]}")
        return number

    def _check_count(self) -> None:
        inputs = len(self.inputs) + len(self.input_channels)
        count = inputs + len(self.outputs) + len(self.output_channels) + len(self._untyped)
        if count >= TOPICS_PER_CLIENT:
            raise InvalidOperation("", f"a client may have {TOPICS_PER_CLIENT} topics at most")

    def _types(self, name: str) -> tuple[str, ...]:
        """Return the types that a topic has now; topics of an action have them from it."""
        view = self.session.view
        types = view.types(name)
        action, mark, part = name.rpartition("/_action/")
        if types or not mark:
            return types
        found = view.action_types(action)
        if part == "feedback":
            return tuple(f"{type}_FeedbackMessage" for type in found)
        return ("action_msgs/msg/GoalStatusArray",) if found and part == "status" else ()

    def _check_type(self, name: str, type: str) -> None:
        types = self._types(name)
        if types and type not in types:
            raise TopicTypeConflict(name, types[0], type)

    def _inferred(self, topic: str) -> str:
        types = self._types(self.session.names.resolve(topic))
        if not types:
            raise UnknownTopicError(topic)
        return types[0]
