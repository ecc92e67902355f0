"""Colour and depth at 15 Hz and a command at 50 Hz over links with delay, jitter, loss and a rate.

Without ``--link`` the tables; with it one cell, or one for each link, mode and congestion control that is named::

    ROPEWAY_LINK=PROGRAM python -m bench.wan --link 20,10,2,0.01 --mode auto,cbor-raw --seconds 15 --runs 3

A link is ``rate,delay[,jitter[,loss]]``: Mbit/s (0: unlimited), ms one way, plus or minus ms, a share of packets. A
mode is an encoding between two gateways, ``overlay`` or ``overlay-routed``, ``client:ENCODING`` (a rosbridge client at
the far end of a ``ropeway server``), ``tcp`` (a bare connection that fills the link), ``local`` (DDS alone, without the
link), or ``peer`` (other gateways: ``--peer-near`` and ``--peer-far`` start them).

Rates count what arrives within the window; delays, p50 / p99 in ms, are of all that was sent within it and ever came.
*rtt* is the round trip of small datagrams beside: above the link's own it is a queue. *link* is what crosses, headers
included; *TCP* a bare connection's payload, *images* that of the images, uncompressed. CPU is of one core.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
from collections.abc import Iterator
from dataclasses import asdict, replace
from statistics import median
from typing import Any

from bench.report import table
from bench.wan.cell import WORK, Cell, Row, measure, reference
from bench.wan.link import Shape, program, sysctl
from bench.wan.modes import MODES

LINKS = ("100,10", "100,35", "20,10,2", "20,10,2,0.01", "20,10,2,0.03", "5,35", "20,0")
FLAT = Shape(0, 50)
CONGESTION = "net.ipv4.tcp_congestion_control"
START_S = 60.0  # for starting and stopping everything, on a busy machine
FLAT_HZ = 120.0  # more than a link program in user space carries
HEADS = ["link", "mode", "cc", "part", *(f"{topic}{figure}" for topic in WORK for figure in (" Hz", " ms"))]
HEADS += ["of sent", "rtt ms", "link Mbit/s", "TCP Mbit/s", "images MB/s", "CPU near", "far", "link", "load"]


def middle(runs: list[list[Row]]) -> list[Row]:
    """Return the medians of the runs, number by number."""

    def of(values: list[Any]) -> Any:
        first = values[0]
        if isinstance(first, dict):
            keys = {key for value in values for key in value}
            return {key: of([value[key] for value in values if key in value]) for key in keys}
        return median(values) if isinstance(first, float | int) else first

    return [Row(**of([asdict(row) for row in rows])) for rows in zip(*runs, strict=True)]


def line(cell: Cell, row: Row) -> list[Any]:
    """Return a row of the table."""
    cells: list[Any] = [str(cell.shape), cell.mode, cell.congestion or sysctl(CONGESTION), row.part]
    for name in WORK:
        got = row.topics.get(name, {})
        cells += [got.get("rate_hz"), both(got)]
    images = [got["mb_s"] for name, got in row.topics.items() if name != "command"]
    cells += [row.topics.get("command", {}).get("arrived"), both(row.rtt), row.link_mbit, row.foreign_mbit]
    cells.append(sum(images) if images else None)
    return [*cells, row.cpu.get("near"), row.cpu.get("far"), row.cpu.get("relay"), row.load]


def both(got: dict[str, float]) -> str | None:
    """Return median and 99th percentile."""
    return f"{got['p50']:.0f} / {got['p99']:.0f}" if "p50" in got else None


def bounded(cell: Cell) -> list[Row]:
    """Measure a cell; one that hangs ends the bench, and its namespaces are removed."""
    signal.alarm(int(cell.warm_s + cell.seconds + cell.drain_s + START_S))
    try:
        return measure(cell)
    finally:
        signal.alarm(0)


def run(title: str, cells: list[Cell], runs: int, as_json: bool) -> None:
    """Measure the cells and print their table; with JSON, all that is known of each."""
    lines = []
    for cell in cells:
        print(f"{cell.shape}, {cell.mode} {cell.congestion or ''} ...", file=sys.stderr, flush=True)
        rows = middle([bounded(cell) for _ in range(runs)])
        lines += [line(cell, row) for row in rows]
        if as_json:
            for row in rows:
                print(json.dumps({"table": title, "cell": asdict(cell), "row": asdict(row)}), flush=True)
    if not as_json:
        table(title, HEADS, lines)


def alone(shapes: list[Shape], congestion: list[str | None], as_json: bool) -> None:
    """Measure the links with nothing of ours on them."""
    lines = []
    for shape in shapes:
        idle = reference(shape)
        for control in congestion:
            bare = measure(Cell(shape, "tcp", congestion=control, seconds=5, warm_s=3))[0]
            cells = [both(idle), 100 * idle["lost"], bare.foreign_mbit, both(bare.rtt), bare.cpu["relay"], bare.load]
            lines.append([str(shape), control or sysctl(CONGESTION), *cells])
    heads = ["link", "cc", "idle rtt ms", "lost %", "bare TCP Mbit/s", "rtt beside it ms"]
    table("the links alone", [*heads, "CPU of the link program", "load"], lines, as_json=as_json)


def cells_of(args: argparse.Namespace) -> Iterator[Cell]:
    """Return the cells that the arguments name."""
    changes = tuple((float(at), words.replace(",", " ")) for at, _, words in (c.partition(":") for c in args.change))
    for text in args.link:
        for mode in args.mode.split(","):
            for congestion in args.congestion.split(","):
                yield Cell(
                    Shape.parse(text, args.queue),
                    mode,
                    work=tuple(args.work.split(",")),
                    images_hz=args.hz,
                    seconds=args.seconds,
                    warm_s=args.warm,
                    congestion=congestion or None,
                    both=args.both,
                    pairs=args.pairs,
                    foreign=args.foreign,
                    changes=changes,
                    peer=(args.peer_near, args.peer_far),
                )


def tables(args: argparse.Namespace) -> None:
    """Measure everything."""
    base = Cell(Shape(), seconds=args.seconds, warm_s=args.warm)
    shapes = [Shape.parse(text, 1000) for text in LINKS]
    controls = sysctl("net.ipv4.tcp_available_congestion_control").split()
    alone([*shapes, FLAT], [None], args.json)

    def measured(title: str, cells: list[Cell]) -> None:
        run(title, cells, args.runs, args.json)

    modes = ["auto", "cbor-raw", "overlay", "overlay-routed", *(["peer"] if args.peer_near else [])]
    peer = (args.peer_near, args.peer_far)
    for mode in modes:
        measured(f"colour, depth and a command: {mode}", [replace(base, shape=s, mode=mode, peer=peer) for s in shapes])
    clients = [
        replace(base, shape=shapes[1], mode=f"client:{name}", work=("colour",)) for name in ("none", "cbor", "cbor-raw")
    ]
    measured("a rosbridge client that reads colour", clients)
    flat = replace(base, shape=FLAT, work=("colour", "command"), images_hz=FLAT_HZ)
    ways = [(mode, control) for control in controls if control != "reno" for mode in ("tcp", "cbor-raw")]
    measured("images flat out", [replace(flat, mode=mode, congestion=control) for mode, control in ways])
    measured("congestion control", [replace(base, shape=s, congestion=c) for s in shapes[2:4] for c in controls])
    measured("short queues", [replace(base, shape=replace(s, queue=20)) for s in shapes])
    measured("5 % loss", [replace(base, shape=replace(shapes[2], loss=0.05))])
    measured("both directions", [replace(base, shape=shapes[2], both=True)])
    measured("two pairs and a foreign connection", [replace(base, shape=shapes[0], pairs=2, foreign="cubic")])
    changes = ((5.0, "rate_mbit=5"), (10.0, "rate_mbit=20 delay_ms=60"))
    measured("rate and delay change", [replace(base, shape=shapes[2], changes=changes, seconds=max(base.seconds, 15))])


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.wan", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--link", action="append", default=[], help="rate,delay[,jitter[,loss]]; may be given again")
    parser.add_argument("--mode", default="auto", help=f"some of tcp,{','.join(MODES)}")
    parser.add_argument("--work", default=",".join(WORK), help="which topics")
    parser.add_argument("--hz", type=float, default=15.0, help="of the images")
    parser.add_argument("--seconds", type=float, default=15.0, help="what counts")
    parser.add_argument("--warm", type=float, default=4.0, help="seconds before it")
    parser.add_argument("--runs", type=int, default=1, help="medians of so many")
    parser.add_argument("--congestion", default="", help="some of bbr,cubic,reno; left out, the kernel's")
    parser.add_argument("--queue", type=int, default=1000, help="packets that the link holds")
    parser.add_argument("--both", action="store_true", help="the same work in both directions")
    parser.add_argument("--pairs", type=int, default=1, help="so many pairs of gateways on one link")
    parser.add_argument(
        "--foreign", nargs="?", const="", metavar="CC", help="a bare connection beside that fills the link"
    )
    parser.add_argument("--change", action="append", default=[], metavar="SECONDS:rate_mbit=5,delay_ms=35")
    parser.add_argument("--alone", action="store_true", help="measure the links alone, too")
    parser.add_argument("--peer-near", default="", help="a command; {near} and {far} are the ends' addresses")
    parser.add_argument("--peer-far", default="", help="likewise")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if program() is None:
        return
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # namespaces are removed in any case
    signal.signal(signal.SIGALRM, lambda *_: sys.exit("a measurement hangs"))
    os.nice(-15)  # other work on the machine is not what is measured
    if not args.link:
        tables(args)
        return
    cells = list(cells_of(args))
    if args.alone:
        shapes = list(dict.fromkeys(cell.shape for cell in cells))
        alone(shapes, list(dict.fromkeys(cell.congestion for cell in cells)), args.json)
    run(f"{args.seconds:g} s, medians of {args.runs}", cells, args.runs, args.json)


if __name__ == "__main__":
    main()
