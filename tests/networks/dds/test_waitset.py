"""The thread of a participant."""

from __future__ import annotations

import asyncio
import threading
import time

import pytest

from ropeway.errors import GraphUnavailable
from ropeway.graph.moderation import Moderation
from ropeway.networks.dds import waitset
from ropeway.networks.dds.waitset import run_in_thread
from ropeway.qos import QoS
from ropeway.tasks import failing
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample
from tests.support.threads import new_threads
from tests.support.until import until

from .conftest import Join


async def test_call(join: Join) -> None:
    """A function runs in the thread, and its result or error comes back."""
    pump = (await join()).participant.pump
    assert await pump.call(threading.get_ident) != threading.get_ident()
    with pytest.raises(ZeroDivisionError):
        await pump.call(lambda: 1 // 0)


async def test_call_after_stop(join: Join) -> None:
    """A call to a pump that has stopped fails, and waits for nothing."""
    graph = await join()
    pump = graph.participant.pump
    await graph.close()
    with pytest.raises(GraphUnavailable):
        await pump.call(lambda: None)


async def test_failing_handler(join: Join, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    """An endpoint that fails in the thread is told in the log once, and costs the others nothing."""
    near, far = await join("near"), await join("far")
    inbox = Inbox()
    await far.create_subscription("/good", STRING, QoS(), inbox)

    def broken() -> int:
        raise RuntimeError("no clock")

    bad = await far.create_subscription("/bad", STRING, QoS(), lambda _: None)
    monkeypatch.setattr(bad._readers[0].raw, "_clock", broken)
    publishers = [await near.create_publisher(topic, STRING) for topic in ("/bad", "/good")]
    await until(lambda: all(p.subscribers == 1 for p in publishers))
    for _ in range(3):
        for publisher in publishers:
            publisher.publish(sample("x"))
    await inbox.wait(3)
    assert len([r for r in caplog.records if "endpoint is dead" in r.message]) == 1


async def test_one_wake_up_per_burst(join: Join) -> None:
    """While the loop is busy, what arrives is joined into one batch per subscription."""
    near, far = await join("near"), await join("far")
    inbox = Inbox()
    await far.create_subscription("/t", STRING, QoS(depth=500), inbox)
    publisher = await near.create_publisher("/t", STRING, QoS(depth=500))
    await until(lambda: publisher.subscribers == 1)
    for _ in range(300):
        publisher.publish(sample("x"))
    time.sleep(0.3)  # noqa: ASYNC251 - the loop is busy, and the thread takes what comes
    await inbox.wait(300)
    assert inbox.batches < 30


async def test_thread_per_graph(join: Join) -> None:
    """A graph has one thread of its own, and none after it is closed."""
    started = new_threads()
    graph = await join()
    for i in range(10):
        await graph.create_subscription(f"/t{i}", STRING, QoS(), lambda _: None)
    assert len(started()) == 1
    await graph.close()
    assert not started()


async def test_cancelled_open(domain: int) -> None:
    """An open that is cancelled leaves no thread."""
    from ropeway.networks.dds import DdsGraph

    started = new_threads()
    task = asyncio.create_task(DdsGraph(domain, interface="lo").open())
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert not started()


async def test_run_in_thread() -> None:
    """A function in a thread of its own tells of its failure, and leaves no thread."""
    started = new_threads()
    await run_in_thread("test", lambda: None)
    with pytest.raises(ZeroDivisionError):
        await run_in_thread("test", lambda: 1 // 0)  # type: ignore[arg-type]
    assert not started()


async def test_thread_fails(join: Join, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    """When the thread fails as a whole, that is told, and it goes on where it was once the failure is over."""
    near, far = await join("near"), await join("far")
    inbox = Inbox()
    await far.create_subscription("/t", STRING, QoS(), inbox)
    publisher = await near.create_publisher("/t", STRING)
    await until(lambda: publisher.subscribers == 1)
    pump = far.participant.pump
    with monkeypatch.context() as patch:
        patch.setattr(pump, "_on_guard", None)
        pump._wake()
        await until(failing)
        assert "the DDS thread" in failing()[0]["task"]
    publisher.publish(sample("x"))
    await inbox.wait(1)
    assert not failing()
    assert await pump.call(lambda: 42) == 42
    assert any("it is started again" in record.message for record in caplog.records)


async def test_a_failed_thread_can_be_closed(join: Join, monkeypatch: pytest.MonkeyPatch) -> None:
    """A graph whose thread fails again and again is closed without a wait, and can be opened again."""
    graph = await join()
    await graph.create_publisher("/t", STRING)
    pump = graph.participant.pump
    with monkeypatch.context() as patch:
        patch.setattr(pump, "_on_guard", None)
        pump._wake()
        await until(failing)
        await graph.close()
    assert not failing()
    await graph.open()
    await graph.create_publisher("/t", STRING)


async def test_what_comes_during_a_rest_is_taken_together(join: Join, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the thread rests after each batch, what comes meanwhile is in the next one, and nothing is lost."""

    class Restful(Moderation):
        def look(self, samples: int) -> None:
            super().look(samples)
            self.rests = True

    monkeypatch.setattr(waitset, "Moderation", Restful)
    monkeypatch.setattr(waitset, "REST_S", 0.1)
    near, far = await join("near"), await join("far")
    inbox = Inbox()
    await far.create_subscription("/t", STRING, QoS(depth=500), inbox)
    publisher = await near.create_publisher("/t", STRING, QoS(depth=500))
    await until(lambda: publisher.subscribers == 1)
    for _ in range(300):
        publisher.publish(sample("x"))
        await asyncio.sleep(0)
    await inbox.wait(300)
    assert inbox.batches < 100
