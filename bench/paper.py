"""The Gateway paper's experiment: colour and depth images over 100 Mbit/s, both directions, every encoding.

Rate is the paper's equation (1), delay its equation (2). The predicted columns are its equations (3) to (5) with
three subscribers per topic: what plain DDS would carry, and what a gateway with this compression ratio can.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from bench.netns import Network, Process, network
from bench.peers import messages
from bench.report import table
from ropeway.networks.rosbridge.protocol import codec
from ropeway.planning import PlannedLink, PlannedTopic, TrafficPlan, predict
from ropeway.types import TypeRegistry

TOPICS = {"/camera/color/image_raw": "rgb", "/camera/depth/image_rect_raw": "depth"}
ENCODINGS = ("none", "cbor", "cbor-raw", "zip", "rawzip", "zstd", "auto")
SUBSCRIBERS = 3
TCP_SHARE = 0.955  # of a link's rate that TCP carries as payload (measured: 95.5 of 100 Mbit/s)


def config(
    directory: Path, name: str, remotes: list[dict[str, Any]], listen: str | None, graph: str = "dds:0?interface=lo"
) -> str:
    """Write a configuration; gives its path."""
    gateway = {"name": name, "graphs": [graph], "listen": [listen] if listen else [], "insecure": True}
    path = directory / f"{name}.json"
    path.write_text(json.dumps({"gateway": gateway, "remotes": remotes}))
    return str(path)


def routes(operation: str, address: str, encoding: str, topics: dict[str, str]) -> list[dict[str, Any]]:
    """The remote of the gateway that dials."""
    items = [{"name": t, "type": messages(kind)[0], "compression": encoding} for t, kind in topics.items()]
    return [{"address": address, operation: items}]


def start_pair(net: Network, directory: Path, operation: str, encoding: str, topics: dict[str, str]) -> list[Any]:
    """Robot in ``a``, cloud in ``b``; data flows from robot to cloud. Gives the two gateways."""
    server, client = ("b", "a") if operation == "publish" else ("a", "b")
    address = net.address_b if server == "b" else net.address_a
    names = {"a": "robot", "b": "cloud"}
    first = config(directory, names[server], [], f"ws://{address}:9090")
    second = config(directory, names[client], routes(operation, f"ws://{address}:9090", encoding, topics), None)
    return [
        net.start(server, "-m", "ropeway", "run", first, "--quiet"),
        net.start(client, "-m", "ropeway", "run", second, "--quiet"),
    ]


def measure(
    net: Network, operation: str, encoding: str, hz: float, seconds: float, topics: dict[str, str]
) -> dict[str, dict[str, float]]:
    """One cell: the sink's figures per topic."""
    with tempfile.TemporaryDirectory() as directory:
        gateways = start_pair(net, Path(directory), operation, encoding, topics)
        sink = net.start(
            "b",
            "-m",
            "bench.peers",
            "sink",
            "--topic",
            ",".join(topics),
            "--kind",
            ",".join(topics.values()),
            "--seconds",
            str(seconds + 4),
        )
        sink.line()
        sources = start_sources(net, hz, seconds, topics)
        result: dict[str, dict[str, float]] = json.loads(sink.finish(seconds + 60).splitlines()[-1])
        for process in (*sources, *gateways):
            process.stop()
    return result


def start_sources(
    net: Network, hz: float, seconds: float, topics: dict[str, str], interface: str = "lo"
) -> list[Process]:
    """A camera driver for each topic, so that their frames do not come in step."""
    return [
        net.start(
            "a",
            "-m",
            "bench.peers",
            "source",
            "--topic",
            t,
            "--kind",
            k,
            "--hz",
            str(hz),
            "--seconds",
            str(seconds),
            "--settle",
            "1",
            "--interface",
            interface,
        )
        for t, k in topics.items()
    ]


def local(net: Network, hz: float, seconds: float, topics: dict[str, str]) -> dict[str, dict[str, float]]:
    """The same without a gateway, source and sink in one namespace."""
    sink = net.start(
        "a",
        "-m",
        "bench.peers",
        "sink",
        "--topic",
        ",".join(topics),
        "--kind",
        ",".join(topics.values()),
        "--seconds",
        str(seconds + 4),
    )
    sink.line()
    sources = start_sources(net, hz, seconds, topics)
    result: dict[str, dict[str, float]] = json.loads(sink.finish(seconds + 60).splitlines()[-1])
    for process in sources:
        process.stop()
    return result


