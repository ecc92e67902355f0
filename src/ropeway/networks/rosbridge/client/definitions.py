"""Asks a rosbridge server, or a gateway, for the definitions of types that are not known here, through its rosapi."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING, Final, Protocol

from ropeway.errors import RopewayError
from ropeway.limits import DEFINITIONS_ASKED
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY
from ropeway.types import described, typedef
from ropeway.types.described import DESCRIPTION_SERVICE
from ropeway.types.told_types import DefinitionTeller

if TYPE_CHECKING:
    from ropeway.networks.rosbridge.client.calls import Calls
    from ropeway.networks.rosbridge.client.topic_table import TopicTable
    from ropeway.networks.rosbridge.link.peer import Peer
    from ropeway.types import TypeRegistry

__all__ = ["RemoteDefinitions"]

log = logging.getLogger("ropeway.rosbridge")

_LOOK_S: Final = 1.0
_RETRY_S: Final = 3.0  # the server may have learnt it meanwhile
_DETAILS: Final = {
    "msg": ("message_details",),
    "srv": ("service_request_details", "service_response_details"),
    "action": ("action_goal_details", "action_result_details", "action_feedback_details"),
}


class AskingGraph(Protocol):
    """A graph behind a link, as its definitions see it."""

    name: str
    registry: TypeRegistry
    peer: Peer | None
    calls: Calls
    table: TopicTable


class RemoteDefinitions(DefinitionTeller):
    """The definitions that the server at the other end of a link told."""

    def __init__(self, graph: AskingGraph) -> None:
        super().__init__(graph.registry, graph=True)
        self._graph, self._types = graph, graph.registry
        self._refused: dict[str, float] = {}  # until when a type is not asked for again

    async def learn(self, type: str) -> bool:
        """See ``Learning.learn``."""
        now = asyncio.get_running_loop().time()
        if self._types.has(type) or self._refused.get(type, now) > now:
            return self._types.has(type)
        try:
            self.tell(type, await (self._described(type) if self._is_gateway else self._detailed(type)))
        except RopewayError as error:
            if len(self._refused) >= DEFINITIONS_ASKED:
                self._refused.clear()
            self._refused[type] = now + _RETRY_S
            log.debug("%s: it does not tell what %s is: %s", self._graph.name, type, error)
        return self._types.has(type)

    @property
    def _is_gateway(self) -> bool:
        peer = self._graph.peer
        return peer is not None and peer.dialect is ROPEWAY

    async def _described(self, type: str) -> str:
        asked = {"type_name": type, "type_hash": "", "include_type_sources": True}
        return described.full_text_of(type, await self._graph.calls.plain(f"/rosapi/{DESCRIPTION_SERVICE}", asked))

    async def _detailed(self, type: str) -> str:
        """Return the definition as rosbridge tells it: without constants and bounds."""
        parts = [
            (await self._graph.calls.plain(f"/rosapi/{service}", {"type": type})).get("typedefs", ())
            for service in _DETAILS[type.split("/")[1]]
        ]
        return typedef.full_text_of(type, parts)

    async def follow(self) -> None:
        """Ask for the type of each topic of the link that is not known, until the server can tell it."""
        self._refused.clear()
        while True:
            for type in {part.type for part in self._graph.table.parts()}:
                await self.learn(type)
            await asyncio.sleep(_LOOK_S)
