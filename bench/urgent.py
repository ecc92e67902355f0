"""A command at 50 Hz beside images that fill a 10 Mbit/s link: how late are the commands?"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from bench.netns import network
from bench.paper import config
from bench.peers import messages
from bench.report import table


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mbit", type=float, default=10)
    parser.add_argument("--seconds", type=float, default=10)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows: list[list[Any]] = []
    for encoding in ("cbor-raw", "auto"):
        with network(args.mbit) as net, tempfile.TemporaryDirectory() as directory:
            items = [
                {"name": "/rgb", "type": messages("rgb")[0], "compression": encoding, "priority": "bulk"},
                {"name": "/cmd_vel", "type": messages("twist")[0], "priority": "command"},
            ]
            far = config(Path(directory), "far", [], f"ws://{net.address_b}:9090")
            near = config(Path(directory), "near", [{"address": f"ws://{net.address_b}:9090", "publish": items}], None)
            net.start("b", "-m", "ropeway", "run", far, "--quiet")
            net.start("a", "-m", "ropeway", "run", near, "--quiet")
            sink = net.start(
                "b",
                "-m",
                "bench.peers",
                "sink",
                "--topic",
                "/rgb,/cmd_vel",
                "--kind",
                "rgb,twist",
                "--seconds",
                str(args.seconds + 3),
            )
            sink.line()
            for topic, kind, hz in (("/rgb", "rgb", 30), ("/cmd_vel", "twist", 50)):
                net.start(
                    "a",
                    "-m",
                    "bench.peers",
                    "source",
                    "--topic",
                    topic,
                    "--kind",
                    kind,
                    "--hz",
                    str(hz),
                    "--seconds",
                    str(args.seconds),
                    "--settle",
                    "1",
                )
            got = json.loads(sink.finish(60).splitlines()[-1])
        for topic, figures in got.items():
            rows.append(
                [
                    encoding,
                    topic,
                    *(figures.get(k) for k in ("rate_hz", "delay_p50_ms", "delay_p99_ms", "delay_max_ms")),
                ]
            )
    heads = ["image encoding", "topic", "rate Hz", "delay p50 ms", "p99 ms (command: < 60)", "max ms"]
    table(f"commands beside images on {args.mbit:g} Mbit/s", heads, rows, as_json=args.json)


if __name__ == "__main__":
    main()
