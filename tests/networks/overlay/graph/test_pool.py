"""Groups of members of the overlay: which are members, and that what is for one goes to no other."""

from __future__ import annotations

import asyncio
import itertools
from collections import Counter
from collections.abc import AsyncIterator, Sequence
from typing import Any

import pytest

from ropeway.errors import NotServed
from ropeway.graph.base import Sample, Undelivered
from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Outcome, Request, ServerGoal
from ropeway.group.graph import Group
from ropeway.group.topics import GroupPublisher
from ropeway.networks.overlay import node
from ropeway.networks.overlay.graph import OverlayGraph
from ropeway.networks.overlay.graph.pool import OverlayPool
from ropeway.networks.overlay.known_gateway import KnownGateway
from ropeway.networks.overlay.membership import Membership
from ropeway.networks.overlay.node import OverlayNode
from ropeway.qos import LATCHED, QoS
from tests.networks.overlay.conftest import Site
from tests.networks.overlay.conftest import site as site
from tests.networks.overlay.fleet import member
from tests.support.actions import order, sequence
from tests.support.messages import STRING, sample
from tests.support.services import ADD, addends, total
from tests.support.until import until

DEEP = QoS(depth=500)  # what waits for its turn is not replaced
FIBONACCI = "example_interfaces/action/Fibonacci"


def text(one: Sample) -> str:
    return one.payload[8:-1].decode()


class Machine:
    """Answers on ``/output`` what was said on ``/input``, and adds."""

    def __init__(self, graph: OverlayGraph) -> None:
        self.graph = graph
        self.name = graph.node.identity.name
        self.heard: list[str] = []
        self.calls = 0
        self.slow = False  # answers when it is told to
        self.goals: list[ServerGoal] = []

    async def start(self) -> None:
        self.output = await self.graph.create_publisher("/output", STRING)
        self.input = await self.graph.create_subscription("/input", STRING, None, self._arrived)
        self.service = await self.graph.create_service("/add", ADD, self._add)
        handlers = ActionHandlers(execute=self._execute)
        self.action = await self.graph.create_action_server("/count", FIBONACCI, handlers)

    def _arrived(self, batch: Sequence[Sample]) -> None:
        for one in batch:
            self.heard.append(text(one))
            if not self.slow:
                self.answer(text(one))

    def answer(self, words: str) -> None:
        self.output.publish(sample(f"{words} by {self.name}"))

    async def _add(self, request: Request) -> bytes:
        self.calls += 1
        return total(self.calls)

    async def _execute(self, goal: ServerGoal) -> Outcome:
        self.goals.append(goal)
        while not goal.cancelled.is_set():
            goal.feedback(sequence(1))
            await asyncio.sleep(0.05)
        return Outcome(GoalStatus.CANCELED, sequence(5))


class Team:
    """Robots and machines at one router."""

    def __init__(self, site: Site) -> None:
        self.site = site
        self.machines: dict[str, Machine] = {}
        self._numbers = itertools.count()

    async def machine(self, name: str = "edge") -> Machine:
        machine = Machine(await self.site.join(member(name)))
        await machine.start()
        self.machines[machine.name] = machine
        return machine

    async def robot(self, **options: Any) -> Group:
        patterns = options.pop("members", ("*",))
        common = OverlayGraph(OverlayNode(member("robot"), routers=[self.site.endpoint], listen=()))
        exchanges = options.pop("exchanges", {"/input": "/output"})
        group = Group({}, roster=OverlayPool(common, patterns, exchanges), exchanges=exchanges, **options)
        await group.open()
        self.site.stack.push_async_callback(group.close)
        return group

    def heard(self) -> Counter[str]:
        return Counter({name: len(machine.heard) for name, machine in self.machines.items()})


@pytest.fixture
async def team(site: Site) -> AsyncIterator[Team]:
    yield Team(site)


async def ready(group: Group, count: int) -> None:
    await until(lambda: len(group.scheduler.here) == count)


def read_by_all(publisher: GroupPublisher) -> bool:
    """Return whether every member reads a topic: one that does not yet is passed over."""
    return all(part.subscribers for part in publisher._parts.values())


