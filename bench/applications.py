"""The applications of the FogROS2-SGC thesis (tables 5.2 and 5.3), without their computing: what the network costs.

Frames of 48 KiB as its visual SLAM sends them, a depth matrix of more than 13 MB for the grasp planner, raw and
compressed on the way, and motion plans of 2 kB, each from robot to cloud through two gateways, over 5 Mbit/s and over a
fast link.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from bench.netns import Network, network
from bench.paper import start_pair
from bench.peers import messages
from bench.report import table

_TOPIC: Final = "/application"
_SETTLE_S: Final = 1.0


@dataclass(frozen=True)
class Application:
    """What is sent: ``kind`` as of ``bench.peers``, in which encoding, and how often over each of the two links."""

    name: str
    kind: str
    encoding: str
    slow_hz: float
    fast_hz: float
    count: int


APPLICATIONS: Final = (
    Application("vSLAM, 48 KiB frames", str(48 << 10), "auto", 10, 30, 100),
    Application("grasp, raw matrix", "matrix", "cbor-raw", 0.04, 0.5, 2),
    Application("grasp, compressed", "matrix", "auto", 0.1, 0.5, 3),
    Application("motion plan, 2 kB", "2000", "auto", 10, 10, 100),
)


def measure(net: Network, application: Application, hz: float) -> dict[str, float]:
    """The figures of one application at its reader."""
    topics = {_TOPIC: application.kind}
    span = application.count / hz
    with tempfile.TemporaryDirectory() as directory:
        gateways = start_pair(net, Path(directory), "publish", application.encoding, topics)
        given = ("--topic", _TOPIC, "--kind", application.kind)
        sink = net.start("b", "-m", "bench.peers", "sink", *given, "--check", "--seconds", str(span + 10), quiet=False)
        sink.line()
        rate = ("--hz", str(hz), "--count", str(application.count), "--seconds", str(2 * span + 10))
        source = net.start("a", "-m", "bench.peers", "source", *given, *rate, "--settle", str(_SETTLE_S))
        found = json.loads(sink.finish(span + 60).splitlines()[-1])
        for process in (source, sink, *gateways):
            process.stop()
    return {**found[_TOPIC], "wrong": found["wrong"]}


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mbit", type=float, default=5, help="of the slow link; the fast one has no limit")
    parser.add_argument("--links", default="slow,fast")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows: list[list[Any]] = []
    with network(args.mbit, name=f"ap{os.getpid()}", subnet=79) as net:
        for mbit in [{"slow": args.mbit, "fast": 0.0}[name] for name in args.links.split(",")]:
            net.rate(mbit)
            for application in APPLICATIONS:
                print(f"{mbit:g} Mbit/s: {application.name}", file=sys.stderr, flush=True)
                size = len(messages(application.kind)[1][0])
                got = measure(net, application, application.slow_hz if mbit else application.fast_hz)
                rows.append(
                    [
                        f"{mbit:g} Mbit/s" if mbit else "fast",
                        application.name,
                        size / 1e3,
                        f"{got['n']}/{application.count}",
                        got["wrong"],
                        8 * size / mbit / 1e6 if mbit else None,
                        got.get("delay_mean_ms", float("nan")) / 1e3,
                        got.get("delay_max_ms", float("nan")) / 1e3,
                    ]
                )
    heads = ["link", "application", "kB", "arrived", "wrong", "raw on the link s", "latency s", "max s"]
    table("applications, robot to cloud", heads, rows, as_json=args.json)


if __name__ == "__main__":
    main()
