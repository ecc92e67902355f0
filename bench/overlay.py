"""The overlay: what names, seals and routers cost beside plain Zenoh and beside the bare link.

``--part`` names some of names, join, seal, throughput, big, roam, link, fleet. The last three need root, the last two
a program that joins two namespaces by a link with delay, named in ROPEWAY_LINK (``PROGRAM --a NAMESPACE ADDRESS
--b NAMESPACE ADDRESS --delay-ms N --rate-mbit N``).
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import uvloop
import zenoh
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import ed25519

from bench.netns import Process, delayed
from bench.report import table
from ropeway import aio
from ropeway.gateway.process.allocator import keep_freed_memory
from ropeway.graph.base import SEQ_NONE, Delivery, Sample
from ropeway.networks.overlay.crypto.identity import Identity, write_private
from ropeway.networks.overlay.crypto.seal import Opener, Sealer
from ropeway.networks.overlay.fleet import Fleet
from ropeway.networks.overlay.graph import OverlayGraph
from ropeway.networks.overlay.node import OverlayNode
from ropeway.qos import QoS

TYPE = "std_msgs/msg/UInt8MultiArray"
ME = ("-m", "bench.overlay")
PORT = 17447
KEEP = QoS(history="keep_all")


def sample(payload: bytes) -> Sample:
    """A message of any bytes; nobody decodes it."""
    return Sample(payload, TYPE, time.time_ns(), bytes(16), SEQ_NONE)


def bundles(directory: Path, *names: str) -> dict[str, str]:
    """A fleet of these members; a name with router in it is one."""
    fleet = Fleet.create("bench", directory / "bench")
    made = {}
    for name in names:
        path = directory / f"{name}.ropeway"
        write_private(path, fleet.issue(name, role="router" if "router" in name else "member").to_text())
        made[name] = str(path)
    return made


def node_of(args: argparse.Namespace) -> OverlayNode:
    """The member that a role runs as."""
    routers = args.connect.split(",") if args.connect else []
    listen = args.listen.split(",") if args.listen else []
    return OverlayNode(Identity.load(args.identity), routers=routers, listen=listen, sessions=args.sessions)


def report(**figures: Any) -> None:
    """One line for whoever measures."""
    print(json.dumps(figures), flush=True)


# ── roles: the overlay ─────────────────────────────────────────────────────────────────────────────────────────────


async def echo(args: argparse.Namespace) -> None:
    """Send back what comes."""
    graph = OverlayGraph(node_of(args))
    await graph.open()
    back = await graph.create_publisher("/pong", TYPE)
    await graph.create_subscription(
        "/ping", TYPE, QoS(), lambda batch: [back.publish(sample(s.payload)) for s in batch]
    )
    print("ready", flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)
    await graph.close()


async def ping(args: argparse.Namespace) -> None:
    """Round trips, one after the other."""
    began = time.perf_counter()
    graph = OverlayGraph(node_of(args))
    await graph.open()
    came: asyncio.Queue[int] = asyncio.Queue()
    await graph.create_subscription("/pong", TYPE, QoS(), lambda batch: [came.put_nowait(1) for _ in batch])
    publisher = await graph.create_publisher("/ping", TYPE)
    wanted = asyncio.Event()
    publisher.on_demand(lambda count: wanted.set() if count else None)
    async with aio.timeout(30):
        await wanted.wait()
        while not graph.node.feeds or not any(
            f is not None
            for feed in graph.node.feeds.values()
            for s in feed.streams.values()
            for f in s.readers.values()
        ):
            await asyncio.sleep(0.002)
    first = None
    out: dict[str, Any] = {}
    for size in map(int, args.sizes.split(",")):
        payload = os.urandom(size)
        times = []
        for _ in range(args.count):
            t = time.perf_counter()
            publisher.publish(sample(payload))
            async with aio.timeout(10):
                await came.get()
            times.append(time.perf_counter() - t)
            first = first or time.perf_counter() - began
        out[str(size)] = [1e3 * float(np.percentile(times, q)) for q in (50, 99)]
    report(rtt=out, first_s=first)
    await graph.close()


async def sink(args: argparse.Namespace) -> None:
    """Count what comes."""
    graph = OverlayGraph(node_of(args))
    await graph.open()
    got = [0, 0]
    times = [0.0, 0.0]

    def take(batch: Any) -> None:
        if not got[0]:
            times[0] = time.perf_counter()
        got[0] += len(batch)
        got[1] += sum(len(s.payload) for s in batch)
        times[1] = time.perf_counter()

    began = time.perf_counter()
    await graph.create_subscription("/flood", TYPE, KEEP if args.reliable else QoS(depth=1), take)
    print("ready", flush=True)
    while not got[0]:
        await asyncio.sleep(0.001)
    report(join_ms=1e3 * (times[0] - began))
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)
    lost = sum(feed.missed for feed in graph.node.feeds.values())
    seconds = times[1] - times[0]
    report(count=got[0], rate=got[0] / seconds, mb_s=got[1] / seconds / 1e6, cpu=time.process_time(), lost=lost)
    await graph.close()


async def source(args: argparse.Namespace) -> None:
    """Send flat out: as many as the lane takes."""
    graph = OverlayGraph(node_of(args))
    await graph.open()
    publisher = await graph.create_publisher("/flood", TYPE, KEEP, delivery=Delivery())
    wanted = asyncio.Event()
    publisher.on_demand(lambda count: wanted.set() if count else None)
    print("ready", flush=True)
    await wanted.wait()
    payload = os.urandom(args.size)
    publisher.source._depth = 0  # nothing is kept, as plain Zenoh keeps nothing
    end, count = time.perf_counter() + args.seconds, 0
    cpu = time.process_time()
    while time.perf_counter() < end:
        while publisher.queue.bytes < 8 << 20:
            for _ in range(max(1, min(200, 200_000 // args.size))):
                publisher.publish(sample(payload))
                count += 1
        await asyncio.sleep(0.005)  # a loop that spins would keep the lane from running
    await graph.sender.flush(publisher.queue)
    report(count=count, cpu=time.process_time() - cpu)
    await graph.close()


async def stream(args: argparse.Namespace) -> None:
    """A numbered message a hundred times a second, reliably, until told to end."""
    graph = OverlayGraph(node_of(args))
    await graph.open()
    publisher = await graph.create_publisher("/beat", TYPE, KEEP)
    print("ready", flush=True)
    told = asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)
    number = 0
    while not told.done():
        number += 1
        publisher.publish(sample(struct.pack("!I", number) + bytes(1020)))
        await asyncio.sleep(0.01)
    await asyncio.sleep(6)  # what was missed is asked for
    report(sent=number)
    await graph.close()


async def hear(args: argparse.Namespace) -> None:
    """The longest silence of the stream, and what of it did not come."""
    graph = OverlayGraph(node_of(args))
    await graph.open()
    numbers: list[int] = []
    times: list[float] = []

    def take(batch: Any) -> None:
        numbers.extend(struct.unpack_from("!I", s.payload)[0] for s in batch)
        times.extend(time.perf_counter() for _ in batch)

    await graph.create_subscription("/beat", TYPE, KEEP, take)
    print("ready", flush=True)
    while len(numbers) < 100:
        await asyncio.sleep(0.01)
    report(flows=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)
    gaps = np.diff(times)
    missing = numbers[-1] - numbers[0] + 1 - len(set(numbers))
    in_order = numbers == sorted(numbers)
    twice = len(numbers) - len(set(numbers))
    report(longest_s=float(gaps.max()), missing=missing, twice=twice, in_order=in_order, last=numbers[-1])
    await graph.close()


# ── roles: plain Zenoh, and the bare link ──────────────────────────────────────────────────────────────────────────


def plain(args: argparse.Namespace) -> zenoh.Session:
    """A session without TLS, as it comes."""
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(args.mode))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("scouting/gossip/enabled", "false")
    config.insert_json5("transport/shared_memory/enabled", "false")  # the other end may be anywhere
    config.insert_json5("listen/endpoints", json.dumps(args.listen.split(",") if args.listen else []))
    config.insert_json5("connect/endpoints", json.dumps(args.connect.split(",") if args.connect else []))
    return zenoh.open(config)


def zsink(args: argparse.Namespace) -> None:
    """Count what comes."""
    session = plain(args)
    got = [0, 0]
    times = [0.0, 0.0]

    def take(s: zenoh.Sample) -> None:
        if not got[0]:
            times[0] = time.perf_counter()
        got[0] += 1
        got[1] += len(bytes(s.payload))
        times[1] = time.perf_counter()

    session.declare_subscriber("flood", zenoh.handlers.Callback(take, indirect=True))
    print("ready", flush=True)
    sys.stdin.readline()
    seconds = times[1] - times[0]
    report(count=got[0], rate=got[0] / seconds, mb_s=got[1] / seconds / 1e6, cpu=time.process_time())
    session.close()


def zsource(args: argparse.Namespace) -> None:
    """Send flat out."""
    session = plain(args)
    publisher = session.declare_publisher("flood", congestion_control=zenoh.CongestionControl.BLOCK)
    print("ready", flush=True)
    while not publisher.matching_status.matching:
        time.sleep(0.01)
    payload, count = os.urandom(args.size), 0
    cpu, end = time.process_time(), time.perf_counter() + args.seconds
    while time.perf_counter() < end:
        publisher.put(payload)
        count += 1
    time.sleep(0.5)
    report(count=count, cpu=time.process_time() - cpu)
    session.close()


def zrouter(args: argparse.Namespace) -> None:
    """Carry it."""
    session = plain(args)
    print("ready", flush=True)
    sys.stdin.readline()
    session.close()


def tcp_echo(args: argparse.Namespace) -> None:
    """Send back what comes, over a bare connection."""
    with socket.create_server((args.host, PORT + 1)) as server:
        print("ready", flush=True)
        connection, _ = server.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        while head := _exactly(connection, 4):
            connection.sendall(head + _exactly(connection, *struct.unpack("!I", head)))


def tcp_ping(args: argparse.Namespace) -> None:
    """Round trips over a bare connection."""
    out = {}
    with socket.create_connection((args.host, PORT + 1)) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for size in map(int, args.sizes.split(",")):
            message, times = struct.pack("!I", size) + os.urandom(size), []
            for _ in range(args.count):
                t = time.perf_counter()
                connection.sendall(message)
                _exactly(connection, 4 + size)
                times.append(time.perf_counter() - t)
            out[str(size)] = [1e3 * float(np.percentile(times, q)) for q in (50, 99)]
    report(rtt=out)


def _exactly(connection: socket.socket, size: int) -> bytes:
    parts = []
    while size:
        part = connection.recv(size)
        if not part:
            return b""
        parts.append(part)
        size -= len(part)
    return b"".join(parts)


# ── what is measured ───────────────────────────────────────────────────────────────────────────────────────────────


def member(name: str, where: dict[str, str], role: str, *more: str, namespace: str | None = None) -> Process:
    """A role as a member, in a process of its own."""
    return Process(namespace, *ME, role, "--identity", where[name], *more, quiet=False)


def sealing(as_json: bool) -> None:
    """What sealing and opening cost of the processor, with signatures and by session, alone in one thread."""
    key = ed25519.Ed25519PrivateKey.generate()
    public, secret = key.public_key(), os.urandom(32)

    def verify(message: bytes, signature: bytes) -> bool:
        try:
            public.verify(signature, message)
        except InvalidSignature:
            return False
        return True

    rows: list[list[Any]] = []
    for size, batch in ((1024, 1), (1024, 32), (305_000, 1)):
        items = [[os.urandom(size)] for _ in range(batch)]
        took: dict[bool, tuple[float, float]] = {}
        for signed in (True, False):
            sealer = Sealer(bytes(32), bytes(16), key.sign)
            sealer.prove_to(() if signed else (secret,))
            opener = Opener(bytes(32), bytes(16), verify, secret=secret)
            opener.add(sealer.grant())
            count = max(int(50e6 / size / batch), 100)
            began = time.process_time()
            packets = [sealer.seal(items) for _ in range(count)]
            middle = time.process_time()
            for packet in packets:
                opener.open(packet)
            end = time.process_time()
            took[signed] = (middle - began) / count / batch, (end - middle) / count / batch
        flat = [1e6 * t for signed in (True, False) for t in took[signed]]
        share = sum(took[True]) / sum(took[False])
        rows.append([size, batch, *flat, share])
    heads = ["bytes", "in a batch", "seal, us", "open, us", "by session: seal, us", "open, us", "signed / session"]
    table("sealing and opening one message", heads, rows, as_json=as_json)


def throughput(as_json: bool, seconds: float) -> None:
    """1 kB and 305 kB flat out, direct and over one router, beside plain Zenoh."""
    rows: list[list[Any]] = []
    for size in (1024, 305_000):
        for path in ("direct", "router"):
            figures = {}
            for kind in ("plain", "sealed", "session"):
                with tempfile.TemporaryDirectory() as directory:
                    where = bundles(Path(directory), "near", "far", "router1")
                    figures[kind] = _flood(kind, path, size, seconds, where)
            sealed, session, bare = figures["sealed"], figures["session"], figures["plain"]
            key = "rate" if size < 10_000 else "mb_s"
            rows.append(
                [
                    size,
                    path,
                    "msg/s" if key == "rate" else "MB/s",
                    bare[key],
                    sealed[key],
                    sealed[key] / bare[key],
                    1e6 * (sealed["cpu"] - bare["cpu"]),
                    session[key],
                    session[key] / bare[key],
                    1e6 * (session["cpu"] - bare["cpu"]),
                    sealed["lost"] + session["lost"],
                ]
            )
    heads = ["bytes", "path", "unit", "plain Zenoh", "sealed", "ratio (>= 0.5)", "added CPU, us/message"]
    heads += ["by session", "ratio", "added CPU", "lost"]
    table("throughput", heads, rows, as_json=as_json)


def _flood(kind: str, path: str, size: int, seconds: float, where: dict[str, str]) -> dict[str, float]:
    scheme = "tcp" if kind == "plain" else "tls"
    endpoint = f"{scheme}/127.0.0.1:{PORT}"
    running: list[Process] = []
    try:
        if path == "router":
            words = ["-m", "ropeway", "router", "-i", where["router1"], "-l", endpoint, "--json"]
            if kind == "plain":
                words = [*ME, "zrouter", "--mode", "router", "--listen", endpoint]
            running.append(Process(None, *words))
            running[0].line()
        listen, connect = ("--listen", endpoint), ("--connect", endpoint)
        far = connect if path == "router" else listen
        flood = ("--size", str(size), "--seconds", str(seconds))
        if kind != "plain":
            more = ("--sessions",) if kind == "session" else ()
            sink = member("far", where, "sink", *far, "--reliable", *more)
            sink.line()
            source = member("near", where, "source", *connect, *flood, *more)
        else:
            mode = ("--mode", "client" if path == "router" else "peer")
            sink = Process(None, *ME, "zsink", *mode, *far)
            sink.line()
            source = Process(None, *ME, "zsource", *mode, *connect, *flood)
        running += [sink, source]
        source.line()
        sent = json.loads(source.line())
        time.sleep(1)
        sink.tell()
        lines = sink.finish(30).splitlines()
        got: dict[str, float] = json.loads(lines[-1])
        got["cpu"] = (got["cpu"] + sent["cpu"]) / max(got["count"], 1)
        return got
    finally:
        for process in running:
            process.stop()


def join(as_json: bool) -> None:
    """A reader that joins a running publisher, and a member's cold start; on loopback."""
    times, starts = [], []
    with tempfile.TemporaryDirectory() as directory:
        names = [f"m{i}" for i in range(12)]
        where = bundles(Path(directory), "near", "echo", "router1", *names)
        endpoint = f"tls/127.0.0.1:{PORT}"
        router = Process(None, "-m", "ropeway", "router", "-i", where["router1"], "-l", endpoint, "--json")
        router.line()
        echoing = member("echo", where, "echo", "--connect", endpoint)
        echoing.line()
        times = uvloop.run(_joins(where["near"], where["m0"], endpoint))
        for name in names[1:]:
            began = time.perf_counter()
            process = member(name, where, "ping", "--connect", endpoint, "--count", "1", "--sizes", "1024")
            process.line()
            starts.append(time.perf_counter() - began)
            process.stop()
        for process in (echoing, router):
            process.stop()
    heads = ["figure", "p50", "max"]
    rows = [
        ["topic join, ms (< 100)", 1e3 * float(np.median(times)), 1e3 * max(times)],
        ["sealed cold start of a process, s (< 2)", float(np.median(starts)), max(starts)],
    ]
    table("joining", heads, rows, as_json=as_json)


