"""Anycast within a latency bound: the scheduler of groups in a simulation, beside the thesis (Chen 2024, 5.3.2, 5.3.3).

The scheduler is the one that runs in the gateway; machines are latencies by the clock of the simulation. A robot
drives towards a target at 1.3 m/s and has to brake 5 cm before it, so an answer to a frame that shows the target has
to come within 38 ms; frames come 90 times a second. Latencies of all machines rise and fall together, as those of
compressed video do, and the base of each is chosen so that a machine alone fails about as often as the thesis reports.
"""

from __future__ import annotations

import argparse
import heapq
import json
import random
import statistics
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from bench.report import table
from ropeway.group.bound import LatencyBound
from ropeway.group.scheduler import Scheduler

FRAME_S: Final = 1 / 90
DEADLINE_S: Final = 0.05 / 1.3
APPROACH_S: Final = 3.0  # from the first frame to the target, with the profile at its beginning
BOUND: Final = LatencyBound.of({"p90": 0.032})
BASES: Final[Mapping[str, float]] = {"edge1": 0.012, "edge2": 0.014, "cloud W": 0.0265, "cloud E": 0.0300}
DELAY_S: Final = 0.0205  # of the packets of edge1 that are delayed: chosen so that it alone fails as in the thesis
THESIS: Final[Mapping[str, tuple[float, float]]] = {  # percent that failed, with the delay on 100 % and on 50 %
    "edge1": (56.7, 26.7),
    "edge1, edge2": (0.0, 0.0),
    "edge1, cloud W": (10.0, 6.7),
    "edge1, cloud E": (30.0, 53.3),
    "edge1, both clouds": (6.7, 10.0),
}
SETS: Final[Mapping[str, Sequence[str]]] = {
    "edge1": ("edge1",),
    "edge1, edge2": ("edge1", "edge2"),
    "edge1, cloud W": ("edge1", "cloud W"),
    "edge1, cloud E": ("edge1", "cloud E"),
    "edge1, both clouds": ("edge1", "cloud W", "cloud E"),
}


class Latencies:
    """What each machine takes for a frame: a base, what rises and falls for all, noise of its own, and the delay."""

    def __init__(self, rng: random.Random, share: float, *, delay_s: float) -> None:
        self._rng, self._share, self._delay_s = rng, share, delay_s
        self._video = rng.gauss(0, 0.004)

    def frame(self) -> dict[str, float]:
        """Return what every machine takes for the next frame."""
        self._video = 0.9 * self._video + self._rng.gauss(0, 0.004 * (1 - 0.81) ** 0.5)
        took = {}
        for name, base in BASES.items():
            took[name] = max(0.004, base + self._video + self._rng.gauss(0, 0.001))
        if self._rng.random() < self._share:
            took["edge1"] += self._delay_s
        return took


def answers(
    scheduler: Scheduler, frames: Iterator[dict[str, float]], seconds: float
) -> tuple[list[tuple[float, float]], int]:
    """Ask for so long; return for each frame when it was taken and how long its first answer took, and all requests."""
    now, requests, key = 0.0, 0, 0
    under_way: list[tuple[float, str, int]] = []
    first: list[tuple[float, float]] = []
    while now < seconds:
        while under_way and under_way[0][0] <= now:
            at, name, number = heapq.heappop(under_way)
            scheduler.answered(name, number, at)
        took, key = next(frames), key + 1
        names = scheduler.targets(now)
        scheduler.asked(names, key, now)
        for name in names:
            heapq.heappush(under_way, (now + took[name], name, key))
        requests += len(names)
        first.append((now, min((took[name] for name in names), default=float("inf"))))
        now += FRAME_S
    return first, requests


def collides(machines: Sequence[str], share: float, seed: int, *, stateless: bool) -> bool:
    """Drive once towards the target; return whether no frame that shows it was answered in time."""
    rng = random.Random(seed)
    latencies = Latencies(rng, share, delay_s=DELAY_S)
    scheduler = Scheduler(list(machines), BOUND, stateless=stateless)
    for name in machines:
        scheduler.came(name, 0.0)
    seen_s = APPROACH_S + rng.random() * FRAME_S
    first, _ = answers(scheduler, iter(latencies.frame, None), APPROACH_S + DEADLINE_S)
    return not any(at >= seen_s and at + took <= seen_s + DEADLINE_S for at, took in first)


