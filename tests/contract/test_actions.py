"""What every kind of graph does with actions."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from ropeway.errors import CallError, CallTimeout, GoalRejected, GraphUnavailable, NotServed
from ropeway.graph.base import GraphEvent
from ropeway.graph.calls import (
    ActionClient,
    ActionHandlers,
    ActionServer,
    ClientGoal,
    Goal,
    GoalStatus,
    Outcome,
    ServerGoal,
)
from tests.support.actions import FIBONACCI, Worker, count, order, ordered, sequence
from tests.support.until import PATIENCE_S, until

from .conftest import Pair


async def using(
    pair: Pair,
    execute: Callable[[ServerGoal], Awaitable[Outcome]],
    *,
    name: str = "/fibonacci",
    accept: Callable[[ServerGoal], Awaitable[bool]] | None = None,
    cancel: Callable[[ServerGoal], Awaitable[bool]] | None = None,
) -> ActionClient:
    """A client of ``near`` for an action of ``far`` that is there."""
    await pair.far.create_action_server(name, FIBONACCI, ActionHandlers(execute, accept, cancel))
    client = await pair.near.create_action_client(name, FIBONACCI)
    assert await client.wait_available(PATIENCE_S)
    return client


async def ended(goal: ClientGoal) -> Outcome:
    """How a goal ends, soon."""
    return await goal.result(PATIENCE_S)


async def test_protocols(pair: Pair) -> None:
    """A client, a server and a goal satisfy the protocols."""
    server = await pair.far.create_action_server("/fibonacci", FIBONACCI, ActionHandlers(count))
    client = await pair.near.create_action_client("/fibonacci", FIBONACCI)
    assert isinstance(server, ActionServer)
    assert isinstance(client, ActionClient)
    assert (server.action, server.type, client.action, client.type) == ("/fibonacci", FIBONACCI) * 2
    assert await client.wait_available(PATIENCE_S)
    assert isinstance(await client.send_goal(Goal(order(1))), ClientGoal)


async def test_succeeds(pair: Pair) -> None:
    """A goal that is carried out ends with status 4 and its result, byte for byte."""
    client = await using(pair, count)
    goal = Goal(order(5))
    sent = await client.send_goal(goal)
    outcome = await ended(sent)
    assert sent.id == goal.id
    assert (int(outcome.status), outcome.payload) == (4, sequence(0, 1, 2, 3, 4))


async def test_goal_arrives(pair: Pair) -> None:
    """The server gets the goal byte for byte, once."""
    worker = Worker()
    worker.finish.set()
    client = await using(pair, worker)
    await ended(await client.send_goal(Goal(order(-77))))
    assert [bytes(goal.payload) for goal in worker.goals] == [order(-77)]


async def test_aborts(pair: Pair) -> None:
    """A goal that its server aborts ends with status 6 and its result."""

    async def abort(goal: ServerGoal) -> Outcome:
        return Outcome(GoalStatus.ABORTED, sequence(9))

    client = await using(pair, abort)
    outcome = await ended(await client.send_goal(Goal(order(1))))
    assert (int(outcome.status), outcome.payload) == (6, sequence(9))


async def test_fails(pair: Pair) -> None:
    """A goal whose handler raises is aborted, and the next one is carried out."""

    async def moody(goal: ServerGoal) -> Outcome:
        if ordered(goal) == 13:
            raise ZeroDivisionError("thirteen")
        return await count(goal)

    client = await using(pair, moody)
    outcome = await ended(await client.send_goal(Goal(order(13))))
    assert outcome.status is GoalStatus.ABORTED
    outcome = await ended(await client.send_goal(Goal(order(1))))
    assert outcome == Outcome(GoalStatus.SUCCEEDED, sequence(0))


async def test_feedback(pair: Pair) -> None:
    """Feedback arrives byte for byte and in order, also what is sent right after the acceptance."""
    worker = Worker()

    async def work(goal: ServerGoal) -> Outcome:
        for step in range(8):
            goal.feedback(sequence(step))
        return await worker(goal)

    client = await using(pair, work)
    got: list[bytes] = []
    sent = await client.send_goal(Goal(order(1)), on_feedback=got.append)
    await until(lambda: len(got) == 8)
    assert [bytes(payload) for payload in got] == [sequence(step) for step in range(8)]
    worker.finish.set()
    assert (await ended(sent)).status is GoalStatus.SUCCEEDED


async def test_feedback_of_each(pair: Pair) -> None:
    """Each of several goals gets its own feedback and its own result."""
    worker = Worker()

    async def work(goal: ServerGoal) -> Outcome:
        goal.feedback(sequence(ordered(goal)))
        await worker(goal)
        return Outcome(GoalStatus.SUCCEEDED, sequence(ordered(goal), 1))

    client = await using(pair, work)
    got: dict[int, list[bytes]] = {number: [] for number in range(5)}
    sent = await asyncio.gather(
        *(client.send_goal(Goal(order(number)), on_feedback=got[number].append, timeout_s=20) for number in got)
    )
    await until(lambda: all(got.values()))
    worker.finish.set()
    outcomes = await asyncio.gather(*map(ended, sent))
    assert got == {number: [sequence(number)] for number in got}
    assert [outcome.payload for outcome in outcomes] == [sequence(number, 1) for number in got]


async def test_two_clients(pair: Pair) -> None:
    """Two clients of one action hear each of their own goals only."""
    worker = Worker()

    async def work(goal: ServerGoal) -> Outcome:
        goal.feedback(sequence(ordered(goal)))
        return await worker(goal)

    first = await using(pair, work)
    second = await pair.near.create_action_client("/fibonacci", FIBONACCI)
    assert await second.wait_available(PATIENCE_S)
    got: tuple[list[bytes], list[bytes]] = ([], [])
    sent = [
        await client.send_goal(Goal(order(number)), on_feedback=inbox.append)
        for number, (client, inbox) in enumerate(zip((first, second), got, strict=True))
    ]
    await until(lambda: all(got))
    worker.finish.set()
    await asyncio.gather(*map(ended, sent))
    assert got == ([sequence(0)], [sequence(1)])


async def test_rejected(pair: Pair) -> None:
    """A goal that the server does not take is rejected, and never carried out."""
    worker = Worker()

    async def positive(goal: ServerGoal) -> bool:
        return ordered(goal) > 0

    worker.finish.set()
    client = await using(pair, worker, accept=positive)
    if pair.can.rejects:
        with pytest.raises(GoalRejected, match="rejected"):
            await client.send_goal(Goal(order(-1)))
    else:
        outcome = await ended(await client.send_goal(Goal(order(-1))))
        assert outcome.status is GoalStatus.ABORTED
        assert "rejected" in outcome.text
    assert (await ended(await client.send_goal(Goal(order(1))))).status is GoalStatus.SUCCEEDED
    assert len(worker.goals) == 1


async def test_cancelled(pair: Pair) -> None:
    """A goal that is cancelled ends with status 5 and its result."""
    worker = Worker()
    client = await using(pair, worker)
    sent = await client.send_goal(Goal(order(1)))
    await until(lambda: worker.goals)
    assert await sent.cancel()
    outcome = await ended(sent)
    assert (int(outcome.status), outcome.payload) == (5, sequence(5))


async def test_cancels_one(pair: Pair) -> None:
    """A cancelled goal leaves the others under way."""
    worker = Worker()
    client = await using(pair, worker)
    sent = [await client.send_goal(Goal(order(number))) for number in range(3)]
    await until(lambda: len(worker.goals) == 3)
    assert await sent[1].cancel()
    assert (await ended(sent[1])).status is GoalStatus.CANCELED
    worker.finish.set()
    assert [(await ended(goal)).status for goal in (sent[0], sent[2])] == [GoalStatus.SUCCEEDED] * 2


async def test_cancel_refused(pair: Pair) -> None:
    """A goal whose end the server does not agree to goes on."""
    worker = Worker()

    async def never(goal: ServerGoal) -> bool:
        return False

    client = await using(pair, worker, cancel=never)
    sent = await client.send_goal(Goal(order(1)))
    await until(lambda: worker.goals)
    if pair.can.refuses_cancel:
        assert not await sent.cancel()
    else:
        await sent.cancel()
    worker.finish.set()
    assert (await ended(sent)).status is GoalStatus.SUCCEEDED


async def test_cancel_after_end(pair: Pair) -> None:
    """A goal that has ended cannot be cancelled."""
    client = await using(pair, count)
    sent = await client.send_goal(Goal(order(1)))
    outcome = await ended(sent)
    assert not await sent.cancel()
    assert await ended(sent) == outcome


async def test_result_twice(pair: Pair) -> None:
    """The outcome can be awaited by several, and again."""
    worker = Worker()
    client = await using(pair, worker)
    sent = await client.send_goal(Goal(order(1)))
    waiting = [asyncio.create_task(ended(sent)) for _ in range(3)]
    await until(lambda: worker.goals)
    worker.finish.set()
    outcomes = [*(await asyncio.gather(*waiting)), await ended(sent)]
    assert outcomes == [Outcome(GoalStatus.SUCCEEDED, sequence(4))] * 4


async def test_result_timeout(pair: Pair) -> None:
    """Who waits for an outcome too shortly may wait again."""
    worker = Worker()
    client = await using(pair, worker)
    sent = await client.send_goal(Goal(order(1)))
    with pytest.raises(CallTimeout):
        await sent.result(0.05)
    worker.finish.set()
    assert (await ended(sent)).status is GoalStatus.SUCCEEDED


async def test_large(pair: Pair) -> None:
    """A result and a feedback of 1 MB arrive whole."""
    big = sequence(*range(250_000))
    worker = Worker()

    async def work(goal: ServerGoal) -> Outcome:
        goal.feedback(big)
        await worker(goal)
        return Outcome(GoalStatus.SUCCEEDED, big)

    client = await using(pair, work)
    got: list[bytes] = []
    sent = await client.send_goal(Goal(order(1)), on_feedback=got.append)
    await until(lambda: got)
    worker.finish.set()
    assert bytes(got[0]) == big
    assert (await ended(sent)).payload == big


async def test_many(pair: Pair) -> None:
    """50 goals at a time are each carried out once."""
    client = await using(pair, count)
    sent = await asyncio.gather(*(client.send_goal(Goal(order(number)), timeout_s=30) for number in range(50)))
    outcomes = await asyncio.gather(*map(ended, sent))
    assert [outcome.payload for outcome in outcomes] == [sequence(*range(number)) for number in range(50)]


async def test_server_closes(pair: Pair) -> None:
    """A server that closes aborts its goals at once."""
    worker = Worker()
    server = await pair.far.create_action_server("/fibonacci", FIBONACCI, ActionHandlers(worker))
    client = await pair.near.create_action_client("/fibonacci", FIBONACCI)
    assert await client.wait_available(PATIENCE_S)
    sent = [await client.send_goal(Goal(order(number))) for number in range(3)]
    await until(lambda: len(worker.goals) == 3)
    await server.close()
    outcomes = await asyncio.gather(*map(ended, sent))
    assert [outcome.status for outcome in outcomes] == [GoalStatus.ABORTED] * 3
    await server.close()


async def test_participant_leaves(pair: Pair) -> None:
    """A participant that leaves aborts the goals that it carries out."""
    worker = Worker()
    client = await using(pair, worker)
    sent = await client.send_goal(Goal(order(1)))
    await until(lambda: worker.goals)
    await pair.far.close()
    assert (await ended(sent)).status is GoalStatus.ABORTED


async def test_client_closes(pair: Pair) -> None:
    """A client that closes has its outcomes ABORTED and sends no more goals."""
    worker = Worker()
    client = await using(pair, worker)
    sent = await client.send_goal(Goal(order(1)))
    waiting = asyncio.create_task(ended(sent))
    await until(lambda: worker.goals)
    await client.close()
    assert (await waiting).status is GoalStatus.ABORTED
    with pytest.raises(GraphUnavailable):
        await client.send_goal(Goal(order(1)))
    await client.close()


async def test_not_served(pair: Pair) -> None:
    """A goal for an action that nobody serves fails, or is aborted where only the outcome can tell."""
    client = await pair.near.create_action_client("/nobody", FIBONACCI)
    assert not client.available
    try:
        sent = await client.send_goal(Goal(order(1)), timeout_s=0.5)
    except NotServed as error:
        assert error.kind == "action"
    except CallError:
        assert not pair.can.rejects
    else:
        assert not pair.can.rejects
        assert (await ended(sent)).status is GoalStatus.ABORTED


async def test_late_server(pair: Pair) -> None:
    """A client finds a server that begins later."""
    client = await pair.near.create_action_client("/fibonacci", FIBONACCI)
    waiting = asyncio.create_task(client.wait_available(20))
    await pair.far.create_action_server("/fibonacci", FIBONACCI, ActionHandlers(count))
    assert await waiting
    await until(lambda: client.available is not False)
    assert (await ended(await client.send_goal(Goal(order(2))))).payload == sequence(0, 1)


async def test_slow_acceptance(pair: Pair) -> None:
    """A goal that is accepted after its sender stopped waiting is cancelled, or does not begin."""
    if not pair.can.rejects:
        return  # the acceptance is not told
    worker = Worker()
    decide = asyncio.Event()

    async def later(goal: ServerGoal) -> bool:
        await decide.wait()
        return True

    client = await using(pair, worker, accept=later)
    with pytest.raises(CallTimeout):
        await client.send_goal(Goal(order(1)), timeout_s=0.3)
    decide.set()
    await (await client.send_goal(Goal(order(2)))).cancel()
    await until(lambda: worker.goals and all(goal.cancelled.is_set() for goal in worker.goals))


async def test_listed(pair: Pair) -> None:
    """An action is listed with its type and who serves it, and listed no more when it closes."""
    server = await pair.far.create_action_server("/listed", FIBONACCI, ActionHandlers(count))
    await until(lambda: "/listed" in pair.near.actions() and pair.near.actions()["/listed"].servers)
    info = pair.near.actions()["/listed"]
    assert (info.name, info.type) == ("/listed", FIBONACCI)
    assert [provider.local for provider in info.servers] == [False]
    assert [provider.local for provider in pair.far.actions()["/listed"].servers] == [True]
    assert not [name for name in pair.near.topics() if "_action" in name]
    await server.close()
    await until(lambda: "/listed" not in pair.near.actions() or not pair.near.actions()["/listed"].servers)


async def test_events(pair: Pair) -> None:
    """An action that comes or goes is told as an event."""
    seen: list[GraphEvent] = []

    async def listen() -> None:
        async for event in changes:
            if event.kind == "action" and event.name == "/told":
                seen.append(event)

    changes = pair.near.changes()
    listener = asyncio.create_task(listen())
    server = await pair.far.create_action_server("/told", FIBONACCI, ActionHandlers(count))
    await until(lambda: seen)
    await server.close()
    await until(lambda: len(seen) == 2)
    listener.cancel()
    assert [(event.discovered, event.type) for event in seen] == [(True, FIBONACCI), (False, FIBONACCI)]
    assert "offers action /told" in str(seen[0])


async def test_closed_graph(pair: Pair) -> None:
    """A graph that is closed neither serves nor uses actions."""
    await pair.near.close()
    with pytest.raises(GraphUnavailable):
        await pair.near.create_action_client("/fibonacci", FIBONACCI)
    with pytest.raises(GraphUnavailable):
        await pair.near.create_action_server("/fibonacci", FIBONACCI, ActionHandlers(count))
