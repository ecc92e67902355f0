"""The graph that several graphs are together: replicas on several machines, asked as one.

What is published goes to the member that the scheduler chooses *here*, at the sender: which one is a variable, so
exactly one gets each message, from the first on, and a change happens between two messages. The others stay connected
and matched. What members publish is taken from the one in use; answers to requests (``Exchange``) from whoever answers
first.
"""

from __future__ import annotations

import asyncio
import functools
import logging
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Mapping
from contextlib import AsyncExitStack
from typing import Any, TypeVar

from ropeway.errors import GraphUnavailable, RopewayError
from ropeway.graph.base import (
    NO_HINTS,
    Delivery,
    Graph,
    GraphEvent,
    NodeInfo,
    Publisher,
    SampleCallback,
    Subscription,
    TopicInfo,
    resolve_name,
)
from ropeway.graph.calls import (
    ActionClient,
    ActionHandlers,
    ActionInfo,
    ActionServer,
    Client,
    Service,
    ServiceHandler,
    ServiceInfo,
)
from ropeway.graph.changes import Changes
from ropeway.graph.graph_base import GraphBase
from ropeway.group.actions import GroupActionClient
from ropeway.group.bound import LatencyBound
from ropeway.group.calls import GroupClient, Ways
from ropeway.group.clock import steady_clock
from ropeway.group.discovery import all_actions, all_services, all_topics
from ropeway.group.hedge import HedgeDelay, Policy
from ropeway.group.offers import GroupActionServer, GroupService
from ropeway.group.pairs import Judge, Pairs
from ropeway.group.part import GroupPart
from ropeway.group.roster import Connecting, Roster
from ropeway.group.scheduler import Options, Scheduler
from ropeway.group.stamp import stamp_reader
from ropeway.group.topics import GroupPublisher, GroupSubscription
from ropeway.qos import DEFAULT, QoS
from ropeway.tasks import Supervised, describe, end
from ropeway.types import TypeRegistry
from ropeway.types.definition import canonical_name

__all__ = ["Group", "Policy"]

log = logging.getLogger("ropeway.group")

T = TypeVar("T")
P = TypeVar("P", bound=GroupPart[Any])

Make = Callable[[str, Graph], Awaitable[Any]]
"""Makes a part on a member."""


