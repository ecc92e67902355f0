"""Calls of a group: who is asked, who is asked next, and which answer counts.

A call is answered once, whatever happens. Whether it may be sent to a second member after a first that may have
carried it out is for ``stateless`` to say; a member that refused it before, or was not there, may always be followed
by another.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from itertools import islice
from typing import Final, Protocol, TypeVar

from ropeway.errors import CallFailed, CallTimeout, GoalRejected, GraphUnavailable, NotServed, RopewayError
from ropeway.graph.calls import DEFAULT_TIMEOUT_S, ActionClient, Client, Request
from ropeway.graph.signal import Signal
from ropeway.group.chooser import Chooser
from ropeway.group.late_watch import LateWatch
from ropeway.group.part import GroupPart
from ropeway.group.race import UNTOUCHED, Race
from ropeway.tasks import end

__all__ = ["GroupClient", "GroupUser", "Ways"]

T = TypeVar("T")
U = TypeVar("U", bound=Client | ActionClient)

Ask = Callable[[str, float], Awaitable[T]]
"""Asks one member, within a time."""

NOBODY: Final[Mapping[str, RopewayError]] = {}


class Available(Protocol):
    """Tells whether a name is served."""

    @property
    def available(self) -> bool | None:
        """Return whether it is served now, ``None`` where that is not known."""

    async def wait_available(self, timeout_s: float) -> bool:
        """Wait until it is."""


class Ways:
    """Decides how the calls of one name go to the members of a group."""

    def __init__(self, group: Chooser, name: str, kind: str = "service") -> None:
        self.group, self.name, self.kind = group, name, kind
        self.closed = False
        self._watch = LateWatch(group)

    def asked(self, names: Sequence[str], key: object, now_s: float) -> None:
        """Note whom a call was sent to, and have it noticed when it is late."""
        self.group.scheduler.asked(names, key, now_s)
        if self._watch.idle:
            self._watch.begin()

    def close(self) -> None:
        """Note that the client is closed."""
        self.closed = True
        self._watch.close()

    async def wait(self, client: Available, timeout_s: float) -> float:
        """Wait until a member can be asked; return what is left of the time, in seconds.

        Raises ``NotServed``, ``CallTimeout``, or ``GraphUnavailable`` once the client is closed.
        """
        if client.available and not self.closed:
            return timeout_s
        loop = asyncio.get_running_loop()
        ends_s = loop.time() + timeout_s
        served = client.available is not False or await client.wait_available(timeout_s)
        if self.closed:
            raise GraphUnavailable(self.group.name, f"the client of {self.name} is closed")
        if not served:
            raise NotServed(self.name, self.kind)
        left_s = ends_s - loop.time()
        if left_s <= 0:
            raise CallTimeout(self.name, timeout_s, self.kind)
        return left_s

    async def ask(
        self,
        ask: Ask[T],
        able: Callable[[str], bool],
        timeout_s: float,
        *,
        alone: bool = False,
        counted: bool = True,
        failed: Mapping[str, RopewayError] = NOBODY,
    ) -> T:
        """Return the answer of the first that answers; ``able`` tells who could. ``alone``: of one at a time.

        Not ``counted``: its answer tells no latency. Members that have ``failed`` already are not asked. Raises the
        error of the one whose failure says most, if none answers.
        """
        loop = asyncio.get_running_loop()
        deadline_s = loop.time() + timeout_s
        group, scheduler = self.group, self.group.scheduler
        first = [name for name in group.targets() if name not in failed and able(name)]
        if alone:
            del first[1:]
        keys: dict[str, object] = {}  # of those that were asked
        others = (n for n in scheduler.ranked(group.now()) if n not in failed and n not in keys and able(n))
        if not first:
            first = list(islice(others, 1))
        if not first:
            group.tell()
            raise next(iter(failed.values()), NotServed(self.name, self.kind))
        keys.update(dict.fromkeys(first, object()))
        self.asked(first, keys[first[0]], group.now())

        async def ask_one(name: str) -> T:
            if name not in keys:  # it is asked later than the first
                keys[name] = object()
                self.asked((name,), keys[name], group.now())
            try:
                answer = await ask(name, max(0.0, deadline_s - loop.time()))
            except BaseException as error:
                self.failed(name, keys[name], error)
                raise
            if counted:
                scheduler.answered(name, keys[name], group.now())
            else:
                scheduler.refused(name, keys[name])
            return answer

        def may_go_on(error: RopewayError) -> bool:
            return loop.time() < deadline_s and self.may_go_on(error, alone=alone)

        hedge_after_s = group.hedge_after_s() if not alone and group.second() else None
        try:
            return await Race(ask_one, others, may_go_on, failed.values()).run(first, hedge_after_s)
        finally:
            group.tell()

    def may_go_on(self, error: RopewayError, *, alone: bool = False) -> bool:
        """Return whether another may be asked after that: nobody has begun it, or it may be done twice."""
        if isinstance(error, (CallFailed, GoalRejected, CallTimeout)):
            return False  # it was answered, or the time is over
        return (self.group.stateless and not alone) or isinstance(error, UNTOUCHED)

    def failed(self, name: str, key: object, error: BaseException) -> None:
        """Note what an error of a member tells of its latency."""
        scheduler = self.group.scheduler
        if isinstance(error, UNTOUCHED):
            scheduler.refused(name, key)
        elif isinstance(error, CallFailed):  # which is an answer
            scheduler.answered(name, key, self.group.now())
        else:  # or another was sooner: it took at least until now
            scheduler.gave_up(name, key, self.group.now())


class GroupUser(GroupPart[U]):
    """Uses a service or an action of a group, as a part per member."""

    def __init__(self, ways: Ways, type: str, parts: Mapping[str, U]) -> None:
        super().__init__(ways.group, parts)
        self.type = next((part.type for part in parts.values()), type)
        self._ways = ways
        self._changed = Signal()

    def add(self, name: str, part: U) -> None:
        """Take the part on a member that has come."""
        super().add(name, part)
        self._changed.notify()

    @property
    def available(self) -> bool | None:
        """Whether a member serves it, ``None`` where none can tell."""
        return any_of(part.available for part in self._parts.values())

    async def wait_available(self, timeout_s: float) -> bool:
        """See ``Client`` and ``ActionClient``."""
        ends_s = asyncio.get_running_loop().time() + timeout_s
        while (left_s := ends_s - asyncio.get_running_loop().time()) > 0:
            waits: list[Awaitable[bool]] = [part.wait_available(left_s) for part in self._parts.values()]
            if await first_true([*waits, self._comes(left_s)]) and self.available is not False:
                return True
            if self._ways.closed:
                return False
        return False

    async def _comes(self, timeout_s: float) -> bool:
        """Wait until a member has come, or the client is closed."""
        before = len(self._parts)
        return await self._changed.wait_for(lambda: len(self._parts) != before or self._ways.closed, timeout_s)

    def part(self, name: str) -> U:
        """Return the part on a member. Raises ``NotServed`` if it has left."""
        if name not in self._parts:
            raise NotServed(self._ways.name, self._ways.kind)
        return self._parts[name]

    def serves(self, name: str) -> bool:
        """Return whether a member may serve it."""
        return name in self._parts and self._parts[name].available is not False

    async def close(self) -> None:
        """See ``Client`` and ``ActionClient``."""
        self._ways.close()
        self._changed.notify()
        await super().close()


class GroupClient(GroupUser[Client]):
    """A service of a group, as a client per member."""

    def __init__(self, ways: Ways, type: str, parts: Mapping[str, Client]) -> None:
        super().__init__(ways, type, parts)
        self.service = ways.name

    async def call(self, request: Request, timeout_s: float = DEFAULT_TIMEOUT_S) -> bytes:
        """See ``Client``."""
        ways, group = self._ways, self._group
        began_s = group.now()
        name = group.alone(began_s)
        part = self._parts.get(name)
        if part is None or part.available is False:
            served = not ways.closed and self.serves(group.scheduler.current)
            return await self._ask(request, timeout_s if served else await ways.wait(self, timeout_s))
        key = object()
        ways.asked((name,), key, began_s)
        try:
            answer = await part.call(request, timeout_s)
        except BaseException as error:
            ways.failed(name, key, error)
            left_s = began_s + timeout_s - group.now()
            if isinstance(error, RopewayError) and left_s > 0 and ways.may_go_on(error):
                return await self._ask(request, left_s, {name: error})
            raise
        group.scheduler.answered(name, key, group.now())
        return answer

    async def _ask(self, request: Request, timeout_s: float, failed: Mapping[str, RopewayError] = NOBODY) -> bytes:
        """Call it where something is to be decided, or more than one is asked."""
        return await self._ways.ask(
            lambda name, limit_s: self.part(name).call(request, limit_s), self.serves, timeout_s, failed=failed
        )


def any_of(known: Iterable[bool | None]) -> bool | None:
    """Return whether one is true, ``None`` where none is and one is not known."""
    unknown = False
    for one in known:
        if one:
            return True
        unknown = unknown or one is None
    return None if unknown else False


async def first_true(waits: Iterable[Awaitable[bool]]) -> bool:
    """Return whether one of them comes true, as soon as one does."""
    tasks = {asyncio.ensure_future(wait) for wait in waits}
    try:
        while tasks:
            done, tasks = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            if any(task.result() for task in done):
                return True
        return False
    finally:
        await end(*tasks)
