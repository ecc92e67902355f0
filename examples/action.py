"""Offer an action and send it a goal, with feedback: python examples/action.py [memory:action]."""

import asyncio
import sys

import ropeway

FIBONACCI = "example_interfaces/action/Fibonacci"


async def fibonacci(goal: ropeway.ExecutingGoal) -> object:
    """Carry a goal out: send feedback on the way, look whether somebody wants it to end, return the result."""
    sequence = [0, 1]
    while len(sequence) < goal.request["order"]:
        if goal.cancel_requested:
            return goal.canceled({"sequence": sequence})
        sequence.append(sequence[-1] + sequence[-2])
        goal.feedback({"sequence": sequence})
        await asyncio.sleep(0.1)
    return {"sequence": sequence}


def show(feedback: ropeway.TypedMessage) -> None:
    """Print what has been reached."""
    print("so far:", feedback["sequence"].tolist())


async def main(url: str = "memory:action") -> None:
    """Be server and client at once; on a network they are two programs."""
    async with (
        ropeway.open(url) as graph,
        graph.serve_action("/fibonacci", FIBONACCI, fibonacci),
        graph.action_client("/fibonacci") as client,
    ):
        goal = await client.send_goal({"order": 6}, on_feedback=show)
        ended = await goal.result(timeout_s=30)
        print(ended.status.name, ended.result)


asyncio.run(main(*sys.argv[1:]))
