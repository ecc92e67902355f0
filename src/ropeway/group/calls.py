"""Calls of a group: who is asked, who is asked next, and which answer counts.

A call is answered once, whatever happens. Whether it may be sent to a second member after a first that may have
carried it out is for ``stateless`` to say; a member that refused it before, or was not there, may always be followed
by another.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Mapping
from typing import Final, Protocol, TypeVar

from ropeway.errors import CallError, CallFailed, CallTimeout, GoalRejected, GraphUnavailable, NotServed, RopewayError
from ropeway.graph.calls import DEFAULT_TIMEOUT_S, ActionClient, Client, Request
from ropeway.graph.signal import Signal
from ropeway.group.chooser import Chooser
from ropeway.group.part import GroupPart
from ropeway.tasks import end

__all__ = ["GroupClient", "GroupUser", "Ways"]

T = TypeVar("T")
U = TypeVar("U", bound=Client | ActionClient)

Ask = Callable[[str, float], Awaitable[T]]
"""Asks one member, within a time."""

_BOTH: Final = 2  # members that are asked at once
_UNTOUCHED: Final = (NotServed, GraphUnavailable)  # nobody has begun to carry it out


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
        self._numbers = 0

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

    async def ask(self, ask: Ask[T], able: Callable[[str], bool], timeout_s: float, *, alone: bool = False) -> T:
        """Return the answer of the first that answers; ``able`` tells who could. ``alone``: of one at a time.

        Raises the error of the one whose failure says most, if none does.
        """
        loop = asyncio.get_running_loop()
        deadline_s = loop.time() + timeout_s
        first = [name for name in self.group.targets() if able(name)]
        if alone or (len(first) < _BOTH and not self.group.second()):
            return await self._ask_in_turn(ask, able, first[:1], deadline_s, alone=alone)
        waiting = [name for name in self._order() if able(name)]
        if not waiting:
            raise NotServed(self.name, self.kind)
        first = [name for name in first if name in waiting] or waiting[:1]
        errors: list[RopewayError] = []
        tasks: dict[asyncio.Task[T], None] = {}

        def begin(names: Iterable[str]) -> None:
            for name in names:
                waiting.remove(name)
                work = self._measured(ask, name, max(0.0, deadline_s - loop.time()))
                tasks[asyncio.create_task(work, name=f"{self.name} at {name}")] = None

        begin(first)
        hedge_at_s = loop.time() + self.group.hedge_after_s() if self.group.second() else None
        try:
            while tasks:
                pause_s = None if hedge_at_s is None or not waiting else max(0.0, hedge_at_s - loop.time())
                done, _ = await asyncio.wait(tasks, timeout=pause_s, return_when=asyncio.FIRST_COMPLETED)
                if not done:
                    begin(waiting[:1])
                    hedge_at_s = None
                for task in done:
                    del tasks[task]
                    error = task.exception()
                    if error is None:
                        return task.result()
                    if not isinstance(error, RopewayError):
                        raise error
                    errors.append(error)
                    if waiting and not tasks and self._may_go_on(error) and loop.time() < deadline_s:
                        begin(waiting[:1])
            raise _telling(errors)
        finally:
            await end(*tasks)
            self.group.tell()

    async def _ask_in_turn(
        self, ask: Ask[T], able: Callable[[str], bool], first: list[str], deadline_s: float, *, alone: bool
    ) -> T:
        """Return the answer of one member, asked without a task of its own; of the next, if that one refuses."""
        tried: dict[str, RopewayError] = {}
        try:
            while True:
                name = first.pop() if first else next((n for n in self._order() if n not in tried and able(n)), "")
                if not name:
                    raise _telling(tried.values()) if tried else NotServed(self.name, self.kind)
                left_s = deadline_s - asyncio.get_running_loop().time()
                try:
                    return await self._measured(ask, name, max(0.0, left_s))
                except RopewayError as error:
                    tried[name] = error
                    if left_s <= 0 or not self._may_go_on(error, alone=alone):
                        raise _telling(tried.values()) from None
        finally:
            self.group.tell()

    def _order(self) -> list[str]:
        return self.group.scheduler.ranked(self.group.now())

    def _may_go_on(self, error: RopewayError, *, alone: bool = False) -> bool:
        """Return whether another may be asked after that: nobody has begun it, or it may be done twice."""
        if isinstance(error, (CallFailed, GoalRejected, CallTimeout)):
            return False  # it was answered, or the time is over
        return (self.group.stateless and not alone) or isinstance(error, _UNTOUCHED)

    async def _measured(self, ask: Ask[T], name: str, timeout_s: float) -> T:
        self._numbers += 1
        key, scheduler = (self, self._numbers), self.group.scheduler
        scheduler.asked((name,), key, self.group.now())
        try:
            answer = await ask(name, timeout_s)
        except _UNTOUCHED:
            scheduler.refused(name, key)
            raise
        except CallError as error:
            if isinstance(error, CallFailed):
                scheduler.answered(name, key, self.group.now())
            else:
                scheduler.gave_up(name, key, self.group.now())
            raise
        except asyncio.CancelledError:  # another was sooner: it took at least until now
            scheduler.gave_up(name, key, self.group.now())
            raise
        scheduler.answered(name, key, self.group.now())
        return answer


def _telling(errors: Iterable[RopewayError]) -> RopewayError:
    """Return the error that says most: what a provider said, what may have been begun, or that nobody is there."""
    ranks = (CallFailed, CallTimeout, CallError)

    def rank(error: RopewayError) -> int:
        if isinstance(error, _UNTOUCHED):
            return len(ranks)
        return next((i for i, kind in enumerate(ranks) if isinstance(error, kind)), len(ranks) - 1)

    return min(errors, key=rank)


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
        self._ways.closed = True
        self._changed.notify()
        await super().close()


class GroupClient(GroupUser[Client]):
    """A service of a group, as a client per member."""

    def __init__(self, ways: Ways, type: str, parts: Mapping[str, Client]) -> None:
        super().__init__(ways, type, parts)
        self.service = ways.name

    async def call(self, request: Request, timeout_s: float = DEFAULT_TIMEOUT_S) -> bytes:
        """See ``Client``."""
        left_s = await self._ways.wait(self, timeout_s)
        return await self._ways.ask(lambda name, limit_s: self.part(name).call(request, limit_s), self.serves, left_s)


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
