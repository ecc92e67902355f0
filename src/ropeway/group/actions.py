"""Actions of a group: a goal goes to one member, and stays with the one that accepted it."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ropeway.graph.calls import DEFAULT_TIMEOUT_S, ActionClient, ClientGoal, Goal
from ropeway.group.calls import GroupUser, Ways

__all__ = ["GroupActionClient"]


class GroupActionClient(GroupUser[ActionClient]):
    """An action of a group, as a client per member.

    A goal is never sent to two members at a time, whatever the policy: it would be carried out twice at full length.
    Its feedback, its cancellation and its outcome are those of the member that accepted it.
    """

    def __init__(self, ways: Ways, type: str, parts: Mapping[str, ActionClient]) -> None:
        super().__init__(ways, type, parts)
        self.action = ways.name

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
            lambda name, limit_s: self.part(name).send_goal(goal, on_feedback=on_feedback, timeout_s=limit_s),
            self.serves,
            left_s,
            alone=True,
        )
