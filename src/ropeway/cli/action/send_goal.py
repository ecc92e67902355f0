"""``ropeway action send_goal``: send a goal, follow it, and cancel it on Ctrl-C."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Annotated, Any, Final

import orjson
import typer

from ropeway import aio
from ropeway.cli.action.info import ActionArgument
from ropeway.cli.console import answer, complain, fail, print_json
from ropeway.cli.loop import run
from ropeway.cli.patience import patiently, served_within
from ropeway.cli.session import GraphOption, JsonOption, OpenGraph, TypesOption, full_name, open_session
from ropeway.cli.topic.render import Style, as_yaml, pick, shown
from ropeway.cli.values import fitted, typed_values
from ropeway.errors import CallError, CallTimeout, GoalRejected, NotServed
from ropeway.graph.calls import ActionClient, ClientGoal, Goal, GoalStatus, Outcome
from ropeway.tasks import end
from ropeway.types import TypeRegistry
from ropeway.types.definition import canonical_name

__all__ = ["GoalReport", "app", "send_goal"]

app = typer.Typer(add_completion=False)

_EARLY: Final = 1000
_CANCEL_S: Final = 5.0  # how long Ctrl-C waits for the server to end the goal


class GoalReport:
    """Reports the progress of a goal, by default nothing."""

    def accepted(self, id: bytes) -> None:
        """Report that the goal was accepted."""

    def feedback(self, payload: bytes) -> None:
        """Report a feedback."""

    def outcome(self, outcome: Outcome) -> None:
        """Report the end of the goal."""


class TextTeller(GoalReport):
    """Speaks as ``ros2 action send_goal``."""

    def __init__(self, registry: TypeRegistry, type: str) -> None:
        self._registry, self._type = registry, type

    def accepted(self, id: bytes) -> None:
        """Say the id of the goal."""
        answer(f"Goal accepted with ID: {id.hex()}\n")

    def feedback(self, payload: bytes) -> None:
        """Show the feedback."""
        answer(f"Feedback:\n{self._yaml('Feedback', payload)}")

    def outcome(self, outcome: Outcome) -> None:
        """Show the result and the status."""
        if outcome.payload is not None:
            answer(f"Result:\n{self._yaml('Result', outcome.payload)}")
        answer(f"Goal finished with status: {outcome.status.name}{f' ({outcome.text})' if outcome.text else ''}")

    def _yaml(self, part: str, payload: bytes) -> str:
        codec = self._registry.codec(f"{self._type}_{part}")
        whole = Style(truncate=None)
        value = shown(self._registry, pick(self._registry, codec.type, codec.decode(payload), ""), whole)
        return "".join(f"    {line}\n" for line in as_yaml(value, whole).splitlines())


class JsonTeller(GoalReport):
    """Prints one JSON object per line: ``accepted``, ``feedback``, ``status``."""

    def __init__(self, registry: TypeRegistry, type: str) -> None:
        self._registry, self._type = registry, type

    def accepted(self, id: bytes) -> None:
        """Print the id of the goal."""
        print_json({"accepted": True, "goal_id": id.hex()})

    def feedback(self, payload: bytes) -> None:
        """Print the feedback."""
        print_json({"feedback": self._message("Feedback", payload)})

    def outcome(self, outcome: Outcome) -> None:
        """Print the status and the result."""
        result = None if outcome.payload is None else self._message("Result", outcome.payload)
        print_json({"status": outcome.status.name, "code": int(outcome.status), "result": result, "text": outcome.text})

    def _message(self, part: str, payload: bytes) -> orjson.Fragment:
        return orjson.Fragment(self._registry.codec(f"{self._type}_{part}").json(payload))


async def send_goal(
    session: OpenGraph,
    action: str,
    type: str,
    values: dict[str, Any],
    teller: GoalReport,
    *,
    timeout_s: float,
    feedback: bool = False,
) -> Outcome:
    """Send a goal and wait for its end; a cancelled task cancels the goal.

    ``timeout_s`` bounds the wait for the acceptance. Raises ``ValueMismatch`` for values that do not fit, before
    anything is sent, and ``CallError``.
    """
    full = canonical_name(type, "action")
    codec = session.registry.codec(f"{full}_Goal")
    payload = codec.from_json(fitted(session.registry, codec.type, values))
    client = await session.graph.create_action_client(action, full)
    news = _Feedback(teller) if feedback else None
    goal = Goal(payload, caller="ropeway action send_goal")
    sending = asyncio.create_task(_send(client, goal, news, timeout_s), name=f"send goal to {action}")
    try:
        async with patiently(lambda: _waiting_for(client, timeout_s)):
            sent = await asyncio.shield(sending)
        teller.accepted(sent.id)
        if news is not None:
            news.release()
        outcome = await sent.result()
    except asyncio.CancelledError:
        await _give_up(sending, teller)
        raise
    finally:
        if not sending.done():
            await end(sending)
        await client.close()
    teller.outcome(outcome)
    return outcome


def _waiting_for(client: ActionClient, timeout_s: float) -> str:
    if client.available:
        return f"waiting for {client.action} to accept the goal ({timeout_s:g} s at most)"
    return f"waiting for an action server of {client.action} ({timeout_s:g} s at most)"


class _Feedback:
    """Tells feedback after the acceptance; what comes before waits for it."""

    def __init__(self, teller: GoalReport) -> None:
        self._teller = teller
        self._early: deque[bytes] | None = deque(maxlen=_EARLY)

    def __call__(self, payload: bytes) -> None:
        if self._early is None:
            self._teller.feedback(payload)
        else:
            self._early.append(payload)

    def release(self) -> None:
        """Report the feedback held back until the acceptance was reported."""
        early, self._early = self._early or (), None
        for payload in early:
            self._teller.feedback(payload)


async def _send(
    client: ActionClient, goal: Goal, on_feedback: Callable[[bytes], None] | None, timeout_s: float
) -> ClientGoal:
    left_s = await served_within(client, timeout_s)
    return await client.send_goal(goal, on_feedback=on_feedback, timeout_s=left_s)


async def _give_up(sending: asyncio.Task[ClientGoal], teller: GoalReport) -> None:
    """Cancel what was sent, and wait a little for how it ends."""
    try:
        async with aio.timeout(_CANCEL_S):
            sent = await sending
            complain("Canceling goal...")
            if not await sent.cancel(_CANCEL_S):
                complain("Failed to cancel goal: the server goes on with it")
                return
            teller.outcome(await sent.result())
    except CallError as error:
        complain(f"Failed to cancel goal: {error}")
    except TimeoutError:
        complain(f"Failed to cancel goal: the server has not ended it within {_CANCEL_S:g} s")


@app.command("send_goal")
def send_goal_command(
    action: ActionArgument,
    type: Annotated[
        str, typer.Argument(help="Its type, such as example_interfaces/action/Fibonacci.", show_default=False)
    ],
    values: Annotated[str, typer.Argument(help="The goal in YAML or JSON, such as '{order: 5}'.")] = "{}",
    graph: GraphOption = "",
    stdin: Annotated[bool, typer.Option("--stdin", help="Read the values from standard input.")] = False,
    feedback: Annotated[bool, typer.Option("--feedback", "-f", help="Print the feedback, too.")] = False,
    timeout: Annotated[float, typer.Option("--timeout", min=0.001, help="Seconds to wait for the acceptance.")] = 5.0,
    types: TypesOption = None,
    as_json: JsonOption = False,
) -> None:
    """Send a goal to ACTION and wait for its end; Ctrl-C cancels it. The exit code is 0 for a goal that succeeded."""
    name = full_name(action)
    fields = typed_values(values, stdin=stdin)

    async def main() -> Outcome:
        async with open_session(graph, types) as session:
            full = canonical_name(type, "action")
            await session.know(full)
            teller = (JsonTeller if as_json else TextTeller)(session.registry, full)
            return await send_goal(session, name, full, fields, teller, timeout_s=timeout, feedback=feedback)

    try:
        outcome = run(main())
    except GoalRejected:
        fail(f"the server of {name} rejected the goal")
    except NotServed:
        fail(f"nobody serves {name} within {timeout:g} s; see `ropeway action list`, or wait longer with --timeout")
    except CallTimeout:
        fail(f"{name} did not say within {timeout:g} s whether it takes the goal; wait longer with --timeout")
    if outcome.status is not GoalStatus.SUCCEEDED:
        raise typer.Exit(1)
