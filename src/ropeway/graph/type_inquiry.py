"""Asks nodes for the definitions of types that nobody here has, as nodes of ROS 2 since Iron tell them.

Discovery tells the hash of each type, and the node that has it under this hash answers with its fields, so that a
message of a robot's own package is read without any file.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import AsyncExitStack
from typing import Final, Protocol, runtime_checkable

from ropeway.errors import RopewayError
from ropeway.graph.base import Graph, GraphEvent, TopicInfo
from ropeway.graph.calls import ActionInfo, Request, ServiceInfo
from ropeway.limits import DEFINITIONS_ASKED, DESCRIPTION_TRIES
from ropeway.tasks import Supervised, end
from ropeway.types import TypeRegistry
from ropeway.types.described import DESCRIPTION_SERVICE, DESCRIPTION_TYPE, full_text_of
from ropeway.types.told_types import DefinitionTeller

__all__ = ["Learning", "TypeInquiry", "learn"]

log = logging.getLogger("ropeway.types")

_SETTLE_S: Final = 1.0  # a tool that only looks around has left by then, and discovery knows the node's services
_ANSWER_S: Final = 3.0
_KINDS: Final = {"msg": "topic", "srv": "service", "action": "action"}


@runtime_checkable
class Learning(Protocol):
    """A graph that can ask its network for definitions."""

    async def learn(self, type: str) -> bool:
        """Ask for the definition of a type that is not known here; return whether it is known now."""
        ...


async def learn(type: str, *graphs: object) -> bool:
    """Ask one graph after the other for a definition; return whether it is known now."""
    for graph in graphs:
        if isinstance(graph, Learning) and await graph.learn(type):
            return True
    return False


class TypeInquiry:
    """Asks for the types that are discovered on ``graph`` and not known in ``registry``.

    It asks at once when somebody needs one, and else in the background.
    """

    def __init__(self, graph: Graph, registry: TypeRegistry) -> None:
        self._graph, self._registry = graph, registry
        self._teller = DefinitionTeller(registry, graph=True)
        self._turn = asyncio.Lock()
        self._tries: dict[tuple[str, str, str], int] = {}  # by type, hash and node
        self._lacking: dict[str, str] = {}  # types, and under which name each was discovered
        self._missed: dict[str, str] = {}  # likewise, asked for in vain until somebody comes who may tell
        self._found = asyncio.Event()
        self._work: tuple[Supervised, ...] = ()

    def start(self) -> None:
        """Look at what is discovered from now on."""
        changes, name = self._graph.changes(), self._graph.name
        self._work = (
            Supervised(lambda: self._watch(changes), f"types on {name}").start(),
            Supervised(self._ask_all, f"definitions from {name}").start(),
        )

    async def close(self) -> None:
        """Stop asking, and forget what was told."""
        await end(*self._work)
        self._teller.leave()

    async def learn(self, type: str, name: str = "") -> bool:
        """See ``Learning.learn``; ``name`` is that of a topic, service or action that has the type."""
        if type not in self._missed and self._lacks(type):
            async with self._turn:
                for hash, node in dict.fromkeys(self._owners(type, name)):
                    if await self._ask(type, hash, node):
                        return True
            if len(self._missed) >= DEFINITIONS_ASKED:
                self._missed.clear()
            self._missed[type] = name
        return self._registry.has(type)

    async def _watch(self, changes: AsyncIterator[GraphEvent]) -> None:
        async for event in changes:
            if event.kind == "node" and not event.discovered:
                for key in [key for key in self._tries if key[2] == event.name]:
                    del self._tries[key]
            elif event.discovered and (event.kind == "node" or event.type == DESCRIPTION_TYPE):
                self._queue({type: name for type, name in self._missed.items() if name})
                self._missed.clear()
            elif event.discovered and event.type and self._lacks(event.type):
                self._missed.pop(event.type, None)
                self._queue({event.type: event.name})

    def _queue(self, types: Mapping[str, str]) -> None:
        if types and len(self._lacking) < DEFINITIONS_ASKED:
            self._lacking.update(types)
            self._found.set()

    async def _ask_all(self) -> None:
        while True:
            await self._found.wait()
            await asyncio.sleep(_SETTLE_S)
            self._found.clear()
            while self._lacking:
                await self.learn(*self._lacking.popitem())

    def _lacks(self, type: str) -> bool:
        """Return whether a node may know more of a type than we do; what is bundled is only a guess."""
        return not self._registry.has(type) or self._registry.is_guess(type)

    def _owners(self, type: str, name: str) -> Iterator[tuple[str, str]]:
        """Yield the hashes under which nodes have a type, and the nodes.

        Of services and actions discovery tells the hashes of their parts, and nodes answer for that of the whole alone:
        only gateways, which need none, are asked. Nor is one told where those who publish do not know the type.
        """
        kind = _KINDS[type.split("/")[1]]
        for info in [self._graph.look_up(kind, name)] if name else self._all(kind):
            if isinstance(info, TopicInfo):
                for end in (*info.publishers, *info.subscriptions):
                    tells = end.type == type and not end.local and (end.type_hash or end.gateway)
                    if tells and self._is_new(type, end.type_hash):
                        yield end.type_hash, end.node
            elif info is not None and type in info.types and not self._registry.has(type):
                for provider in (*info.servers, *info.clients):
                    if provider.gateway and not provider.local:
                        yield "", provider.node

    def _all(self, kind: str) -> list[TopicInfo | ServiceInfo | ActionInfo]:
        if kind == "topic":
            return [*self._graph.topics().values()]
        return [*(self._graph.services() if kind == "service" else self._graph.actions()).values()]

    def _is_new(self, type: str, hash: str) -> bool:
        registry = self._registry
        if not registry.has(type):
            return True
        return bool(hash) and (registry.others is None or registry.others.by_hash(type, hash) is None)

    async def _ask(self, type: str, hash: str, node: str) -> bool:
        """Ask a node; return whether it told what is of use."""
        key = (type, hash, node)
        service = f"{node}/{DESCRIPTION_SERVICE}"
        tries = self._tries.get(key, 0)
        if not node or tries >= DESCRIPTION_TRIES or DESCRIPTION_TYPE not in self._graph.types_of("service", service):
            return False
        if len(self._tries) >= DEFINITIONS_ASKED:
            self._tries.clear()
        self._tries[key] = tries + 1
        ask, read = (self._registry.codec(f"{DESCRIPTION_TYPE}_{end}") for end in ("Request", "Response"))
        request = {"type_name": type, "type_hash": hash, "include_type_sources": True}
        try:
            async with AsyncExitStack() as stack:
                client = await self._graph.create_client(service, DESCRIPTION_TYPE)
                stack.push_async_callback(client.close)
                await client.wait_available(_ANSWER_S)
                answer = await client.call(Request(ask.encode(request), timeout_s=_ANSWER_S), _ANSWER_S)
            self._teller.tell(type, full_text_of(type, read.decode(answer), hash))
        except RopewayError as error:
            log.debug("%s: %s does not tell what %s is: %s", self._graph.name, node, type, error)
            return False
        log.info("%s: %s told what %s is", self._graph.name, node, type)
        return True