async def _joins(near: str, far: str, endpoint: str) -> list[float]:
    graphs = [OverlayGraph(OverlayNode(Identity.load(path), routers=[endpoint], listen=())) for path in (near, far)]
    for graph in graphs:
        await graph.open()
    times = []
    for number in range(20):
        name = f"/stream{number}"
        publisher = await graphs[0].create_publisher(name, TYPE)
        while name not in graphs[1].topics():
            await asyncio.sleep(0.001)
        came = asyncio.Event()
        began = time.perf_counter()
        subscription = await graphs[1].create_subscription(name, TYPE, QoS(), lambda _, came=came: came.set())
        while not came.is_set():
            publisher.publish(sample(bytes(1024)))
            await asyncio.sleep(0.001)
        times.append(time.perf_counter() - began)
        await subscription.close()
    for graph in graphs:
        await graph.close()
    return times


def names(as_json: bool, count: int) -> None:
    """Many names of one gateway: announcing, finding, and a gateway that joins late."""
    with tempfile.TemporaryDirectory() as directory:
        where = bundles(Path(directory), "near", "far", "late", "router1")
        endpoint = f"tls/127.0.0.1:{PORT}"
        router = Process(None, "-m", "ropeway", "router", "-i", where["router1"], "-l", endpoint, "--json")
        router.line()
        rows = uvloop.run(_names(where, endpoint, count, router))
        router.stop()
    table(f"{count} names of one gateway", ["figure", "value"], rows, as_json=as_json)