async def test_one_of_two(team: Team) -> None:
    """Of two members exactly one gets each message, from the first on, and each is answered once."""
    await team.machine()
    await team.machine()
    group = await team.robot()
    heard: list[str] = []
    input = await group.create_publisher("/input", STRING, DEEP)
    await group.create_subscription("/output", STRING, None, lambda batch: heard.extend(map(text, batch)))
    await until(lambda: len(group.scheduler.here) == 2 and read_by_all(input))
    for number in range(50):
        input.publish(sample(f"r{number}"))
        await asyncio.sleep(0.002)
    await until(lambda: len(heard) == 50)
    assert sorted(team.heard().values()) == [0, 50]
    for machine in team.machines.values():
        assert machine.graph.node.rpc.counts["history"] == 0


async def test_nothing_is_fetched_by_others(team: Team) -> None:
    """What is sent to one member reaches no other, whatever that reads, and no other asks for a key."""
    first, second = await team.machine(), await team.machine()
    packets: list[str] = []
    end = second.graph.node.fabric.subscribe("rw/d/*/*", lambda key, *_: packets.append(key))
    group = await team.robot(members=[first.name])
    input = await group.create_publisher("/input", STRING, DEEP)
    await until(lambda: input.subscribers == 1)
    for number in range(20):
        input.publish(sample(str(number)))
    await until(lambda: len(first.heard) == 20)
    end()
    own = {first.output.advert.endpoint.hex()}  # answers, which anybody may read
    assert {key.split("/")[3] for key in packets} <= own
    assert not second.heard
    gateway = group._roster.common.node.gateway
    assert second.graph.node.rib.count(gateway) == 0
    assert first.graph.node.rib.count(gateway) == 1


async def test_a_new_member_gets_no_old_requests(team: Team) -> None:
    """What was latched for one member is not sent again to one that comes later and takes over."""
    first = await team.machine()
    group = await team.robot()
    input = await group.create_publisher("/input", STRING, LATCHED)
    await until(lambda: input.subscribers == 1)
    input.publish(sample("old"))
    await until(lambda: first.heard == ["old"])
    second = await team.machine()
    await ready(group, 2)
    await first.input.close()
    await until(lambda: group.scheduler.current == second.name)
    await until(lambda: input.subscribers == 1)
    input.publish(sample("new"))
    await until(lambda: second.heard == ["new"])
    assert first.heard == ["old"]


async def test_a_switch_in_a_burst(team: Team) -> None:
    """A switch in the middle of a burst loses nothing, repeats nothing and keeps the order at each member."""
    machines = [await team.machine(), await team.machine()]
    group = await team.robot(exchanges={})
    input = await group.create_publisher("/input", STRING, DEEP)
    await ready(group, 2)
    await until(lambda: all(part.subscribers == 1 for part in input._parts.values()))
    for number in range(200):
        if number % 50 == 49:
            other = next(name for name in group.scheduler.here if name != group.scheduler.current)
            group.scheduler.switch(other, group.now())
        input.publish(sample(f"{number:03}"))
        await asyncio.sleep(0)
    await until(lambda: team.heard().total() == 200)
    assert sorted(itertools.chain(*(machine.heard for machine in machines))) == [f"{n:03}" for n in range(200)]
    for machine in machines:
        assert machine.heard == sorted(machine.heard)
        assert machine.heard


async def test_calls_follow_the_scheduler(team: Team) -> None:
    """A call goes to the member in use, and after a switch to the other."""
    await team.machine()
    await team.machine()
    group = await team.robot()
    client = await group.create_client("/add", ADD)
    await ready(group, 2)
    await client.call(Request(addends(1)))
    first = group.scheduler.current
    assert team.machines[first].calls == 1
    other = next(name for name in group.scheduler.here if name != first)
    group.scheduler.switch(other, group.now())
    await client.call(Request(addends(1)))
    assert team.machines[other].calls == 1
    assert team.machines[first].calls == 1


