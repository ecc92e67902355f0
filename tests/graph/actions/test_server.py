"""An action server made of services and topics."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Sequence

import pytest

from ropeway.errors import CallError, UnknownType
from ropeway.graph.actions import server as module
from ropeway.graph.actions.parts import FEEDBACK_QOS, STATUS_QOS
from ropeway.graph.base import Sample, Undelivered
from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Outcome, ServerGoal, new_id
from ropeway.qos import LATCHED, QoS
from tests.support.actions import order, sequence
from tests.support.until import until

from .conftest import REGISTRY, Scene

pytestmark = pytest.mark.jumping

NONE, REJECTED, UNKNOWN, TERMINATED = range(4)


async def statuses(scene: Scene) -> list[list[int]]:
    """What the status topic says from now on, as lists of statuses."""
    told: list[list[int]] = []
    codec = REGISTRY.codec("action_msgs/msg/GoalStatusArray")

    def take(batch: Sequence[Sample]) -> None:
        told.extend([goal["status"] for goal in codec.decode(s.payload)["status_list"]] for s in batch)

    await scene.near.create_subscription(scene.parts.status, "action_msgs/msg/GoalStatusArray", LATCHED, take)
    return told


async def test_states(scene: Scene) -> None:
    """A goal is told as executing once its acceptance was answered, as by rclcpp, and as ended once its result was."""
    told = await statuses(scene)
    await scene.serve()
    id = new_id()
    assert await scene.send(id)
    scene.worker.finish.set()
    assert await scene.result(id) == (4, sequence(1))
    await until(lambda: told[-1:] == [[4]])
    assert told == [[], [2], [4]]


async def test_cancel_states(scene: Scene) -> None:
    """A goal that is cancelled is canceling until it has ended."""
    told = await statuses(scene)
    await scene.serve()
    id = new_id()
    await scene.send(id)
    await until(lambda: told[-1:] == [[2]])
    assert await scene.cancel(id) == (NONE, [id])
    scene.worker.outcome = Outcome(GoalStatus.CANCELED, sequence(2))
    scene.worker.finish.set()
    assert await scene.result(id) == (5, sequence(2))
    await until(lambda: told[-1:] == [[5]])
    assert told == [[], [2], [3], [5]]


async def test_late_status(scene: Scene) -> None:
    """Who comes late to the status topic learns how things stand."""
    await scene.serve()
    await scene.send(new_id())
    await until(lambda: scene.worker.goals)
    told = await statuses(scene)
    await until(lambda: told)
    assert told == [[2]]


async def test_duplicate_goal(scene: Scene) -> None:
    """A goal id that is known is rejected, also when the goal has ended."""
    await scene.serve()
    id = new_id()
    assert await scene.send(id)
    assert not await scene.send(id)
    scene.worker.finish.set()
    await scene.result(id)
    assert not await scene.send(id)
    assert len(scene.worker.goals) == 1


async def test_duplicate_while_deciding(scene: Scene) -> None:
    """A goal that comes again while the first is being decided on is rejected."""
    decide = asyncio.Event()
    asked: list[ServerGoal] = []

    async def accept(goal: ServerGoal) -> bool:
        asked.append(goal)
        await decide.wait()
        return True

    await scene.serve(accept=accept)
    id = new_id()
    first = asyncio.create_task(scene.send(id))
    await until(lambda: asked)
    assert not await scene.send(id)
    decide.set()
    assert await first
    assert len(asked) == 1


async def test_accept_fails(scene: Scene, caplog: pytest.LogCaptureFixture) -> None:
    """A handler that fails to decide rejects the goal, and the failure is logged."""

    async def accept(goal: ServerGoal) -> bool:
        raise ZeroDivisionError("no idea")

    await scene.serve(accept=accept)
    assert not await scene.send(new_id())
    assert "accepting a goal failed" in caplog.text


async def test_too_many(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """A server that is busy with as many goals as it can rejects more."""
    monkeypatch.setattr(module, "_GOALS_LIMIT", 2)
    await scene.serve()
    assert [await scene.send(new_id()) for _ in range(3)] == [True, True, False]


async def test_short_request(scene: Scene) -> None:
    """A goal without an id fails its call."""
    await scene.serve()
    with pytest.raises(CallError, match="too few for a goal id"):
        await scene.call(scene.parts.send_goal, scene.parts.send_goal_type, order(1))


async def test_late_result(scene: Scene) -> None:
    """The result of a goal can be asked for after its end, and again."""
    await scene.serve()
    id = new_id()
    await scene.send(id)
    scene.worker.finish.set()
    assert [await scene.result(id) for _ in range(2)] == [(4, sequence(1))] * 2


async def test_result_of_unknown(scene: Scene) -> None:
    """A goal that was never sent has the status unknown."""
    await scene.serve()
    assert await scene.result(new_id()) == (0, sequence())


async def test_results_are_bounded(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """The oldest results are forgotten when there are too many."""
    monkeypatch.setattr(module, "_KEPT", 3)
    await scene.serve()
    scene.worker.finish.set()
    ids = [new_id() for _ in range(5)]
    for id in ids:
        await scene.send(id)
        await scene.result(id)
    assert [(await scene.result(id))[0] for id in ids] == [0, 0, 4, 4, 4]


async def test_results_are_bounded_in_bytes(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """The oldest results are forgotten when they are too big together."""
    monkeypatch.setattr(module, "_KEPT_BYTES", 1000)
    await scene.serve()
    scene.worker.finish.set()
    scene.worker.outcome = Outcome(GoalStatus.SUCCEEDED, sequence(*range(100)))
    ids = [new_id() for _ in range(4)]
    for id in ids:
        await scene.send(id)
        await scene.result(id)
    assert [(await scene.result(id))[0] for id in ids] == [0, 0, 4, 4]


async def test_results_are_bounded_in_time(scene: Scene) -> None:
    """A result is forgotten a quarter of an hour after the end of its goal."""
    await scene.serve()
    scene.worker.finish.set()
    id = new_id()
    await scene.send(id)
    assert (await scene.result(id))[0] == 4
    await asyncio.sleep(899)
    assert (await scene.result(id))[0] == 4
    await asyncio.sleep(2)
    assert (await scene.result(id))[0] == 0


async def test_bad_result(scene: Scene, caplog: pytest.LogCaptureFixture) -> None:
    """A result that is not one aborts the goal, and the reason is logged."""
    await scene.serve()
    scene.worker.outcome = Outcome(GoalStatus.SUCCEEDED, b"\0\1\0\0\xff\xff\xff\xff")
    scene.worker.finish.set()
    id = new_id()
    await scene.send(id)
    assert await scene.result(id) == (6, sequence())
    assert "the result of a goal cannot be sent" in caplog.text


async def test_unfinished_outcome(scene: Scene, caplog: pytest.LogCaptureFixture) -> None:
    """A handler that returns a status that is no end aborts the goal."""
    await scene.serve()
    scene.worker.outcome = Outcome(GoalStatus.EXECUTING)
    scene.worker.finish.set()
    id = new_id()
    await scene.send(id)
    assert (await scene.result(id))[0] == 6
    assert "EXECUTING" in caplog.text


async def test_execute_fails(scene: Scene, caplog: pytest.LogCaptureFixture) -> None:
    """A handler that raises aborts the goal; an error of ours is logged in one line."""

    async def execute(goal: ServerGoal) -> Outcome:
        raise UnknownType("a/msg/B")

    caplog.set_level(logging.WARNING)
    await scene.serve(execute=execute)
    id = new_id()
    await scene.send(id)
    assert await scene.result(id) == (6, sequence())
    assert "carrying out a goal failed: the definition of a/msg/B" in caplog.text
    assert "Traceback" not in caplog.text


async def test_cancel_unknown(scene: Scene) -> None:
    """A goal that was never sent cannot be cancelled."""
    await scene.serve()
    assert await scene.cancel(new_id()) == (UNKNOWN, [])


async def test_cancel_terminated(scene: Scene) -> None:
    """A goal that has ended cannot be cancelled."""
    await scene.serve()
    scene.worker.finish.set()
    id = new_id()
    await scene.send(id)
    await scene.result(id)
    assert await scene.cancel(id) == (TERMINATED, [])


async def test_cancel_twice(scene: Scene) -> None:
    """A goal that is canceling can be asked for again."""
    await scene.serve()
    id = new_id()
    await scene.send(id)
    assert await scene.cancel(id) == await scene.cancel(id) == (NONE, [id])


async def test_cancel_all(scene: Scene) -> None:
    """A request without id and time means every goal."""
    await scene.serve()
    ids = [new_id() for _ in range(3)]
    for id in ids:
        await scene.send(id)
    assert await scene.cancel() == (NONE, ids)
    assert all(goal.cancelled.is_set() for goal in scene.worker.goals)


async def test_cancel_nothing(scene: Scene) -> None:
    """A request for every goal is agreed to where there is none."""
    await scene.serve()
    assert await scene.cancel() == (NONE, [])


async def test_cancel_before(scene: Scene) -> None:
    """A request with a time means the goals accepted until then, and the one that it names."""
    served = await scene.serve()
    ids = [new_id() for _ in range(4)]
    for id in ids:
        await scene.send(id)
    stamp_ns = served._goals[ids[1]].stamp_ns
    assert await scene.cancel(stamp_ns=stamp_ns) == (NONE, ids[:2])
    assert await scene.cancel(ids[3], stamp_ns) == (NONE, [ids[0], ids[1], ids[3]])


async def test_cancel_refused(scene: Scene) -> None:
    """A request that the handler refuses for every goal is rejected."""

    async def cancel(goal: ServerGoal) -> bool:
        if goal.payload == order(13):
            raise ZeroDivisionError("unlucky")
        return goal.payload == order(1)

    await scene.serve(cancel=cancel)
    first, second, third = new_id(), new_id(), new_id()
    for id, value in ((first, 1), (second, 2), (third, 13)):
        await scene.send(id, value)
    assert await scene.cancel(second) == (REJECTED, [])
    assert await scene.cancel(third) == (REJECTED, [])
    assert await scene.cancel() == (NONE, [first])


async def test_ends_while_deciding(scene: Scene) -> None:
    """A goal that ends while its cancellation is decided on is not cancelled."""

    async def cancel(goal: ServerGoal) -> bool:
        scene.worker.finish.set()
        await until(lambda: not served._goals)
        return True

    served = await scene.serve(cancel=cancel)
    id = new_id()
    await scene.send(id)
    assert await scene.cancel(id) == (REJECTED, [])
    assert (await scene.result(id))[0] == 4


async def test_close_answers(scene: Scene) -> None:
    """Who waits for a result when the server closes gets it: aborted."""
    served = await scene.serve()
    ids = [new_id() for _ in range(3)]
    for id in ids:
        await scene.send(id)
    waiting = [asyncio.create_task(scene.result(id)) for id in ids]
    await until(lambda: served._waiting == 3)
    await served.close()
    assert await asyncio.gather(*waiting) == [(6, sequence())] * 3
    assert not scene.near.services()
    assert not scene.near.network.publishers


async def test_close_ends_handlers(scene: Scene) -> None:
    """Handlers under way are ended when the server closes."""
    began, ended = asyncio.Event(), asyncio.Event()

    async def execute(goal: ServerGoal) -> Outcome:
        began.set()
        try:
            await asyncio.Event().wait()
        finally:
            ended.set()
        raise AssertionError

    served = await scene.serve(execute=execute)
    await scene.send(new_id())
    await began.wait()
    await served.close()
    assert ended.is_set()


async def test_asked_while_closing(scene: Scene) -> None:
    """Who sent a goal just before the server closes, and asks for its result only then, learns that it was aborted."""
    served = await scene.serve()
    id = new_id()
    await scene.send(id)
    await until(lambda: scene.worker.goals)
    closing = asyncio.create_task(served.close())
    await asyncio.sleep(0.05)
    assert await scene.result(id) == (GoalStatus.ABORTED, sequence())
    await closing


async def test_late_feedback(scene: Scene) -> None:
    """Feedback of a goal that has ended is dropped and counted."""
    await scene.serve()
    id = new_id()
    await scene.send(id)
    scene.worker.finish.set()
    await scene.result(id)
    scene.worker.goals[0].feedback(sequence(1))
    assert scene.far.drops[scene.parts.feedback, Undelivered.CLOSED] == 1


async def test_failed_open(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """A server that cannot begin leaves nothing behind."""

    async def refuse(*_: object, **__: object) -> None:
        raise CallError("/x", "no")

    monkeypatch.setattr(scene.far, "create_service", refuse)
    with pytest.raises(CallError):
        await scene.serve()
    assert not scene.far.network.publishers


async def test_caller_is_told(scene: Scene) -> None:
    """The handler learns who sent the goal and through which gateways it came."""
    await scene.serve()
    client = await scene.use()
    await client.send_goal(Goal(order(1), via=("one", "two"), caller="somebody"))
    await until(lambda: scene.worker.goals)
    assert (scene.worker.goals[0].via, scene.worker.goals[0].caller) == (("one", "two"), "somebody")


def test_profiles() -> None:
    """Feedback and status have the profiles of ROS 2."""
    assert QoS(depth=10) == FEEDBACK_QOS
    assert QoS(durability="transient_local", depth=1) == STATUS_QOS


async def test_unknown_type(scene: Scene) -> None:
    """An action of an unknown type is refused before anything is created."""
    with pytest.raises(UnknownType):
        await scene.far.create_action_server("/x", "a/action/B", ActionHandlers(scene.worker))
    assert not scene.far.services()


async def test_states_of_many(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of goals that have ended, the last are told, and each at least once, however many end together."""
    monkeypatch.setattr(module, "_TOLD", 2)
    told = await statuses(scene)
    await scene.serve()
    for _ in range(4):
        await scene.send(new_id())
    await until(lambda: told[-1:] == [[2] * 4])
    scene.worker.finish.set()
    await until(lambda: told[-1:] == [[4] * 4])
    scene.worker.finish.clear()
    await scene.send(new_id())
    await until(lambda: told[-1:] == [[4, 4, 2]])
