"""What verbs share: the graph's address, QoS options, waiting for discovery."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from dataclasses import replace

import pytest
import typer

from ropeway.cli.session import OpenGraph, default_graph, find_topic, qos_of, settle, topic_name
from ropeway.errors import GraphUnavailable
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.rosbridge.client import RosbridgeGraph
from ropeway.qos import LATCHED, SENSOR_DATA, QoS
from tests.support.clock import Stopwatch
from tests.support.messages import STRING


def test_default_graph_follows_ros() -> None:
    """Without ``--graph`` the domain is the one ROS is told to use."""
    assert default_graph({}) == "dds:0"
    assert default_graph({"ROS_DOMAIN_ID": " 7 "}) == "dds:7"
    with pytest.raises(typer.Exit):
        default_graph({"ROS_DOMAIN_ID": "seven"})


def test_qos_options() -> None:
    """Options that are given change the profile that is named; none at all leave the choice to the graph."""
    assert qos_of("", None, "", "", "") is None
    assert qos_of("sensor_data", None, "", "", "") == SENSOR_DATA
    assert qos_of("", None, "", "best_effort", "", base=LATCHED) == replace(LATCHED, reliability="best_effort")
    assert qos_of("latched", 5, "", "", "") == QoS(durability="transient_local", depth=5)
    assert qos_of("", None, "keep_all", "best_effort", "") == QoS(history="keep_all", reliability="best_effort")
    assert LATCHED.transient_local


@pytest.mark.parametrize("options", [("fast", None, "", "", ""), ("", None, "", "sometimes", "")])
def test_wrong_qos_options(options: tuple[str, int | None, str, str, str], capsys: pytest.CaptureFixture[str]) -> None:
    """A wrong value ends with the valid ones."""
    with pytest.raises(typer.Exit) as ended:
        qos_of(*options)
    assert ended.value.exit_code == 2
    assert "reliable" in (said := capsys.readouterr().err) or "sensor_data" in said


def test_topic_names_are_made_absolute(capsys: pytest.CaptureFixture[str]) -> None:
    """A relative topic starts at the root; a wrong one ends with the rule it breaks."""
    assert topic_name("chatter") == "/chatter"
    with pytest.raises(typer.Exit):
        topic_name("a b")
    assert "part 'a b'" in capsys.readouterr().err


@pytest.mark.jumping
async def test_settle_ends_when_nothing_new_comes(pair: tuple[OpenGraph, OpenGraph]) -> None:
    """Discovery is over once something is there and the network is quiet."""
    here, there = pair
    await there.graph.create_publisher("/a", STRING)
    watch = Stopwatch()
    assert list(await settle(here.graph, 10.0)) == ["/a"]
    assert watch.seconds < 1.0


@pytest.mark.jumping
async def test_settle_is_bounded(pair: tuple[OpenGraph, OpenGraph]) -> None:
    """Where nothing is there, the wait ends in time."""
    watch = Stopwatch()
    assert await settle(pair[0].graph, 0.2) == {}
    assert watch.seconds == 0.2


async def test_settle_leaves_out_what_is_only_ours(pair: tuple[OpenGraph, OpenGraph]) -> None:
    """Our own ends are not part of the network."""
    here, _ = pair
    await here.graph.create_publisher("/mine", STRING)
    assert await settle(here.graph, 0.05) == {}


@pytest.mark.jumping
async def test_find_topic_returns_when_it_appears(pair: tuple[OpenGraph, OpenGraph]) -> None:
    """A topic that appears while we wait is found at once."""
    here, there = pair
    waiting = asyncio.create_task(find_topic(here.graph, "/late", 10.0, published=True))
    await asyncio.sleep(0.05)
    await there.graph.create_publisher("/late", STRING)
    watch = Stopwatch()
    found = await waiting
    assert found is not None
    assert found.type == STRING
    assert watch.seconds == 0
    assert await find_topic(here.graph, "/never", 0.05) is None


@pytest.mark.jumping
async def test_settle_waits_for_what_is_announced() -> None:
    """A quiet network where more is expected has not settled yet."""

    class Slow(MemoryGraph):
        settled = False

    graph, other = Slow("slow", node="/here"), MemoryGraph("slow", node="/there")
    async with AsyncExitStack() as stack:
        for part in (graph, other):
            await part.open()
            stack.push_async_callback(part.close)
        await other.create_publisher("/a", STRING)
        loop = asyncio.get_running_loop()
        loop.call_later(0.8, setattr, graph, "settled", True)
        watch = Stopwatch()
        assert list(await settle(graph, 10.0)) == ["/a"]
        assert 0.8 <= watch.seconds < 1.0


async def test_nothing_there(pair: tuple[OpenGraph, OpenGraph], capsys: pytest.CaptureFixture[str]) -> None:
    """An empty network is told as such; where nobody tells what there is, that is an error."""
    assert await settle(pair[0].graph, 0.0) == {}
    assert "nothing was discovered on" in capsys.readouterr().err
    graph = RosbridgeGraph("ws://127.0.0.1:9", wait=False)
    await graph.open()
    with pytest.raises(GraphUnavailable, match=r"ws://127\.0\.0\.1:9: "):
        await settle(graph, 0.0)
    await graph.close()
