"""ropeway.group.graph: machines on networks of their own, asked as one by a robot."""

from __future__ import annotations

import asyncio
import itertools
from collections import Counter
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ropeway.errors import CallFailed, GraphUnavailable, NotServed, ProviderLost
from ropeway.graph.base import Sample, Undelivered
from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Outcome, Request, ServerGoal
from ropeway.group.bound import LatencyBound
from ropeway.group.graph import Group, Policy
from ropeway.networks.memory.graph import MemoryGraph
from tests.support.messages import STRING, sample
from tests.support.services import ADD, addends, total
from tests.support.until import until

pytestmark = pytest.mark.jumping

FIBONACCI = "example_interfaces/action/Fibonacci"
BOUND = LatencyBound.of({"p90": 0.05})
_numbers = itertools.count()


def text(one: Sample) -> str:
    return one.payload[8:-1].decode()


class Link(MemoryGraph):
    """A link to a machine, which can be cut."""

    def __init__(self, network: str) -> None:
        super().__init__(network, node="/robot")
        self._callbacks: list[Callable[[bool], None]] = []

    def on_reached(self, callback: Callable[[bool], None]) -> None:
        self._callbacks.append(callback)
        callback(True)

    def reached(self, reached: bool) -> None:
        for callback in self._callbacks:
            callback(reached)


class Machine:
    """Answers on ``/output`` what was said on ``/input``, and adds, after ``latency_s``."""

    def __init__(self, name: str, latency_s: float) -> None:
        self.name, self.latency_s = name, latency_s
        self.network = f"group-{name}-{next(_numbers)}"
        self.graph = MemoryGraph(self.network, node=f"/{name}")
        self.heard: list[str] = []
        self.calls = 0
        self.fails = ""
        self.gone = asyncio.Event()

    async def start(self) -> None:
        await self.graph.open()
        self.output = await self.graph.create_publisher("/output", STRING)
        await self.graph.create_subscription("/input", STRING, None, self._arrived)
        self.service = await self.graph.create_service("/add", ADD, self._add)

    def _arrived(self, batch: Sequence[Sample]) -> None:
        for one in batch:
            self.heard.append(text(one))
            asyncio.get_running_loop().call_later(self.latency_s, self.say, f"{text(one)} by {self.name}")

    def say(self, words: str) -> None:
        self.output.publish(sample(words))

    async def _add(self, request: Request) -> bytes:
        self.calls += 1
        await asyncio.sleep(self.latency_s)
        if self.fails:
            raise CallFailed("/add", self.fails)
        return total(self.calls)


class Robot:
    """A robot with a group of machines."""

    def __init__(self, stack: AsyncExitStack) -> None:
        self.stack = stack
        self.machines: dict[str, Machine] = {}
        self.links: dict[str, Link] = {}
        self.heard: list[str] = []

    async def start(self, latencies: dict[str, float], **options: Any) -> Group:
        for name, latency_s in latencies.items():
            machine = self.machines[name] = Machine(name, latency_s)
            await machine.start()
            self.stack.push_async_callback(machine.graph.close)
            self.links[name] = Link(machine.network)
        given: dict[str, Any] = {"exchanges": {"/input": "/output"}, "bound": BOUND} | options
        self.group = Group(self.links, **given)
        await self.group.open()
        self.stack.push_async_callback(self.group.close)
        self.input = await self.group.create_publisher("/input", STRING)
        await self.group.create_subscription("/output", STRING, None, lambda batch: self.heard.extend(map(text, batch)))
        self.client = await self.group.create_client("/add", ADD)
        return self.group

    async def ask(self, count: int, period_s: float = 0.011) -> None:
        """Publish so many requests."""
        for _ in range(count):
            self.input.publish(sample(f"r{next(_numbers)}"))
            await asyncio.sleep(period_s)

    def asked(self) -> Counter[str]:
        """How many requests each machine has got."""
        return Counter({name: len(machine.heard) for name, machine in self.machines.items()})


@pytest.fixture
async def robot() -> AsyncIterator[Robot]:
    async with AsyncExitStack() as stack:
        yield Robot(stack)


