"""The WebSocket subprotocols that are served, and who serves those of others on the port of a server."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, Protocol

if TYPE_CHECKING:
    from ropeway.listener.connection import Connection

__all__ = ["FOXGLOVE_SUBPROTOCOLS", "GATEWAY_SUBPROTOCOLS", "PLAIN_SUBPROTOCOL", "ROPEWAY_SUBPROTOCOL", "Guests"]

ROPEWAY_SUBPROTOCOL: Final = "ropeway.1"
"""Names what Ropeway gateways speak with each other."""

PLAIN_SUBPROTOCOL: Final = "rosbridge"
"""A browser that sends its token as a subprotocol may offer this one, too, to be answered without the token."""

GATEWAY_SUBPROTOCOLS: Final = (ROPEWAY_SUBPROTOCOL, PLAIN_SUBPROTOCOL)
"""The subprotocols of a server of gateways and rosbridge clients; the first that a client offers is chosen."""

FOXGLOVE_SUBPROTOCOLS: Final = ("foxglove.sdk.v1", "foxglove.websocket.v1")
"""The subprotocols of Foxglove's viewers: of today, and before. They differ in nothing that is used here."""


class Guests(Protocol):
    """Serves the clients of other subprotocols on the port of a server, which has let them in."""

    @property
    def subprotocols(self) -> Sequence[str]:
        """The subprotocols of its clients."""
        ...

    def __len__(self) -> int:
        """Return how many clients there are."""
        ...

    def welcome(self, connection: Connection) -> None:
        """Take over the connection of a client; its role is ``connection.grant``."""
        ...
