"""Serves one client: carries out its operations, in order, on our graph."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from ropeway import aio
from ropeway.errors import AccessDenied, CallTimeout, InvalidOperation, RopewayError, TypesError, WireError
from ropeway.graph.calls import DEFAULT_TIMEOUT_S
from ropeway.group.state_lease import HeldState
from ropeway.limits import SEARCHES_PER_CLIENT, UNREAD_STATUS_BYTES
from ropeway.listener.authorization import Access
from ropeway.listener.turns import Turns
from ropeway.networks.rosbridge.link.peer import Peer
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY
from ropeway.networks.rosbridge.protocol.records import Arrival
from ropeway.networks.rosbridge.server.action_ops import ActionOps
from ropeway.networks.rosbridge.server.graph_watch import Watch
from ropeway.networks.rosbridge.server.host import RosapiAnswers
from ropeway.networks.rosbridge.server.names import Names
from ropeway.networks.rosbridge.server.retire import Retire
from ropeway.networks.rosbridge.server.service_ops import ServiceOps
from ropeway.networks.rosbridge.server.topic_channels import TopicIn, TopicOut
from ropeway.networks.rosbridge.server.topic_ops import TopicOps
from ropeway.types.told_types import DefinitionTeller

if TYPE_CHECKING:
    from ropeway.hub.hub import Hub
    from ropeway.listener.connection import Connection
    from ropeway.types import MessageCodec, TypeRegistry
    from ropeway.types.ros1_spelling import Ros1Spelling

__all__ = ["RosapiAnswers", "Session"]

log = logging.getLogger("ropeway.server")

_LONG_CODECS: Final = 1024  # codecs for clients that want texts for numbers of 64 bits
_RATED: Final[Mapping[type, str]] = {
    ops.Publish: "publish",
    ops.Advertise: "publish",
    ops.Subscribe: "subscribe",
    ops.CallService: "call_service",
    ops.AdvertiseService: "advertise_service",
    ops.SendActionGoal: "send_action_goal",
    ops.AdvertiseAction: "advertise_action",
}


class Session:
    """The session of one client; it is withdrawn as a whole when the client leaves.

    A client that connects with ``?status=1`` in its URL is told what it did wrong, in ``status`` operations
    (``{"op":"status","level":"error","msg":…}``, with the id of the operation where it had one). Others are not:
    rosbridge for ROS 2 has no such operation, and some client libraries stumble over it.

    With ``?int64=text`` in its URL, the JSON that a client gets has integers of 64 bits as texts: JavaScript rounds
    numbers beyond 2**53.

    ``ros1``: how messages are written for clients of a ROS 1 network; gateways get them as ROS 2 has them.
    ``call_timeout_s``: how long a call waits whose client gives no ``timeout``, 0 and below for as long as may be.
    ``cancel_goals``: the goals of a client that leaves are cancelled; those of a gateway always are.
    """

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
        call_timeout_s: float = DEFAULT_TIMEOUT_S,
        cancel_goals: bool = True,
        access: Access | None = None,
        rosapi: RosapiAnswers | None = None,
        names: Names | None = None,
        ros1: Ros1Spelling | None = None,
    ) -> None:
        self.registry = registry
        self.gateway_id = gateway_id
        self.access = access or Access(client=connection.peer, is_own=rosapi.serves if rosapi else None)
        self.rosapi = rosapi
        self.names = names or Names(f"/{name}")
        self._ros1 = ros1
        self.peer = Peer(connection, registry, self)
        self.peer.on_invalid = self.invalid
        self.gateway = self.peer.dialect is ROPEWAY
        self.codec: Callable[[str], MessageCodec] = registry.codec if self.gateway else self._own_codec
        self.view = hub.view(connection.peer, echo=not self.gateway)
        self.remote: dict[str, str] = {}
        self.all_sessions: Callable[[], Iterable[Session]] = tuple
        self.turns: Turns[ops.Op | Retire] = Turns(connection, self.peer.op_sender)
        self.topics = TopicOps(self, unregister_timeout_s=unregister_timeout_s, on_advertised=on_advertised)
        self.services = ServiceOps(self, call_timeout_s=call_timeout_s)
        self.actions = ActionOps(self, cancel_goals=cancel_goals or self.gateway)
        self._rated_bytes = 0
        self._watch: Watch | None = None
        self._teller = DefinitionTeller(registry)
        self.state = HeldState()
        self.gone = False
        self.requests_bytes = 0
        self._searches = asyncio.Semaphore(SEARCHES_PER_CLIENT)  # for what nobody is known to serve
        hold = connection.account.hold
        hold("operations that wait", lambda: self.turns.bytes)
        hold("requests under way", lambda: self.requests_bytes)
        hold("topics and what they keep", lambda: self.topics.held_bytes)
        hold("definitions", lambda: self._teller.held_bytes)
        query = connection.handshake.query if connection.handshake is not None else {}
        self._tells_status = query.get("status", ["0"])[-1].lower() not in ("0", "", "false", "no", "none")
        self._long_texts = query.get("int64", [""])[-1] == "text"
        self._long_codecs: dict[str, MessageCodec] = {}
        if self._tells_status:
            self.peer.fault_log.on_note = lambda kind, text, id: self._send_status("error", f"{kind}: {text}", id)
        if self.gateway:
            self.peer.hello(gateway_id, name, express=True)
            self.peer.ping()

    def siblings(self) -> Iterator[Session]:
        """Yield the other sessions of the gateway that the client is: it has several links to us."""
        gateway = self.remote.get("gateway") if self.gateway else None
        for session in self.all_sessions() if gateway else ():
            if session is not self and session.gateway and session.remote.get("gateway") == gateway:
                yield session

    @property
    def connection(self) -> Connection:
        """The connection of the client."""
        return self.peer.connection

    @property
    def inputs(self) -> dict[str, TopicIn]:
        """The topics that a plain client publishes."""
        return self.topics.inputs

    @property
    def outputs(self) -> dict[str, TopicOut]:
        """The topics that a plain client reads."""
        return self.topics.outputs

    # ── lifecycle ──────────────────────────────────────────────────────────────────────────────────────────────

    async def run(self) -> None:
        """Carry out the client's operations until it leaves, then take back what it created."""
        try:
            await self.turns.carry_out(self._carry_out, lambda: self.gone)
        finally:
            self.gone = True
            await self._leave()
            if not self.lingers:
                await self.withdraw()

    async def give_up(self, reason: str) -> None:
        """Answer what the client waits for, before its connection is closed."""
        self.turns.forget()
        await self.services.give_up(reason)
        await self.actions.give_up(reason)

    async def _leave(self) -> None:
        """Take back everything but the topics that linger; ``withdraw`` takes those back."""
        self.turns.forget()
        if self._watch is not None:
            await self._watch.close()
        await self.services.leave()
        await self.actions.leave()
        await self.topics.leave()
        self._teller.leave()

    @property
    def lingers(self) -> bool:
        """Whether the client, which has left, published topics that may still be wanted."""
        return self.topics.lingers

    async def withdraw(self, name: str | None = None) -> None:
        """Take back the topics of a client that has left for good, or with ``name`` this one."""
        await self.topics.withdraw(name)
        if not self.topics.inputs:
            await self.view.close()

    # ── what the peer says ─────────────────────────────────────────────────────────────────────────────────────

    def operation(self, op: ops.Op) -> None:
        """Carry out an operation. What takes no time is done at once, unless something waits; all else has its turn."""
        if self.access.limited and not self._within_rates(op):
            return
        turns = self.turns
        try:
            if turns.waiting or turns.paused or not self._at_once(op):
                turns.push(op)
        except (RopewayError, ValueError) as error:
            self._failed(op, error)
        turns.look()

    def _within_rates(self, op: ops.Op) -> bool:
        """Return whether the client keeps to the rates of its role; otherwise a request is refused, and all else
        dropped.
        """
        verb = _RATED.get(type(op))
        if verb is None:
            return True  # an answer, or something taken back: others wait for it
        before, self._rated_bytes = self._rated_bytes, self.peer.connection.bytes_in
        try:
            self.access.spend(verb, op.about[1], self._rated_bytes - before)
        except AccessDenied as error:
            if isinstance(op, ops.CallService):
                self.services.refuse(op, error)
            elif isinstance(op, ops.SendActionGoal):
                self.actions.refuse(op, error)
            else:
                self._failed(op, error)
            return False
        return True

    @contextlib.asynccontextmanager
    async def searching(self, name: str, timeout_s: float) -> AsyncIterator[None]:
        """Count a search for a name that nobody is known to serve, while few others are under way.

        Raises ``CallTimeout``.
        """
        try:
            async with aio.timeout(timeout_s):
                await self._searches.acquire()
        except TimeoutError:
            raise CallTimeout(name, timeout_s) from None
        try:
            yield
        finally:
            self._searches.release()

    def control(self, message: Mapping[str, Any]) -> None:
        """Handle a message of the Ropeway dialect."""
        op = message.get("op")
        if op == "hello":
            self.remote = {k: message[k][:256] for k in ("gateway", "name") if isinstance(message.get(k), str)}
            if self.remote.get("name"):
                self.view.user = f"gateway {self.remote['name']} ({self.peer.connection.peer})"
        elif op == "watch" and self._watch is None:
            self._watch = Watch(self.view, self.peer.send, self.access)
        elif op == "accepted" or op == "cancelling":
            self.actions.control(message)
        elif op == "state":
            self.state.told(message, self.view.user)

    def invalid(self, message: Mapping[str, Any], error: WireError) -> None:
        """Handle something that is not an operation. Where an answer is awaited, this is it."""
        op = message.get("op")
        if op == "call_service":
            self.services.invalid_call(message, error)
        elif op == "service_response":
            self.services.invalid_response(message, error)
        elif op == "send_action_goal":
            self.actions.invalid_goal(message, error)
        elif op == "action_result":
            self.actions.invalid_result(message, error)
        name = message.get("topic", message.get("service", message.get("action", "")))
        self.complain(
            "operation", str(name)[:200], error, error.id if isinstance(error, InvalidOperation) else ops.ABSENT
        )

    def arrived(self, channel: int, arrivals: Sequence[Arrival]) -> None:
        """Deliver messages that came on a channel."""
        if self.access.limited:
            arrivals = [arrival for arrival in arrivals if self._may_arrive(channel, arrival)]
        self.topics.arrived(channel, arrivals, self.turns.waiting)

    def _may_arrive(self, channel: int, arrival: Arrival) -> bool:
        topic = self.topics.input_channels.get(channel)
        try:
            self.access.spend("publish", topic.topic if topic is not None else f"channel {channel}", len(arrival.body))
        except AccessDenied:
            return False
        return True

    def takes(self, channel: int) -> bool:
        """Return whether the client has advertised a channel, or is about to."""
        return self.topics.takes(channel, self.turns.waiting)

    def lost(self, code: int, reason: str) -> None:
        """Begin to clean up: the connection is gone."""
        self.gone = True
        self.turns.wake()

    # ── what is said of it ─────────────────────────────────────────────────────────────────────────────────────

    def complain(self, kind: str, name: str, error: object, id: object = ops.ABSENT) -> None:
        """Count and log something that the client did wrong, and tell it, if it wants to know."""
        if not isinstance(error, AccessDenied):
            self.peer.fault_log.note(kind, name, error, id=id)
        elif self._tells_status:  # it is counted and logged by ``access``
            self._send_status("error", str(error), id)

    def inform(self, text: str, id: object = ops.ABSENT) -> None:
        """Log something that the client may want to know, and tell it, if it does."""
        log.info("%s: %s", self.peer.connection.peer, text)
        if self._tells_status:
            self._send_status("info", text, id)

    def _send_status(self, level: str, text: str, id: object) -> None:
        if self.peer.connection.unsent_bytes < UNREAD_STATUS_BYTES:
            self.peer.send(ops.Status(level=level, msg=text, id=id))

    def tick(self) -> None:
        """Bring the meters up to date, and tell a gateway how its topics arrive; called about once a second."""
        self.topics.tick()
        self.turns.tick()
        self.peer.connection.look()
        if self.gateway:
            self.peer.ping()

    def status(self) -> dict[str, Any]:
        """Return what the client does here, for people and programs."""
        return {
            **self.state.status(),
            **self.peer.connection.status(),
            "gateway": self.remote.get("name", ""),
            "dialect": self.peer.dialect.name,
            "role": self.access.role.name,
            "denied": dict(self.access.denied),
            "complaints": {f"{kind} {topic}".strip(): n for (kind, topic), n in self.peer.fault_log.counts.items()},
            "topics": list(self.topics.status()),
            "services": list(self.services.status()),
            "actions": list(self.actions.status()),
        }

    # ── operations ─────────────────────────────────────────────────────────────────────────────────────────────

    def _at_once(self, op: ops.Op | Retire) -> bool:
        """Carry out an operation that needs no waiting; false for others. What answers a request answers failures."""
        match op:
            case ops.Publish():
                return self.topics.published(op)
            case ops.CallService():
                self.services.call(op)
            case ops.ServiceResponse():
                self.services.response(op)
            case ops.SendActionGoal():
                self.actions.send(op)
            case ops.CancelActionGoal():
                self.actions.cancel(op)
            case ops.ActionFeedback():
                self.actions.feedback(op)
            case ops.ActionResult():
                self.actions.result(op)
            case _:
                return False
        return True

    async def _carry_out(self, op: ops.Op | Retire) -> None:
        try:
            if self._at_once(op):
                return
            match op:
                case ops.Advertise():
                    await self.topics.advertise(op)
                case ops.Unadvertise():
                    await self.topics.unadvertise(op)
                case Retire():
                    await self.topics.retire(op.topic)
                case ops.Publish():
                    await self.topics.publish(op)
                case ops.Subscribe():
                    await self.topics.subscribe(op)
                case ops.Unsubscribe():
                    await self.topics.unsubscribe(op)
                case ops.AdvertiseService():
                    await self.services.advertise(op)
                case ops.UnadvertiseService():
                    await self.services.unadvertise(op)
                case ops.AdvertiseAction():
                    await self.actions.advertise(op)
                case ops.UnadvertiseAction():
                    await self.actions.unadvertise(op)
                case _:
                    self.complain("operation", "", f"{op.op} is not served here", op.id)
        except (RopewayError, ValueError) as error:
            self._failed(op, error)

    def _failed(self, op: ops.Op | Retire, error: RopewayError | ValueError) -> None:
        if isinstance(op, Retire):
            self.complain(op.op, op.topic, error)
            return
        kind, name = op.about
        self.complain(op.op, name, error, op.id)
        if not self.gateway:
            return
        channel = (op.ropeway or {}).get("channel")
        if isinstance(channel, int):
            self.peer.send({"op": "refused", "channel": channel, "reason": str(error)})
        elif isinstance(op, (ops.AdvertiseService, ops.AdvertiseAction)):
            self.peer.send({"op": "refused", kind: name, "reason": str(error)})

    def _own_codec(self, type: str) -> MessageCodec:
        codec = self.registry.codec(type) if self._ros1 is None else self._ros1.codec(type)
        if not self._long_texts:
            return codec
        known = self._long_codecs.get(type)
        if known is None:
            if len(self._long_codecs) >= _LONG_CODECS:
                self._long_codecs.clear()
            known = self._long_codecs[type] = codec.with_long_texts()
        return known

    @property
    def is_ros1(self) -> bool:
        """Whether the client gets messages as ROS 1 writes them."""
        return self._ros1 is not None and not self.gateway

    def knows(self, type: str) -> bool:
        """Return whether messages of the type can be decoded."""
        try:
            self.codec(type)
        except TypesError:
            return False
        return True

    def learn(self, type: str, extra: Mapping[str, Any] | None) -> None:
        """Take the definition of a type that a gateway sent along. Raises ``RopewayError`` for one that is no good."""
        text = (extra or {}).get("definition")
        if self.gateway and isinstance(text, str):
            self._teller.tell(type, text)
