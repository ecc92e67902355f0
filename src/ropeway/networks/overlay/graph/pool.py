"""Finds the gateways of the overlay that offer the same, and makes each a member of a group."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Final

from ropeway.graph.actions import service_of_action
from ropeway.graph.base import Delivery, Graph
from ropeway.graph.signal import Signal
from ropeway.limits import OVERLAY_POOL_GATEWAYS
from ropeway.networks.overlay.advert import Advertisement
from ropeway.networks.overlay.graph.graph import OverlayGraph
from ropeway.networks.overlay.graph.member import MemberGraph
from ropeway.tasks import Supervised, end
from ropeway.types.definition import canonical_name

__all__ = ["OverlayPool"]

_OTHER_SIDE: Final = {
    "publisher": "subscription",
    "subscription": "publisher",
    "client": "service",
    "action": "service",
}

Wanted = tuple[bytes, str]
"""A global name, and the kind of what is looked for under it."""


class OverlayPool:
    """The gateways that offer what a group asks for, found on the graph ``common``: a roster of the group.

    A gateway counts if a pattern of ``members`` fits the name in its certificate. One that offers at least one of the
    names is a member, kept ready; those are used that offer as many of the names as any. ``answers`` has the topics
    that are answered, each with that on which the answers come.
    """

    def __init__(
        self, common: OverlayGraph, members: Sequence[str] = ("*",), answers: Mapping[str, str] | None = None
    ) -> None:
        self.common: Graph = common
        self.changed = Signal()
        self._graph, self._patterns, self.answers = common, tuple(members), dict(answers or {})
        self._wanted: Counter[Wanted] = Counter()
        self._members: dict[bytes, MemberGraph] = {}
        self._stop: Callable[[], None] | None = None
        self._watching: Supervised | None = None
        self._stale = False

    async def open(self) -> None:
        """See ``Roster``."""
        await self._graph.open()
        self._stop = self._graph.node.rib.on_change(self._told)
        self._watching = Supervised(self._watch, f"members of {self._graph.name}").start()

    async def close(self) -> None:
        """See ``Roster``."""
        await end(self._watching)
        if self._stop is not None:
            self._stop()
        self._members.clear()
        await self._graph.close()

    def want(self, kind: str, name: str, type: str, delivery: Delivery) -> Callable[[], None]:
        """See ``Roster``."""
        other = _OTHER_SIDE[kind]
        if kind == "action":
            name, type = service_of_action(name), f"{canonical_name(type, 'action')}_SendGoal"
        wanted = self._graph.name_of(other, name, type, delivery), other
        self._wanted[wanted] += 1
        self._refresh()

        def end_want() -> None:
            self._wanted[wanted] -= 1
            if not self._wanted[wanted]:
                del self._wanted[wanted]
            self._refresh()

        return end_want

    def members(self) -> Mapping[str, MemberGraph]:
        """See ``Roster``."""
        return {member.name: member for member in self._members.values()}

    async def _watch(self) -> None:
        """Look again at each change of who is there, and while that is in doubt."""
        doubts = self._graph.node.membership.doubts
        while True:
            self._refresh()
            await doubts.wait()

    def _told(self, advert: Advertisement, added: bool) -> None:
        if (advert.global_name, advert.kind) in self._wanted:
            self._refresh()

    def _refresh(self) -> None:
        """Find out who offers what, and who is to be used."""
        offers = self._offers()
        for gateway in self._members.keys() - offers.keys():
            self._members.pop(gateway).set_reached(False)
        for gateway in offers.keys() - self._members.keys():
            if len(self._members) < OVERLAY_POOL_GATEWAYS:
                member = self._members[gateway] = MemberGraph(self._graph, gateway, self._name(gateway))
                member.answers = self.answers
        doubted = self._graph.node.membership.doubted
        there = {gateway for gateway in self._members if not doubted(gateway)}
        most = max((offers[gateway] for gateway in there), default=0)
        for gateway, member in self._members.items():
            member.set_reached(gateway in there and offers[gateway] == most)
        self.changed.notify()

    def _offers(self) -> Counter[bytes]:
        """Return how many of the names that are wanted each gateway has, where any.

        While nothing is wanted, those stay that are there: what paused goes on with them.
        """
        node = self._graph.node
        if not self._wanted:
            return Counter({gateway: 1 for gateway in self._members if node.owner(gateway)})
        found: Counter[bytes] = Counter()
        for name, kind in self._wanted:
            found.update({advert.gateway for advert in node.rib.by_name(name, kind)})
        fits = {gateway: self._fits(node.owner(gateway)) for gateway in found}
        return Counter({gateway: count for gateway, count in found.items() if fits[gateway]})

    def _fits(self, owner: str) -> bool:
        return bool(owner) and any(fnmatchcase(owner, pattern) for pattern in self._patterns)

    def _name(self, gateway: bytes) -> str:
        """Return the name of a member: that in its certificate, with its id where another has the same."""
        owner = self._graph.node.owner(gateway)
        taken = any(member.name == owner for member in self._members.values())
        return f"{owner} {gateway.hex()[:8]}" if taken else owner