async def test_a_goal_stays_where_it_was_accepted(team: Team) -> None:
    """Feedback, cancellation and outcome are those of the member that accepted the goal, whoever is in use by then."""
    await team.machine()
    await team.machine()
    group = await team.robot()
    client = await group.create_action_client("/count", FIBONACCI)
    await ready(group, 2)
    fed: list[bytes] = []
    goal = await client.send_goal(Goal(order(3)), on_feedback=fed.append)
    first = group.scheduler.current
    group.scheduler.switch(next(name for name in group.scheduler.here if name != first), group.now())
    await until(lambda: len(fed) >= 2)
    assert await goal.cancel()
    outcome = await goal.result(5.0)
    assert outcome.status is GoalStatus.CANCELED
    assert {name: len(machine.goals) for name, machine in team.machines.items() if machine.goals} == {first: 1}


async def test_a_member_that_lacks_a_name(team: Team) -> None:
    """A member that offers fewer of the names than another stands by, and is used when the other has gone."""
    whole, part = await team.machine(), await team.machine()
    await part.service.close()
    group = await team.robot()
    input, client = await group.create_publisher("/input", STRING, DEEP), await group.create_client("/add", ADD)
    await until(lambda: group.scheduler.here == [whole.name] and input.subscribers == 1)
    await whole.graph.close()
    await until(lambda: group.scheduler.here == [part.name])
    with pytest.raises(NotServed):
        await client.call(Request(addends(1)), 0.2)
    input.publish(sample("on"))
    await until(lambda: part.heard == ["on"])


async def test_nobody_and_then_somebody(team: Team) -> None:
    """Without members messages are dropped and counted, and a call waits for the first that comes."""
    group = await team.robot()
    input, client = await group.create_publisher("/input", STRING, DEEP), await group.create_client("/add", ADD)
    assert input.subscribers == 0
    assert client.available is False
    input.publish(sample("lost"))
    assert group.drops["/input", Undelivered.NOBODY] == 1
    call = asyncio.create_task(client.call(Request(addends(1)), 20.0))
    machine = await team.machine()
    await call
    assert machine.calls == 1
    await until(lambda: input.subscribers == 1)


async def test_patterns(team: Team) -> None:
    """Only those whose certificates have a name that fits a pattern are members."""
    await team.machine("edge")
    await team.machine("toy")
    group = await team.robot(members=["edge*", "cloud*"])
    await group.create_publisher("/input", STRING, DEEP)
    await ready(group, 1)
    assert group.scheduler.here[0].startswith("edge")


async def test_a_machine_dies_in_mid_goal(team: Team) -> None:
    """When the member that has accepted a goal leaves, the goal is aborted at once, and goes to no other."""
    machines = [await team.machine(), await team.machine()]
    group = await team.robot()
    client = await group.create_action_client("/count", FIBONACCI)
    await ready(group, 2)
    goal = await client.send_goal(Goal(order(3)))
    dying = next(machine for machine in machines if machine.goals)
    await dying.graph.close()
    outcome = await goal.result(10.0)
    assert outcome.status is GoalStatus.ABORTED
    assert sum(len(machine.goals) for machine in machines) == 1


async def test_a_member_that_flaps(team: Team) -> None:
    """A member that comes and goes is left the first time, and not returned to while the other serves."""
    steady = await team.machine()
    flapping = await team.machine()
    group = await team.robot()
    client = await group.create_client("/add", ADD)
    await ready(group, 2)
    group.scheduler.switch(flapping.name, group.now())
    before = group.scheduler.decided
    for _ in range(5):
        await flapping.service.close()
        await ready(group, 1)
        await client.call(Request(addends(1)))
        flapping.service = await flapping.graph.create_service("/add", ADD, flapping._add)
        await ready(group, 2)
        await client.call(Request(addends(1)))
    assert steady.calls == 10
    changes = [d for d in list(group.scheduler.decisions)[before:] if d.before != d.after]
    assert len(changes) == 1