async def _names(where: dict[str, str], endpoint: str, count: int, router: Process) -> list[list[Any]]:
    import psutil

    rss = psutil.Process().memory_info
    graphs = {
        name: OverlayGraph(OverlayNode(Identity.load(where[name]), routers=[endpoint], listen=()))
        for name in ("near", "far", "late")
    }
    near, far, late = graphs.values()
    for graph in (near, far):
        await graph.open()
    while not (near.node.membership.gateways() and far.node.membership.gateways()):
        await asyncio.sleep(0.01)
    before, routed = rss().rss, router.memory_bytes()
    began = time.perf_counter()
    for number in range(count):
        await near.create_publisher(f"/name{number}", TYPE)
    announced = time.perf_counter() - began
    while far.node.rib.count(near.node.gateway) < count:
        await asyncio.sleep(0.01)
    known = time.perf_counter() - began
    grown = rss().rss - before
    began = time.perf_counter()
    for number in range(1000):
        target = far._global("publisher", f"/name{number * 7 % count}", TYPE)
        assert far.node.rib.by_name(target, "publisher")
    resolved = (time.perf_counter() - began) / 1000
    began = time.perf_counter()
    await late.open()
    while late.node.rib.count(near.node.gateway) < count:
        await asyncio.sleep(0.01)
    joined = time.perf_counter() - began
    rows: list[list[Any]] = [
        ["announce, ms each (< 1)", 1e3 * announced / count],
        ["until another gateway has it, ms each", 1e3 * known / count],
        ["resolve, ms each (< 1)", 1e3 * resolved],
        ["a gateway that joins has all, s (< 3)", joined],
        ["memory of both gateways, MB", grown / 1e6],
        ["memory of the router, MB", (router.memory_bytes() - routed) / 1e6],
    ]
    for graph in graphs.values():
        await graph.close()
    return rows


