"""Does what is due again and again on a connection: measures a gateway's clock, asks a plain server for its topics."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING, Final, Protocol

from ropeway.errors import GraphUnavailable
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY

if TYPE_CHECKING:
    from ropeway.networks.rosbridge.client.calls import Calls
    from ropeway.networks.rosbridge.client.mirror import RemoteMirror
    from ropeway.networks.rosbridge.client.ros1_spelling import Spelling
    from ropeway.networks.rosbridge.link.peer import Peer

__all__ = ["LinkChores"]

log = logging.getLogger("ropeway.rosbridge")

_CLOCK_S: Final = 1.0
_ROSAPI_S: Final = 3.0


class ChoresHost(Protocol):
    """The graph behind a link, as its chores see it."""

    name: str
    calls: Calls
    mirror: RemoteMirror
    spelling: Spelling


class LinkChores:
    """The chores on the connections of ``graph``. ``asks`` tells whether a plain server is asked what it has.

    ``error`` says why the last question had no answer, ``""`` where it had one. ``wants_calls`` is set once somebody
    wants to know the services and actions, too.
    """

    def __init__(self, graph: ChoresHost, *, asks: bool) -> None:
        self.error = ""
        self.wants_calls = False
        self._graph, self._asks = graph, asks

    async def run(self, peer: Peer) -> None:
        """Do the chores on the connection to ``peer``."""
        graph = self._graph
        while True:
            if peer.dialect is ROPEWAY:
                peer.ping()
                await asyncio.sleep(_CLOCK_S)
            elif self._asks:
                await self._ask(peer)
                await asyncio.sleep(_ROSAPI_S)
            else:
                graph.mirror.filled.set()  # nobody will tell
                await graph.spelling.find_out(peer)
                return

    async def _ask(self, peer: Peer) -> None:
        graph = self._graph
        try:
            await graph.mirror.ask_rosapi(graph.calls.plain)
            graph.spelling.seen(peer, [info.type for info in graph.mirror.topics.values()])
            if self.wants_calls:
                await graph.mirror.ask_calls(graph.calls.plain)
            self.error = ""
        except GraphUnavailable as error:
            self.error = f"it does not answer what is asked of rosapi: {error.reason}"
            log.debug("%s: %s", graph.name, self.error)
            graph.mirror.filled.set()
