"""The topics of IoRT nodes, as a server has them: who publishes and reads what, and the last value of each.

A ``Space`` joins its members: sessions of nodes, and graphs of this process. Every value goes into the store, and to
all who subscribed except the member that published it.
"""

from __future__ import annotations

import itertools
import logging
import re
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import translate
from typing import Any, Final, Protocol

from ropeway.errors import ValueRefused
from ropeway.limits import BROUGHT_TOPICS_PER_NODE, ENDPOINTS_PER_NODE, PATTERN_CHARACTERS, PATTERNS_PER_NODE
from ropeway.store import Entry, Key, Sink, Store

__all__ = ["Member", "MemberEndpoint", "Space", "is_pattern"]

log = logging.getLogger("ropeway.iort")

_KNOWN_LIMIT: Final = 4096  # topics for which is known which patterns fit
_AHEAD_US: Final = 5_000_000  # a live version further in the future than this is a wrong clock's


@dataclass(frozen=True, slots=True)
class MemberEndpoint:
    """A publisher or a subscription of a member. ``qos`` is JSON as in rosbridge's ``qos`` object, or empty."""

    kind: str  # "publisher" or "subscription"
    system: str
    topic: str
    type: str = ""
    qos: str = ""
    node: str = ""
    id: str = ""


class Member(Protocol):
    """A member of a space."""

    node: str
    """How others see it."""

    def value(self, entry: Entry, latest: bool) -> None:
        """Take a value of a subscribed topic; ``latest`` is true for one that was there before."""

    def event(self, endpoint: MemberEndpoint, there: bool) -> None:
        """Take the news that an endpoint came or went; only for members that watch."""


class _Presence:
    """Holds what one member has in the space."""

    __slots__ = ("endpoints", "id", "watches")

    def __init__(self, id: str) -> None:
        self.id = id
        self.endpoints: dict[tuple[str, str, str], MemberEndpoint] = {}
        self.watches = False


class _Pattern:
    """A subscription with wildcards, and who made it."""

    __slots__ = ("_system", "_topic", "members")

    def __init__(self, system: str, topic: str) -> None:
        self._system, self._topic = re.compile(translate(system)), re.compile(translate(topic))
        self.members: dict[Member, None] = {}

    def fits(self, system: str, topic: str) -> bool:
        """Return whether the topic is one of those that are meant."""
        return self._system.match(system) is not None and self._topic.match(topic) is not None


def is_pattern(name: str) -> bool:
    """Return whether ``name`` contains ``*`` or another wildcard."""
    return "*" in name or "?" in name or "[" in name