def big(as_json: bool, count: int = 20) -> None:
    """13 MB messages over a router, every byte compared."""
    with tempfile.TemporaryDirectory() as directory:
        where = bundles(Path(directory), "near", "far", "router1")
        endpoint = f"tls/127.0.0.1:{PORT}"
        router = Process(None, "-m", "ropeway", "router", "-i", where["router1"], "-l", endpoint, "--json")
        router.line()
        intact, took = uvloop.run(_big(where, endpoint, count))
        router.stop()
    heads = ["messages", "intact (20 of 20)", "MB/s"]
    table("13 MB messages over a router", heads, [[count, intact, 13 * count / took]], as_json=as_json)


async def _big(where: dict[str, str], endpoint: str, count: int) -> tuple[int, float]:
    near, far = (
        OverlayGraph(OverlayNode(Identity.load(where[name]), routers=[endpoint], listen=())) for name in ("near", "far")
    )
    for graph in (near, far):
        await graph.open()
    came: asyncio.Queue[bytes] = asyncio.Queue()
    await far.create_subscription("/big", TYPE, QoS(depth=2), lambda batch: [came.put_nowait(s.payload) for s in batch])
    publisher = await near.create_publisher("/big", TYPE, QoS(depth=2))
    while not publisher.subscribers:
        await asyncio.sleep(0.01)
    intact, took = 0, 0.0
    for _ in range(count):
        payload = os.urandom(13_000_000)
        began = time.perf_counter()
        publisher.publish(sample(payload))
        async with aio.timeout(20):
            intact += await came.get() == payload
        took += time.perf_counter() - began
    for graph in (near, far):
        await graph.close()
    return intact, took


