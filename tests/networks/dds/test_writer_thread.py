"""Big messages, which a thread puts on the network."""

from __future__ import annotations

import threading
import time

import pytest

from ropeway.graph.base import Undelivered
from ropeway.networks.dds.writer_thread import Courier
from ropeway.qos import QoS
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample, text
from tests.support.threads import new_threads
from tests.support.until import PATIENCE_S, until

from .conftest import Join

BIG = "x" * (3 << 20)


async def test_order(join: Join) -> None:
    """Small messages do not overtake big ones of their topic."""
    started = new_threads()
    near, far = await join("near"), await join("far")
    inbox = Inbox()
    await far.create_subscription("/t", STRING, QoS(depth=100), inbox)
    publisher = await near.create_publisher("/t", STRING, QoS(depth=100))
    await until(lambda: publisher.subscribers == 1)
    sent = [f"{i}{BIG if i % 3 == 0 else ''}" for i in range(30)]
    for value in sent:
        publisher.publish(sample(value))
    await inbox.wait(len(sent))
    assert inbox.payloads == [text(value) for value in sent]
    assert len(started()) == 3  # one per graph, and the courier


async def test_one_errand_fails_alone(caplog: pytest.LogCaptureFixture) -> None:
    """An errand that fails is told, and those after it are run."""
    courier = Courier("test")
    done: list[int] = []
    courier.submit(lambda: done.append(1 // 0))
    courier.submit(lambda: done.append(1))
    await courier.stop()
    assert done == [1]
    assert "test: putting a message on the network failed" in caplog.messages


async def test_loop_goes_on(join: Join) -> None:
    """Publishing a message of 60 MB costs the loop next to nothing."""
    near, far = await join("near"), await join("far")
    inbox = Inbox()
    await far.create_subscription("/t", STRING, QoS(), inbox)
    publisher = await near.create_publisher("/t", STRING)
    await until(lambda: publisher.subscribers == 1)
    huge = sample("x" * 60_000_000)
    gate = threading.Event()
    near.participant.courier.submit(lambda: (gate.wait(PATIENCE_S), None)[1])
    began = time.thread_time()
    publisher.publish(huge)  # does not wait for the thread, which cannot do it yet
    assert time.thread_time() - began < 0.02
    gate.set()
    await inbox.wait(1)


async def test_newest_survive(join: Join) -> None:
    """Of more big messages than the network takes, the newest are sent and the others counted."""
    near, far = await join("near"), await join("far")
    inbox = Inbox()
    await far.create_subscription("/t", STRING, QoS(depth=100), inbox)
    publisher = await near.create_publisher("/t", STRING, QoS(depth=3))
    await until(lambda: publisher.subscribers == 1)
    samples = [sample(f"{i:04}{BIG}") for i in range(50)]
    for sent in samples:
        publisher.publish(sent)
    dropped = ("/t", Undelivered.WRITE)
    await until(lambda: len(inbox.samples) + near.drops[dropped] == 50)
    numbers = [int(p[8:12]) for p in inbox.payloads]
    assert numbers == sorted(numbers)
    assert numbers[-3:] == [47, 48, 49]
    assert near.drops[dropped] > 0
    assert not far.drops


async def test_close_sends_what_waits(join: Join) -> None:
    """A publisher that closes has sent what it was given."""
    near, far = await join("near"), await join("far")
    inbox = Inbox()
    await far.create_subscription("/t", STRING, QoS(depth=100), inbox)
    publisher = await near.create_publisher("/t", STRING)
    await until(lambda: publisher.subscribers == 1)
    for i in range(5):
        publisher.publish(sample(f"{i}{BIG}"))
    await publisher.close()
    await inbox.wait(5)


async def test_refusals_come_back(join: Join) -> None:
    """What turns out to be no CDR in the thread is counted, too."""
    graph = await join()
    publisher = await graph.create_publisher("/t", STRING)
    bad = sample("")
    bad.payload = b"\xff" * (2 << 20)
    publisher.publish(bad)
    await until(lambda: graph.drops == {("/t", Undelivered.ENCODE): 1})


async def test_without_errands() -> None:
    """A courier that was never needed has no thread, and ends at once."""
    started = new_threads()
    courier = Courier("test")
    await courier.flush()
    await courier.stop()
    done: list[int] = []
    courier.submit(lambda: done.append(1))
    await courier.flush()
    assert done == [1]
    await courier.stop()
    assert not started()
