"""Actions of a group: a goal goes to one member, and stays with the one that accepted it."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ropeway.graph.calls import DEFAULT_TIMEOUT_S, ActionClient, ClientGoal, Goal
from ropeway.group.calls import Ways, any_of, first_true

__all__ = ["GroupActionClient"]


class GroupActionClient:
    """An action of a group, as a client per member.

    A goal is never sent to two members at a time, whatever the policy: it would be carried out twice at full length.
    Its feedback, its cancellation and its outcome are those of the member that accepted it.
    """

    def __init__(self, ways: Ways, parts: Mapping[str, ActionClient]) -> None:
        first = next(iter(parts.values()))
        self.action, self.type = first.action, first.type
        self._ways, self._parts = ways, dict(parts)

    @property
    def available(self) -> bool | None:
        """Return whether a member serves it, ``None`` where none can tell."""
        return any_of(part.available for part in self._parts.values())

    async def wait_available(self, timeout_s: float) -> bool:
        """See ``ActionClient``."""
        return await first_true([part.wait_available(timeout_s) for part in self._parts.values()])

    async def send_goal(
        self,
        goal: Goal,
        *,
        on_feedback: Callable[[bytes], None] | None = None,
        timeout_s: float = DEFAULT_TIMEOUT_S,
    ) -> ClientGoal:
        """See ``ActionClient``. The latency of the group's windows is the time until the goal is accepted."""
        left_s = await self._ways.wait(self, timeout_s)
        return await self._ways.ask(
            lambda name, limit_s: self._parts[name].send_goal(goal, on_feedback=on_feedback, timeout_s=limit_s),
            lambda name: self._parts[name].available is not False,
            left_s,
            alone=True,
        )

    async def close(self) -> None:
        """See ``ActionClient``."""
        self._ways.closed = True
        for part in self._parts.values():
            await part.close()
        self._ways.group.closed(self)