async def hub(args: argparse.Namespace) -> None:
    """Answer each robot's image with an action, to that robot."""
    graph = OverlayGraph(node_of(args))
    await graph.open()
    for robot in range(args.count):
        back = await graph.create_publisher(f"/robot{robot}/act", TYPE)
        await graph.create_subscription(
            f"/robot{robot}/image",
            TYPE,
            QoS(depth=1),
            lambda batch, back=back: [back.publish(sample(bytes(64))) for _ in batch],
        )
    print("ready", flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)
    await graph.close()


async def fleet(args: argparse.Namespace) -> None:
    """Robots of one fleet step together: each sends its image, and all wait for all answers."""
    bundles_of = args.identity.split(",")
    graphs, publishers, queues = [], [], []
    for robot, bundle in enumerate(bundles_of):
        graph = OverlayGraph(OverlayNode(Identity.load(bundle), routers=args.connect.split(","), listen=()))
        await graph.open()
        came: asyncio.Queue[int] = asyncio.Queue()
        await graph.create_subscription(
            f"/robot{robot}/act", TYPE, QoS(depth=1), lambda batch, came=came: [came.put_nowait(1) for _ in batch]
        )
        publishers.append(await graph.create_publisher(f"/robot{robot}/image", TYPE, QoS(depth=1)))
        graphs.append(graph)
        queues.append(came)
    async with aio.timeout(30):
        while not all(p.subscribers for p in publishers):
            await asyncio.sleep(0.01)
    await asyncio.sleep(0.5)
    payload, times = os.urandom(args.size), []
    for _ in range(30):
        began = time.perf_counter()
        for publisher in publishers:
            publisher.publish(sample(payload))
        async with aio.timeout(20):
            for came in queues:
                await came.get()
        times.append(time.perf_counter() - began)
    report(step_ms=[1e3 * float(np.percentile(times, q)) for q in (50, 99)])
    for graph in graphs:
        await graph.close()


