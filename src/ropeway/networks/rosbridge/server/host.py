"""Say what the topics, services and actions of a session may know of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from typing import TYPE_CHECKING, Any, Protocol

from ropeway.networks.rosbridge.protocol import ops

if TYPE_CHECKING:
    from ropeway.graph.base import Sample
    from ropeway.hub.hub import View
    from ropeway.listener.authorization import Access
    from ropeway.listener.turns import Turns
    from ropeway.networks.rosbridge.link.peer import Peer
    from ropeway.networks.rosbridge.server.names import Names
    from ropeway.types import MessageCodec, TypeRegistry

__all__ = ["RosapiAnswers", "SessionHost", "SiblingSession", "TopicsSent"]


class RosapiAnswers(Protocol):
    """Answers the services of rosapi; see ``ropeway.networks.rosbridge.rosapi``."""

    def serves(self, name: str) -> bool:
        """Return whether it answers the service ``name``."""

    def question(self, name: str, args: Any) -> Callable[[], Any]:
        """Return what finds the ``values`` of the response, as JSON has them. Raises ``RopewayError``."""


class TopicsSent(Protocol):
    """Knows what was sent of topics; ``TopicOps`` does so."""

    def just_sent(self, topic: str) -> Sequence[Sample]:
        """Return the last small messages of a topic that the client got."""
        ...


class SiblingSession(Protocol):
    """Serves another link of the same gateway."""

    @property
    def topics(self) -> TopicsSent:
        """Return its topics."""
        ...


class SessionHost(Protocol):
    """Serves one client; ``Session`` does so."""

    registry: TypeRegistry
    gateway_id: str
    access: Access
    rosapi: RosapiAnswers | None
    names: Names
    peer: Peer
    gateway: bool
    view: View
    remote: dict[str, str]
    turns: Turns[Any]
    gone: bool
    """Whether the client has left, so that nothing new begins."""
    codec: Callable[[str], MessageCodec]
    """Returns the codec of messages for this client. Raises ``TypesError``."""
    requests_bytes: int
    """The bytes of the client's requests that are under way."""

    def siblings(self) -> Iterable[SiblingSession]:
        """Yield the other sessions of the gateway that the client is: it has several links to us."""
        ...

    @property
    def is_ros1(self) -> bool:
        """Whether the client gets messages as ROS 1 writes them."""
        ...

    def searching(self, name: str, timeout_s: float) -> AbstractAsyncContextManager[None]:
        """Count a search for a name that nobody is known to serve. Raises ``CallTimeout``."""
        ...

    def complain(self, kind: str, name: str, error: object, id: object = ops.ABSENT) -> None:
        """Count and log something that the client did wrong, and tell it, if it wants to know."""
        ...

    def inform(self, text: str, id: object = ops.ABSENT) -> None:
        """Log something that the client may want to know, and tell it, if it does."""
        ...

    def knows(self, type: str) -> bool:
        """Return whether messages of the type can be decoded."""
        ...

    def learn(self, type: str, extra: Mapping[str, Any] | None) -> None:
        """Take the definition of a type that a gateway sent along. Raises ``RopewayError`` for one that is no good."""
        ...
