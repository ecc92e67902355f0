"""Say what the parts of a ``rosbridge`` graph may know of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from ropeway.graph.host import Host

if TYPE_CHECKING:
    from ropeway.graph.layout_border import Border
    from ropeway.networks.rosbridge.client.echoes import EchoFilter
    from ropeway.networks.rosbridge.client.mirror import RemoteMirror
    from ropeway.networks.rosbridge.client.plain_servers import PlainServer
    from ropeway.networks.rosbridge.client.ros1_spelling import Spelling
    from ropeway.networks.rosbridge.link.peer import Peer
    from ropeway.types import TypeRegistry
    from ropeway.types.told_types import DefinitionTeller

__all__ = ["LinkGraph", "LinkTopics"]


class LinkTopics(Protocol):
    """The topics of a link, as one of them sees the others; ``TopicTable`` has them."""

    echoes: dict[str, EchoFilter]

    def next_number(self) -> int:
        """Return a channel number that is free."""
        ...

    def forget(self, number: int, topic: str) -> None:
        """Remove a topic that was closed."""
        ...


class LinkGraph(Host, Protocol):
    """The graph behind a link, as all of its parts see it."""

    peer: Peer | None
    registry: TypeRegistry
    border: Border
    gateway_id: str
    mirror: RemoteMirror
    plain_server: PlainServer
    spelling: Spelling
    one_of_several: bool
    """Whether other links lead to the same gateway: what they have just brought of a topic comes again by this one."""

    @property
    def teller(self) -> DefinitionTeller:
        """The teller of the far side's definitions."""
        ...

    @property
    def table(self) -> LinkTopics:
        """The topics of the link."""
        ...

    @property
    def last_error(self) -> str:
        """Return why the last try to connect failed, ``""`` while connected."""
        ...

    def type_note(self, type: str) -> dict[str, Any]:
        """Return what a gateway should know of a type: its hash, and once per connection its definition."""
        ...