def tcp_hub(args: argparse.Namespace) -> None:
    """The same over bare connections."""
    with socket.create_server((args.host, PORT + 1)) as server:
        print("ready", flush=True)
        threads = []
        for _ in range(args.count):
            connection, _ = server.accept()
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threads.append(threading.Thread(target=_answer_images, args=(connection,)))
            threads[-1].start()
        for thread in threads:
            thread.join()


def _answer_images(connection: socket.socket) -> None:
    while head := _exactly(connection, 4):
        _exactly(connection, *struct.unpack("!I", head))
        connection.sendall(bytes(64))


def tcp_fleet(args: argparse.Namespace) -> None:
    """The same over bare connections."""
    connections = [socket.create_connection((args.host, args.port)) for _ in range(args.count)]
    message, times = struct.pack("!I", args.size) + os.urandom(args.size), []
    for _ in range(30):
        began = time.perf_counter()
        senders = [threading.Thread(target=c.sendall, args=(message,)) for c in connections]
        for sender in senders:
            sender.start()
        for connection in connections:
            _exactly(connection, 64)
        times.append(time.perf_counter() - began)
        for sender in senders:
            sender.join()
    report(step_ms=[1e3 * float(np.percentile(times, q)) for q in (50, 99)])
    for connection in connections:
        connection.close()


class Tunnel:
    """An ssh tunnel from one namespace to the hub in the other; ``there`` is false without a server of ssh."""

    def __init__(self, a: str, b: str, far_ip: str, directory: str) -> None:
        self._running: list[subprocess.Popen[bytes]] = []
        server = shutil.which("sshd") or shutil.which("/usr/sbin/sshd")
        self.there = server is not None and shutil.which("ssh") is not None
        if server is None or not self.there:
            print("no sshd is installed: ssh is left out")
            return
        base, port = Path(directory), PORT + 3
        for name in ("host", "user"):
            make = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(base / name)]
            if not (base / name).exists():
                subprocess.run(make, check=True)
        (base / "authorized").write_bytes((base / "user.pub").read_bytes())
        Path("/run/sshd").mkdir(exist_ok=True)
        options = [f"HostKey={base / 'host'}", f"AuthorizedKeysFile={base / 'authorized'}", "StrictModes=no"]
        options += ["PermitRootLogin=prohibit-password", "UsePAM=no", f"PidFile={base / 'pid'}"]
        flags = [word for option in options for word in ("-o", option)]
        self._start(b, [server, "-D", "-f", "/dev/null", "-p", str(port), *flags])
        known = ["StrictHostKeyChecking=no", "UserKnownHostsFile=/dev/null", "LogLevel=ERROR", "ConnectionAttempts=20"]
        trust = [word for option in known for word in ("-o", option)]
        forward = ["-N", "-L", f"{PORT + 2}:{far_ip}:{PORT + 1}", "-p", str(port), "-i", str(base / "user")]
        self._start(a, ["ssh", *trust, *forward, f"root@{far_ip}"])
        time.sleep(3)

    def _start(self, namespace: str, command: list[str]) -> None:
        self._running.append(subprocess.Popen(["ip", "netns", "exec", namespace, *command]))

    def close(self) -> None:
        """End both."""
        for process in reversed(self._running):
            process.terminate()
            process.wait()


