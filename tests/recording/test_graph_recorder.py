"""ropeway.recording.graph_recorder: which topics are recorded."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator

import pytest

from ropeway.networks.memory.graph import MemoryGraph
from ropeway.qos import LATCHED
from ropeway.recording.channel import Recorded
from ropeway.recording.condition import Condition
from ropeway.recording.graph_recorder import GraphRecorder, TopicChoice
from ropeway.types import TypeRegistry
from tests.support.messages import STRING, sample, text
from tests.support.until import until


@pytest.fixture
async def graphs(request: pytest.FixtureRequest) -> AsyncIterator[tuple[MemoryGraph, MemoryGraph]]:
    """A robot, and the participant that records it."""
    made = tuple(MemoryGraph(request.node.name, node=node) for node in ("/robot", "/recorder"))
    for graph in made:
        await graph.open()
    yield made[0], made[1]
    for graph in made:
        await graph.close()


@pytest.mark.parametrize(
    ("choice", "taken"),
    [
        (TopicChoice(["/camera/*"]), {"/camera/a", "/camera/_b"}),
        (TopicChoice(everything=True), {"/camera/a", "/scan"}),
        (TopicChoice(everything=True, hidden=True, excluded=["/scan"]), {"/camera/a", "/camera/_b"}),
        (TopicChoice(regex=re.compile("s.a")), {"/scan"}),
        (TopicChoice(), set()),
    ],
)
def test_choice(choice: TopicChoice, taken: set[str]) -> None:
    """Topics are chosen by name, pattern, regular expression or all of them; hidden ones only where asked for."""
    assert {name for name in ("/camera/a", "/camera/_b", "/scan") if choice.takes(name)} == taken


async def test_what_is_there_and_what_comes(graphs: tuple[MemoryGraph, MemoryGraph]) -> None:
    """Topics that are there, latched ones with what they have, and those that come later are recorded."""
    robot, here = graphs
    got: list[Recorded] = []
    (await robot.create_publisher("/latched", STRING, LATCHED)).publish(sample("before"))
    recorder = GraphRecorder(here, TypeRegistry(), TopicChoice(everything=True), got.append).start()
    await until(lambda: len(got) == 1)
    later = await robot.create_publisher("/later", STRING)
    await until(lambda: later.subscribers == 1)
    later.publish(sample("after"))
    await until(lambda: len(got) == 2)
    assert [(one.channel.topic, one.channel.latched, one.payload) for one in got] == [
        ("/latched", 1, text("before")),
        ("/later", 0, text("after")),
    ]
    await recorder.close()
    assert later.subscribers == 0


async def test_conditions(graphs: tuple[MemoryGraph, MemoryGraph]) -> None:
    """A condition on a topic triggers once when it becomes true; the topic is recorded only where it is chosen."""
    robot, here = graphs
    told: list[str] = []
    got: list[Recorded] = []
    conditions = [Condition("/state.data == lost")]
    recorder = GraphRecorder(
        here, TypeRegistry(), TopicChoice(["/other"]), got.append, conditions=conditions, triggered=told.append
    ).start()
    state, other = [await robot.create_publisher(name, STRING) for name in ("/state", "/other")]
    await until(lambda: state.subscribers == 1 and other.subscribers == 1)
    for value in ("well", "lost", "lost", "well", "lost"):
        state.publish(sample(value))
    other.publish(sample("x"))
    await until(lambda: len(told) == 2 and len(got) == 1)
    assert got[0].channel.topic == "/other"
    await recorder.close()


async def test_several_types(graphs: tuple[MemoryGraph, MemoryGraph]) -> None:
    """A topic that cannot be recorded is told with the reason."""
    robot, here = graphs
    for type in (STRING, "std_msgs/msg/Bool"):
        await robot.create_publisher("/x", type)
    recorder = GraphRecorder(here, TypeRegistry(), TopicChoice(everything=True), lambda message: None).start()
    await until(lambda: "/x" in recorder.refused)
    assert "several types" in recorder.refused["/x"]
    await recorder.close()
