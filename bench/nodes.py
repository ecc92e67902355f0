"""IoRT nodes: the paper's first test over a lossy link, acknowledged publications a second, and the way to ROS 2.

``--part`` names some of paper, rate, many, ros2, narrow. The first and the last need root and a program that joins two
namespaces by a link with delay, jitter, loss and a rate, named in ROPEWAY_LINK.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import struct
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import uvloop

from bench.netns import Process, delayed
from bench.report import table
from ropeway import aio
from ropeway.graph.base import Sample
from ropeway.iort import AsyncNode, Packet, Parser, Value, pack
from ropeway.networks.dds import DdsGraph
from ropeway.qos import QoS
from ropeway.types import TypeRegistry

PORT, DOMAIN = 17410, 66
ME = ("-m", "bench.nodes")
TWIST = "geometry_msgs/msg/Twist"
CMD_VEL = b"0.0,0.0,0.0,0.0,0.0,0.0"


def config(directory: str, host: str, *, graph: str = "memory:bench", maps: tuple[Any, ...] = ()) -> str:
    """The file of a gateway that serves nodes."""
    path = Path(directory) / "gateway.json"
    gateway = {
        "name": "bench",
        "graphs": [graph],
        "listen": [f"iort://{host}:{PORT}"],
        "insecure": True,
        "iort": {"maps": list(maps)},
        "store": {"path": str(Path(directory) / "values.sqlite")},
    }
    path.write_text(json.dumps({"gateway": gateway}))
    return str(path)


def start_gateway(path: str, namespace: str | None = None) -> Process:
    """A gateway as a user runs it."""
    return Process(namespace, "-m", "ropeway", "run", path)


async def connect(host: str, port: int) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """A connection, as soon as somebody listens."""
    for _ in range(300):
        with contextlib.suppress(OSError):
            return await asyncio.open_connection(host, port)
        await asyncio.sleep(0.1)
    raise SystemExit(f"nobody listens at {host}:{port}")


# ── roles ──────────────────────────────────────────────────────────────────────────────────────────────────────────


async def echo(args: argparse.Namespace) -> None:
    """Sends back what comes: the link's own round trip."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(65536):
                writer.write(data)

    server = await asyncio.start_server(serve, args.host, PORT + 1)
    print("ready", flush=True)
    async with server:
        await server.serve_forever()


async def pinger(args: argparse.Namespace) -> None:
    """Round trips of packets of this size, as many nodes at a time as in the paper."""

    async def one() -> list[float]:
        reader, writer = await asyncio.open_connection(args.host, PORT + 1)
        raw = pack("01", "TURTLESIM", "cmd_vel", "p", None, CMD_VEL)
        times = []
        for _ in range(args.count):
            began = time.perf_counter()
            writer.write(raw)
            await reader.readexactly(len(raw))
            times.append(time.perf_counter() - began)
        writer.close()
        return times

    found = await asyncio.gather(*[one() for _ in range(args.nodes)])
    print(json.dumps({"bare": percentiles([t for times in found for t in times])}), flush=True)


async def robots(args: argparse.Namespace) -> None:
    """The paper's first test: every node publishes and reads, one packet after the other."""
    names = ["TURTLESIM", "TURTLEBOT4", "RUTAS", "PEPPER", "ALICE"]
    answered = {"publish": 0, "read": 0}

    async def one(name: str) -> tuple[list[float], list[float]]:
        reader, writer = await connect(args.host, PORT)
        parser, ready = Parser(), []

        async def packet() -> Packet:
            while not ready:
                ready.extend(parser.feed(await reader.read(65536)))
            return ready.pop(0)

        publish, read = [], []
        for n in range(args.count):
            began = time.perf_counter()
            data = CMD_VEL[:-1] + str(n).encode()
            writer.write(pack("01", name, "cmd_vel", "+pub", {"n": n}, data))
            answer = await packet()
            publish.append(time.perf_counter() - began)
            answered["publish"] += answer.op == "+ok" and answer.head["n"] == str(n)
            began = time.perf_counter()
            writer.write(pack("01", name, "cmd_vel", "s"))
            answer = await packet()
            read.append(time.perf_counter() - began)
            answered["read"] += answer.data == data
        writer.close()
        return publish, read

    found = await asyncio.gather(*[one(name) for name in names[: args.nodes]])
    print(
        json.dumps(
            {
                "publish": percentiles([t for times, _ in found for t in times]),
                "read": percentiles([t for _, times in found for t in times]),
                "answered": answered,
            }
        ),
        flush=True,
    )


