"""Actions of a group: a goal goes to one member, and stays with the one that accepted it."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ropeway.graph.calls import DEFAULT_TIMEOUT_S, ActionClient, ClientGoal, Goal, GoalStatus, Outcome
from ropeway.group.calls import GroupUser, Ways
from ropeway.group.chooser import Chooser

__all__ = ["GroupActionClient"]


class MemberGoal:
    """A goal that a member has accepted; how long it takes is noted when it has succeeded."""

    def __init__(self, goal: ClientGoal, member: str, group: Chooser, asked_s: float) -> None:
        self.id = goal.id
        self._goal, self._member, self._group, self._asked_s = goal, member, group, asked_s
        self._noted = False

    async def result(self, timeout_s: float | None = None) -> Outcome:
        """See ``ClientGoal``."""
        outcome = await self._goal.result(timeout_s)
        if not self._noted and outcome.status is GoalStatus.SUCCEEDED:
            self._noted = True
            now_s = self._group.now()
            self._group.scheduler.finished(self._member, now_s - self._asked_s, now_s)
        return outcome

    async def cancel(self, timeout_s: float = DEFAULT_TIMEOUT_S) -> bool:
        """See ``ClientGoal``."""
        return await self._goal.cancel(timeout_s)


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
        """See ``ActionClient``. The latency is the time until the goal is accepted, or until it has succeeded."""
        left_s = await self._ways.wait(self, timeout_s)
        group = self._group

        async def send(name: str, limit_s: float) -> ClientGoal:
            asked_s = group.now()
            sent = await self.part(name).send_goal(goal, on_feedback=on_feedback, timeout_s=limit_s)
            return MemberGoal(sent, name, group, asked_s)

        counted = not group.scheduler.options.judge_results
        return await self._ways.ask(send, self.serves, left_s, alone=True, counted=counted)