async def test_one_of_two(robot: Robot) -> None:
    """Of two replicas exactly one gets each request, and each request is answered once."""
    group = await robot.start({"edge1": 0.02, "edge2": 0.03})
    await robot.ask(50)
    await asyncio.sleep(0.1)
    assert sum(robot.asked().values()) == 50
    assert len(robot.heard) == 50
    assert group.scheduler.current == "edge1"


async def test_the_best_is_found(robot: Robot) -> None:
    """After a moment with each, requests go to the machine that is fastest."""
    await robot.start({"cloud": 0.045, "edge1": 0.03, "edge2": 0.01})
    await robot.ask(100)
    assert robot.group.scheduler.current == "edge2"
    assert robot.asked()["edge2"] > 60


async def test_a_machine_becomes_slow(robot: Robot) -> None:
    """A machine that misses the bound is left for another, and of what both were asked one answer is heard."""
    await robot.start({"edge1": 0.01, "edge2": 0.02}, stateless=True)
    await robot.ask(60)
    robot.machines["edge1"].latency_s = 0.08
    await robot.ask(60)
    await asyncio.sleep(0.2)
    assert robot.group.scheduler.current == "edge2"
    asked = [words.partition(" by ")[0] for words in robot.heard]
    assert len(asked) == len(set(asked))
    assert robot.group.drops["/output", Undelivered.ANSWERED] + robot.group.drops["/output", Undelivered.OUTDATED] > 0


async def test_a_machine_is_cut_off(robot: Robot) -> None:
    """When the link to the machine in use goes, the next request goes to another; when it is back, nothing changes."""
    await robot.start({"edge1": 0.01, "edge2": 0.02})
    await robot.ask(40)
    robot.links["edge1"].reached(False)
    await robot.ask(10)
    assert robot.group.scheduler.current == "edge2"
    robot.links["edge1"].reached(True)
    await robot.ask(10)
    assert robot.group.scheduler.current == "edge2"


async def test_nobody_is_there(robot: Robot) -> None:
    """With all machines gone, requests are dropped and counted, and go on with the first that is back."""
    await robot.start({"edge1": 0.01, "edge2": 0.02})
    for link in robot.links.values():
        link.reached(False)
    await robot.ask(5)
    assert robot.group.drops["/input", Undelivered.NOBODY] == 5
    robot.links["edge2"].reached(True)
    await robot.ask(5)
    assert robot.asked() == {"edge1": 0, "edge2": 5}


async def test_members_without_the_topic(robot: Robot) -> None:
    """What no member has a publisher for, as none has come back yet, is dropped and counted."""
    await robot.start({"edge1": 0.01, "edge2": 0.02})
    for name in robot.links:
        await robot.input.remove(name)
    await robot.ask(3)
    assert robot.group.drops["/input", Undelivered.NOBODY] == 3


async def test_standby_says_nothing(robot: Robot) -> None:
    """What a machine that is not in use publishes unasked is dropped, and counted."""
    await robot.start({"edge1": 0.01, "edge2": 0.02})
    robot.machines["edge1"].say("from edge1")
    robot.machines["edge2"].say("from edge2")
    await until(lambda: robot.group.drops["/output", Undelivered.STANDBY] == 1)
    assert robot.heard == ["from edge1"]


async def test_hedge(robot: Robot) -> None:
    """A second machine is asked once the first takes longer than it usually does, and the first answer wins."""
    await robot.start({"edge1": 0.01, "edge2": 0.02}, policy=Policy.HEDGE, stateless=True, bound=LatencyBound())
    await robot.ask(50)
    await asyncio.sleep(0.1)
    before = robot.asked()
    assert before["edge2"] <= 5
    robot.machines["edge1"].latency_s = 10.0
    await robot.ask(5)
    await asyncio.sleep(0.1)
    assert robot.asked()["edge2"] == before["edge2"] + 5
    assert [words for words in robot.heard if words.endswith("edge2")][-1:] != []
    assert len(robot.heard) == 55