async def flood(args: argparse.Namespace) -> None:
    """Acknowledged publications as fast as they go, of several nodes at once; up to 200 of each under way."""

    async def one(index: int) -> None:
        reader, writer = await connect(args.host, PORT)
        room, parser = asyncio.Semaphore(200), Parser()

        async def read() -> None:
            done = 0
            while done < args.count:
                for packet in parser.feed(await reader.read(65536)):
                    assert isinstance(packet, Packet)
                    assert packet.op == "+ok", packet
                    done += 1
                    room.release()

        async def write() -> None:
            for n in range(args.count):
                await room.acquire()
                writer.write(pack("01", f"R{index}", f"t{n % 10}", "+pub", {"n": n}, CMD_VEL))

        await asyncio.gather(read(), write())
        writer.close()

    began = time.perf_counter()
    await asyncio.gather(*[one(i) for i in range(args.nodes)])
    print(json.dumps({"rate": args.nodes * args.count / (time.perf_counter() - began)}), flush=True)


async def idle(args: argparse.Namespace) -> None:
    """Many connections that say who they are, publish once, subscribe, and stay."""
    ends = []
    for index in range(args.nodes):
        reader, writer = await connect(args.host, PORT)
        writer.write(pack("01", f"R{index}", "-", "+hello", {"n": 1}))
        writer.write(pack("01", f"R{index}", "pose", "+pub", {"n": 2}, CMD_VEL))
        writer.write(pack("01", f"R{index}", "cmd_vel", "+sub", {"n": 3}))
        seen = b""
        while b"n=3" not in seen or b"n=2" not in seen:
            seen += await reader.read(65536)
        ends.append(writer)
    print("ready", flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)
    for writer in ends:
        writer.close()


async def camera(args: argparse.Namespace) -> None:
    """Publishes a picture of 95 kB 15 times a second and a pose 50 times, each beginning with the time."""
    _, writer = await connect(args.host, PORT)

    async def send(topic: str, size: int, hz: float) -> None:
        loop = asyncio.get_running_loop()
        began = loop.time()
        for number in range(int(args.count * hz)):
            await asyncio.sleep(max(0.0, began + number / hz - loop.time()))
            writer.write(pack("01", "CAMERA", topic, "p", None, str(time.time_ns()).encode().ljust(size, b"x")))

    await asyncio.gather(send("picture", 95_000, 15), send("pose", 100, 50))
    writer.close()


async def viewer(args: argparse.Namespace) -> None:
    """Reads both, over the link."""
    reader, writer = await connect(args.host, PORT)
    writer.write(pack("01", "CAMERA", "*", "+sub", {"n": 1}))
    parser = Parser()
    delays: dict[str, list[float]] = {"picture": [], "pose": []}
    print("ready", flush=True)
    with contextlib.suppress(TimeoutError):
        async with aio.timeout(args.count):
            while data := await reader.read(65536):
                for packet in parser.feed(data):
                    if isinstance(packet, Packet) and packet.topic in delays:
                        delays[packet.topic].append((time.time_ns() - int(packet.data[:19])) / 1e9)
    writer.close()
    print(json.dumps({topic: [len(found) / args.count, *percentiles(found)] for topic, found in delays.items()}))


async def answerer(args: argparse.Namespace) -> None:
    """A node of ROS 2 (a DDS participant) that turns every Twist around."""
    graph = DdsGraph(DOMAIN, name="robot", interface="lo", registry=TypeRegistry())
    await graph.open()
    publisher = await graph.create_publisher("/PC/odom", TWIST, QoS())

    def turn(batch: Any) -> None:
        for sample in batch:
            publisher.publish(Sample(sample.payload, TWIST, time.time_ns(), bytes(16), 0))
            print(json.dumps([struct.unpack_from("<d", sample.payload, 4)[0], time.time_ns()]), flush=True)

    await graph.create_subscription("/ROBOT/cmd_vel", TWIST, QoS(), turn)
    print("ready", flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)
    await graph.close()


