"""Two processes, so that messages cross the network stack."""

from __future__ import annotations

import asyncio
import hashlib
import os
import signal
import time

import pytest

from ropeway.graph.base import Sample
from ropeway.qos import LATCHED, SENSOR_DATA, QoS
from tests.support.clock import held_up
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample, text
from tests.support.threads import new_threads
from tests.support.until import PATIENCE_S, until

from .conftest import Join
from .helpers import process, stop

READER = """
    import hashlib
    async def main(domain, topic, count, qos):
        graph = DdsGraph(domain, name="reader", interface="lo")
        await graph.open()
        inbox = Inbox()
        await graph.create_subscription(topic, STRING, qos, inbox)
        print("ready", flush=True)
        await inbox.wait(count, 40)
        for sample in inbox.samples[:count]:
            print(sample.seq, len(sample.payload), hashlib.sha256(sample.payload).hexdigest(), flush=True)
        sys.stdin.readline()
        await graph.close()
    asyncio.run(main(int(sys.argv[1]), sys.argv[2], int(sys.argv[3]), QoS(depth=int(sys.argv[4]))))
"""


@pytest.mark.parametrize(("size", "count"), [(6_000_000, 5), (60_000_000, 1)])
async def test_big_messages(join: Join, domain: int, size: int, count: int) -> None:
    """Messages far beyond any socket buffer arrive whole, under their sequence numbers."""
    graph = await join()
    publisher = await graph.create_publisher("/cloud", STRING, QoS(depth=count))
    with process(READER, domain, "/cloud", count, count) as reader:
        assert reader.stdin is not None
        assert reader.stdout is not None
        await until(lambda: publisher.subscribers == 1)
        block = bytes(range(256)) * (size // 256)
        sent = []
        for i in range(count):
            payload = text(str(i)) + block
            stamp = time.time_ns()
            publisher.publish(Sample(payload, STRING, 0, bytes(16), stamp))
            sent.append(f"{stamp} {len(payload)} {hashlib.sha256(payload).hexdigest()}")
        assert reader.stdout.readline() == "ready\n"
        got = [reader.stdout.readline().strip() for _ in range(count)]
        print("", file=reader.stdin, flush=True)
        assert got == sent
        assert reader.wait(PATIENCE_S) == 0


WRITER = """
    async def main(domain):
        graph = DdsGraph(domain, name="writer", interface="lo", gateway_id="far")
        await graph.open()
        latched = await graph.create_publisher("/map", STRING, LATCHED)
        latched.publish(sample("map"))
        sensor = await graph.create_publisher("/scan", STRING, SENSOR_DATA)
        print("ready", flush=True)
        await until(lambda: sensor.subscribers == 1)
        sensor.publish(sample("scan"))
        await asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)
        await graph.close()
    asyncio.run(main(int(sys.argv[1])))
"""


async def test_late_joiner_and_best_effort(join: Join, domain: int) -> None:
    """History and best effort cross processes; a gateway's publisher is known by its mark, and seen to leave."""
    graph = await join()
    with process(WRITER, domain) as writer:
        assert writer.stdin is not None
        assert writer.stdout is not None
        assert writer.stdout.readline() == "ready\n"
        await until(lambda: {"/map", "/scan"} <= set(graph.topics()))
        for _ in range(2):
            inbox = Inbox()
            await graph.create_subscription("/map", STRING, LATCHED, inbox)
            (sample,) = await inbox.wait(1)
            assert sample.payload == text("map")
            assert sample.relayed
        inbox = Inbox()
        await graph.create_subscription("/scan", STRING, SENSOR_DATA, inbox)
        await inbox.wait(1)
        await until(lambda: graph.topics()["/map"].publishers[0].node == "/writer")
        assert graph.topics()["/map"].publishers[0].gateway == "far"
        print("", file=writer.stdin, flush=True)
        assert writer.wait(PATIENCE_S) == 0
        await until(lambda: "/writer" not in graph.nodes())
        await until(lambda: not graph.topics()["/map"].publishers)


async def test_keep_all_never_blocks(join: Join, domain: int) -> None:
    """A reader that has stopped costs a keep-all publisher messages, which are counted, and no time."""
    graph = await join()
    publisher = await graph.create_publisher("/t", STRING, QoS(history="keep_all"))
    with process(READER, domain, "/t", 10**9, 10) as reader:
        assert reader.stdout is not None
        await until(lambda: publisher.subscribers == 1)
        stop(reader)
        big = sample("x" * 1_000_000)
        for _ in range(60):
            with held_up() as seconds:
                publisher.publish(big)
            assert seconds() < 0.5
        assert sum(graph.drops.values()) > 0


async def test_close_beside_a_stopped_reader(join: Join, domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """While publishers wait a moment for a reader that has stopped, the graph goes on; all wait at the same time."""
    linger = "<WriterLingerDuration>30s</WriterLingerDuration>"
    longer = f"<CycloneDDS><Domain><Internal>{linger}</Internal></Domain></CycloneDDS>"
    monkeypatch.setenv("CYCLONEDDS_URI", f"{os.environ['CYCLONEDDS_URI']},{longer}")
    started = new_threads()

    def waiting() -> int:
        return sum(name.endswith(" linger") for name in started())

    graph, other = await join("near"), await join("other")
    publishers = [await graph.create_publisher("/t", STRING) for _ in range(5)]
    inbox = Inbox()
    await graph.create_subscription("/alive", STRING, QoS(), inbox)
    alive = await other.create_publisher("/alive", STRING)
    with process(READER, domain, "/t", 10**9, 10) as reader:
        await until(lambda: all(p.subscribers == 1 for p in publishers) and alive.subscribers == 1)
        stop(reader)
        for publisher in publishers:
            publisher.publish(sample("x"))
        closing = [asyncio.create_task(publishers.pop().close())]
        await until(lambda: waiting() == 1)
        alive.publish(sample("y"))
        await inbox.wait(1)
        assert waiting() == 1
        closing.append(asyncio.create_task(graph.close()))
        await until(lambda: waiting() >= 5)  # what tells of the node may have to wait, too
        reader.send_signal(signal.SIGCONT)
        await asyncio.gather(*closing)
