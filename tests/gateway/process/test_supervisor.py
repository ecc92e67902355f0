"""ropeway.gateway.process.supervisor: slices of a configuration in processes that fall and come back."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import os
import signal
import socket
import sys
import time
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import psutil
import pytest

from ropeway import processor_queue
from ropeway.errors import ConfigError, ConnectFailed, GraphUnavailable
from ropeway.gateway.config import config
from ropeway.gateway.process import supervisor as supervisor_module
from ropeway.gateway.process.changes import commit, prepare
from ropeway.gateway.process.questions import Question
from ropeway.gateway.process.supervisor import Supervisor, places, slices
from ropeway.gateway.process.worker_process import WorkerProcess
from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.hub.hub import Hub
from ropeway.networks.dds import DdsGraph
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.rosbridge.server import RosbridgeServer
from ropeway.qos import QoS
from ropeway.types import TypeRegistry
from tests.support.messages import STRING, text
from tests.support.ports import free_port
from tests.support.until import PATIENCE_S, until
from tests.support.websocket import Client

_domains = itertools.cycle(range(100, 110))
_numbers = itertools.count()
HZ = 50.0
DEPTH = 5000  # as much as comes in all the time of a test, in which a busy machine may hold anybody up


def settings(graph: str, **more: Any) -> dict[str, Any]:
    return {"name": "robot", "graphs": [graph], "listen": [], **more}


class Cloud:
    """A server far away, and which messages of a topic came there."""

    def __init__(self) -> None:
        self.heard: list[int] = []
        self.url = ""

    async def start(self, stack: AsyncExitStack, topic: str) -> None:
        network = f"supervised-{next(_numbers)}"
        graphs = [MemoryGraph(network, node=f"/{node}") for node in ("cloud", "reader")]
        for graph in graphs:
            await graph.open()
            stack.push_async_callback(graph.close)
        server = RosbridgeServer(Hub(graphs[0]), TypeRegistry())
        stack.push_async_callback(server.close)
        self.url = f"ws://127.0.0.1:{(await server.listen('ws://127.0.0.1:0')).port}"
        await graphs[1].create_subscription(topic, STRING, QoS(depth=DEPTH), self._hear)

    def _hear(self, batch: Any) -> None:
        for sample in batch:
            self.heard.append(int(bytes(sample.payload[8:]).split(b"\0")[0]))


async def talker(stack: AsyncExitStack, domain: int, topic: str) -> None:
    """A robot that publishes numbers over DDS."""
    graph = DdsGraph(domain, name="talker", interface="lo")
    await graph.open()
    stack.push_async_callback(graph.close)
    publisher = await graph.create_publisher(topic, STRING, QoS(depth=DEPTH))

    async def talk() -> None:
        began, number = time.monotonic(), 0
        while True:
            number += 1
            publisher.publish(Sample(text(str(number)), STRING, time.time_ns(), bytes(16), SEQ_NONE))
            await asyncio.sleep(max(0.0, began + number / HZ - time.monotonic()))

    task = asyncio.create_task(talk())
    stack.callback(task.cancel)


# ── slices ─────────────────────────────────────────────────────────────────────────────────────────────────────────


def parsed(workers: int | str, **more: Any) -> config.Config:
    item = {"name": "/x", "type": STRING}
    remotes = [{"address": f"ws://h{i}", "publish": [item], "active": i != 1} for i in range(4)]
    return config.parse({"gateway": {**settings("memory:x"), "workers": workers, **more}, "remotes": remotes})


def test_one_worker_posts_to_web_servers() -> None:
    """What goes to web servers is in the first slice alone: every message is posted once."""
    rule = {"url": "http://127.0.0.1:1/", "topic": "/a", "type": "std_msgs/msg/String"}
    assert [len(part.gateway.http) for _, part in slices(parsed(3, http=[rule]))] == [1, 0, 0]


def test_slices() -> None:
    """Active remotes are dealt out to the workers; per-remote gives each its own, and the listeners one more."""

    def addresses(parts: list[tuple[str, config.Config]]) -> dict[str, list[str]]:
        return {name: [r.address.removeprefix("ws://h")[0] for r in part.remotes if r.active] for name, part in parts}

    assert addresses(slices(parsed(2))) == {"worker0": ["0", "3"], "worker1": ["2"]}
    assert addresses(slices(parsed("per-remote"))) == {"remote0": ["0"], "remote2": ["2"], "remote3": ["3"]}
    listening = slices(parsed("per-remote", listen=["ws://127.0.0.1:9090"]))
    assert {name: bool(part.gateway.listen) for name, part in listening} == {
        "server": True,
        "remote0": False,
        "remote2": False,
        "remote3": False,
    }
    assert all(part.gateway.listen for _, part in slices(parsed(3, listen=["ws://127.0.0.1:9090"])))


def test_a_remote_stays_with_its_worker() -> None:
    """Remotes are dealt by what they are: an insertion moves nobody, and new ones go to the emptiest worker."""
    old = parsed(2)
    item = {"name": "/x", "type": STRING}
    new = config.parse(
        {
            "gateway": {**settings("memory:x"), "workers": 2},
            "remotes": [{"address": f"ws://{host}", "publish": [item]} for host in ("new", "h3", "h2", "h0")],
        }
    )
    before = places(old)
    found = {name: [r.address for r in part.remotes if r.active] for name, part in slices(new, before)}
    assert found == {"worker0": ["ws://h3:9090", "ws://h0:9090"], "worker1": ["ws://new:9090", "ws://h2:9090"]}


# ── workers ────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("workers", [2, "per-remote"])
async def test_killed_worker(stack: AsyncExitStack, workers: int | str, caplog: pytest.LogCaptureFixture) -> None:
    """A worker that is killed is back at once with its routes, in the spare process; the others never notice."""
    domain = next(_domains)
    clouds = [Cloud(), Cloud()]
    for cloud in clouds:
        await cloud.start(stack, "/n")
    item = {"name": "/n", "type": STRING}
    remotes = [{"address": cloud.url, "publish": [item]} for cloud in clouds]
    document = {"gateway": {**settings(f"dds:{domain}?interface=lo"), "workers": workers}, "remotes": remotes}
    supervisor = await stack.enter_async_context(Supervisor(config.parse(document), log_level="WARNING", steady_s=0))
    await talker(stack, domain, "/n")
    await until(lambda: all(len(cloud.heard) > 10 for cloud in clouds))
    first, second = (worker.process for worker in supervisor.workers)
    assert first is not None
    assert second is not None
    for _ in range(2):
        await until(lambda: supervisor.spare.pid)
        killed, spare = supervisor.workers[0].process, supervisor.spare.pid
        assert killed is not None
        killed.send_signal(signal.SIGKILL)
        await killed.wait()
        # What the killed one had sent may still be on its way: it says nothing of the one that takes its place.
        await until(lambda k=killed: supervisor.workers[0].process is not k and supervisor.workers[0].running)
        heard = len(clouds[0].heard)
        await until(lambda h=heard: len(clouds[0].heard) > h + 10)
        back = supervisor.workers[0].process
        assert back is not None
        assert back.pid == spare  # which had loaded everything
    assert [m for m in caplog.messages if "it is started again" in m] == [
        f"worker {supervisor.workers[0].name} ended; it is started again"  # that is, without a pause
    ] * 2
    assert second.returncode is None
    numbers = clouds[1].heard
    assert numbers == list(range(numbers[0], numbers[-1] + 1))
    assert [w.starts for w in supervisor.workers] == [3, 1]
    assert clouds[0].heard == sorted(set(clouds[0].heard))


async def test_a_machine_that_lets_workers_wait(stack: AsyncExitStack, monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers that get no processor are waited for, when they start and when they are asked, however long it takes."""
    monkeypatch.setattr(supervisor_module, "_START_S", 0.001)
    monkeypatch.setattr(processor_queue, "queued_s", lambda pid: time.monotonic())
    supervisor = await stack.enter_async_context(Supervisor(parsed(2), log_level="WARNING"))
    await supervisor.apply(parsed(2, http=[{"url": "http://127.0.0.1:1/", "topic": "/a", "type": STRING}]))
    assert [worker.starts for worker in supervisor.workers] == [1, 1]