def percentiles(times: list[float]) -> list[float]:
    """Median, mean and 99th percentile in milliseconds."""
    return [1e3 * float(v) for v in (np.percentile(times, 50), np.mean(times), np.percentile(times, 99))]


# ── parts ──────────────────────────────────────────────────────────────────────────────────────────────────────────


def link() -> contextlib.AbstractContextManager[tuple[str, str, str] | None]:
    """The paper's Wi-Fi: 5 ms one way, 2 ms jitter, 1 % loss, 50 Mbit/s."""
    return delayed("rwn", "10.79.0", delay_ms=5, jitter_ms=2, loss=0.01, rate_mbit=50)


def paper(as_json: bool, count: int) -> None:
    """Five nodes, each ``count`` publications and ``count`` reads, beside the link's own round trip."""
    with link() as ends, tempfile.TemporaryDirectory() as directory:
        if ends is None:
            return
        a, b, far_ip = ends
        server, far = start_gateway(config(directory, far_ip), b), Process(b, *ME, "echo", "--host", far_ip)
        far.line()
        more = ("--host", far_ip, "--count", str(count), "--nodes", "5")
        bare = json.loads(Process(a, *ME, "pinger", *more).finish(600))["bare"]
        ours = json.loads(Process(a, *ME, "robots", *more, quiet=False).finish(600))
        far.stop()
        server.stop()
    rows = []
    for what in ("publish", "read"):
        p50, mean, p99 = ours[what]
        share = 100 * ours["answered"][what] / (5 * count)
        rows.append([what, share, p50, p50 / bare[0], mean, mean / bare[1], p99, p99 / bare[2]])
    heads = ["operation", "delivered %", "p50 ms", "/ link (<= 1.2)", "mean ms", "/ link", "p99 ms", "/ link"]
    table(f"five nodes, {count} of each, 5 ms +- 2 ms, 1 % loss (link {bare[0]:.1f} ms)", heads, rows, as_json=as_json)


def narrow(as_json: bool, seconds: int) -> None:
    """A node that reads pictures and poses over links that carry fewer pictures than there are."""
    rows = []
    for mbit, delay_ms in ((5, 35), (20, 10)):
        with (
            delayed("rwn", "10.79.0", delay_ms=delay_ms, rate_mbit=mbit) as ends,
            tempfile.TemporaryDirectory() as directory,
        ):
            if ends is None:
                return
            a, b, far_ip = ends
            server = start_gateway(config(directory, far_ip), b)
            more = ("--host", far_ip, "--count", str(seconds))
            reading = Process(a, *ME, "viewer", *more, quiet=False)
            reading.line()
            source = Process(b, *ME, "camera", *more)
            found = json.loads(reading.finish(seconds + 30))
            source.stop()
            server.stop()
        rows += [[f"{mbit} Mbit/s, {delay_ms} ms", topic, *figures] for topic, figures in found.items()]
    heads = ["link", "value", "Hz", "delay p50 ms", "mean ms", "p99 ms"]
    table("a node that reads 95 kB at 15 Hz and 100 bytes at 50 Hz over a narrow link", heads, rows, as_json=as_json)