class Group(GraphBase):
    """Presents several graphs as one.

    ``members`` has them by the names that they are called by; or ``roster`` finds them as they come and go, and what
    is offered is offered once, on the graph that all of them are found on. ``policy`` says who is asked: ``one`` the
    member that the scheduler chooses by ``bound``; ``hedge`` that one, and the next if its answer takes longer than
    usual; ``all`` every one, and the first answer wins. The last two need ``stateless``: a request may be carried out
    more than once.
    ``exchanges`` pairs topics: ``{"/yolo/input": "/yolo/output"}`` is asked on the first and answered on the second,
    which is how latencies of topics are known. Latencies of services and actions are measured without being asked for.
    ``first`` is asked before anything is known; who is ``barred`` is connected, and asked nothing. ``on_decision`` is
    called after each decision, and when members come and go.
    """

    kind = "group"

    def __init__(
        self,
        members: Mapping[str, Graph],
        *,
        roster: Roster | None = None,
        name: str = "group",
        policy: Policy = Policy.ONE,
        bound: LatencyBound = LatencyBound(),  # noqa: B008 - frozen
        stateless: bool = False,
        exchanges: Mapping[str, str] | None = None,
        registry: TypeRegistry | None = None,
        first: str = "",
        barred: Collection[str] = (),
        options: Options = Options(),  # noqa: B008 - frozen
    ) -> None:
        if not members and roster is None:
            raise ValueError("a group has one member at least")
        if policy is not Policy.ONE and not stateless:
            raise ValueError(
                f'policy "{policy.value}" asks several members, so a request may be carried out more than once; write '
                '"stateless": true if that does no harm'
            )
        super().__init__(name)
        self.members = dict(members)
        self.policy, self.stateless = policy, stateless
        self.scheduler = Scheduler(list(members), bound, stateless=stateless, first=first, options=options)
        self.registry = registry or TypeRegistry()
        self.publisher_class = GroupPublisher
        self.on_decision: Callable[[], None] = lambda: None
        self._barred = frozenset(barred)
        self._there: set[str] = set()
        self._delay = HedgeDelay(self.scheduler)
        self.now: Callable[[], float] = time.monotonic
        """Returns the time of the steady clock that latencies are measured with."""
        self._limit_s = bound.limit_s
        self._several = policy is not Policy.ONE or (stateless and self._limit_s is not None)
        self.pairs = Pairs(self.scheduler, exchanges or {})
        self._watchers: list[Supervised] = []
        self._stack = AsyncExitStack()
        self._roster = roster
        self._parts: dict[GroupPart[Any], Make] = {}
        self._wants: dict[object, Callable[[], None]] = {}
        self._changing = asyncio.Lock()  # of members and parts, one at a time
        self._told = 0
        self._open = False
        self._opened: dict[str, Graph] = {}

    # ── opening, members, closing ──────────────────────────────────────────────────────────────────────────────

    async def open(self) -> None:
        """Open every member. Raises ``GraphUnavailable`` if none can be opened; of others the log tells why."""
        if self._open:
            return
        self.now = steady_clock(asyncio.get_running_loop())
        self._changes = Changes()
        names = list(self.members)
        results = await asyncio.gather(*(self.members[name].open() for name in names), return_exceptions=True)
        failed = {name: r for name, r in zip(names, results, strict=True) if isinstance(r, BaseException)}
        for name, error in failed.items():
            if not isinstance(error, RopewayError):
                raise error
            log.warning("%s: member %s cannot be reached: %s", self.name, name, error)
        if names and len(failed) == len(names):
            raise GraphUnavailable(self.name, "; ".join(map(describe, failed.values())))
        self._open = True
        for name in names:
            if name in failed:
                continue
            self._stack.push_async_callback(self.members[name].close)
            self._listen(name, self.members[name])
            await self._join(name, self.members[name])
        if self._roster is not None:
            roster = self._roster
            await roster.open()
            self._stack.push_async_callback(roster.close)
            self._listen("all", roster.common)
            self._watchers.append(Supervised(lambda: self._follow(roster), f"members of {self.name}").start())

    async def close(self) -> None:
        """Leave every member with everything that was created here."""
        if not self._open:
            return
        self._open = False
        await end(*self._watchers)
        self._watchers.clear()
        for part in list(self._parts):
            await part.close()
        if self._roster is not None:
            for name in list(self._opened):
                await self._part_from(name)
        await self._stack.aclose()
        self._opened.clear()
        self._changes.close()

    def _listen(self, name: str, graph: Graph) -> None:
        watch = functools.partial(self._watch, graph.changes())
        self._watchers.append(Supervised(watch, f"changes of {name} in {self.name}").start())

    async def _follow(self, roster: Roster) -> None:
        """Join members that come, and part from those that leave."""
        while True:
            members = dict(roster.members())
            for name in [name for name, graph in self._opened.items() if members.get(name) is not graph]:
                await self._part_from(name)
            for name, graph in members.items():
                if name not in self._opened:
                    await graph.open()
                    await self._join(name, graph)
            if dict(roster.members()) == members:
                await roster.changed.wait()

    async def _join(self, name: str, graph: Graph) -> None:
        """Make every part on a member, then use it when it is reached."""
        async with self._changing:
            self.scheduler.add(name)
            self._opened[name] = graph
            for part, make in list(self._parts.items()):
                part.add(name, await make(name, graph))
        if isinstance(graph, Connecting):
            graph.on_reached(functools.partial(self._reached, name))
        else:
            self._reached(name, True)

    async def _part_from(self, name: str) -> None:
        """Use a member no longer."""
        self._reached(name, False)
        async with self._changing:
            graph = self._opened.pop(name)
            for part in list(self._parts):
                await part.remove(name)
        await graph.close()

    def _reached(self, name: str, reached: bool) -> None:
        if name not in self._opened:
            return
        (self._there.add if reached else self._there.discard)(name)
        if reached and name not in self._barred:
            self.scheduler.came(name, self.now())
        else:
            self.scheduler.left(name, self.now())
            self.pairs.forget(name)
        self.tell()
        self.on_decision()

    def reached(self) -> dict[str, Graph]:
        """Return the members that are there, by name; also those that are asked nothing."""
        return {name: graph for name, graph in self._opened.items() if name in self._there}

    async def announce_anew(self, topics: Collection[str]) -> None:
        """Publish these topics of the members anew, as what is known of them there has changed."""
        async with self._changing:
            for part in [p for p in self._parts if isinstance(p, GroupPublisher) and p.topic in topics]:
                for name in part.on:
                    await part.replace(name, await self._parts[part](name, self._opened[name]))

    async def _watch(self, changes: AsyncIterator[GraphEvent]) -> None:
        async for event in changes:
            self._changes.emit(event)

    def tell(self) -> None:
        """Log what the scheduler has decided since the last time."""
        new = self.scheduler.decided - self._told
        if not new:
            return
        self._told = self.scheduler.decided
        for decision in list(self.scheduler.decisions)[-new:]:
            log.info("%s: %s", self.name, decision)
        self.on_decision()

    def status(self) -> dict[str, Any]:
        """Return the group as it stands, as JSON."""
        return {
            "policy": self.policy.value,
            **self.scheduler.status(self.now()),
            "paired": self.pairs.status(),
            "drops": {f"{topic}: {why.value}": n for (topic, why), n in self.drops.items() if n},
        }

    # ── who is asked ───────────────────────────────────────────────────────────────────────────────────────────

    def alone(self, now_s: float) -> str:
        """Return the member that gets the next request alone; ``""`` where something is to be decided first."""
        return "" if self._several else self.scheduler.alone(now_s)

    def targets(self) -> tuple[str, ...]:
        """Return the members that get the next request at once."""
        if self.policy is Policy.ALL:
            return tuple(self.scheduler.here)
        found = self.scheduler.targets(self.now())
        if self.scheduler.decided != self._told:
            self.tell()
        return found

    def ranked(self) -> list[str]:
        """Return the members that are there, the one in use first, then the most promising."""
        return self.scheduler.ranked(self.now())

    def second(self) -> str:
        """Return who is asked next if the first is late, ``""`` for nobody.

        That is the rule of ``hedge``; with ``one`` it is so where a bound says what is late, and twice does no harm.
        """
        if self.policy is Policy.ALL or not self._several:
            return ""
        ranked = self.scheduler.ranked(self.now())
        return ranked[1] if len(ranked) > 1 else ""

    def hedge_after_s(self) -> float:
        """Return how long the first has before the second is asked, too."""
        limit_s = self._limit_s
        return limit_s if self.policy is Policy.ONE and limit_s is not None else self._delay.seconds(self.now())

    # ── parts ──────────────────────────────────────────────────────────────────────────────────────────────────

    async def create_publisher(
        self, topic: str, type: str, qos: QoS | None = None, *, delivery: Delivery = NO_HINTS
    ) -> GroupPublisher:
        """See ``Graph.create_publisher``: it is announced to every member, and each message goes where it is due."""
        name = resolve_name(topic)
        exchange = self.pairs.asked_on(name)
        stamp = stamp_reader(self.registry, type) if exchange is not None else None

        async def make(_: str, graph: Graph) -> Publisher:
            return await graph.create_publisher(topic, type, qos, delivery=delivery)

        return await self._create(
            make,
            lambda parts: self.publisher_class(
                self, name, canonical_name(type, "msg"), qos or DEFAULT, parts, exchange, stamp
            ),
            ("publisher", topic, type, delivery),
        )

    async def create_subscription(
        self,
        topic: str,
        type: str,
        qos: QoS | None,
        callback: SampleCallback,
        *,
        delivery: Delivery = NO_HINTS,
    ) -> GroupSubscription:
        """See ``Graph.create_subscription``: every member is read, and what counts is handed on."""
        judge, exchange = self._judge(name := resolve_name(topic), type, qos), self.pairs.answered_on(name)
        made = GroupSubscription(self, name, canonical_name(type, "msg"), callback, judge, exchange)

        async def make(name: str, graph: Graph) -> Subscription:
            arrived = functools.partial(made.arrived, name)
            return await graph.create_subscription(topic, type, qos, arrived, delivery=delivery)

        def join(parts: Mapping[str, Subscription]) -> GroupSubscription:
            for member, part in parts.items():
                made.add(member, part)
            return made

        return await self._create(make, join, ("subscription", topic, type, delivery))

    def _judge(self, topic: str, type: str, qos: QoS | None) -> Judge:
        """Return what says which messages of a topic count."""
        return self.pairs.judge(topic, stamp_reader(self.registry, type))

    async def create_client(self, service: str, type: str, *, delivery: Delivery = NO_HINTS) -> GroupClient:
        """See ``Graph.create_client``."""

        async def make(_: str, graph: Graph) -> Client:
            return await graph.create_client(service, type, delivery=delivery)

        ways = Ways(self, resolve_name(service))
        return await self._create(
            make,
            lambda parts: GroupClient(ways, canonical_name(type, "srv"), parts),
            ("client", service, type, delivery),
        )

    async def create_service(
        self, service: str, type: str, handler: ServiceHandler, *, delivery: Delivery = NO_HINTS
    ) -> Service:
        """See ``Graph.create_service``: it is served to every member."""
        if self._roster is not None:
            return await self._roster.common.create_service(service, type, handler, delivery=delivery)

        async def make(_: str, graph: Graph) -> Service:
            return await graph.create_service(service, type, handler, delivery=delivery)

        return await self._create(
            make, lambda parts: GroupService(self, resolve_name(service), next(iter(parts.values())).type, parts)
        )

    async def create_action_client(self, action: str, type: str, *, delivery: Delivery = NO_HINTS) -> GroupActionClient:
        """See ``Graph.create_action_client``: a goal stays with the member that accepted it."""

        async def make(_: str, graph: Graph) -> ActionClient:
            return await graph.create_action_client(action, type, delivery=delivery)

        ways = Ways(self, resolve_name(action), "action")
        return await self._create(
            make,
            lambda parts: GroupActionClient(ways, canonical_name(type, "action"), parts),
            ("action", action, type, delivery),
        )

    async def create_action_server(
        self, action: str, type: str, handlers: ActionHandlers, *, delivery: Delivery = NO_HINTS
    ) -> ActionServer:
        """See ``Graph.create_action_server``: it is served to every member."""
        if self._roster is not None:
            return await self._roster.common.create_action_server(action, type, handlers, delivery=delivery)

        async def make(_: str, graph: Graph) -> ActionServer:
            return await graph.create_action_server(action, type, handlers, delivery=delivery)

        return await self._create(
            make, lambda parts: GroupActionServer(self, resolve_name(action), next(iter(parts.values())).type, parts)
        )

    async def _create(
        self, make: Make, join: Callable[[Mapping[str, Any]], P], wanted: tuple[str, str, str, Delivery] | None = None
    ) -> P:
        """Make a part on every member, and one of them; what was made is closed again if one cannot be."""
        if not self._open:
            raise GraphUnavailable(self.name, "is not open; call open() first")
        made: dict[str, Any] = {}
        async with self._changing:
            try:
                for name, graph in self._opened.items():
                    made[name] = await make(name, graph)
            except BaseException:
                for one in made.values():
                    await one.close()
                raise
            part = join(made)
            self._parts[part] = make
        if self._roster is not None and wanted is not None:
            self._wants[part] = self._roster.want(*wanted)
        return part

    def closed(self, part: object) -> None:
        """Forget a part that was closed."""
        self._parts.pop(part, None)  # type: ignore[call-overload]
        if (end_want := self._wants.pop(part, None)) is not None:
            end_want()

    # ── discovery ──────────────────────────────────────────────────────────────────────────────────────────────

    def _looked_at(self) -> list[Graph]:
        return list(self._opened.values()) if self._roster is None else [self._roster.common]

    def topics(self) -> dict[str, TopicInfo]:
        """Return what is discovered on any member."""
        return all_topics(self._looked_at())

    def services(self) -> dict[str, ServiceInfo]:
        """Return what is served on any member."""
        return all_services(self._looked_at())

    def actions(self) -> dict[str, ActionInfo]:
        """Return the actions of any member."""
        return all_actions(self._looked_at())

    def nodes(self) -> dict[str, NodeInfo]:
        """Return the nodes of every member; one that is on several is told of once."""
        return {name: info for graph in self._looked_at() for name, info in graph.nodes().items()}
