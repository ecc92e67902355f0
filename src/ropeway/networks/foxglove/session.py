"""Serves one viewer: shows it the graph, and carries out its operations in order."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, TypeVar

import orjson

from ropeway.errors import AccessDenied, InvalidOperation, RopewayError
from ropeway.fault_log import FaultLog
from ropeway.limits import TOPICS_PER_CLIENT
from ropeway.listener.turns import Turns
from ropeway.networks.foxglove import wire
from ropeway.networks.foxglove.calls import ViewerCalls
from ropeway.networks.foxglove.channels import ServiceChannel, TopicChannel
from ropeway.networks.foxglove.graph_state import GraphState, graph_state, graph_update
from ropeway.networks.foxglove.publishing import ViewerPublications
from ropeway.networks.foxglove.questions import ViewerQuestions
from ropeway.networks.foxglove.reading import ChannelReader
from ropeway.networks.foxglove.sender import ViewerSender
from ropeway.networks.foxglove.statuses import ERROR, Statuses

if TYPE_CHECKING:
    from ropeway.hub.hub import View
    from ropeway.listener.authorization import Access
    from ropeway.listener.connection import Connection
    from ropeway.networks.foxglove.host import Place

__all__ = ["ViewerSession"]

_TOLD_AT_ONCE_BYTES: Final = 256 << 10  # of channels in one operation, so that messages have their turn between them
_SHOWN_LACKING: Final = 20  # types without a definition that a viewer is warned of
_READER_BYTES: Final = 2 << 10  # of one subscription: its names, its queue, and the place in tables

_NOTHING: Final[GraphState] = {"published": {}, "subscribed": {}, "served": {}}

_Entry = TypeVar("_Entry", TopicChannel, ServiceChannel)


@dataclass(frozen=True, slots=True)
class _ChannelsGone:
    """Channels are gone, and their subscriptions with them."""

    ids: frozenset[int]
    op: str = "unsubscribe"


class ViewerSession:
    """The session of one viewer; it is withdrawn as a whole when the viewer leaves."""

    def __init__(self, connection: Connection, view: View, access: Access, place: Place) -> None:
        self.connection, self.view, self.access, self.place = connection, view, access, place
        self.settings, self.writer = place.settings, place.writer
        self.peer_name = connection.peer
        self.fault_log = FaultLog(connection.peer)
        self.sender = ViewerSender(connection, limit_bytes=place.settings.send_buffer_bytes)
        self.statuses = Statuses(self.sender)
        self.turns: Turns[wire.ViewerOperation | _ChannelsGone] = Turns(connection, self.sender)
        self.publications = ViewerPublications(self)
        self.calls = ViewerCalls(self, self._callable, timeout_s=place.call_timeout_s)
        self.questions = ViewerQuestions(self, place)
        self.remote: dict[str, str] = {}
        self.requests_bytes = 0
        self.gone = False
        self._readers: dict[int, ChannelReader] = {}
        self._told: dict[int, TopicChannel] = {}
        self._told_services: dict[int, ServiceChannel] = {}
        self._graph: GraphState | None = None  # what it knows of the graph, if it watches it
        self._news = False  # it has not been told what has changed
        self.sender.on_idle = self._catch_up
        connection.on_text = self._text
        connection.on_binary = self._binary
        connection.on_closed = self._lost
        hold = connection.account.hold
        hold("operations that wait", lambda: self.turns.bytes)
        hold("requests under way", lambda: self.requests_bytes)
        hold("channels and what they keep", lambda: self.publications.held_bytes + _READER_BYTES * len(self._readers))
        self.sender.text(place.greeting)
        self.tell()

    # ── lifecycle ──────────────────────────────────────────────────────────────────────────────────────────────

    async def run(self) -> None:
        """Carry out the viewer's operations until it leaves, then take back what it has."""
        try:
            await self.turns.carry_out(self._carry_out, lambda: self.gone)
        finally:
            self.gone = True
            await self._leave()

    async def _leave(self) -> None:
        self.turns.forget()
        readers, self._readers = self._readers, {}
        for reader in readers.values():
            await reader.close()
        await self.calls.close()
        await self.questions.close()
        await self.publications.close()
        self.sender.close()
        await self.view.close()

    def _lost(self, code: int, reason: str) -> None:
        self.leave()

    def leave(self) -> None:
        """Begin to clean up: the connection is gone."""
        self.gone = True
        self.turns.wake()

    def tick(self) -> None:
        """Bring the meters up to date, and see whether the viewer reads; called about once a second."""
        for reader in self._readers.values():
            reader.passage.meter.update()
        self.publications.tick()
        self.turns.tick()
        self.connection.look()

    # ── what the viewer is shown ───────────────────────────────────────────────────────────────────────────────

    def tell(self) -> None:
        """Tell what has changed of channels and services, now or once the viewer has read what waits for it."""
        if self.gone:
            return
        if not self.sender.idle:
            self._news = True
            return
        self._news = False
        access, catalogue = self.access, self.place.catalogue
        channels = {id: each for id, each in catalogue.channels.items() if access.allows("subscribe", each.topic)}
        if channels != self._told:
            before, self._told = self._told, channels
            gone = before.keys() - channels.keys()
            self._show("unadvertise", "channelIds", "advertise", "channels", gone, _new(channels, before))
            if any(reader.channel.id in gone for reader in self._readers.values()):
                self.turns.push(_ChannelsGone(frozenset(gone)))
        if self.place.offers("services"):
            self._tell_services()
        self._warn()
        self._tell_graph()
        self.questions.tell_changes()

    def _tell_graph(self) -> None:
        if self._graph is not None:
            before, self._graph = self._graph, graph_state(self.view, self.settings, self.access)
            update = graph_update(before, self._graph)
            if update is not None:
                self.sender.text(wire.dumps(update))

    def parameter_changed(self, name: str, value: Any) -> None:
        """Tell a change of a parameter, if the viewer watches it."""
        self.questions.changed(name, value)
        if self.sender.idle:
            self.questions.tell_changes()
        else:
            self._news = True

    def _tell_services(self) -> None:
        access, catalogue = self.access, self.place.catalogue
        services = {id: each for id, each in catalogue.services.items() if access.allows("call_service", each.service)}
        if services != self._told_services:
            before, self._told_services = self._told_services, services
            gone, new = before.keys() - services.keys(), _new(services, before)
            self._show("unadvertiseServices", "serviceIds", "advertiseServices", "services", gone, new)

    def _show(self, take_back: str, ids: str, show: str, items: str, gone: Iterable[int], new: Iterable[bytes]) -> None:
        """Send what is gone and what is new of a table."""
        if listed := sorted(gone):
            self.sender.text(wire.dumps({"op": take_back, ids: listed}))
        for batch in _batches(new):
            self.sender.text(wire.dumps({"op": show, items: [orjson.Fragment(told) for told in batch]}))

    def _warn(self) -> None:
        """Tell which types have no definition, so that their messages cannot be read, and take it back once they do."""
        lacking = [each.type for each in self._told.values() if each.lacks]
        lacking += [each.type for each in self._told_services.values() if each.lacks]
        self.statuses.stand(
            {
                f"type {type}": f"the definition of {type} is not known, so its messages cannot be read; name a file "
                "with it under types in the configuration of the gateway"
                for type in itertools.islice(dict.fromkeys(lacking), _SHOWN_LACKING)
            }
        )

    def _catch_up(self) -> None:
        if self._news:
            self.tell()

    def _callable(self, service: int) -> ServiceChannel | None:
        return self._told_services.get(service) if service in self.place.catalogue.services else None

    def visible(self, channel: int) -> TopicChannel | None:
        """Return a channel that the viewer was told of and that is still there."""
        return self._told.get(channel) if channel in self.place.catalogue.channels else None

    # ── what the viewer sends ──────────────────────────────────────────────────────────────────────────────────

    def _text(self, data: bytes) -> None:
        try:
            operation = wire.read_text(data)
        except RopewayError as error:
            self.complain("operation", "", error)
            return
        self._take(operation, len(data))

    def _binary(self, data: bytes | memoryview) -> None:
        try:
            operation = wire.read_binary(data)
        except RopewayError as error:
            self.complain("frame", "", error)
            return
        self._take(operation, len(data))

    def _take(self, operation: wire.ViewerOperation, size: int) -> None:
        """Carry out an operation. What takes no time is done at once, unless something waits; all else has its turn."""
        turns = self.turns
        try:
            if self.access.limited:
                self._spend(operation, size)
            if turns.waiting or turns.paused or not self._at_once(operation):
                turns.push(operation)
        except RopewayError as error:
            self._failed(operation, error)
        turns.look()

    def _spend(self, operation: wire.ViewerOperation, size: int) -> None:
        """Count what is sent towards the rates of the role. Raises ``AccessDenied``."""
        match operation:
            case wire.ViewerMessage():
                self.access.spend("publish", self.publications.topic_of(operation.channel), size)
            case wire.ViewerCall():
                self.access.spend("call_service", f"service {operation.service}", size)
            case wire.LeaveChannels() | wire.WithdrawChannels():
                return
            case _:
                self.access.spend("subscribe", operation.op, size)

    def _at_once(self, operation: wire.ViewerOperation | _ChannelsGone) -> bool:
        """Carry out an operation that needs no waiting; false for others."""
        match operation:
            case wire.ViewerMessage():
                self.place.check_offered("clientPublish", operation.op)
                self.publications.published(operation)
            case wire.ViewerCall():
                self.calls.call(operation)
            case _:
                return False
        return True

    async def _carry_out(self, operation: wire.ViewerOperation | _ChannelsGone) -> None:
        try:
            if self._at_once(operation):
                return
            match operation:
                case wire.ReadChannels():
                    await self._each(operation.op, operation.pairs, self._read)
                case wire.LeaveChannels():
                    await self._each(operation.op, operation.ids, self._unread)
                case wire.OfferChannels():
                    self.place.check_offered("clientPublish", operation.op)
                    await self._each(operation.op, operation.channels, self.publications.add)
                case wire.WithdrawChannels():
                    await self._each(operation.op, operation.ids, self.publications.remove)
                case _ChannelsGone():
                    await self._close_readers(operation.ids)
                case wire.WatchGraph():
                    self.place.check_offered("connectionGraph", operation.op)
                    self._graph = _NOTHING if operation.on else None
                    self._tell_graph()
                case wire.WatchParameters():
                    self.place.check_offered("parametersSubscribe", operation.op)
                    self.questions.watch(operation)
                case wire.GetParameters() | wire.SetParameters():
                    self.place.check_offered("parameters", operation.op)
                    self.questions.ask(operation)
                case wire.FetchAsset():
                    self._fetch(operation)
        except RopewayError as error:
            self._failed(operation, error)

    def _fetch(self, operation: wire.FetchAsset) -> None:
        if self.place.offers("assets"):
            self.questions.ask(operation)
        else:
            text = "this server offers no files: name directories with packages under gateway.foxglove.asset_roots"
            self.sender.binary(wire.asset_error(operation.request_id, text))

    async def _each(self, op: str, items: Iterable[Any], do: Any) -> None:
        """Do something for each item of an operation; one that fails costs the others nothing."""
        for item in items:
            if self.gone:
                return
            try:
                await do(item)
            except (RopewayError, ValueError) as error:
                self.complain(op, "", error)
            await asyncio.sleep(0)  # others have their turn

    async def _read(self, pair: tuple[int, int]) -> None:
        id, number = pair
        channel = self.visible(number)
        if channel is None:
            raise InvalidOperation("subscribe", f"there is no channel {number}")
        if id in self._readers:
            raise InvalidOperation("subscribe", f"subscription {id} is that of {self._readers[id].channel.topic}")
        if any(reader.channel.id == number for reader in self._readers.values()):
            raise InvalidOperation("subscribe", f"channel {number} ({channel.topic}) is subscribed to already")
        if len(self._readers) >= TOPICS_PER_CLIENT:
            raise InvalidOperation("subscribe", f"a viewer reads {TOPICS_PER_CLIENT} channels at most")
        self.access.check("subscribe", channel.topic)
        reader = self._readers[id] = ChannelReader(self, id, channel)
        try:
            await reader.open()
        except BaseException:
            del self._readers[id]
            await reader.close()
            raise

    async def _unread(self, id: int) -> None:
        reader = self._readers.pop(id, None)
        if reader is None:
            raise InvalidOperation("unsubscribe", f"there is no subscription {id}")
        await reader.close()

    async def _close_readers(self, channels: frozenset[int]) -> None:
        for id, reader in list(self._readers.items()):
            if reader.channel.id in channels:
                del self._readers[id]
                await reader.close()

    # ── what is said of it ─────────────────────────────────────────────────────────────────────────────────────

    def _failed(self, operation: wire.ViewerOperation | _ChannelsGone, error: RopewayError) -> None:
        self.complain(operation.op, "", error)

    def complain(self, kind: str, name: str, error: object) -> None:
        """Count and log something that the viewer did wrong, and tell it."""
        if not isinstance(error, AccessDenied):  # which ``access`` counts and logs
            self.fault_log.note(kind, name, error)
        self.statuses.tell(ERROR, str(error))

    def status(self) -> dict[str, Any]:
        """Return what the viewer does here, for people and programs."""
        return {
            **self.connection.status(),
            "gateway": "",
            "dialect": self.connection.subprotocol,
            "role": self.access.role.name,
            "denied": dict(self.access.denied),
            "complaints": {f"{kind} {topic}".strip(): n for (kind, topic), n in self.fault_log.counts.items()},
            "topics": [*self.publications.status(), *(reader.status() for reader in self._readers.values())],
            "services": [],
            "actions": [],
        }


def _new(entries: Mapping[int, _Entry], before: Mapping[int, _Entry]) -> Iterator[bytes]:
    """Yield what is told of the entries that were not there before."""
    return (entry.told for id, entry in entries.items() if id not in before)


def _batches(items: Iterable[bytes]) -> Iterator[list[bytes]]:
    """Yield items in batches of about the size of one operation."""
    batch: list[bytes] = []
    size = 0
    for item in items:
        if batch and size + len(item) > _TOLD_AT_ONCE_BYTES:
            yield batch
            batch, size = [], 0
        batch.append(item)
        size += len(item)
    if batch:
        yield batch
