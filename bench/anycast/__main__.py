"""Anycast within a latency bound: the scheduler in a simulation, and groups of real processes over links of their own.

``python -m bench.anycast`` measures everything; ``--only simulation`` needs no root. The rest joins each machine with
the robot by a link of its own, made by the program that ROPEWAY_LINK names (see docs/performance.md).
"""

from __future__ import annotations

import argparse

from bench.anycast.simulation import DELAY_S, collisions, following, hedged
from bench.report import table

PARTS = ("simulation",)


def simulation(trials: int, as_json: bool) -> None:
    """Measure the scheduler by the clock of the simulation."""
    heads = ["thesis", "best alone", "one", "one, stateless"]
    columns = [f"{head}, {share} %" for share in (100, 50) for head in heads]
    delay = f"{1e3 * DELAY_S:.1f} ms more on 100 % and on 50 % of edge1's packets"
    table(
        f"simulated: collisions in percent of {trials} trials; {delay}",
        ["machines", *columns],
        collisions(trials),
        as_json=as_json,
    )
    for hz in (30, 90):
        found = following(60, 1 / hz)
        title = f"simulated: target following at {hz} Hz, 50 ms more on edge1"
        table(title, list(found), [list(found.values())], as_json=as_json)
    tail = hedged(100_000)
    title = "simulated: hedge at P95, heavy tail: P99 in ms, ratio, extra requests in percent"
    table(title, list(tail), [list(tail.values())], as_json=as_json)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=300, help="simulated trials of each cell (the thesis: 30)")
    parser.add_argument("--only", choices=PARTS, help="measure this part alone")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    simulation(given.trials, given.json)


if __name__ == "__main__":
    main()