def failures(trials: int) -> list[list[Any]]:
    """Return a row for each set of machines: how often it failed, beside the best of its machines alone, in percent."""
    rows: list[list[Any]] = []
    for label, machines in SETS.items():
        cells: list[Any] = []
        for column, share in enumerate((1.0, 0.5)):
            alone = min(failed(trials, (machine,), share, stateless=False) for machine in machines)
            group = [failed(trials, machines, share, stateless=stateless) for stateless in (False, True)]
            cells += [THESIS[label][column], alone, *group]
        rows.append([label, *cells])
    return rows


def failed(trials: int, machines: Sequence[str], share: float, *, stateless: bool) -> float:
    """Return how many of the trials failed, in percent."""
    return 100 * sum(collides(machines, share, seed, stateless=stateless) for seed in range(trials)) / trials


def following(trials: int) -> dict[str, float]:
    """Return how many frames pass from a delay of 50 ms on edge1 to the change, and how many are answered late."""
    frames, late = [], []
    for seed in range(trials):
        rng = random.Random(seed)
        plain = Latencies(rng, 0.0, delay_s=0.0)
        began = APPROACH_S + rng.random()
        clock = [0.0]

        def took(plain: Latencies = plain, clock: list[float] = clock, began: float = began) -> dict[str, float]:
            found = plain.frame()
            found["edge1"] += 0.05 if clock[0] >= began else 0.0
            clock[0] += FRAME_S
            return found

        scheduler = Scheduler(["edge1", "edge2"], BOUND, stateless=True)
        for name in ("edge1", "edge2"):
            scheduler.came(name, 0.0)
        first, _ = answers(scheduler, iter(took, None), APPROACH_S + 3)
        change = next((d.at_s for d in scheduler.decisions if d.after == "edge2" and d.at_s > began), float("inf"))
        frames.append((change - began) / FRAME_S)
        late.append(sum(t > DEADLINE_S for at, t in first if at >= began))
    return {
        "frames until the change, median": statistics.median(frames),
        "late frames, median": statistics.median(late),
    }


def hedged(requests: int, *, percent: float = 95.0) -> dict[str, float]:
    """Return P99 of one machine and of two that are hedged, in milliseconds.

    A machine takes 50 ms and, 3 times of 100, as long as a Pareto distribution of shape 0.4 says.
    """
    rng = random.Random(1)

    def draw() -> float:
        return 0.05 * rng.lognormvariate(0, 0.15) if rng.random() > 0.03 else 0.05 * rng.paretovariate(0.4)

    single = [draw() for _ in range(requests)]
    limit = sorted(single)[int(requests * percent / 100)]
    both = [first if first <= limit else min(first, limit + draw()) for first in single]
    extra = sum(first > limit for first in single) / requests

    def p99(values: Sequence[float]) -> float:
        return sorted(values)[int(len(values) * 0.99)] * 1e3

    return {"one": p99(single), "hedged": p99(both), "ratio": p99(single) / p99(both), "extra": 100 * extra}


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=300, help="of each cell (the thesis: 30)")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    rows = failures(given.trials)
    follow = following(min(given.trials, 100))
    tail = hedged(100_000)
    if given.json:
        print(json.dumps({"failures": rows, "following": follow, "hedge": tail}))
        return
    heads = ["thesis", "best alone", "one", "one, stateless"]
    delay = f"{1e3 * DELAY_S:.1f} ms more on edge1"
    table(
        f"collisions in percent of {given.trials} trials; {delay}: on 100 % and on 50 % of the packets",
        ["machines", *heads, *heads],
        rows,
    )
    table("target following: 50 ms more on edge1", list(follow), [list(follow.values())])
    table("hedge at P95, heavy tail: P99 in ms, ratio, extra requests in percent", list(tail), [list(tail.values())])


if __name__ == "__main__":
    main()
