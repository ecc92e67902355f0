"""Playing a recording: pace, repetition, stamps, bounds."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer as McapWriter

from ropeway.cli.session import OpenGraph
from ropeway.graph.base import Sample
from ropeway.qos import LATCHED, QoS
from ropeway.recording.bag import Bag, BagTopic, Record
from ropeway.recording.channel import Recorded, cdr_channel
from ropeway.recording.files import McapFiles
from ropeway.recording.player import PlaybackSchedule, Played, play, read_ahead, restamped
from ropeway.types import TypeRegistry
from tests.support.clock import Stopwatch
from tests.support.messages import STRING, text
from tests.support.until import until

POINT = "geometry_msgs/msg/PointStamped"
STEP_NS = 20_000_000


@pytest.fixture
def recording(tmp_path: Path, registry: TypeRegistry) -> Path:
    """Ten points 20 ms apart, and a text between each two of them."""
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start("ros2")
        numbers = {}
        for topic, type in (("/point", POINT), ("/text", STRING)):
            schema = writer.register_schema(type, "ros2msg", registry.full_text(type).encode())
            numbers[topic] = writer.register_channel(topic, "cdr", schema)
        for n in range(10):
            time_ns = 10**9 + n * STEP_NS
            payload = registry.codec(POINT).encode({"header": {"stamp": {"sec": n}}, "point": {"x": float(n)}})
            writer.add_message(numbers["/point"], time_ns, payload, time_ns)
            if n < 9:
                text = registry.codec(STRING).encode({"data": str(n)})
                writer.add_message(numbers["/text"], time_ns + STEP_NS // 2, text, time_ns)
        writer.finish()
    return path


@pytest.mark.jumping
async def test_everything_arrives_in_order_and_at_the_recorded_pace(
    pair: tuple[OpenGraph, OpenGraph], recording: Path, registry: TypeRegistry
) -> None:
    """The messages come as they were recorded, as far apart as they were."""
    here, there = pair
    got: list[Sample] = []
    came: list[float] = []
    watch = Stopwatch()

    def heard(batch: Sequence[Sample]) -> None:
        got.extend(batch)
        came.extend(watch.seconds for _ in batch)

    await here.graph.create_subscription("/point", POINT, None, heard)
    with Bag(recording, registry) as bag:
        played = await play(there.graph, bag)
    assert (played.messages, dict(played.by_topic)) == (19, {"/point": 10, "/text": 9})
    await until(lambda: len(got) == 10)
    codec = registry.codec(POINT)
    assert [codec.decode(s.payload)["point"]["x"] for s in got] == [float(n) for n in range(10)]
    assert [codec.header_stamp_ns(s.payload) for s in got] == [n * 10**9 for n in range(10)]
    assert came == pytest.approx([n * STEP_NS / 1e9 for n in range(10)])
    assert here.graph.topics()["/point"].publishers == ()


@pytest.mark.jumping
async def test_rate_and_topics(pair: tuple[OpenGraph, OpenGraph], recording: Path, registry: TypeRegistry) -> None:
    """Ten times the rate takes a tenth of the time; topics that are not named stay silent."""
    with Bag(recording, registry) as bag:
        watch = Stopwatch()
        played = await play(pair[1].graph, bag, rate=10, topics=["/text"])
    assert watch.seconds == pytest.approx(0.016)  # from the first text to the last
    assert dict(played.by_topic) == {"/text": 9}
    assert "/point" not in pair[0].graph.topics()


async def test_restamp(pair: tuple[OpenGraph, OpenGraph], recording: Path, registry: TypeRegistry) -> None:
    """Headers get the time of sending, the rest of a message stays as it was."""
    here, there = pair
    got: list[Sample] = []
    await here.graph.create_subscription("/point", POINT, None, got.extend)
    with Bag(recording, registry) as bag:
        await play(there.graph, bag, rate=10, restamp=True)
    await until(lambda: len(got) == 10)
    codec = registry.codec(POINT)
    assert all(codec.header_stamp_ns(s.payload) == s.stamp_ns for s in got)
    assert [codec.decode(s.payload)["point"]["x"] for s in got] == [float(n) for n in range(10)]


def test_restamped_keeps_the_byte_order(registry: TypeRegistry) -> None:
    """A big-endian message gets a big-endian stamp."""
    codec = registry.codec(POINT)
    little = codec.encode({})
    big = b"\0\0" + little[2:]
    for payload in (little, big):
        assert codec.header_stamp_ns(restamped(payload, 3_000_000_007)) == 3_000_000_007
        assert len(restamped(payload, 1)) == len(payload)


@pytest.mark.jumping
async def test_loop_until_the_time_is_over(
    pair: tuple[OpenGraph, OpenGraph], recording: Path, registry: TypeRegistry
) -> None:
    """A loop starts again with the usual gap and ends in time."""
    told: list[int] = []
    with Bag(recording, registry) as bag:
        watch = Stopwatch()
        played = await play(
            pair[1].graph, bag, loop=True, for_s=0.5, topics=["/point"], told=lambda p: told.append(p.messages)
        )
    assert watch.seconds == 0.5
    assert played.rounds == 2
    assert played.messages == 25
    assert told == list(range(1, played.messages + 1))


async def test_cancelling_closes_everything(
    pair: tuple[OpenGraph, OpenGraph], recording: Path, registry: TypeRegistry
) -> None:
    """A player that is cancelled withdraws its topics."""
    here, there = pair
    with Bag(recording, registry) as bag:
        running = asyncio.create_task(play(there.graph, bag, loop=True))
        await until(lambda: "/text" in here.graph.topics())
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running
    assert here.graph.topics() == {}


@pytest.mark.jumping
async def test_waits_for_readers(pair: tuple[OpenGraph, OpenGraph], recording: Path, registry: TypeRegistry) -> None:
    """The first message waits until each topic is read, and not for ever."""
    here, there = pair
    got: list[Sample] = []
    with Bag(recording, registry) as bag:
        running = asyncio.create_task(play(there.graph, bag, rate=10, wait_s=5.0, topics=["/point"]))
        await until(lambda: "/point" in here.graph.topics())
        await asyncio.sleep(0.05)
        await here.graph.create_subscription("/point", POINT, None, got.extend)
        assert (await running).messages == 10
        await until(lambda: len(got) == 10)
        watch = Stopwatch()
        await play(there.graph, bag, rate=10, wait_s=0.1, topics=["/text"])
        assert watch.seconds == pytest.approx(0.1 + 0.016)


async def test_reading_ahead_is_bounded() -> None:
    """Never more than two batches are held, however long the recording is."""
    topic = BagTopic("/x", "a/msg/B", 0)
    made = 0

    def records() -> Iterator[Record]:
        nonlocal made
        for n in range(100):
            made += 1
            yield Record(n, topic, bytes(1 << 20))

    used = 0
    async for batch in read_ahead(records()):
        assert sum(len(record.payload) for record in batch) <= 8 << 20
        used += len(batch)
        await asyncio.sleep(0.005)
        assert made - used <= 8
    assert used == 100


async def test_errors_of_the_recording_reach_the_player() -> None:
    """What goes wrong in the reading thread is raised where the records are used."""

    def records() -> Iterator[Record]:
        raise ZeroDivisionError
        yield

    with pytest.raises(ZeroDivisionError):
        async for _ in read_ahead(records()):
            pass


def test_played_starts_at_nothing() -> None:
    """A fresh count is zero."""
    assert (Played().messages, Played().rounds) == (0, 0)


SECOND = 10**9
STAMPS = st.one_of(st.integers(0, 2**64 - 1), st.integers(0, 10 * SECOND))


@given(st.lists(STAMPS, min_size=1, max_size=40))
def test_no_stamp_is_waited_for_for_ever(stamps: list[int]) -> None:
    """Whatever the stamps, no message is due long after the one before, and none before it."""
    pace = PlaybackSchedule(60.0)
    due = [pace.due(stamp) for stamp in stamps]
    assert all(0 <= after - before <= 60.0 for before, after in itertools.pairwise(due))
    assert due[0] == 0


def test_pauses_are_kept_up_to_a_limit() -> None:
    """Messages keep their distance, also those behind an impossible stamp, and what is skipped is counted."""
    pace = PlaybackSchedule(60.0)
    start = 1_700_000_000 * SECOND
    stamps = [0, start, start + SECOND, 2**63, start + 2 * SECOND, start + 4 * SECOND, start + 3 * SECOND]
    assert [pace.due(stamp) for stamp in stamps] == [0.0, 1.0, 2.0, 3.0, 3.0, 5.0, 5.0]
    assert pace.jumps == 3
    assert pace.longest_s > 7e9


@pytest.fixture
def latched_recording(tmp_path: Path, registry: TypeRegistry) -> Path:
    """A map that is latched, and points for a second behind it."""
    files = McapFiles(tmp_path / "latched.mcap")
    map_ = cdr_channel(registry, "/map", STRING, [LATCHED])
    points = cdr_channel(registry, "/text", STRING, [])
    files.write([Recorded(map_, 10**9, text("map"))])
    files.write(Recorded(points, 10**9 + n * 10**8, text(str(n))) for n in range(10))
    files.close()
    return files.paths[0]


@pytest.mark.jumping
async def test_from_the_middle(
    pair: tuple[OpenGraph, OpenGraph], latched_recording: Path, registry: TypeRegistry
) -> None:
    """With an offset what is latched comes first, then what was recorded from there on, under other names and QoS."""
    here, there = pair
    got: list[tuple[str, bytes]] = []
    for name in ("/map", "/renamed"):
        take = lambda batch, name=name: got.extend((name, one.payload) for one in batch)  # noqa: E731
        await here.graph.create_subscription(name, STRING, None, take)
    qos = QoS(reliability="best_effort")
    with Bag(latched_recording, registry) as bag:
        names = {"/text": "/renamed"}
        await play(there.graph, bag, start_s=0.75, offer=lambda _: qos, rename=lambda name: names.get(name, name))
    await until(lambda: len(got) == 3)
    assert got == [("/map", text("map")), ("/renamed", text("8")), ("/renamed", text("9"))]


@pytest.mark.jumping
async def test_clock(pair: tuple[OpenGraph, OpenGraph], latched_recording: Path, registry: TypeRegistry) -> None:
    """The time of the recording goes on evenly on /clock, twice as fast where it is played so."""
    here, there = pair
    ticks: list[float] = []
    clock = registry.codec("rosgraph_msgs/msg/Clock")

    def tick(batch: Sequence[Sample]) -> None:
        for one in batch:
            time_ = clock.decode(one.payload)["clock"]
            ticks.append(time_["sec"] + time_["nanosec"] / 1e9)

    await here.graph.create_subscription("/clock", "rosgraph_msgs/msg/Clock", None, tick)
    with Bag(latched_recording, registry) as bag:
        await play(there.graph, bag, clock_hz=100.0, rate=2.0)
    await until(lambda: len(ticks) > 30)
    assert ticks == sorted(ticks)
    assert 1.0 <= ticks[0] < 1.1
    assert 1.8 < ticks[-1] <= 1.91