def rate(as_json: bool, count: int) -> None:
    """Acknowledged publications a second with SQLite."""
    rows = []
    for nodes in (1, 5, 20):
        with tempfile.TemporaryDirectory() as directory:
            server = start_gateway(config(directory, "127.0.0.1"))
            more = ("--nodes", str(nodes), "--count", str(count // nodes))
            Process(None, *ME, "flood", "--nodes", "1", "--count", "1").finish(300)
            began_s = server.cpu_s()  # what it took to start is no cost of a publication
            found = json.loads(Process(None, *ME, "flood", *more, quiet=False).finish(300))
            rows.append([nodes, found["rate"], 1e6 * (server.cpu_s() - began_s) / count])
            server.stop()
    heads = ["nodes", "acknowledged /s (>= 20000)", "server CPU us each"]
    table("acknowledged publications, SQLite", heads, rows, as_json=as_json)


def many(as_json: bool, nodes: int) -> None:
    """Memory of a server with many nodes."""
    with tempfile.TemporaryDirectory() as directory:
        server = start_gateway(config(directory, "127.0.0.1"))
        first = Process(None, *ME, "idle", "--nodes", "1")
        first.line()
        first.stop()
        before = server.memory_bytes()
        clients = Process(None, *ME, "idle", "--nodes", str(nodes), quiet=False)
        clients.line()
        memory, used = server.memory_bytes(), server.cpu_s()
        time.sleep(5)
        cpu = (server.cpu_s() - used) / 5
        clients.stop()
        server.stop()
    row = [nodes, memory / 1e6, (memory - before) / 1e3 / nodes, 100 * cpu]
    heads = ["nodes", "memory MB (<= 200)", "kB each", "idle CPU %"]
    table("connected nodes", heads, [row], as_json=as_json)


async def _ros2(args: argparse.Namespace, robot: Process) -> list[list[Any]]:
    there: list[float] = []
    back: list[float] = []
    arrived = asyncio.Event()
    got: dict[float, int] = {}

    def odom(value: Value) -> None:
        got[value.floats[0]] = time.time_ns()
        arrived.set()

    async with AsyncNode("PC", f"iort://127.0.0.1:{PORT}") as node:
        await node.wait_mode("remote", 20)
        await node.subscribe("odom", odom)
        for n in range(1, args.count + 1):
            arrived.clear()
            began = time.time_ns()
            node.publish_nowait("cmd_vel", [n, 0, 0, 0, 0, 0], system="ROBOT")
            try:
                async with aio.timeout(1.0 if n > 20 else 0.2):
                    await arrived.wait()
            except TimeoutError:
                continue
            number, at = json.loads(await asyncio.to_thread(robot.line))
            while number != n:
                number, at = json.loads(await asyncio.to_thread(robot.line))
            there.append((at - began) / 1e9)
            back.append((got[float(n)] - at) / 1e9)
    return [["node to ROS 2", *percentiles(there), len(there)], ["ROS 2 to node", *percentiles(back), len(back)]]


def ros2(args: argparse.Namespace) -> None:
    """From a node to a subscriber of ROS 2, and back."""
    maps = (
        {"system": "ROBOT", "topic": "cmd_vel", "type": TWIST, "form": "floats", "direction": "in"},
        {"system": "PC", "topic": "odom", "type": TWIST, "form": "floats", "direction": "out"},
    )
    with tempfile.TemporaryDirectory() as directory:
        server = start_gateway(config(directory, "127.0.0.1", graph=f"dds:{DOMAIN}?interface=lo", maps=maps))
        robot = Process(None, *ME, "answerer", quiet=False)
        robot.line()
        rows = uvloop.run(_ros2(args, robot))
        robot.stop()
        server.stop()
    heads = ["way", "p50 ms (< 2)", "mean ms", "p99 ms", "messages"]
    table("one value between a node and a subscriber of ROS 2, loopback", heads, rows, as_json=args.json)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    roles = {"echo": echo, "pinger": pinger, "robots": robots, "flood": flood, "idle": idle, "answerer": answerer}
    roles |= {"camera": camera, "viewer": viewer}
    parser.add_argument("role", nargs="?", default="measure", choices=["measure", *roles])
    parser.add_argument("--part", default="paper,rate,many,ros2,narrow")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--nodes", type=int, default=1000)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if args.role in roles:
        uvloop.run(roles[args.role](args))
        return
    parts = args.part.split(",")
    if "paper" in parts:
        paper(args.json, args.count)
    if "rate" in parts:
        rate(args.json, 100 * args.count)
    if "many" in parts:
        many(args.json, args.nodes)
    if "ros2" in parts:
        ros2(args)
    if "narrow" in parts:
        narrow(args.json, max(args.count // 100, 5))


if __name__ == "__main__":
    main()
