"""One cell of a table: a link, what carries the topics over it, and what came in the window that counts."""

from __future__ import annotations

import itertools
import json
import os
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.netns import Process
from bench.wan import modes
from bench.wan.ends import Topic
from bench.wan.link import FAR, NEAR, Link, Shape

__all__ = ["Cell", "Row", "measure", "reference"]

_ENDS, _PROBE = ("-m", "bench.wan.ends"), ("-m", "bench.wan.probe")
WORK = {
    "colour": Topic("colour", "rgb", 15),
    "depth": Topic("depth", "depth", 15),
    "command": Topic("command", "command", 50),
}

Figures = dict[str, float]


@dataclass(frozen=True)
class Cell:
    """What is measured."""

    shape: Shape
    mode: str = "auto"
    work: tuple[str, ...] = tuple(WORK)
    images_hz: float = 15.0
    seconds: float = 15.0
    warm_s: float = 4.0
    drain_s: float = 6.0
    congestion: str | None = None
    both: bool = False
    pairs: int = 1
    foreign: str | None = None
    """The congestion control of a bare connection that fills the link beside; the kernel's choice where empty."""
    changes: tuple[tuple[float, str], ...] = ()
    """Seconds into the window, and what the link becomes then."""
    peer: tuple[str, str] = ("", "")

    def topics(self, direction: str, pair: int) -> list[Topic]:
        """Return what is sent in a direction by a pair."""
        made = []
        for name in self.work:
            kind, hz = WORK[name].kind, WORK[name].hz if name == "command" else self.images_hz
            made.append(Topic(f"/{direction}{pair}/{name}", kind, hz))
        return made


@dataclass
class Row:
    """What came over the link in one direction, from one pair, in one part of the window."""

    part: str
    topics: dict[str, Figures] = field(default_factory=dict)
    rtt: Figures = field(default_factory=dict)
    link_mbit: float = 0.0
    foreign_mbit: float | None = None
    cpu: Figures = field(default_factory=dict)
    load: float = 0.0


def distribution(values: list[float]) -> Figures:
    """Return percentiles, in milliseconds."""
    if not values:
        return {}
    return {f"p{q}": 1e3 * float(np.percentile(values, q)) for q in (50, 99)} | {"max": 1e3 * max(values)}


def figures(sent: list[float], got: list[tuple[float, float, int]], began: float, ended: float) -> Figures:
    """Return rate and delay of a topic within a part of the window.

    The rate counts what arrives within it. The delay is that of all that was sent within it and ever came, so that a
    queue shows as what it is, also where the end would cut it off.
    """
    inside = [row for row in got if began <= row[1] < ended]
    mine = [row for row in got if began <= row[0] < ended]
    offered = sum(began <= at < ended for at in sent)
    stamps = [row[0] for row in got]
    return {
        "rate_hz": len(inside) / (ended - began),
        "offered_hz": offered / (ended - began),
        "arrived": len(mine) / offered if offered else 0.0,
        "mb_s": sum(row[2] for row in inside) / (ended - began) / 1e6,
        "disordered": float(sum(b < a for a, b in itertools.pairwise(stamps))),
        "twice": float(len(stamps) - len(set(stamps))),
        **distribution([row[1] - row[0] for row in mine]),
    }


def measure(cell: Cell) -> list[Row]:
    """Measure one cell; gives a row for each direction, pair and part of the window."""
    if cell.mode == "tcp":
        return [_bare(cell)]
    with Link.open(cell.shape, congestion=cell.congestion) as link, tempfile.TemporaryDirectory() as directory:
        carriers = [
            modes.start(
                link,
                Path(directory),
                cell.mode,
                pair,
                cell.topics("up", pair),
                cell.topics("down", pair) if cell.both else [],
                cell.peer,
            )
            for pair in range(cell.pairs)
        ]
        ways = [(way, pair) for pair in range(cell.pairs) for way in (("up", "down") if cell.both else ("up",))]
        sinks = [_sink(link, cell, carriers[pair], way, pair) for way, pair in ways]
        probes = [_ping(link)]
        if cell.foreign is not None:
            probes.append(_flood(link, "--congestion", cell.foreign))
        for process in sinks:
            process.line()
        sources = [_source(link, cell, way, pair) for way, pair in ways]
        for process in sources:
            process.line()
        began = time.time() + cell.warm_s
        edges = [began, *(began + at for at, _ in cell.changes), began + cell.seconds]
        for process in (*sinks, *probes, *sources):
            process.tell(f"{began} {edges[-1]}")
        marks = list(_watch(link, cell, carriers, edges))
        sent = [json.loads(process.line()) for process in sources]
        rtts, *foreign = (json.loads(process.line()) for process in probes)
        got = [json.loads(process.line()) for process in sinks]
    rows = []
    for number, (start, end) in enumerate(itertools.pairwise(edges)):
        before, after = marks[number], marks[number + 1]
        for index, (way, pair) in enumerate(ways):
            row = Row(_part(cell, way, pair, number))
            for topic in cell.topics(way, pair):
                name = topic.name
                row.topics[name.rpartition("/")[2]] = figures(sent[index][name], got[index][name], start, end)
            row.rtt = distribution([took for left, took in rtts["rows"] if start <= left < end])
            row.link_mbit = 8e-6 * (after[way] - before[way]) / (end - start)
            for flow in foreign:
                carried = sum(size for at, size in flow["rows"] if start <= at < end)
                row.foreign_mbit = 8e-6 * carried / (end - start)
            row.cpu = {k: (after[k] - before[k]) / (end - start) for k in after if k not in ("up", "down")}
            row.load = os.getloadavg()[0]
            rows.append(row)
    return rows


