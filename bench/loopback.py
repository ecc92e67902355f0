"""One machine without limits: publisher, gateway, gateway, subscriber beside publisher, subscriber alone.

Throughput flat out, processor time at 60 Hz, the latency that the pair adds, small messages per second.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

from bench.netns import Process
from bench.paper import config
from bench.peers import messages
from bench.report import table

DOMAIN_A, DOMAIN_B, PORT = 62, 63, 19090


def gateways(directory: Path, topics: dict[str, str], encoding: str, qos: dict[str, Any] | None) -> list[Process]:
    """A pair on one machine, each on a DDS domain of its own."""
    items = [
        {"name": t, "type": messages(k)[0], "compression": encoding, **({"qos": qos} if qos else {})}
        for t, k in topics.items()
    ]
    far = config(directory, "far", [], f"ws://127.0.0.1:{PORT}", f"dds:{DOMAIN_B}?interface=lo")
    near = config(
        directory,
        "near",
        [{"address": f"ws://127.0.0.1:{PORT}", "publish": items}],
        None,
        f"dds:{DOMAIN_A}?interface=lo",
    )
    return [Process(None, "-m", "ropeway", "run", path, "--quiet") for path in (far, near)]


def measure(
    topics: dict[str, str],
    *,
    hz: float,
    seconds: float,
    pair: bool,
    encoding: str = "auto",
    keep_all: bool = False,
    burst: int = 16,
    depth: int = 10,
) -> dict[str, Any]:
    """Figures per topic, and the processor share of each gateway."""
    more = ["--keep-all"] if keep_all else ["--depth", str(depth)]
    qos = {"reliability": "reliable", "history": "keep_all"} if keep_all else None
    with tempfile.TemporaryDirectory() as directory:
        running = gateways(Path(directory), topics, encoding, qos) if pair else []
        sink = Process(
            None,
            "-m",
            "bench.peers",
            "sink",
            "--domain",
            str(DOMAIN_B if pair else DOMAIN_A),
            "--topic",
            ",".join(topics),
            "--kind",
            ",".join(topics.values()),
            "--seconds",
            str(seconds + 3),
            *more,
        )
        sink.line()
        source = Process(
            None,
            "-m",
            "bench.peers",
            "source",
            "--domain",
            str(DOMAIN_A),
            "--topic",
            ",".join(topics),
            "--kind",
            ",".join(topics.values()),
            "--hz",
            str(hz),
            "--seconds",
            str(seconds),
            "--settle",
            "1",
            "--burst",
            str(burst),
            *more,
        )
        source.line()
        before, began = [p.cpu_s() for p in running], time.monotonic()
        time.sleep(seconds * 0.8)
        span = time.monotonic() - began
        cpu = [(p.cpu_s() - b) / span for p, b in zip(running, before, strict=True)]
        memory = [p.memory_bytes() for p in running]
        sent = json.loads(source.finish().splitlines()[-1])["sent"]
        got = json.loads(sink.finish(60).splitlines()[-1])
        for process in running:
            process.stop()
    return {"topics": got, "cpu": cpu, "memory": memory, "sent": sent}


def total(result: dict[str, Any], key: str) -> float:
    """A figure added up over the topics."""
    return float(sum(f.get(key, 0.0) for f in result["topics"].values()))


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=6)
    parser.add_argument("--only", default="")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    images = {"/rgb": "rgb", "/depth": "depth"}
    rows: list[list[Any]] = []

    def wanted(name: str) -> bool:
        return not args.only or name in args.only.split(",")

    if wanted("images"):
        bare = measure(images, hz=0, seconds=args.seconds, pair=False, burst=1)
        pair = measure(images, hz=0, seconds=args.seconds, pair=True, burst=1)
        a, b = total(bare, "mbps"), total(pair, "mbps")
        rows.append(["images flat out, MB/s", a, b, b / a, ">= 0.33"])
    if wanted("rate"):
        bare = measure(images, hz=60, seconds=args.seconds, pair=False)
        pair = measure(images, hz=60, seconds=args.seconds, pair=True)
        for t in images:
            x, y = bare["topics"][t], pair["topics"][t]
            rows.append(
                [
                    f"{t} at 60 Hz, delay p50 ms",
                    x["delay_p50_ms"],
                    y["delay_p50_ms"],
                    y["delay_p50_ms"] - x["delay_p50_ms"],
                    "added < 1.5",
                ]
            )
            rows.append([f"{t} at 60 Hz, rate", x["rate_hz"], y["rate_hz"], y["rate_hz"] / x["rate_hz"], "1"])
        for name, cpu, memory in zip(("far", "near"), pair["cpu"], pair["memory"], strict=True):
            rows.append([f"gateway {name}: % of a core at 60 Hz", None, 100 * cpu, None, "<= 8"])
            rows.append([f"gateway {name}: memory MB", None, memory / 1e6, None, "<= 120"])
    if wanted("small"):
        small = {"/small": "1000"}
        for offered in (10_000, 20_000, 30_000, 50_000):
            bare = measure(small, hz=offered, seconds=args.seconds, pair=False, depth=1000)
            pair = measure(small, hz=offered, seconds=args.seconds, pair=True, depth=1000)
            a, b = total(bare, "rate_hz"), total(pair, "rate_hz")
            rows.append([f"1 kB messages/s, {offered} offered", a, b, b / a, ">= 20000"])
        bare = measure(small, hz=200, seconds=args.seconds, pair=False)
        pair = measure(small, hz=200, seconds=args.seconds, pair=True)
        x, y = total(bare, "delay_p50_ms"), total(pair, "delay_p50_ms")
        rows.append(["1 kB delay p50 ms at 200 Hz", x, y, y - x, "added < 0.5"])
    table(
        "loopback",
        ["figure", "bare DDS", "through two gateways", "ratio or difference", "to reach"],
        rows,
        as_json=args.json,
    )


if __name__ == "__main__":
    main()
