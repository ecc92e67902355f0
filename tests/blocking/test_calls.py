"""Clients, services and actions of threads."""

from __future__ import annotations

import threading

import pytest

from ropeway import CallFailed, CallTimeout, GoalStatus, NotServed, TypedMessage, blocking
from ropeway.blocking import BlockingExecutingGoal

ADD = "example_interfaces/srv/AddTwoInts"
FIBONACCI = "example_interfaces/action/Fibonacci"


def add(request: TypedMessage) -> dict[str, int]:
    return {"sum": request["a"] + request["b"]}


@pytest.mark.parametrize("url", ["memory:blocking-calls", "dds:58?interface=lo"])
def test_service(url: str) -> None:
    """A service of one graph answers another."""
    with (
        blocking.open(url, name="one") as one,
        blocking.open(url, name="two") as two,
        one.serve("/add", ADD, add) as service,
    ):
        assert (service.service, service.type, service.taken_by) == ("/add", ADD, "")
        assert two.call("/add", {"a": 1, "b": 2}, timeout_s=20)["sum"] == 3
        with two.client("/add") as client:
            client.wait_available(timeout_s=20)
            assert (client.service, client.type, client.available) == ("/add", ADD, True)
            assert client.call({"a": 2, "b": 2}, timeout_s=20)["sum"] == 4


def test_handler_may_call(network: str) -> None:
    """A handler runs in a thread, and may call another service of the same graph."""

    def add_twice(request: TypedMessage) -> dict[str, int]:
        once = graph.call("/add", request, ADD)
        return {"sum": 2 * once["sum"]}

    with blocking.open(network) as graph, graph.serve("/add", ADD, add), graph.serve("/twice", ADD, add_twice):
        assert graph.call("/twice", {"a": 1, "b": 2})["sum"] == 6


def test_failures(network: str) -> None:
    """A call fails with what the handler raises, with its time, or because nobody serves it."""
    never = threading.Event()

    def handler(request: TypedMessage) -> None:
        if request["data"]:
            raise ValueError("no")
        never.wait(20)

    with blocking.open(network) as graph:
        with graph.serve("/set", "std_srvs/SetBool", handler), graph.client("/set") as client:
            with pytest.raises(CallFailed, match="no"):
                client.call({"data": True})
            with pytest.raises(CallTimeout):
                client.call({"data": False}, timeout_s=0.05)
            never.set()
        with pytest.raises(NotServed):
            graph.call("/other", type=ADD, timeout_s=0.05)


@pytest.mark.parametrize("url", ["memory:blocking-actions", "dds:58?interface=lo"])
def test_action(url: str) -> None:
    """A goal is carried out in a thread, with feedback in order."""
    found: list[list[int]] = []
    done = threading.Event()

    def execute(goal: BlockingExecutingGoal) -> dict[str, list[int]]:
        sequence = [0, 1]
        for _ in range(goal.request["order"]):
            sequence.append(sequence[-1] + sequence[-2])
            goal.feedback({"sequence": sequence})
        return {"sequence": sequence}

    def take(feedback: TypedMessage) -> None:
        found.append(list(feedback["sequence"]))
        if len(found) == 3:
            done.set()

    with (
        blocking.open(url, name="one") as one,
        blocking.open(url, name="two") as two,
        one.serve_action("/fib", FIBONACCI, execute) as server,
        two.action_client("/fib", timeout_s=20) as client,
    ):
        assert (server.action, server.type, server.taken_by) == ("/fib", FIBONACCI, "")
        client.wait_available(timeout_s=20)
        assert (client.action, client.type, client.available) == ("/fib", FIBONACCI, True)
        goal = client.send_goal({"order": 3}, on_feedback=take, timeout_s=20)
        ended = goal.result(timeout_s=20)
        assert ended.result is not None
        assert list(ended.result["sequence"]) == [0, 1, 1, 2, 3]
        assert done.wait(10)
        assert [len(sequence) for sequence in found] == [3, 4, 5]


@pytest.mark.parametrize("how", ["cancel", "close"])
def test_goal_that_is_given_up(network: str, how: str) -> None:
    """A goal sees that its end is asked for, or that nobody waits for it any more."""
    seen = threading.Event()
    began = threading.Event()

    def execute(goal: BlockingExecutingGoal) -> object:
        began.set()
        while not goal.cancel_requested:
            seen.wait(0.01)
        seen.set()
        return goal.canceled({"sequence": [1]})

    def accept(request: TypedMessage) -> bool:
        return "/wait" in graph.actions()  # which waits for the thread of the event loop

    with blocking.open(network) as graph:
        server = graph.serve_action("/wait", FIBONACCI, execute, accept=accept)
        with graph.action_client("/wait") as client:
            goal = client.send_goal()
            assert began.wait(10)
            if how == "cancel":
                assert goal.cancel()
            else:
                server.close()
            status = goal.result(timeout_s=10).status
            assert status is (GoalStatus.CANCELED if how == "cancel" else GoalStatus.ABORTED)
            assert seen.wait(10)