def fleet_step(as_json: bool, robots: int = 4, size: int = 100_000) -> None:
    """The thesis' fleet step (5.3.1): four robots, a hub, a barrier; beside bare connections on the same link."""
    rows: list[list[Any]] = []
    for delay_ms in (1.0, 35.0):
        steps: dict[str, list[float]] = {}
        with joined(delay_ms, 0.0) as ends, tempfile.TemporaryDirectory() as directory:
            if ends is None:
                return
            a, b, far_ip = ends
            names = [f"robot{i}" for i in range(robots)]
            where = bundles(Path(directory), "hub", *names)
            endpoint = f"tls/{far_ip}:{PORT}"
            count = ("--count", str(robots))
            for run in ("bare", "ssh", "sealed"):
                tunnel = Tunnel(a, b, far_ip, directory) if run == "ssh" else None
                if run == "ssh" and not (tunnel and tunnel.there):
                    steps[run] = [float("nan")]
                    continue
                if run != "sealed":
                    far = Process(b, *ME, "tcp_hub", "--host", far_ip, *count)
                    where_to = ("--host", far_ip) if run == "bare" else ("--port", str(PORT + 2))
                    near = ("tcp_fleet", *where_to, *count)
                else:
                    far = member("hub", where, "hub", "--listen", endpoint, *count, namespace=b)
                    near = ("fleet", "--identity", ",".join(where[name] for name in names), "--connect", endpoint)
                far.line()
                robot = Process(a, *ME, *near, "--size", str(size), quiet=False)
                steps[run] = json.loads(robot.finish(120).splitlines()[-1])["step_ms"]
                far.stop()
                if tunnel is not None:
                    tunnel.close()
        rows.append([delay_ms, steps["bare"][0], steps["ssh"][0], steps["sealed"][0], steps["sealed"][1]])
    heads = ["one way, ms", "bare step p50 ms", "ssh tunnel p50 ms", "sealed step p50 ms", "p99 ms"]
    table(f"fleet step: {robots} robots, {size // 1000} kB images", heads, rows, as_json=as_json)


def joined(delay_ms: float, mbit: float) -> contextlib.AbstractContextManager[tuple[str, str, str] | None]:
    """Two namespaces joined by a link with delay."""
    return delayed("rwl", "10.78.0", delay_ms=delay_ms, rate_mbit=mbit)


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)


@contextlib.contextmanager
def town() -> Iterator[tuple[str, str, str]]:
    """Three namespaces on one Ethernet: a router's (10.80.0.254), and those of two members (10.80.0.1 and .2)."""
    r, a, b = "rwor", "rwoa", "rwob"
    for namespace in (r, a, b):
        subprocess.run(["ip", "netns", "del", namespace], check=False, capture_output=True)
        _ip("netns", "add", namespace)
        _ip("-n", namespace, "link", "set", "lo", "up")
    _ip("-n", r, "link", "add", "br0", "type", "bridge")
    _ip("-n", r, "addr", "add", "10.80.0.254/24", "dev", "br0")
    _ip("-n", r, "link", "set", "br0", "up")
    for number, namespace in enumerate((a, b), 1):
        _ip("-n", r, "link", "add", f"v{number}", "type", "veth", "peer", "name", "eth0", "netns", namespace)
        _ip("-n", r, "link", "set", f"v{number}", "master", "br0", "up")
        _ip("-n", namespace, "addr", "add", f"10.80.0.{number}/24", "dev", "eth0")
        _ip("-n", namespace, "link", "set", "eth0", "up")
    try:
        yield r, a, b
    finally:
        for namespace in (r, a, b):
            subprocess.run(["ip", "netns", "del", namespace], check=False, capture_output=True)


def roam(as_json: bool) -> None:
    """Addresses that change in mid-stream: the publisher's, the reader's, both at once; over a router and direct."""
    rows: list[list[Any]] = []
    for direct in (False, True):
        for who in ("publisher", "reader", "both"):
            with town() as (r, a, b), tempfile.TemporaryDirectory() as directory:
                where = bundles(Path(directory), "near", "far", "router1")
                endpoint = f"tls/10.80.0.254:{PORT}"
                router = Process(r, "-m", "ropeway", "router", "-i", where["router1"], "-l", endpoint, "--json")
                router.line()
                ends = []
                for namespace, name, role in ((a, "near", "stream"), (b, "far", "hear")):
                    listen = ("--listen", "tls/0.0.0.0:0") if direct else ()
                    ends.append(member(name, where, role, "--connect", endpoint, *listen, namespace=namespace))
                    ends[-1].line()
                ends[1].line()
                time.sleep(3)  # a direct link is made meanwhile
                for namespace, number, moves in ((a, 1, who != "reader"), (b, 2, who != "publisher")):
                    if moves:
                        _ip("-n", namespace, "addr", "add", f"10.80.0.{number}1/24", "dev", "eth0")
                        _ip("-n", namespace, "addr", "del", f"10.80.0.{number}/24", "dev", "eth0")
                        # the kernel takes the second address with the first one of its net
                        subprocess.run(
                            ["ip", "-n", namespace, "addr", "add", f"10.80.0.{number}1/24", "dev", "eth0"],
                            check=False,
                            capture_output=True,
                        )
                time.sleep(8)
                ends[0].tell()
                sent = json.loads(ends[0].line())["sent"]
                ends[1].tell()
                got = json.loads(ends[1].line())
                got["missing"] += sent - got["last"]
                rows.append(
                    [
                        "direct" if direct else "router",
                        who,
                        got["longest_s"],
                        got["missing"],
                        got["twice"],
                        got["in_order"],
                    ]
                )
                for process in (*ends, router):
                    process.stop()
    heads = ["path", "who moves", "longest silence s (<= 2)", "missing", "twice", "in order"]
    table("addresses change in mid-stream, 100 messages a second", heads, rows, as_json=as_json)