def _sink(link: Link, cell: Cell, carrier: modes.Carrier, way: str, pair: int) -> Process:
    end = "near" if carrier.local or way == "down" else "far"
    topics = ",".join(map(str, cell.topics(way, pair)))
    words = ("--topics", topics, "--drain", str(cell.drain_s))
    if carrier.client is not None:
        where = ("--host", NEAR, "--port", str(9090 + pair), "--compression", carrier.client)
        return link.start(end, *_ENDS, "client", *words, *where)
    return link.start(end, *_ENDS, "sink", *words, "--domain", str(pair))


def _source(link: Link, cell: Cell, way: str, pair: int) -> Process:
    end = "near" if way == "up" else "far"
    topics = ",".join(map(str, cell.topics(way, pair)))
    return link.start(end, *_ENDS, "source", "--topics", topics, "--domain", str(pair), "--drain", str(cell.drain_s))


def _ping(link: Link) -> Process:
    """Start the round trips of small datagrams; gives who tells of them."""
    link.start("far", *_PROBE, "echo", "--host", FAR).line()
    ping = link.start("near", *_PROBE, "ping", "--host", FAR)
    ping.line()
    return ping


def _flood(link: Link, *args: str) -> Process:
    """Start a bare connection that fills the link; gives who tells what came."""
    drain = link.start("far", *_PROBE, "drain", "--host", FAR)
    drain.line()
    link.start("near", *_PROBE, "flood", "--host", FAR, *args).line()
    return drain


def _watch(link: Link, cell: Cell, carriers: list[modes.Carrier], edges: list[float]) -> Iterator[dict[str, float]]:
    """Change the link at each edge of the window, and read counters there."""
    for at, change in zip(edges, ("", *(words for _, words in cell.changes), ""), strict=True):
        time.sleep(max(0.0, at - time.time()))
        if change:
            link.change(change)
        mark = {"up": float(link.received_bytes("far")), "down": float(link.received_bytes("near"))}
        mark["relay"] = link.relay.cpu_s()
        for end in ("near", "far"):
            running = [process for carrier in carriers if (process := getattr(carrier, end)) is not None]
            mark[end] = sum(process.cpu_s() for process in running)
        yield mark


def _part(cell: Cell, way: str, pair: int, number: int) -> str:
    words = []
    if cell.changes:
        words.append(cell.changes[number - 1][1] if number else "before")
    if cell.both:
        words.append(way)
    if cell.pairs > 1:
        words.append(f"pair {pair + 1}")
    return ", ".join(words)


def _bare(cell: Cell) -> Row:
    """A bare TCP connection that fills the link."""
    with Link.open(cell.shape, congestion=cell.congestion) as link:
        drain, ping = _flood(link), _ping(link)
        began = time.time() + cell.warm_s
        for process in (drain, ping):
            process.tell(f"{began} {began + cell.seconds}")
        before, after = _watch(link, cell, [], [began, began + cell.seconds])
        carried = sum(size for _, size in json.loads(drain.line())["rows"])
        rtts = [took for left, took in json.loads(ping.line())["rows"] if left >= began]
    row = Row("", rtt=distribution(rtts), load=os.getloadavg()[0])
    row.link_mbit = 8e-6 * (after["up"] - before["up"]) / cell.seconds
    row.foreign_mbit = 8e-6 * carried / cell.seconds
    row.cpu = {"relay": (after["relay"] - before["relay"]) / cell.seconds}
    return row


def reference(shape: Shape, seconds: float = 3.0) -> dict[str, Any]:
    """Measure the link alone: round trips of small datagrams while it is idle."""
    with Link.open(shape) as link:
        ping = _ping(link)
        began = time.time() + 0.2
        ping.tell(f"{began} {began + seconds}")
        got = json.loads(ping.line())
    lost = 1 - len(got["rows"]) / max(got["sent"], 1)
    return distribution([took for _, took in got["rows"]]) | {"lost": lost}
