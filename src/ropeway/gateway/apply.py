"""Applies a plan to a running gateway: starts the new, swaps, drains the old; restores everything if a part fails.

In two phases, so that several processes change together or not at all: ``prepare`` starts what is new beside what runs,
and fails if anything of it cannot be had; ``commit`` swaps. ``abort`` takes back what was prepared.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Sequence
from typing import Final, Protocol

from ropeway import aio
from ropeway.gateway.config.config import Config, Route
from ropeway.gateway.config.type_hints import known_types, learn_types
from ropeway.gateway.credentials import read_credentials
from ropeway.gateway.needed_modules import needed_modules
from ropeway.gateway.plan import ConfigPlan, RemotePlan
from ropeway.gateway.recording.recorders import Recorders, check_directories
from ropeway.gateway.running_remote import RunningRemote
from ropeway.loading import preload
from ropeway.tasks import describe
from ropeway.types import TypeRegistry

__all__ = ["Changing", "ConfigChange"]

log = logging.getLogger("ropeway.gateway")

_CONNECT_S: Final = 3.0  # a link that replaces one that stands; a peer that is away is not waited for longer
_LOOK_S: Final = 0.02


class Changing(Protocol):
    """Has the parts of a gateway that a change replaces; ``Gateway`` is one."""

    config: Config
    registry: TypeRegistry
    running: list[RunningRemote]
    recorders: Recorders

    async def open_remote(self, config: Config, index: int, routes: Sequence[Route]) -> RunningRemote:
        """Bring a remote of a configuration up, with its routes."""
        ...

    def read_access(self, config: Config) -> Callable[[], None]:
        """Read who may come in by a configuration; return what makes it so."""
        ...

    async def restart(self, config: Config) -> None:
        """Take everything down and bring another configuration up, or else the one before."""
        ...


class ConfigChange:
    """A change of configuration that is under way. Nothing else may change the gateway meanwhile."""

    def __init__(self, gateway: Changing, plan: ConfigPlan) -> None:
        self.gateway, self.plan = gateway, plan
        self._before = {running.index: running for running in gateway.running}
        self._opened: dict[int, RunningRemote] = {}
        self._added: list[tuple[RunningRemote, str]] = []
        self._renew: Callable[[], None] | None = None

    async def prepare(self) -> None:
        """Start what is new beside what runs. Raises ``RopewayError`` if that cannot be; nothing new is left then."""
        plan, new = self.plan, self.plan.new
        await preload(needed_modules(new))
        for remote in plan.remotes:
            if remote.before is None:
                read_credentials(new.remotes[remote.index], remote.index)
        if plan.restart or plan.live & {"audit", "auth", "globs", "tls"}:
            self._renew = self.gateway.read_access(new)
        if plan.restart:
            known_types(new)
            return
        if "types" in plan.live:
            learn_types(new, self.gateway.registry)
        if "record" in plan.live:
            check_directories(new)
        try:
            for remote in plan.remotes:
                await self._start(remote)
            await self._connected()
        except BaseException:
            await self.abort()
            raise

    async def commit(self) -> None:
        """Swap, and drain the old. Raises ``RopewayError`` if that cannot be; everything is then as before."""
        plan = self.plan
        if plan.restart:
            await self.gateway.restart(plan.new)
            return
        await self._swap()
        running = []
        for remote in plan.remotes:
            there = self._opened[remote.index] if remote.before is None else self._before[remote.before]
            running.append(there)
        old = [self._before[index] for index in plan.stopped if index in self._before]
        self.gateway.running[:] = running
        self.gateway.config = plan.new
        await self.gateway.recorders.change(plan.new.gateway.record)
        if self._renew is not None:
            self._renew()
        removals = [
            self._before[remote.before].remove(route.key)
            for remote in plan.remotes
            if remote.before is not None
            for route in remote.removed
        ]
        ended = await asyncio.gather(*removals, *map(_end, old), return_exceptions=True)
        for outcome in ended:
            if isinstance(outcome, Exception):  # the new runs; what is left of the old is said
                log.warning("something old did not end in order: %s", describe(outcome), exc_info=outcome)
        self._renumber()

    async def abort(self) -> None:
        """Take back what was prepared."""
        for running, key in reversed(self._added):
            await running.remove(key)
        for remote in self.plan.remotes:
            if remote.before is not None:
                await self._before[remote.before].remote.crosses(self.plan.old.remotes[remote.before])
        for running in self._opened.values():
            await running.close()
        self._added.clear()
        self._opened.clear()

    async def _start(self, remote: RemotePlan) -> None:
        if remote.before is None:
            self._opened[remote.index] = await self.gateway.open_remote(self.plan.new, remote.index, remote.added)
            return
        running = self._before[remote.before]
        await running.remote.crosses(self.plan.new.remotes[remote.index])
        for route in remote.added:
            await running.add(route)
            self._added.append((running, route.key))

    async def _connected(self) -> None:
        """Wait for links that take the place of links that stand, for a moment."""
        waiting = [
            self._opened[remote.index].remote
            for remote in self.plan.remotes
            if remote.replaces in self._before and self._before[remote.replaces].remote.state == "connected"
        ]
        with contextlib.suppress(TimeoutError):
            async with aio.timeout(_CONNECT_S):
                while any(remote.state != "connected" for remote in waiting):  # noqa: ASYNC110 - of many kinds
                    await asyncio.sleep(_LOOK_S)

    async def _swap(self) -> None:
        """Change the routes that stay, all at once; if one cannot be, all are changed back."""
        pairs = [
            (self._before[remote.before], was, becomes)
            for remote in self.plan.remotes
            if remote.before is not None
            for was, becomes in remote.changed
        ]
        changes = (running.change(becomes) for running, _, becomes in pairs)
        outcomes = await asyncio.gather(*changes, return_exceptions=True)
        error = next((outcome for outcome in outcomes if isinstance(outcome, BaseException)), None)
        if error is None:
            return
        for running, was, _ in pairs:
            await running.change(was)
        await self.abort()
        raise error

    def _renumber(self) -> None:
        new = self.plan.new
        for remote in self.plan.remotes:
            if remote.before is not None:
                self._before[remote.before].renumber(new.remotes[remote.index], remote.index, remote.routes)


async def _end(running: RunningRemote) -> None:
    await running.finish()
    await running.close()