async def test_all(robot: Robot) -> None:
    """Every machine gets each request, and one answer to each is heard."""
    await robot.start({"edge1": 0.02, "edge2": 0.01, "cloud": 0.03}, policy=Policy.ALL, stateless=True)
    await robot.ask(20)
    await asyncio.sleep(0.1)
    assert robot.asked() == {"edge1": 20, "edge2": 20, "cloud": 20}
    assert len(robot.heard) == 20
    assert all(words.endswith("edge2") for words in robot.heard)


@pytest.mark.parametrize("policy", [Policy.HEDGE, Policy.ALL])
def test_only_stateless(policy: Policy) -> None:
    """A policy that asks several says that requests may then be carried out more than once, and how to allow it."""
    with pytest.raises(ValueError, match='write "stateless": true'):
        Group({"a": MemoryGraph("x")}, policy=policy)


async def test_calls(robot: Robot) -> None:
    """Each call is carried out by one machine, and its latency is known without being asked for."""
    group = await robot.start({"edge1": 0.02, "edge2": 0.03})
    for _ in range(10):
        await robot.client.call(Request(addends(1)))
    assert sum(machine.calls for machine in robot.machines.values()) == 10
    found = group.scheduler.window(group.scheduler.current).statistics(group.now())
    assert found is not None
    assert found.answered


async def test_hedged_calls(robot: Robot) -> None:
    """A call that hangs on one machine is answered by the next within the usual time, and exactly once."""
    await robot.start({"edge1": 0.01, "edge2": 0.02}, policy=Policy.HEDGE, stateless=True, bound=LatencyBound())
    for _ in range(20):
        await robot.client.call(Request(addends(1)))
    robot.machines["edge1"].latency_s = 60.0
    loop = asyncio.get_running_loop()
    began = loop.time()
    await robot.client.call(Request(addends(1)))
    assert loop.time() - began < 0.05
    assert robot.machines["edge2"].calls >= 1


async def test_both_answer_at_once(robot: Robot) -> None:
    """Two answers in the same turn of the loop are one answer."""
    await robot.start({"edge1": 0.02, "edge2": 0.02}, policy=Policy.ALL, stateless=True)
    for _ in range(5):
        await robot.client.call(Request(addends(1)))
    calls = {name: machine.calls for name, machine in robot.machines.items()}
    assert sum(calls.values()) == 10 and calls["edge2"] >= 5  # the first robot profiles both


async def test_a_provider_dies(robot: Robot) -> None:
    """A call whose machine dies goes on with another where it may be carried out twice, and else fails at once."""
    for stateless in (True, False):
        made = Robot(robot.stack)
        await made.start({"edge1": 30.0, "edge2": 0.01}, stateless=stateless, bound=LatencyBound())
        call = asyncio.create_task(made.client.call(Request(addends(1)), 10.0))
        await until(lambda made=made: made.machines["edge1"].calls == 1)
        await made.machines["edge1"].service.close()
        if stateless:
            await call
        else:
            with pytest.raises(ProviderLost):
                await call
        assert made.machines["edge2"].calls == stateless


async def test_a_refusal_is_an_answer(robot: Robot) -> None:
    """What a machine says against a call is its answer, and no other machine is asked."""
    await robot.start({"edge1": 0.01, "edge2": 0.01}, stateless=True)
    robot.machines["edge1"].fails = "too heavy"
    with pytest.raises(CallFailed, match="too heavy"):
        await robot.client.call(Request(addends(1)))
    assert robot.machines["edge2"].calls == 0


async def test_not_served(robot: Robot) -> None:
    """A service that no machine has is not served, and one that only the second has is called there."""
    await robot.start({"edge1": 0.01, "edge2": 0.01})
    client = await robot.group.create_client("/nothing", ADD)
    with pytest.raises(NotServed):
        await client.call(Request(addends(1)), 0.1)
    await robot.machines["edge1"].service.close()
    await robot.client.call(Request(addends(1)))
    assert robot.machines["edge2"].calls == 1


