"""Anycast within a latency bound: the scheduler in a simulation, and groups of real processes over links of their own.

``python -m bench.anycast`` measures everything; ``--only simulation`` needs no root. The rest joins each machine with
the robot by a link of its own, made by the program that ROPEWAY_LINK names (see docs/performance.md).
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from bench.anycast import processes
from bench.anycast.simulation import BOUND, DELAY_S, collisions, following, hedged
from bench.report import table
from ropeway.group.scheduler import Scheduler

PARTS: Final = ("simulation", "collisions", "following", "switch", "killed", "spot", "tail", "cost")
MEMBERS: Final = 100


def simulation(trials: int, as_json: bool) -> None:
    """Measure the scheduler by the clock of the simulation."""
    heads = ["thesis", "best alone", "one", "one, stateless", "one - best"]
    columns = [f"{head}, {share} %" for share in (100, 50) for head in heads]
    delay = f"{1e3 * DELAY_S:.1f} ms more on 100 % and on 50 % of edge1's packets"
    table(
        f"simulated: collisions in percent of {trials} trials; {delay}",
        ["machines", *columns],
        collisions(trials),
        as_json=as_json,
    )
    for hz in (30, 90):
        one_row(f"simulated: target following at {hz} Hz, 50 ms more on edge1", following(60, 1 / hz), as_json)
    title = "simulated: hedge at P95, heavy tail: P99 in ms, ratio, extra requests in percent"
    one_row(title, hedged(100_000), as_json)


def one_row(title: str, found: Mapping[str, Any], as_json: bool) -> None:
    """Print figures as a table of one row."""
    table(title, list(found), [list(found.values())], as_json=as_json)


def scheduling(seconds: float = 40.0, hz: float = 100.0) -> dict[str, float]:
    """Return what a scheduler of many members costs for requests at a rate, in percent of a core."""
    names = [f"m{i}" for i in range(MEMBERS)]
    scheduler = Scheduler(names, BOUND)
    for name in names:
        scheduler.came(name, 0.0)
    cpu, requests = time.process_time(), int(seconds * hz)
    for key in range(requests):
        now_s = key / hz
        targets = scheduler.targets(now_s)
        scheduler.asked(targets, key, now_s)
        scheduler.answered(targets[0], key, now_s + 0.005)
        scheduler.ranked(now_s)
    return {"members": MEMBERS, "requests a second": hz, "% of a core": 100 * (time.process_time() - cpu) / seconds}


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=300, help="simulated trials of each cell (the thesis: 30)")
    parser.add_argument("--real", type=int, default=30, help="real trials of each cell")
    parser.add_argument("--seconds", type=float, default=60.0, help="for which machines are killed every 5 s")
    parser.add_argument("--calls", type=int, default=3000, help="calls to machines with a heavy tail, and for the cost")
    parser.add_argument("--plot", type=Path, help="write the track of the target following as a PNG")
    parser.add_argument("--only", choices=PARTS, help="measure this part alone")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    wanted = [given.only] if given.only else PARTS
    if "simulation" in wanted:
        simulation(given.trials, given.json)
    if "cost" in wanted:
        one_row("a scheduler of many members", scheduling(), given.json)
    if wanted == ["simulation"]:
        return
    if not os.environ.get("ROPEWAY_LINK"):
        print("skipped real processes; name a program that joins namespaces in ROPEWAY_LINK")
        return
    if "collisions" in wanted:
        columns = [f"{head}, {share} %" for share in (100, 50) for head in ("thesis", "best alone", "group")]
        title = f"collisions in percent of {given.real} trials"
        table(title, ["machines", *columns], processes.collisions(given.real), as_json=given.json)
    if "following" in wanted:
        one_row("target following at 30 Hz, 50 ms more on edge1", processes.following(given.plot), given.json)
    if "switch" in wanted:
        one_row("a change by hand in the middle of a burst at 100 Hz", processes.switched(), given.json)
    if "killed" in wanted:
        one_row("the machine in use is gone: the longest gap between answers", processes.killed(), given.json)
    if "spot" in wanted:
        one_row("machines killed at random every 5 s", processes.spot(given.seconds), given.json)
    if "tail" in wanted:
        one_row("a heavy tail: P99 in ms", processes.tail(given.calls), given.json)
    if "cost" in wanted:
        one_row("what a group of four costs per call", processes.cost(given.calls), given.json)


if __name__ == "__main__":
    main()