async def test_workers_that_do_not_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers that could run, but do not get ready, are given up, with how many of them are."""
    monkeypatch.setattr(supervisor_module, "_START_S", 0.001)
    monkeypatch.setattr(processor_queue, "queued_s", lambda pid: 0.0)
    with pytest.raises(GraphUnavailable, match=r"robot: 0 of its 2 workers are up, and none more within 0\.001 s"):
        async with Supervisor(parsed(2), log_level="WARNING"):
            pass


async def test_status(stack: AsyncExitStack) -> None:
    """The workers' status is told as that of one gateway, with every worker's process."""
    port = free_port()
    item = {"name": "/x", "type": STRING}
    remotes = [{"address": f"ws://127.0.0.1:{free_port()}", "publish": [item]} for _ in range(2)]
    document = {
        "gateway": settings("memory:x", listen=[f"ws://127.0.0.1:{port}"], workers=2),
        "remotes": remotes,
    }
    supervisor = await stack.enter_async_context(Supervisor(config.parse(document), log_level="WARNING"))
    clients = [await stack.enter_async_context(Client(port)) for _ in range(6)]
    for client in clients:
        await client.done()
    await until(lambda: len(supervisor.status()["sessions"]) == 6)
    status = supervisor.status()
    assert status["name"] == "robot"
    assert [r["address"] for r in status["remotes"]] == [r["address"] for r in remotes]
    assert [r["name"] for r in status["routes"]] == ["/x", "/x"]
    assert [(w["name"], w["starts"]) for w in status["workers"]] == [("worker0", 1), ("worker1", 1)]
    assert all(psutil.Process(w["pid"]).ppid() == os.getpid() for w in status["workers"])
    (listener,) = status["listen"]
    assert listener["clients"] == 6
    json.dumps(status)
    assert supervisor.workers[0].process is not None
    supervisor.workers[0].process.kill()
    await until(lambda: supervisor.workers[0].starts == 2)
    async with Client(port) as another:  # the other worker takes it, or the new one
        await another.done()


async def test_status_of_parts_that_one_worker_has() -> None:
    """Rules for web servers and safety of any worker are told, and the store that all of them share once."""
    supervisor = Supervisor(parsed(2))
    access: dict[str, Any] = {"memory": {"held_bytes": 0, "limit_bytes": 1, "ended": {}}}
    supervisor.workers[0].status = {**access, "http": [{"url": "http://a/"}], "store": {"values": 1}}
    supervisor.workers[1].status = {**access, "safety": [{"topic": "/cmd_vel"}], "store": {"values": 1}}
    status = supervisor.status()
    assert (status["http"], status["safety"]) == ([{"url": "http://a/"}], [{"topic": "/cmd_vel"}])
    assert status["store"] == {"values": 1}
    assert "nodes" not in status


async def test_start_failure(stack: AsyncExitStack) -> None:
    """Where nothing can start, as the port is taken, the reason is told, and no process is left."""
    taken = socket.socket()
    stack.callback(taken.close)
    taken.bind(("127.0.0.1", 0))
    taken.listen()
    listen = [f"ws://127.0.0.1:{taken.getsockname()[1]}"]
    supervisor = Supervisor(config.parse({"gateway": settings("memory:x", listen=listen, workers=2)}))
    with pytest.raises(ConnectFailed, match=r"is another gateway running\?"):
        await supervisor.__aenter__()
    assert not psutil.Process().children()


async def test_start_that_is_given_up() -> None:
    """Whoever gives up a start of workers in its midst leaves no process behind."""
    supervisor = Supervisor(config.parse({"gateway": settings("memory:x", workers=2)}))
    starting = asyncio.create_task(supervisor.__aenter__())
    await until(lambda: psutil.Process().children())
    starting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await starting
    assert not psutil.Process().children()


async def test_worker_that_keeps_falling(stack: AsyncExitStack, caplog: pytest.LogCaptureFixture) -> None:
    """A worker that falls again and again is started again, at growing intervals."""
    document = {"gateway": settings("memory:x", workers=1)}
    supervisor = await stack.enter_async_context(
        Supervisor(config.parse(document), log_level="WARNING", steady_s=10 * PATIENCE_S)
    )
    (worker,) = supervisor.workers
    times = []
    for starts in (1, 2, 3):
        await until(lambda n=starts: worker.starts == n and worker.process and worker.process.returncode is None)
        process = worker.process
        assert process is not None
        began = time.monotonic()
        process.kill()
        await until(lambda n=starts: worker.starts > n)
        times.append(time.monotonic() - began)
    assert times[1] >= 1
    assert times[2] >= 2
    told = [message.partition("it is started again")[2] for message in caplog.messages]
    assert told == ["", " in 1 s", " in 2 s"]


async def two_clouds(stack: AsyncExitStack, workers: int | str) -> tuple[Supervisor, list[Cloud], Any]:
    """Return a robot with two workers, each with a link to a cloud, and what makes configurations."""
    domain = next(_domains)
    clouds = [Cloud(), Cloud()]
    for cloud in clouds:
        await cloud.start(stack, "/n")

    def made(*remotes: dict[str, Any]) -> config.Config:
        graph = f"dds:{domain}?interface=lo"
        return config.parse({"gateway": {**settings(graph), "workers": workers}, "remotes": list(remotes)})

    supervisor = Supervisor(made(*map(route, clouds)), log_level="WARNING", steady_s=0)
    await stack.enter_async_context(supervisor)
    await talker(stack, domain, "/n")
    await until(lambda: all(len(cloud.heard) > 10 for cloud in clouds))
    return supervisor, clouds, made


def route(cloud: Cloud, *names: str, **more: Any) -> dict[str, Any]:
    items = [{"name": name, "type": STRING} for name in ("/n", *names)]
    return {"address": cloud.url, "publish": items, **more}


async def test_a_change_in_all_workers(stack: AsyncExitStack) -> None:
    """A route is added and a remote goes while the processes and the other routes go on; asking works in each."""
    supervisor, clouds, made = await two_clouds(stack, 2)
    pids = [worker.process.pid for worker in supervisor.workers if worker.process]
    await supervisor.apply(made(route(clouds[0], "/more"), route(clouds[1])))
    rows = await supervisor.ask(route_names, {})
    assert sorted(name for names in rows for name in names) == ["/more", "/n", "/n"]
    await supervisor.apply(made(route(clouds[0], "/more")))
    assert await supervisor.ask(route_names, {}) == [["/n", "/more"], []]
    assert [worker.process.pid for worker in supervisor.workers if worker.process] == pids
    heard = len(clouds[0].heard)
    await until(lambda: len(clouds[0].heard) > heard + 10)
    numbers = clouds[0].heard
    assert numbers == list(range(numbers[0], numbers[-1] + 1))


async def route_names(gateway: Any, params: Any) -> list[str]:
    return [row.name for row in gateway.routes()]


async def test_all_workers_or_none(stack: AsyncExitStack, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where one worker cannot change, no worker does; a worker that is killed comes back as the others are."""
    supervisor, clouds, made = await two_clouds(stack, "per-remote")
    bad = {"token": {"env": "SET_IN_THE_SUPERVISOR_ALONE"}}
    monkeypatch.setenv("SET_IN_THE_SUPERVISOR_ALONE", "x")
    with pytest.raises(ConfigError, match="SET_IN_THE_SUPERVISOR_ALONE"):
        await supervisor.apply(made(route(clouds[0], "/more"), route(clouds[1], **bad)))
    assert await supervisor.ask(route_names, {}) == [["/n"], ["/n"]]
    killed = supervisor.workers[0].process
    assert killed is not None
    killed.kill()
    with pytest.raises(GraphUnavailable, match="worker remote0"):
        await supervisor.apply(made(route(clouds[0]), route(clouds[1], "/more")))
    await until(lambda: supervisor.workers[0].running)
    assert await supervisor.ask(route_names, {}) == [["/n"], ["/n"]]
    await supervisor.apply(made(route(clouds[0], "/more")))
    assert [worker.name for worker in supervisor.workers] == ["remote0"]
    assert await supervisor.ask(route_names, {}) == [["/n", "/more"]]