async def test_late_answers(team: Team) -> None:
    """An answer of a member that was left, to a request older than one that its successor has answered, is dropped."""
    first, second = await team.machine(), await team.machine()
    group = await team.robot()
    heard: list[str] = []
    input = await group.create_publisher("/input", STRING, DEEP)
    await group.create_subscription("/output", STRING, None, lambda batch: heard.extend(map(text, batch)))
    await ready(group, 2)
    await until(lambda: all(part.subscribers == 1 for part in input._parts.values()))
    await until(lambda: first.output.subscribers == 1 and second.output.subscribers == 1)
    group.scheduler.switch(first.name, group.now())
    first.slow = True
    input.publish(sample("old"))
    await until(lambda: first.heard == ["old"])
    group.scheduler.switch(second.name, group.now())
    input.publish(sample("new"))
    await until(lambda: heard == [f"new by {second.name}"])
    first.answer("old")
    await until(lambda: group.drops["/output", Undelivered.OUTDATED] == 1)
    assert heard == [f"new by {second.name}"]


async def test_garbage(team: Team) -> None:
    """A member that answers with what is no message of the type costs nobody else anything, and is asked no less."""
    machine = await team.machine()
    group = await team.robot()
    heard: list[bytes] = []
    input = await group.create_publisher("/input", STRING, DEEP)
    await group.create_subscription("/output", STRING, None, lambda batch: heard.extend(one.payload for one in batch))
    await until(lambda: input.subscribers == 1 and machine.output.subscribers == 1)
    machine.slow = True
    input.publish(sample("a"))
    await until(lambda: machine.heard == ["a"])
    machine.output.publish(Sample(b"\xff", STRING, 1, bytes(16), 1))
    await until(lambda: heard == [b"\xff"])
    machine.slow = False
    input.publish(sample("b"))
    await until(lambda: len(heard) == 2)


class OldMembership(Membership):
    """Tells and reads what members did before there were targets."""

    def _note(self, kind: str, body: Any) -> bytes:
        return super()._note(kind, {key: part for key, part in body.items() if key not in ("aims", "at", "to")})

    def _read(self, raw: bytes, gateway: bytes, kind: str, known: KnownGateway) -> dict[str, Any] | None:
        body = super()._read(raw, gateway, kind, known)
        return None if body is None else {key: part for key, part in body.items() if key not in ("at", "to")}


async def test_older_members(team: Team, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two members that know no targets are a group as well: one gets each message, and the other gets no key for it."""
    monkeypatch.setattr(node, "Membership", OldMembership)
    old = [await team.machine(), await team.machine()]
    monkeypatch.undo()
    new = await team.machine()
    group = await team.robot()
    input = await group.create_publisher("/input", STRING, DEEP)
    await ready(group, 3)
    await until(lambda: all(part.subscribers == 1 for part in input._parts.values()))
    for machine in (*old, new):
        group.scheduler.switch(machine.name, group.now())
        for number in range(10):
            input.publish(sample(f"{machine.name} {number}"))
        await until(lambda machine=machine: len(machine.heard) == 10)
    for machine in (*old, new):
        assert machine.heard == [f"{machine.name} {number}" for number in range(10)]


async def test_answers_go_to_who_asked(team: Team) -> None:
    """Of two robots that use one machine each gets the answers to its own requests; who only reads gets them all."""
    machine = await team.machine()
    heard: dict[str, list[str]] = {"a": [], "b": [], "viewer": []}
    viewer = await team.site.join()
    await viewer.create_subscription("/output", STRING, None, lambda batch: heard["viewer"].extend(map(text, batch)))
    inputs = {}
    for name in ("a", "b"):
        group = await team.robot()
        inputs[name] = await group.create_publisher("/input", STRING, DEEP)
        await group.create_subscription(
            "/output", STRING, None, lambda batch, name=name: heard[name].extend(map(text, batch))
        )
    answers = machine.output._answers
    await until(lambda: answers is not None and len(list(answers.ready())) == 2 and machine.output.subscribers == 3)
    await until(lambda: all(input.subscribers == 1 for input in inputs.values()))
    for number in range(10):
        for name, input in inputs.items():
            input.publish(sample(f"{name}{number}"))
            await until(lambda name=name, number=number: len(heard[name]) == number + 1)
    for name in inputs:
        assert heard[name] == [f"{name}{number} by {machine.name}" for number in range(10)]
    await until(lambda: len(heard["viewer"]) == 20)
    machine.output.publish(sample("unasked"))
    await until(lambda: all(words[-1] == "unasked" for words in heard.values()))
