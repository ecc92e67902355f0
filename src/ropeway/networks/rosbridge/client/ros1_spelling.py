"""Finds out how a server writes messages and names types: rosbridge on ROS 1 does both differently."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

from ropeway.errors import GraphUnavailable, TypesError
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY
from ropeway.types.ros1_spelling import Ros1Spelling
from ropeway.types.ros1_types import Ros1Types

if TYPE_CHECKING:
    from ropeway.networks.rosbridge.client.plain_servers import PlainServer
    from ropeway.networks.rosbridge.link.peer import Peer
    from ropeway.types import MessageCodec, TypeRegistry

__all__ = ["Spelling"]

log = logging.getLogger("ropeway.rosbridge")


class AnnouncedTopic(Protocol):
    """A topic that is announced to a server."""

    def announce_anew(self, peer: Peer) -> None:
        """Announce it once more: its type has another name there."""
        ...


class AnnouncedTopics(Protocol):
    """The topics that are announced to a server."""

    def parts(self) -> Sequence[AnnouncedTopic]:
        """Return them."""
        ...


class AnnouncedProvider(Protocol):
    """A service or an action that is announced to a server."""

    def connected(self, peer: Peer) -> None:
        """Announce it."""
        ...


class SpellingCalls(Protocol):
    """Calls services of the server, and knows what is served to it."""

    async def plain(self, service: str, args: Mapping[str, Any], timeout_s: float = 5.0) -> Mapping[str, Any]:
        """Call a service by JSON. Raises ``GraphUnavailable``."""
        ...

    def providers(self) -> Sequence[AnnouncedProvider]:
        """Return what is served."""
        ...


class SpellingHost(Protocol):
    """Gives the spelling the part of the graph that it may use."""

    name: str
    peer: Peer | None
    registry: TypeRegistry
    plain_server: PlainServer

    @property
    def calls(self) -> SpellingCalls:
        """Return the calls on the link."""
        ...

    @property
    def table(self) -> AnnouncedTopics:
        """Return the topics of the link."""
        ...


class Spelling:
    """The spelling of the server of ``graph``. ``ros1`` tells whether it belongs to ROS 1, ``None`` that it is to be
    seen.

    It is seen in the names of types that rosapi tells, or in a message that makes sense in ROS 1 only. Gateways have
    ROS 2's spelling always.
    """

    def __init__(self, graph: SpellingHost, ros1: bool | None) -> None:
        self._graph = graph
        self.ros1 = ros1

    @cached_property
    def _theirs(self) -> Ros1Spelling:
        """Made when it is needed: it reads all definitions of ROS 1."""
        return Ros1Spelling(Ros1Types(self._graph.registry))

    @property
    def is_ros1(self) -> bool:
        """Whether the server belongs to ROS 1."""
        peer = self._graph.peer
        return bool(self.ros1) and (peer is None or peer.dialect is not ROPEWAY)

    def codec(self, type: str) -> MessageCodec:
        """Return the codec for messages of a type as the server writes them. Raises ``TypesError``."""
        return self._theirs.codec(type) if self.is_ros1 else self._graph.registry.codec(type)

    def type_name(self, type: str) -> str:
        """Return the name of a type as the server writes it."""
        return self._theirs.name(type) if self.is_ros1 else type

    async def find_out(self, peer: Peer) -> None:
        """Ask a rosbridge server once for its types."""
        if self.ros1 is not None or not self._graph.plain_server.is_rosbridge:
            return
        with contextlib.suppress(GraphUnavailable):
            types = (await self._graph.calls.plain("/rosapi/topics", {})).get("types")
            if isinstance(types, list):
                self.seen(peer, [type for type in types if isinstance(type, str)])

    def seen(self, peer: Peer, types: Iterable[str]) -> None:
        """Learn from the names of types which ROS it is."""
        if self.ros1 is not None:
            return
        parts = {type.count("/") for type in types if type}
        if parts == {1}:
            self._turn(peer)
        elif 2 in parts:
            self.ros1 = False

    def read(self, peer: Peer, type: str, decode: Callable[[MessageCodec], bytes]) -> bytes:
        """Return what ``decode`` makes of a message.

        Raises what it does for one that makes no sense in ROS 2 nor, if that may be, in ROS 1.
        """
        try:
            return decode(self.codec(type))
        except TypesError as error:
            if self.ros1 is not None:
                raise
            try:
                payload = decode(self._theirs.codec(type))
            except TypesError:
                raise error from None
        self._turn(peer)
        return payload

    def _turn(self, peer: Peer) -> None:
        """Switch to ROS 1 and announce everything anew, since types have other names there."""
        self.ros1 = True
        log.info("%s: this is a rosbridge server of ROS 1", self._graph.name)
        for part in self._graph.table.parts():
            part.announce_anew(peer)
        for provider in self._graph.calls.providers():
            provider.connected(peer)