async def test_a_goal_stays(robot: Robot) -> None:
    """A goal stays with the machine that accepted it, with its feedback and its end, whoever is in use by then."""
    await robot.start({"edge1": 0.01, "edge2": 0.01})
    begun = asyncio.Event()

    async def execute(goal: ServerGoal) -> Outcome:
        begun.set()
        goal.feedback(b"\0\1\0\0" + bytes(4))
        await goal.cancelled.wait()
        return Outcome(GoalStatus.CANCELED, b"\0\1\0\0" + bytes(4))

    await robot.machines["edge1"].graph.create_action_server("/fibonacci", FIBONACCI, ActionHandlers(execute))
    other = asyncio.Event()

    async def never(goal: ServerGoal) -> Outcome:
        other.set()
        return Outcome(GoalStatus.SUCCEEDED)

    await robot.machines["edge2"].graph.create_action_server("/fibonacci", FIBONACCI, ActionHandlers(never))
    client = await robot.group.create_action_client("/fibonacci", FIBONACCI)
    assert await client.wait_available(1.0)
    feedback: list[bytes] = []
    goal = await client.send_goal(Goal(b"\0\1\0\0" + bytes(4)), on_feedback=feedback.append)
    await begun.wait()
    robot.group.scheduler.switch("edge2", robot.group.now())
    assert await goal.cancel()
    assert (await goal.result(5.0)).status is GoalStatus.CANCELED
    await until(lambda: len(feedback) == 1)
    assert not other.is_set()


async def test_discovery(robot: Robot) -> None:
    """A group shows what any of its machines has, each name once."""
    group = await robot.start({"edge1": 0.01, "edge2": 0.01})
    assert {"/input", "/output"} <= set(group.topics())
    assert len(group.topics()["/output"].publishers) == 2
    assert len(group.services()["/add"].servers) == 2
    assert {"/edge1", "/edge2"} <= set(group.nodes())
    assert group.actions() == {}


async def test_status(robot: Robot) -> None:
    """Status says who is in use and why, what is known of each machine, and how answers were paired."""
    group = await robot.start({"edge1": 0.01, "edge2": 0.02})
    await robot.ask(40)
    await asyncio.sleep(0.1)
    status = group.status()
    assert (status["policy"], status["current"]) == ("one", "edge1")
    assert status["members"]["edge1"]["standing"] == "met"
    assert sum(status["paired"]["/output"].values()) == len(robot.heard)


async def test_members_that_cannot_be_opened(robot: Robot) -> None:
    """A member that cannot be opened is left out with a warning; without any the group cannot be opened."""

    class Broken(MemoryGraph):
        async def open(self) -> None:
            raise GraphUnavailable(self.name, "no such network")

    machine = Machine("edge1", 0.01)
    await machine.start()
    robot.stack.push_async_callback(machine.graph.close)
    group = Group({"broken": Broken("b"), "edge1": Link(machine.network)})
    await group.open()
    assert group.scheduler.here == ["edge1"]
    client = await group.create_client("/add", ADD)
    await client.call(Request(addends(1)))
    await group.close()
    with pytest.raises(GraphUnavailable, match="no such network"):
        await Group({"broken": Broken("b")}).open()
    with pytest.raises(GraphUnavailable):
        await group.create_client("/add", ADD)


async def test_two_robots_on_one_pool(robot: Robot) -> None:
    """Each robot chooses for itself, and hears the answers to its own requests only once."""
    await robot.start({"edge1": 0.01, "edge2": 0.02})
    other = Robot(robot.stack)
    other.machines = robot.machines
    other.links = {name: Link(machine.network) for name, machine in robot.machines.items()}
    other.group = Group(other.links, exchanges={"/input": "/output"})
    await other.group.open()
    robot.stack.push_async_callback(other.group.close)
    client = await other.group.create_client("/add", ADD)
    other.group.scheduler.switch("edge2", other.group.now())
    answers = await asyncio.gather(
        *(client.call(Request(addends(1))) for _ in range(5)),
        *(robot.client.call(Request(addends(1))) for _ in range(5)),
    )
    assert len(answers) == 10
    calls = {name: machine.calls for name, machine in robot.machines.items()}
    assert sum(calls.values()) == 10
    assert calls["edge2"] >= 5  # the first robot profiles both
