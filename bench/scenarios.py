"""The Gateway paper's figures 3 and 4: local, one subnet, gateways and rosbridge, each read by three DDS readers.

The least and the greatest rate and delay of all readers stand beside the mean, as the paper's error bars do, and the
share of frames that came within the time between two frames (66.7, 33.3 and 16.7 ms), its limit for real time.
``--plot FILE`` draws both figures. The rosbridge rows need root, as all do, and a sourced ROS 2 with rosbridge_server.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from bench.netns import Network, Process, network
from bench.paper import TOPICS, config, routes, start_sources
from bench.report import table

READERS: Final = 3
PORT: Final = 9090
_FOUND_S: Final = 4.0  # for everybody to find everybody
_MARGIN_S: Final = 4.0  # readers stay so much longer than the sources
_HEADS: Final = [
    "source Hz",
    "scenario",
    "topic",
    "Hz",
    "least",
    "greatest",
    "delay ms",
    "min",
    "p99",
    "max",
    "limit ms",
    "in time",
]


@dataclass(frozen=True)
class Scenario:
    """One bar: where the readers are, and what is started between the sources and them."""

    name: str
    readers: str  # namespace
    interface: str
    between: Callable[[Network, Path], list[Process]]


def _nothing(net: Network, directory: Path) -> list[Process]:
    return []


def _gateways(operation: str, encoding: str) -> Callable[[Network, Path], list[Process]]:
    def start(net: Network, directory: Path) -> list[Process]:
        server, client = ("b", "a") if operation == "publish" else ("a", "b")
        address = f"ws://{net.address_b if server == 'b' else net.address_a}:{PORT}"
        near = config(directory, "server", [], address)
        far = config(directory, "client", routes(operation, address, encoding, TOPICS), None)
        return [_run(net, server, near), _run(net, client, far)]

    return start


def _rosbridge(operation: str, encoding: str) -> Callable[[Network, Path], list[Process]]:
    def start(net: Network, directory: Path) -> list[Process]:
        server, client = ("b", "a") if operation == "publish" else ("a", "b")
        address = net.address_b if server == "b" else net.address_a
        given = ("--ros-args", "-p", f"address:={address}", "-p", f"port:={PORT}")
        domain = {"ROS_DOMAIN_ID": "0", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "RMW_IMPLEMENTATION": _RMW}
        bridge = net.start(server, *given, program=str(rosbridge()), **domain)
        time.sleep(_FOUND_S)  # it tells nobody when it listens
        far = config(directory, "client", routes(operation, f"ws://{address}:{PORT}", encoding, TOPICS), None)
        return [bridge, _run(net, client, far)]

    return start


_RMW: Final = "rmw_cyclonedds_cpp"
SCENARIOS: Final = (
    Scenario("ros2-localhost", "a", "lo", _nothing),
    Scenario("ros2-subnet", "b", "wire", _nothing),
    Scenario("gateway-pub-json", "b", "lo", _gateways("publish", "none")),
    Scenario("gateway-sub-json", "b", "lo", _gateways("subscribe", "none")),
    Scenario("gateway-sub-raw", "b", "lo", _gateways("subscribe", "cbor-raw")),
    Scenario("gateway-sub-auto", "b", "lo", _gateways("subscribe", "auto")),
    Scenario("rosbridge-pub-json", "b", "lo", _rosbridge("publish", "none")),
    Scenario("rosbridge-sub-json", "b", "lo", _rosbridge("subscribe", "none")),
    Scenario("rosbridge-sub-raw", "b", "lo", _rosbridge("subscribe", "cbor-raw")),
)


def rosbridge() -> Path | None:
    """The program of rosbridge_server, where ROS 2 is sourced."""
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    places = [Path(prefix) / "lib/rosbridge_server/rosbridge_websocket" for prefix in prefixes if prefix]
    return next((place for place in places if place.exists()), None)


def _run(net: Network, where: str, path: str) -> Process:
    return net.start(where, "-m", "ropeway", "run", path, "--quiet")


def measure(net: Network, scenario: Scenario, hz: float, seconds: float) -> list[dict[str, dict[str, float]]]:
    """What each of the readers got, by topic."""
    with tempfile.TemporaryDirectory() as directory:
        between = scenario.between(net, Path(directory))
        wanted = ("--topic", ",".join(TOPICS), "--kind", ",".join(TOPICS.values()), "--interface", scenario.interface)
        span = ("--seconds", str(seconds + _FOUND_S + _MARGIN_S), "--limit-ms", str(1e3 / hz))
        readers = [net.start(scenario.readers, "-m", "bench.peers", "sink", *wanted, *span) for _ in range(READERS)]
        for reader in readers:
            reader.line()
        time.sleep(_FOUND_S)
        sources = start_sources(net, hz, seconds, TOPICS, interface=scenario.interface)
        found = [json.loads(reader.finish(seconds + 60).splitlines()[-1]) for reader in readers]
        alive = all(process.running for process in between)
        for process in (*readers, *sources, *between):
            process.stop()
    if not alive:
        raise SystemExit(f"{scenario.name}: what stands between the networks has ended; nothing of it is a figure")
    return found


def row(hz: float, name: str, topic: str, found: list[dict[str, dict[str, float]]]) -> list[Any]:
    """One line of the table: all readers together."""
    got = [one.get(topic, {}) for one in found]
    got = [one for one in got if "rate_hz" in one]
    head = [hz, name, topic.rsplit("/", 2)[-2]]
    if not got:
        return [*head, 0.0, 0.0, 0.0, None, None, None, None, 1e3 / hz, 0.0]
    rates = [one["rate_hz"] for one in got] + [0.0] * (len(found) - len(got))
    frames = sum(one["n"] for one in got)
    return [
        *head,
        sum(rates) / len(rates),
        min(rates),
        max(rates),
        sum(one["delay_mean_ms"] * one["n"] for one in got) / frames,
        min(one["delay_min_ms"] for one in got),
        max(one["delay_p99_ms"] for one in got),
        max(one["delay_max_ms"] for one in got),
        1e3 / hz,
        sum(one["within"] * one["n"] for one in got) / frames,
    ]


def draw(rows: list[list[Any]], path: str) -> None:
    """Draw the rates (figure 3) and the delays (figure 4), with the least and the greatest as bars."""
    import matplotlib as mpl

    mpl.use("agg")
    from matplotlib import pyplot

    speeds = sorted({line[0] for line in rows})
    figure, axes = pyplot.subplots(2, len(speeds), figsize=(5 * len(speeds), 8), squeeze=False)
    for column, hz in enumerate(speeds):
        for topic, shift in (("color", -0.2), ("depth", 0.2)):
            lines = [dict(zip(_HEADS, line, strict=True)) for line in rows if (line[0], line[2]) == (hz, topic)]
            places = [index + shift for index in range(len(lines))]
            _bars(axes[0][column], places, lines, "Hz", "least", "greatest", topic)
            _bars(axes[1][column], places, lines, "delay ms", "min", "max", topic)
            for axis in (axes[0][column], axes[1][column]):
                axis.set_xticks(range(len(lines)), [line["scenario"] for line in lines], rotation=60, ha="right")
        axes[0][column].axhline(hz, linestyle="--", color="grey")
        axes[1][column].axhline(1e3 / hz, linestyle="--", color="grey", label=f"limit {1e3 / hz:.1f} ms")
        axes[0][column].set_title(f"{hz:g} Hz")
        axes[1][column].set_yscale("log")
        axes[1][column].legend()
    axes[0][0].set_ylabel("rate, Hz")
    axes[1][0].set_ylabel("delay, ms")
    figure.tight_layout()
    figure.savefig(path, dpi=120)


def _bars(
    axis: Any, places: list[float], lines: list[Mapping[str, Any]], mean: str, low: str, high: str, topic: str
) -> None:
    values = [line[mean] or 0.0 for line in lines]
    below = [max(value - (line[low] or 0.0), 0.0) for value, line in zip(values, lines, strict=True)]
    above = [max((line[high] or 0.0) - value, 0.0) for value, line in zip(values, lines, strict=True)]
    axis.bar(places, values, width=0.4, yerr=[below, above], capsize=3, label=topic)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mbit", type=float, default=100)
    parser.add_argument("--hz", default="15,30,60")
    parser.add_argument("--scenarios", default="", help="some of: " + ", ".join(one.name for one in SCENARIOS))
    parser.add_argument("--seconds", type=float, default=8)
    parser.add_argument("--plot", default="", help="where the PNG goes")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    wanted = [one for one in SCENARIOS if not args.scenarios or one.name in args.scenarios.split(",")]
    if rosbridge() is None:
        print("the rosbridge rows are left out: no ROS 2 with rosbridge_server is sourced", file=sys.stderr)
        wanted = [one for one in wanted if not one.name.startswith("rosbridge")]
    rows: list[list[Any]] = []
    with network(args.mbit, name=f"rw{os.getpid()}", subnet=78) as net:
        for hz in map(float, args.hz.split(",")):
            for scenario in wanted:
                found = measure(net, scenario, hz, args.seconds)
                rows += [row(hz, scenario.name, topic, found) for topic in TOPICS]
                print(f"{hz:g} Hz {scenario.name} done", file=sys.stderr, flush=True)
    table(f"colour and depth over {args.mbit:g} Mbit/s, {READERS} DDS readers", _HEADS, rows, as_json=args.json)
    if args.plot:
        draw(rows, args.plot)


if __name__ == "__main__":
    main()