def link(as_json: bool, delay_ms: float, mbit: float, count: int) -> None:
    """Round trips over a link with delay, beside a bare connection on the same link."""
    figures: dict[str, dict[str, list[float]]] = {}
    sizes = "1024,8192"
    more = ("--sizes", sizes, "--count", str(count))
    with joined(delay_ms, mbit) as ends, tempfile.TemporaryDirectory() as directory:
        if ends is None:
            return
        a, b, far_ip = ends
        where = bundles(Path(directory), "near", "far")
        endpoint = f"tls/{far_ip}:{PORT}"
        for run in ("bare", "sealed", "session"):
            sessions = ("--sessions",) if run == "session" else ()
            if run == "bare":
                far = Process(b, *ME, "tcp_echo", "--host", far_ip)
                far.line()
                near = Process(a, *ME, "tcp_ping", "--host", far_ip, *more)
            else:
                far = member("far", where, "echo", "--listen", endpoint, *sessions, namespace=b)
                far.line()
                near = member("near", where, "ping", "--connect", endpoint, *more, *sessions, namespace=a)
            figures[run] = json.loads(near.finish(120).splitlines()[-1])["rtt"]
            far.stop()
    rows = []
    for size in sizes.split(","):
        bare, sealed, session = (figures[run][size] for run in ("bare", "sealed", "session"))
        added = [
            figure - without for figures in (sealed, session) for figure, without in zip(figures, bare, strict=True)
        ]
        rows.append([int(size), bare[0], sealed[0], *added])
    heads = ["bytes", "bare p50 ms", "sealed p50 ms", "added p50 ms (<= 2)", "p99 ms", "by session p50 ms", "p99 ms"]
    table(f"round trip at {delay_ms:g} ms one way and {mbit:g} Mbit/s", heads, rows, as_json=as_json)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    roles = {
        "echo": echo,
        "ping": ping,
        "sink": sink,
        "source": source,
        "hub": hub,
        "fleet": fleet,
        "stream": stream,
        "hear": hear,
    }
    zenoh_roles = {"zsink": zsink, "zsource": zsource, "zrouter": zrouter}
    tcp_roles = {"tcp_echo": tcp_echo, "tcp_ping": tcp_ping, "tcp_hub": tcp_hub, "tcp_fleet": tcp_fleet}
    plain_roles = {**zenoh_roles, **tcp_roles}
    parser.add_argument("role", nargs="?", default="measure", choices=["measure", *roles, *plain_roles])
    parser.add_argument("--part", default="names,join,seal,throughput,big,roam,link,fleet")
    parser.add_argument("--identity")
    parser.add_argument("--connect", default="")
    parser.add_argument("--listen", default="")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=PORT + 1)
    parser.add_argument("--mode", default="peer")
    parser.add_argument("--size", type=int, default=1024)
    parser.add_argument("--sizes", default="1024")
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--names", type=int, default=10_000)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--reliable", action="store_true")
    parser.add_argument("--sessions", action="store_true", help="members prove packets to each other, and do not sign")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    keep_freed_memory()  # as gateways do
    if args.role in roles:
        uvloop.run(roles[args.role](args))
    elif args.role in plain_roles:
        plain_roles[args.role](args)
    else:
        parts = args.part.split(",")
        if "names" in parts:
            names(args.json, args.names)
        if "join" in parts:
            join(args.json)
        if "seal" in parts:
            sealing(args.json)
        if "throughput" in parts:
            throughput(args.json, args.seconds)
        if "big" in parts:
            big(args.json)
        if "fleet" in parts:
            fleet_step(args.json)
        if "roam" in parts:
            roam(args.json)
        if "link" in parts:
            link(args.json, 35.0, 5.0, args.count)


if __name__ == "__main__":
    main()
