"""Connects an ``iort`` graph to a space: in this process, or at a server over the network."""

from __future__ import annotations

import asyncio
import contextlib
import ssl
from collections.abc import Callable, Iterator
from typing import Protocol

from ropeway.errors import GraphUnavailable, StoreError
from ropeway.iort import AsyncNode, NodeError, Packet, Value
from ropeway.networks.iort.space import MemberEndpoint, Space
from ropeway.store import Entry

__all__ = ["Link", "LocalLink", "RemoteLink"]

OnValue = Callable[[Entry, bool], None]
OnEvent = Callable[[MemberEndpoint, bool], None]


class Link(Protocol):
    """Connects a graph to a space. Everything that is refused raises ``GraphUnavailable``."""

    async def open(self, on_value: OnValue, on_event: OnEvent, on_lost: Callable[[], None]) -> None:
        """Join; ``on_lost`` is called when all endpoints that were told are no longer known."""

    async def close(self) -> None:
        """Leave the space."""

    def publish(self, system: str, topic: str, data: bytes, type: str, stamp_ns: int, origin: str, form: str) -> bool:
        """Publish a value; return false if it is refused at once."""

    async def advertise(self, system: str, topic: str, type: str, qos: str) -> None:
        """Tell that we publish."""

    async def withdraw(self, system: str, topic: str) -> None:
        """Tell that we publish no longer."""

    async def subscribe(self, system: str, topic: str, type: str, qos: str) -> None:
        """Get every value, the one that is there first."""

    async def unsubscribe(self, system: str, topic: str) -> None:
        """End a subscription."""


class LocalLink:
    """A member of a space of this process."""

    def __init__(self, space: Space, node: str) -> None:
        self.space, self.node = space, node
        self._on_value: OnValue | None = None
        self._on_event: OnEvent | None = None

    async def open(self, on_value: OnValue, on_event: OnEvent, on_lost: Callable[[], None]) -> None:
        """Join the space."""
        self._on_value, self._on_event = on_value, on_event
        self.space.join(self)
        self.space.watch(self)

    async def close(self) -> None:
        """Leave the space."""
        self._on_value = self._on_event = None
        self.space.leave(self)

    def value(self, entry: Entry, latest: bool) -> None:
        """Deliver a value."""
        if self._on_value is not None:
            self._on_value(entry, latest)

    def event(self, endpoint: MemberEndpoint, there: bool) -> None:
        """Deliver the news that an endpoint came or went."""
        if self._on_event is not None:
            self._on_event(endpoint, there)

    def publish(self, system: str, topic: str, data: bytes, type: str, stamp_ns: int, origin: str, form: str) -> bool:
        """Publish a value; one that the store refuses is counted there."""
        try:
            self.space.publish(self, system, topic, data, origin=origin, stamp_ns=stamp_ns, type=type, form=form)
        except StoreError:
            return False
        return True

    async def advertise(self, system: str, topic: str, type: str, qos: str) -> None:
        """Tell that we publish."""
        with _told(self.node):
            self.space.advertise(self, system, topic, type, qos)

    async def withdraw(self, system: str, topic: str) -> None:
        """Tell that we publish no longer."""
        self.space.withdraw(self, system, topic)

    async def subscribe(self, system: str, topic: str, type: str, qos: str) -> None:
        """Get every value."""
        with _told(self.node):
            self.space.subscribe(self, system, topic, latest=True, type=type, qos=qos)

    async def unsubscribe(self, system: str, topic: str) -> None:
        """End a subscription."""
        self.space.unsubscribe(self, system, topic)


class RemoteLink:
    """A node of a server elsewhere; it connects again by itself, and tells what stands again."""

    def __init__(
        self,
        url: str,
        node: str,
        *,
        token: str | None = None,
        ssl_context: ssl.SSLContext | None = None,
        max_packet_bytes: int = 64 << 20,
        wait_s: float = 5.0,
    ) -> None:
        self.url, self.node_name = url, node
        self.node = AsyncNode(
            node,
            url,
            token=token,
            tls=ssl_context,
            max_packet_bytes=max_packet_bytes,
            kind="",
            on_mode=self._mode_changed,
            on_event=self._event,
        )
        self._wait_s = wait_s
        self._on_value: OnValue | None = None
        self._on_event: OnEvent | None = None
        self._on_lost: Callable[[], None] | None = None
        self._ends: dict[tuple[str, str], Callable[[], object]] = {}
        self._open = False

    @property
    def connected(self) -> bool:
        """Whether the server answers."""
        return self.node.mode == "remote"

    async def open(self, on_value: OnValue, on_event: OnEvent, on_lost: Callable[[], None]) -> None:
        """Connect to the server. With ``wait_s`` 0 it need not be reached at once; else ``GraphUnavailable``
        is raised.
        """
        self._on_value, self._on_event, self._on_lost = on_value, on_event, on_lost
        await self.node.open(self._wait_s)
        self._open = True
        if self._wait_s and not self.connected:
            error = self.node.last_error
            await self.close()
            raise GraphUnavailable(self.url, error or f"did not answer within {self._wait_s:g} s")
        with self._told():
            await self.node.stand("*", "*", "+watch", {})

    async def close(self) -> None:
        """Leave the server."""
        self._on_value = self._on_event = self._on_lost = None
        self._open = False
        await self.node.close()

    def publish(self, system: str, topic: str, data: bytes, type: str, stamp_ns: int, origin: str, form: str) -> bool:
        """Publish a value; while the connection is slow, a newer one replaces it."""
        self.node.publish_nowait(topic, data, system=system, type=type, stamp_ns=stamp_ns, origin=origin)
        return True

    async def advertise(self, system: str, topic: str, type: str, qos: str) -> None:
        """Tell that we publish."""
        with self._told():
            await self.node.stand(system, topic, "+adv", {"k": type, "q": qos})

    async def withdraw(self, system: str, topic: str) -> None:
        """Tell that we publish no longer."""
        await self.node.stand(system, topic, "+adv", None)
        with contextlib.suppress(NodeError):
            await self.node.request(system, topic, "+unadv", {})

    async def subscribe(self, system: str, topic: str, type: str, qos: str) -> None:
        """Get every value."""
        with self._told():
            self._ends[system, topic] = await self.node.subscribe(
                topic, self._value, system=system, head={"k": type, "q": qos}
            )

    async def unsubscribe(self, system: str, topic: str) -> None:
        """End a subscription."""
        end = self._ends.pop((system, topic), None)
        if end is not None:
            result = end()
            if asyncio.iscoroutine(result):
                await result

    def _told(self) -> contextlib.AbstractContextManager[None]:
        return _told(self.url)

    def _value(self, value: Value) -> None:
        if self._on_value is not None:
            entry = Entry(
                value.system, value.topic, value.data, value.version, value.stamp_ns, value.origin, value.type
            )
            self._on_value(entry, value.latest)

    def _event(self, packet: Packet) -> None:
        head = packet.head
        if self._on_event is not None and head.get("kind") in ("publisher", "subscription"):
            endpoint = MemberEndpoint(
                head["kind"],
                packet.system,
                packet.topic,
                head.get("k", ""),
                head.get("q", ""),
                head.get("node", ""),
                head.get("id", ""),
            )
            self._on_event(endpoint, head.get("here") == "1")

    def _mode_changed(self, mode: str) -> None:
        if mode != "remote" and self._on_lost is not None:
            self._on_lost()


@contextlib.contextmanager
def _told(where: str) -> Iterator[None]:
    try:
        yield
    except (NodeError, StoreError) as error:
        raise GraphUnavailable(where, str(error)) from error