def ratios(topics: dict[str, str]) -> dict[tuple[str, str], tuple[float, float]]:
    """Per (topic, encoding): mean bytes on the wire, and the compression ratio."""
    registry = TypeRegistry()
    out: dict[tuple[str, str], tuple[float, float]] = {}
    for topic, kind in topics.items():
        type, payloads = messages(kind)
        some = payloads[:: max(1, len(payloads) // 10)]
        raw = sum(map(len, some)) / len(some)
        for encoding in ENCODINGS:
            name = "zstd" if encoding == "auto" else encoding
            sizes = [len(codec.encode_msg(name, p, registry.codec(type), stamp_ns=0)) for p in some]
            mean = sum(sizes) / len(sizes)
            out[topic, encoding] = (mean, raw / mean)
    return out


def predicted(hz: float, link_bps: float, wire: dict[tuple[str, str], tuple[float, float]], encoding: str) -> float:
    """Return the rate at which each topic arrives, by equations (3) to (5); ``encoding`` may be ``"dds"``."""
    topics = tuple(
        PlannedTopic(
            topic,
            wire[topic, "cbor-raw"][0],
            hz,
            publishers={"robot": 1},
            readers={"cloud": SUBSCRIBERS},
            ratios={name: wire[topic, name][1] for name in ENCODINGS},
        )
        for topic in TOPICS
    )
    rows = predict(TrafficPlan(topics, (PlannedLink(link_bps, hosts=frozenset(("robot", "cloud"))),)), [encoding])
    return min(row.rate_hz for row in rows)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mbit", type=float, default=100)
    parser.add_argument("--hz", default="15,30,60")
    parser.add_argument("--encodings", default=",".join(ENCODINGS))
    parser.add_argument("--operations", default="publish,subscribe")
    parser.add_argument("--seconds", type=float, default=8)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows: list[list[Any]] = []
    wire = ratios(TOPICS)
    link = args.mbit * 1e6 * TCP_SHARE
    with network(args.mbit) as net:
        for hz in map(float, args.hz.split(",")):
            base = local(net, hz, args.seconds, TOPICS)
            dds = predicted(hz, 1e6 * args.mbit, wire, "dds")
            for topic in TOPICS:
                f = base[topic]
                rows.append(
                    [
                        hz,
                        "local DDS",
                        "",
                        topic.rsplit("/", 2)[-2],
                        f["rate_hz"],
                        1.0,
                        dds,
                        None,
                        f["delay_p50_ms"],
                        f["delay_p99_ms"],
                        None,
                        None,
                    ]
                )
            for operation in args.operations.split(","):
                for encoding in args.encodings.split(","):
                    got = measure(net, operation, encoding, hz, args.seconds, TOPICS)
                    both = sum(wire[t, encoding][0] for t in TOPICS)
                    expected = predicted(hz, 1e6 * args.mbit, wire, encoding)
                    capacity = min(hz, link / 8 / both)
                    wire_ms = 8e3 * both / (args.mbit * 1e6)
                    for topic in TOPICS:
                        f = got.get(topic, {})
                        rate = f.get("rate_hz", 0.0)
                        rows.append(
                            [
                                hz,
                                operation,
                                encoding,
                                topic.rsplit("/", 2)[-2],
                                rate,
                                rate / base[topic]["rate_hz"],
                                expected,
                                rate / capacity,
                                f.get("delay_p50_ms"),
                                f.get("delay_p99_ms"),
                                f.get("delay_p50_ms", 0) / wire_ms,
                                f.get("delay_p99_ms", 0) / wire_ms,
                            ]
                        )
                    print(f"{hz:g} Hz {operation} {encoding} done", file=sys.stderr, flush=True)
    heads = [
        "source Hz",
        "operation",
        "encoding",
        "topic",
        "rate Hz",
        "of local",
        "eq. (3)-(5) Hz",
        "of capacity",
        "delay p50 ms",
        "p99 ms",
        "p50/wire",
        "p99/wire",
    ]
    table(f"colour and depth over {args.mbit:g} Mbit/s", heads, rows, as_json=args.json)


if __name__ == "__main__":
    main()