class Space:
    """Holds all systems and topics of one server, over an opened store."""

    def __init__(self, store: Store) -> None:
        self.store = store
        self.refused: Counter[str] = Counter()
        self.published = 0
        self._members: dict[Member, _Presence] = {}
        self._exact: dict[Key, tuple[Member, ...]] = {}  # most topics have one reader, if any
        self._patterns: dict[tuple[str, str], _Pattern] = {}
        self._fitting: dict[Key, list[_Pattern]] = {}  # by topic: the patterns that fit, as far as was looked
        self._publisher: Member | None = None
        self._numbers = itertools.count(1)
        store.on_change.append(self._changed)

    def close(self) -> None:
        """Stop following the store."""
        if self._changed in self.store.on_change:
            self.store.on_change.remove(self._changed)

    # ── members ────────────────────────────────────────────────────────────────────────────────────────────────

    def join(self, member: Member) -> str:
        """Add a member and return the id of its endpoints."""
        presence = self._members[member] = _Presence(f"{next(self._numbers):x}")
        return presence.id

    def leave(self, member: Member) -> None:
        """Remove a member with everything that belongs to it."""
        presence = self._members.pop(member, None)
        if presence is None:
            return
        for endpoint in list(presence.endpoints.values()):
            self._take_away(member, presence, endpoint)

    def endpoints(self) -> Iterator[tuple[Member, MemberEndpoint]]:
        """Yield every endpoint of every member."""
        for member, presence in self._members.items():
            for endpoint in presence.endpoints.values():
                yield member, endpoint

    def watch(self, member: Member) -> None:
        """Tell the member of all endpoints of others, and of each that comes and goes."""
        presence = self._members[member]
        presence.watches = True
        for other, endpoint in list(self.endpoints()):
            if other is not member:
                member.event(endpoint, True)

    def advertise(self, member: Member, system: str, topic: str, type: str = "", qos: str = "") -> None:
        """Note that the member publishes a topic. Raises ``ValueRefused`` above the limit of endpoints."""
        self._add(member, MemberEndpoint("publisher", system, topic, type, qos, member.node, self._members[member].id))

    def withdraw(self, member: Member, system: str, topic: str) -> None:
        """Note that the member publishes a topic no longer."""
        presence = self._members[member]
        endpoint = presence.endpoints.get(("publisher", system, topic))
        if endpoint is not None:
            self._take_away(member, presence, endpoint)

    def subscribe(
        self, member: Member, system: str, topic: str, *, latest: bool = True, type: str = "", qos: str = ""
    ) -> None:
        """Give the member every value that others publish; ``latest``: first those that are there now.

        Names may be patterns of a shell. Raises ``ValueRefused`` above the limits of endpoints and patterns.
        """
        self.check_subscription(member, system, topic)
        id = self._members[member].id
        self._add(member, MemberEndpoint("subscription", system, topic, type, qos, member.node, id))
        if is_pattern(system) or is_pattern(topic):
            if (system, topic) not in self._patterns:
                self._patterns[system, topic] = _Pattern(system, topic)
                self._fitting.clear()
            self._patterns[system, topic].members[member] = None
        elif member not in (readers := self._exact.get((system, topic), ())):
            self._exact[system, topic] = (*readers, member)
        if latest:
            for entry in self.store.entries(system, topic):
                member.value(entry, True)

    def unsubscribe(self, member: Member, system: str, topic: str) -> None:
        """Stop giving the member a topic (or pattern)."""
        presence = self._members[member]
        endpoint = presence.endpoints.get(("subscription", system, topic))
        if endpoint is not None:
            self._take_away(member, presence, endpoint)

    def check_subscription(self, member: Member, system: str, topic: str) -> None:
        """Raise ``ValueRefused`` where the member may have no more subscriptions of this kind."""
        mine = self._members[member].endpoints
        if ("subscription", system, topic) in mine:
            return
        text = ""
        if len(mine) >= ENDPOINTS_PER_NODE:
            text = f"a node has {ENDPOINTS_PER_NODE} topics at most, and no more"
        elif not (is_pattern(system) or is_pattern(topic)):
            return
        elif max(len(system), len(topic)) > PATTERN_CHARACTERS:
            text = f"a pattern has {PATTERN_CHARACTERS} characters at most"
        elif (
            sum(kind == "subscription" and (is_pattern(s) or is_pattern(t)) for kind, s, t in mine) >= PATTERNS_PER_NODE
        ):
            text = f"a node has {PATTERNS_PER_NODE} patterns at most, and no more"
        if text:
            self.refused["full"] += 1
            raise ValueRefused(system[:40], topic[:40], "full", text)

    def _add(self, member: Member, endpoint: MemberEndpoint) -> None:
        presence = self._members[member]
        key = (endpoint.kind, endpoint.system, endpoint.topic)
        before = presence.endpoints.get(key)
        if before == endpoint:
            return
        if before is None:
            self._check_room(presence, endpoint.system, endpoint.topic, ENDPOINTS_PER_NODE)
        else:
            self._tell(member, before, False)
        self._set(member, presence, endpoint)

    def _set(self, member: Member, presence: _Presence, endpoint: MemberEndpoint) -> None:
        presence.endpoints[endpoint.kind, endpoint.system, endpoint.topic] = endpoint
        self._tell(member, endpoint, True)

    def _check_room(self, presence: _Presence, system: str, topic: str, most: int) -> None:
        if len(presence.endpoints) >= most:
            self.refused["full"] += 1
            raise ValueRefused(system[:40], topic[:40], "full", f"a node has {most} topics at most, and no more")

    def _take_away(self, member: Member, presence: _Presence, endpoint: MemberEndpoint) -> None:
        presence.endpoints.pop((endpoint.kind, endpoint.system, endpoint.topic), None)
        if endpoint.kind == "subscription":
            where = (endpoint.system, endpoint.topic)
            pattern = self._patterns.get(where)
            if readers := self._exact.pop(where, ()):
                others = tuple(reader for reader in readers if reader is not member)
                if others:
                    self._exact[where] = others
            if pattern is not None and pattern.members.pop(member, member) is None and not pattern.members:
                del self._patterns[where]
                self._fitting.clear()
        self._tell(member, endpoint, False)

    def _tell(self, member: Member, endpoint: MemberEndpoint, there: bool) -> None:
        for other, presence in list(self._members.items()):
            if presence.watches and other is not member:
                other.event(endpoint, there)

    # ── values ─────────────────────────────────────────────────────────────────────────────────────────────────

    def publish(
        self,
        member: Member | None,
        system: str,
        topic: str,
        data: bytes,
        *,
        origin: str,
        stamp_ns: int = 0,
        version: int = 0,
        merge: bool = False,
        type: str = "",
        form: str = "",
        sink: Sink | None = None,
        token: Any = None,
    ) -> Entry:
        """Publish a value of a member; ``sink`` is told once it is kept.

        Live values are the last in the order of their arrival: ``version`` is taken if it is later than what is there
        and not far in the future. With ``merge`` it was written while the server was away: its version decides, and
        ``stale`` is raised where a later value is there. Raises ``ValueRefused``, also above the limit of endpoints,
        which then leaves the store as it was.
        """
        store = self.store
        presence = self._members.get(member) if member is not None else None
        is_new = presence is not None and ("publisher", system, topic) not in presence.endpoints
        if presence is not None and is_new:
            self._check_room(presence, system, topic, BROUGHT_TOPICS_PER_NODE if merge else ENDPOINTS_PER_NODE)
        before = store.get(system, topic)
        if not merge or not version:
            last = before.version if before is not None else 0
            if version <= last or version > time.time_ns() // 1000 + _AHEAD_US:
                version = store.versions.next(last)
        entry = Entry(system, topic, data, version, stamp_ns or time.time_ns(), origin, type, form)
        self._publisher = member
        try:
            store.put(entry, sink, token)
        except ValueRefused as refused:
            self.refused[refused.code] += 1
            raise
        finally:
            self._publisher = None
        self.published += 1
        if member is not None and presence is not None and is_new:
            self._set(member, presence, MemberEndpoint("publisher", system, topic, type, "", member.node, presence.id))
        return entry

    def _patterns_of(self, key: Key) -> list[_Pattern]:
        """Return the patterns that fit a topic; they are tried once, until there are others."""
        found = self._fitting.get(key)
        if found is None:
            if len(self._fitting) >= _KNOWN_LIMIT:
                self._fitting.clear()
            found = self._fitting[key] = [pattern for pattern in self._patterns.values() if pattern.fits(*key)]
        return found

    def _changed(self, change: Entry | Key) -> None:
        if not isinstance(change, Entry):
            return
        key = (change.system, change.topic)
        readers = self._exact.get(key)
        if readers is None and not self._patterns:
            return
        found = dict.fromkeys(readers or ())
        for pattern in self._patterns_of(key):
            found.update(pattern.members)
        if self._publisher is not None:
            found.pop(self._publisher, None)
        for member in found:
            member.value(change, False)
