"""Carries out what people and nodes may ask of a group: its profile, a new one, another member, a pause."""

from __future__ import annotations

import asyncio
from typing import Any, Final

from ropeway import aio
from ropeway.errors import CallFailed
from ropeway.gateway.config.suggest import one_of
from ropeway.group.graph import Group
from ropeway.group.report import profile_report
from ropeway.group.scheduler import Phase

__all__ = ["GroupCommands"]

_PROFILE_S: Final = 10.0
"""How long somebody waits for a profile: each member has to be sent a request by the robot, and to answer it."""

_LOOK_S: Final = 0.02
_NOBODY: Final = "no member is there; `ropeway status` says why each is not reached"


class GroupCommands:
    """Carries out commands on one group. ``names`` has the names that a policy gives its members."""

    def __init__(self, group: Group, names: dict[str, str]) -> None:
        self._group, self._names = group, names

    def report(self) -> dict[str, Any]:
        """Return the profile as it stands, as JSON."""
        group = self._group
        return {
            "group": group.name,
            "policy": group.policy.value,
            "machines": dict(self._names),
            **profile_report(group.scheduler, group.now()),
        }

    async def optimise(self) -> dict[str, Any]:
        """Ask each member for a moment, use the best, and return the profile.

        Raises ``CallFailed`` where no member is there, or no requests come that members could be asked.
        """
        group = self._group
        if not group.scheduler.here:
            raise CallFailed(group.name, _NOBODY)
        group.scheduler.profile(group.now())
        try:
            async with aio.timeout(_PROFILE_S):
                while group.scheduler.phase is Phase.PROFILING:
                    await asyncio.sleep(_LOOK_S)
                    group.scheduler.step(group.now())
        except TimeoutError:
            why = f"no profile within {_PROFILE_S:g} s; members are profiled with the requests that the robot sends"
            raise CallFailed(group.name, why) from None
        group.tell()
        return self.report()

    def switch(self, member: str) -> dict[str, Any]:
        """Use a member from the next request on, by its address, or its name in the policy. Raises ``CallFailed``."""
        group = self._group
        name = self._names.get(member, member)
        here = group.scheduler.here
        if name not in here:
            known = [*here, *(machine for machine, address in self._names.items() if address in here)]
            raise CallFailed(group.name, f"member: {one_of(member, known)}" if known else _NOBODY)
        group.scheduler.switch(name, group.now())
        group.tell()
        return self.report()

    def pause(self, paused: bool) -> dict[str, Any]:
        """Have the scheduler stay with the member in use until it is gone, or choose again."""
        self._group.scheduler.held = paused
        return self.report()
