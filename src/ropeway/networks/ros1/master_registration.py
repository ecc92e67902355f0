"""Keeps what the master knows of us and what we know of the master up to date.

The master is polled for its state. Parts of ours that it does not know (it was restarted, or was away when we
registered) are registered again; changes are reported; the types of new services are looked up.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import secrets
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from ropeway import aio
from ropeway.errors import ConnectFailed, TypesError
from ropeway.graph.changes import Changes
from ropeway.graph.signal import Signal
from ropeway.networks.ros1.master import MasterRefused
from ropeway.networks.ros1.reader import TopicReader
from ropeway.networks.ros1.service import ServiceDoor
from ropeway.networks.ros1.service_probe import probe_service
from ropeway.networks.ros1.snapshot import Ros1Snapshot, State, full_name
from ropeway.networks.ros1.type_learning import learn_type
from ropeway.networks.ros1.writer import TopicWriter
from ropeway.qos import LATCHED, QoS
from ropeway.tasks import Supervised, background, describe, end

if TYPE_CHECKING:
    from ropeway.networks.ros1.node import Ros1Node

__all__ = ["MasterRegistration"]

log = logging.getLogger("ropeway.ros1")

_SOON_S: Final = 0.05  # the master is asked so soon after it told us of a change
_ASKING_LIMIT: Final = 8  # nodes that are asked for types at a time
_ASK_AGAIN: Final = 10  # polls until a node that gave no answer is asked again

Part = TopicWriter | TopicReader | ServiceDoor


class MasterRegistration:
    """Keeps our node registered with the master, and polls the master. ``poll_s``: how often the master is asked;
    ``up``: whether it answered last.
    """

    def __init__(self, node: Ros1Node, changes: Changes, poll_s: float) -> None:
        self.node = node
        self.up = False
        self._first_name = node.name
        self.picture = Ros1Snapshot(node.graph.name, lambda: node.name, self._profile)
        self._changes = changes
        self._poll_s = poll_s
        self._task: Supervised | None = None
        self._wake = asyncio.Event()
        self.changed = Signal()
        """Notified whenever the picture changes, and as the keeper stops."""
        self._service_types: dict[tuple[str, tuple[str, ...]], str] = {}
        self._unknown: dict[tuple[str, ...], int] = {}  # what nobody could tell: in how many polls to ask again
        self._asking: dict[tuple[str, ...], asyncio.Task[None]] = {}
        self._types: tuple[object, dict[str, str]] = (None, {})
        self._said = ""
        self._rename = False

    # ── the loop ───────────────────────────────────────────────────────────────────────────────────────────────

    async def start(self) -> None:
        """Ask for the first time, then go on. Raises ``ConnectFailed`` and ``MasterRefused``."""
        await self._look()
        self.node.on_update = self._wake.set
        self.node.on_shutdown = self._asked_to_leave
        self._task = Supervised(self._run, f"master of {self.node.graph.name}").start()

    async def stop(self) -> None:
        """Stop polling the master."""
        await end(self._task, *self._asking.values())
        self._task = None
        self.changed.notify()

    async def _run(self) -> None:
        while True:
            with contextlib.suppress(TimeoutError):
                async with aio.timeout(self._poll_s):
                    await self._wake.wait()
                    await asyncio.sleep(_SOON_S)
            self._wake.clear()
            try:
                await self._look()
            except (ConnectFailed, MasterRefused) as error:
                if self.up or not self._said:
                    self._said = str(error)
                    log.warning("%s: the master does not answer, waiting for it: %s", self.node.graph.name, error)
                self.up = False
            except Exception:  # whatever a master answers, it is asked again
                log.exception("%s: the state of the master could not be used", self.node.graph.name)

    async def _look(self) -> None:
        if self._rename:
            self._rename = False
            await self._take_name(self._other_name())
        registered = [part for part in self._parts() if part.registered]
        publishers, subscribers, services = await self.node.master.system_state()
        if not self.up and self._said:
            log.info("%s: the master answers again", self.node.graph.name)
            self._said = ""
        self.up = True
        state = State(publishers, subscribers, services)
        await self._renew(registered, state)
        await self._see(state)

    def _asked_to_leave(self, reason: str) -> None:
        """Handle a request to shut down: the node has to end, under this name, if another node has taken it."""
        node = self.node
        if reason.startswith("[") and not reason.startswith(f"[{node.name}]"):
            return  # that was our name before
        if "new node registered" not in reason:
            log.warning("%s: a request to shut down is ignored: %s", node.graph.name, reason)
            return
        log.warning("%s: another node is called %s now; we take a new name", node.graph.name, node.name)
        self._rename = True
        self._wake.set()

    def _other_name(self) -> str:
        return f"{self._first_name}_{secrets.token_hex(2)}"

    async def _take_name(self, name: str) -> None:
        """Continue under another name; what the master still has of ours under the old one is withdrawn."""
        node = self.node
        for part in self._parts():
            part.registered = False
            if isinstance(part, ServiceDoor):
                await node.master.leave("unregisterService", part.name, node.service_api)
            else:
                end = "Publisher" if isinstance(part, TopicWriter) else "Subscriber"
                await node.master.leave(f"unregister{end}", part.topic, node.uri)
        node.name = node.master.caller = name

    # ── what we have registered ────────────────────────────────────────────────────────────────────────────────

    def _parts(self) -> list[Any]:
        node = self.node
        return [*node.writers.values(), *node.readers.values(), *node.services.values()]

    async def _renew(self, registered: list[Part], state: State) -> None:
        lost = [part for part in registered if part.registered and not self._is_known(part, state)]
        if lost:
            log.warning("%s: the master has forgotten us; we register again", self.node.graph.name)
            self.node.epoch += 1
            for part in lost:
                part.registered = False
            if await self.node.master.lookup_node(self.node.name) not in (None, self.node.uri):
                await self._take_name(self._other_name())  # it forgot us for another node of our name
        await self._withdraw(state)
        for part in self._parts():
            if not part.registered:
                await self.register(part)
            elif isinstance(part, TopicReader):
                there = [name for name in state.publishers.get(part.topic, ()) if name != self.node.name]
                if len(there) > len(part.uris):
                    await self.register(part)  # an update of the master did not come through

    async def _withdraw(self, state: State) -> None:
        """Take back what is not ours any more and the master could not be told so."""
        node = self.node
        for method, table, ours, api in (
            ("unregisterPublisher", state.publishers, node.writers, node.uri),
            ("unregisterSubscriber", state.subscribers, node.readers, node.uri),
            ("unregisterService", state.services, node.services, node.service_api),
        ):
            for name, nodes in table.items():
                if node.name in nodes and name not in ours:
                    await node.master.leave(method, name, api)

    def _is_known(self, part: Part, state: State) -> bool:
        if isinstance(part, ServiceDoor):
            return bool(state.services.get(part.name))  # who takes a service over may keep it, until it leaves
        table = state.publishers if isinstance(part, TopicWriter) else state.subscribers
        return self.node.name in table.get(part.topic, ())

    async def register(self, part: Part) -> None:
        """Tell the master of a part; if it does not answer, that is done when it does."""
        node = self.node
        try:
            if isinstance(part, TopicWriter):
                await node.master.register_publisher(part.topic, part.ros1_name, node.uri)
            elif isinstance(part, TopicReader):
                uris = await node.master.register_subscriber(part.topic, part.ros1_name, node.uri)
                if node.readers.get(part.topic) is part:
                    part.update(uris)
            else:
                await node.master.register_service(part.name, node.service_api, node.uri)
        except (ConnectFailed, MasterRefused) as error:
            log.info("%s: a registration failed and is tried again: %s", node.graph.name, error)
            return
        part.registered = True
        self._wake.set()

    # ── what others have ───────────────────────────────────────────────────────────────────────────────────────

    async def _see(self, state: State) -> None:
        key = (state.publishers, state.subscribers)
        if self._types[0] != key or any(topic not in self._types[1] for topic in state.publishers):
            types = await self.node.master.topic_types()
            self._types = (key, {topic: full for topic, type in types.items() if (full := full_name(type))})
        state.topic_types = self._types[1]
        self._ask(state)
        self._show(state)

    def _show(self, state: State) -> None:
        for service, nodes in state.services.items():
            if (type := self._service_types.get((service, tuple(nodes)))) is not None:
                state.service_types[service] = type
        before = self.picture.state
        events = self.picture.update(state)
        for event in events:
            self._changes.emit(event)
        if events or before != state:
            self.changed.notify()

    def _ask(self, state: State) -> None:
        """Ask nodes for the types of services, and for definitions that nobody here knows."""
        node = self.node
        there = {(name, tuple(nodes)) for name, nodes in state.services.items()}
        self._service_types = {key: type for key, type in self._service_types.items() if key in there}
        for service, nodes in there:
            if (door := node.services.get(service)) is not None:
                self._service_types[service, nodes] = full_name(door.ros1_name, "srv")
            elif not self._service_types.get((service, nodes)):
                self._start(("service", service), lambda s=service, n=nodes: self._probe(s, n))  # type: ignore[misc]
        for topic, nodes_ in state.publishers.items():
            type = state.topic_types.get(topic, "")
            if type and not self._can(type) and any(name != node.name for name in nodes_):
                self._start(("type", type), lambda t=topic, f=type: learn_type(node, t, f))  # type: ignore[misc]

    def _can(self, type: str) -> bool:
        try:
            self.node.types.teach(type)
        except TypesError:
            return False
        return True

    def _start(self, key: tuple[str, ...], ask: Callable[[], Any]) -> None:
        left = self._unknown.get(key, 0)
        if left > 0:
            self._unknown[key] = left - 1
            return
        if key in self._asking or len(self._asking) >= _ASKING_LIMIT:
            return
        self._unknown[key] = _ASK_AGAIN
        if len(self._unknown) > 4096:
            self._unknown.clear()
        self._asking[key] = background(self._asked(key, ask), f"{' '.join(key)} of {self.node.graph.name}")

    async def _asked(self, key: tuple[str, ...], ask: Callable[[], Any]) -> None:
        try:
            await ask()
        except Exception as error:  # whatever a node answers, it is asked again
            log.debug("%s: %s is not known: %s", self.node.graph.name, " ".join(key), describe(error), exc_info=error)
        finally:
            self._asking.pop(key, None)

    async def _probe(self, service: str, nodes: tuple[str, ...]) -> None:
        api = await self.node.master.lookup_service(service)
        type = full_name(await probe_service(self.node, service, api), "srv") if api else ""
        self._service_types[service, nodes] = type
        if type:
            self._unknown.pop(("service", service), None)
        self._wake.set()

    def _profile(self, topic: str, node: str) -> QoS | None:
        """Return what is known of a publisher because it is ours, or because we are connected to it."""
        if node == self.node.name:
            writer = self.node.writers.get(topic)
            users = writer.users if isinstance(writer, TopicWriter) else ()
            return users[0].qos if users else None
        reader = self.node.readers.get(topic)
        if isinstance(reader, TopicReader) and any(link.caller == node and link.latched for link in reader.links):
            return LATCHED
        return None