@pytest.mark.parametrize("question", [prepare, commit])
async def test_a_worker_killed_in_a_change(
    stack: AsyncExitStack, monkeypatch: pytest.MonkeyPatch, question: Question
) -> None:
    """Where a worker is killed while it prepares or before it swaps, all workers change, or none does."""
    supervisor, clouds, made = await two_clouds(stack, "per-remote")
    before, after = supervisor.config, made(*(route(cloud, "/more") for cloud in clouds))
    ask = WorkerProcess.ask
    killed: list[int] = []

    async def ask_and_kill(worker: WorkerProcess, asked: Question, params: Any, *, timeout_s: float) -> Any:
        if asked is question and not killed and worker.process is not None:
            killed.append(worker.process.pid)
            worker.process.kill()
        return await ask(worker, asked, params, timeout_s=timeout_s)

    monkeypatch.setattr(WorkerProcess, "ask", ask_and_kill)
    with contextlib.suppress(GraphUnavailable):
        await supervisor.apply(after)
    assert killed
    await until(lambda: all(worker.running for worker in supervisor.workers))
    has_more = supervisor.config.etag == after.etag
    assert has_more or supervisor.config.etag == before.etag
    names = ["/n", "/more"] if has_more else ["/n"]
    assert await supervisor.ask(route_names, {}) == [names, names]


@pytest.mark.timeout(120)
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
async def test_end_of_the_supervisor(tmp_path: Path, how: signal.Signals) -> None:
    """When the supervisor goes, however it goes, its workers go."""
    file = tmp_path / "gateway.json"
    file.write_text(json.dumps({"gateway": settings("memory:x", workers=2)}))
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "ropeway", "run", str(file), "--quiet"),
        stdout=asyncio.subprocess.DEVNULL,
        stderr=asyncio.subprocess.DEVNULL,
    )
    try:
        parent = psutil.Process(process.pid)
        await until(lambda: len(parent.children()) == 3)  # one waits to step in
        workers = parent.children()
        process.send_signal(how)
        await process.wait()
        await until(lambda: not any(w.is_running() and w.status() != psutil.STATUS_ZOMBIE for w in workers))
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
