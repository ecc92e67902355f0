"""Messages of 13 MB and 60 MB: does every one arrive whole, and how long does it take?"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from bench.netns import network
from bench.paper import TCP_SHARE, config
from bench.peers import messages
from bench.report import table


def measure(size: int, mbit: float, count: int, period_s: float) -> dict[str, Any]:
    """Send ``count`` messages; the sink compares every byte."""
    with network(mbit) as net, tempfile.TemporaryDirectory() as directory:
        items = [{"name": "/cloud", "type": messages(str(size))[0], "compression": "cbor-raw"}]
        far = config(Path(directory), "far", [], f"ws://{net.address_b}:9090")
        near = config(Path(directory), "near", [{"address": f"ws://{net.address_b}:9090", "publish": items}], None)
        net.start("b", "-m", "ropeway", "run", far, "--quiet")
        net.start("a", "-m", "ropeway", "run", near, "--quiet")
        seconds = count * period_s
        sink = net.start(
            "b",
            "-m",
            "bench.peers",
            "sink",
            "--topic",
            "/cloud",
            "--kind",
            str(size),
            "--check",
            "--seconds",
            str(seconds + 6 + period_s),
        )
        sink.line()
        net.start(
            "a",
            "-m",
            "bench.peers",
            "source",
            "--topic",
            "/cloud",
            "--kind",
            str(size),
            "--hz",
            str(1 / period_s),
            "--count",
            str(count),
            "--seconds",
            str(seconds + 60),
            "--settle",
            "1",
        )
        result: dict[str, Any] = json.loads(sink.finish(seconds + 120).splitlines()[-1])
        return result


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--limited-count", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows: list[list[Any]] = []
    for size in (13_000_000, 60_000_000):
        for mbit, count in ((0.0, args.count), (100.0, args.limited_count)):
            wire_s = 8 * size / (mbit * 1e6 * TCP_SHARE) if mbit else 0.0
            got = measure(size, mbit, count, wire_s * 1.3 + (0.5 if size < 20e6 else 1.5))
            figures = got["/cloud"]
            delay = figures.get("delay_p50_ms")
            rows.append(
                [
                    size / 1e6,
                    mbit or "unlimited",
                    count,
                    figures["n"],
                    got["wrong"],
                    delay,
                    delay / 1e3 / wire_s if wire_s and delay else None,
                ]
            )
    heads = ["MB", "Mbit/s", "sent", "arrived", "damaged", "delay p50 ms", "of wire time (<= 1.1)"]
    table("big messages", heads, rows, as_json=args.json)


if __name__ == "__main__":
    main()
