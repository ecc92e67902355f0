"""The scheduler of groups by a clock of its own, for thousands of trials.

The scheduler is the one that runs in the gateway; machines are latencies by the clock of the simulation. A robot
drives towards a target at 1.3 m/s and has to brake 5 cm before it, so an answer to a frame that shows the target has
to come within 38 ms; frames come 90 times a second, so the bound is what is left of that after one frame. Latencies of
all machines rise and fall together, as those of compressed video do, and the base of each is chosen so that a machine
alone fails about as often as the thesis reports.
"""

from __future__ import annotations

import heapq
import math
import random
import statistics
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from ropeway.group.bound import LatencyBound
from ropeway.group.scheduler import Options, Phase, Scheduler

__all__ = ["BASES", "BOUND", "DEADLINE_S", "FRAME_S", "SETS", "THESIS", "collisions", "following", "hedged"]

FRAME_S: Final = 1 / 90
DEADLINE_S: Final = 0.05 / 1.3
APPROACH_S: Final = 1.5  # from the first frame to the target, with the profile at its beginning
BOUND: Final = LatencyBound.of({"p90": round(DEADLINE_S - FRAME_S, 4)})
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
SHARES: Final = (1.0, 0.5)

Took = Callable[[float], dict[str, float]]
"""What every machine takes for a frame of that time."""


class Latencies:
    """What each machine takes for a frame: a base, what rises and falls for all, noise of its own, and the delay."""

    def __init__(self, rng: random.Random, share: float, *, delay_s: float = DELAY_S) -> None:
        self._rng, self._share, self._delay_s = rng, share, delay_s
        self._video = rng.gauss(0, 0.004)

    def frame(self, at_s: float = 0.0) -> dict[str, float]:
        """Return what every machine takes for the next frame."""
        gauss = self._rng.gauss
        self._video = 0.9 * self._video + gauss(0, 0.004 * (1 - 0.81) ** 0.5)
        took = {name: max(0.004, base + self._video + gauss(0, 0.001)) for name, base in BASES.items()}
        if self._rng.random() < self._share:
            took["edge1"] += self._delay_s
        return took


class Drive:
    """A robot that asks at a rate, and what comes of it, by the clock of the simulation.

    As in the gateway, the scheduler is woken when a request is late, and then all that waits goes to another machine.
    """

    def __init__(self, scheduler: Scheduler) -> None:
        self.scheduler = scheduler
        self.sent: list[float] = []
        self.took: list[float] = []  # until the first answer of each
        self._all: list[dict[str, float]] = []  # what each machine takes for a frame
        self._asked: dict[int, tuple[str, ...]] = {}  # what has no answer yet
        self._under_way: list[tuple[float, str, int]] = []

    def frame(self, now_s: float, took: Mapping[str, float]) -> None:
        """Send a frame."""
        self.run(now_s)
        key = len(self.sent)
        self.sent.append(now_s)
        self.took.append(float("inf"))
        self._all.append(dict(took))
        self._ask(self.scheduler.targets(now_s), key, now_s)

    def run(self, until_s: float) -> None:
        """Let come what comes until then."""
        now_s = self.sent[-1] if self.sent else 0.0
        while True:
            answer_s = self._under_way[0][0] if self._under_way else float("inf")
            late_s = self.scheduler.late_at_s(now_s)
            now_s = min(answer_s, late_s)
            if now_s > until_s:
                return
            if answer_s <= late_s:
                _, name, key = heapq.heappop(self._under_way)
                self.scheduler.answered(name, key, now_s)
                self._asked.pop(key, None)
            else:
                self._late(now_s)

    def _ask(self, names: Sequence[str], key: int, now_s: float) -> None:
        self.scheduler.asked(names, key, now_s)
        self._asked[key] = (*self._asked.get(key, ()), *names)
        for name in names:
            at_s = now_s + self._all[key][name]
            self.took[key] = min(self.took[key], at_s - self.sent[key])
            heapq.heappush(self._under_way, (at_s, name, key))

    def _late(self, now_s: float) -> None:
        before = self.scheduler.decided
        self.scheduler.step(now_s)
        if not self.scheduler.stateless or self.scheduler.phase is not Phase.COMPARING:
            return
        if self.scheduler.decided == before:
            return
        for key, asked in list(self._asked.items()):
            name = next((n for n in self.scheduler.ranked(now_s) if n not in asked), "")
            if name and len(asked) == 1:
                self._ask((name,), key, now_s)


def answers(scheduler: Scheduler, took: Took, seconds: float, *, frame_s: float = FRAME_S) -> list[tuple[float, float]]:
    """Ask for so long; return for each frame when it was taken and how long its first answer took."""
    drive, now_s = Drive(scheduler), 0.0
    while now_s < seconds:
        drive.frame(now_s, took(now_s))
        now_s += frame_s
    drive.run(now_s)
    return list(zip(drive.sent, drive.took, strict=True))


def among(machines: Sequence[str], *, stateless: bool) -> Scheduler:
    """Return a scheduler of machines that are all there."""
    scheduler = Scheduler(list(machines), BOUND, stateless=stateless, options=Options())
    for name in machines:
        scheduler.came(name, 0.0)
    return scheduler


def collides(machines: Sequence[str], share: float, seed: int, *, stateless: bool) -> bool:
    """Drive once towards the target; return whether no frame that shows it was answered in time."""
    rng = random.Random(seed)
    seen_s = APPROACH_S + rng.random() * FRAME_S
    latencies = Latencies(rng, share)
    if len(machines) == 1:
        times = [i * FRAME_S for i in range(int((APPROACH_S + DEADLINE_S) / FRAME_S) + 1)]
        first = [(at, latencies.frame()[machines[0]]) for at in times]
    else:
        first = answers(among(machines, stateless=stateless), latencies.frame, APPROACH_S + DEADLINE_S)
    return not any(at >= seen_s and at + took <= seen_s + DEADLINE_S for at, took in first)


def collisions(trials: int) -> list[list[Any]]:
    """Return a row for each set of machines: how often it failed, beside the best of its machines alone, in percent.

    Behind each share stands by how much ``one`` failed more than that machine in the same trials, and within which
    the truth is in 95 of 100 cases.
    """
    alone = {(name, share): failures(trials, (name,), share) for name in BASES for share in SHARES}
    rows: list[list[Any]] = []
    for label, machines in SETS.items():
        cells: list[Any] = []
        for column, share in enumerate(SHARES):
            best = min((alone[machine, share] for machine in machines), key=sum)
            several = len(machines) > 1
            one, twice = (
                failures(trials, machines, share, stateless=stateless) if several else best
                for stateless in (False, True)
            )
            cells += [THESIS[label][column], *map(percent, (best, one, twice)), paired(one, best)]
        rows.append([label, *cells])
    return rows


def failures(trials: int, machines: Sequence[str], share: float, *, stateless: bool = False) -> list[bool]:
    """Return which of the trials failed."""
    return [collides(machines, share, seed, stateless=stateless) for seed in range(trials)]


def percent(outcomes: Sequence[bool]) -> float:
    """Return how many of the trials failed, in percent."""
    return round(100 * sum(outcomes) / len(outcomes), 2)


def paired(mine: Sequence[bool], other: Sequence[bool]) -> str:
    """Return by how many points one failed more than another in the same trials, with the interval of 95 %."""
    count = len(mine)
    changes = [int(a) - int(b) for a, b in zip(mine, other, strict=True)]
    mean = sum(changes) / count
    error = math.sqrt(max(0.0, sum(change**2 for change in changes) / count - mean**2) / count)
    return f"{100 * mean:+.2f} ± {196 * error:.2f}"


def following(trials: int, frame_s: float = 1 / 30) -> dict[str, float]:
    """Return how many frames pass from a delay of 50 ms on edge1 to the change, and how many are answered late."""
    frames, late = [], []
    for seed in range(trials):
        rng = random.Random(seed)
        plain = Latencies(rng, 0.0)
        began = APPROACH_S + rng.random()

        def took(at_s: float, plain: Latencies = plain, began: float = began) -> dict[str, float]:
            found = plain.frame()
            found["edge1"] += 0.05 if at_s >= began else 0.0
            return found

        scheduler = among(("edge1", "edge2"), stateless=True)
        first = answers(scheduler, took, APPROACH_S + 3, frame_s=frame_s)
        begins = next(at for at, _ in first if at >= began)
        before = [d for d in scheduler.decisions if d.at_s < begins]
        if before[-1].after != "edge1":
            continue  # the profile found the other better, which it may
        change = next((d.at_s for d in scheduler.decisions if d.after == "edge2" and d.at_s > begins), float("inf"))
        frames.append(math.inf if change == math.inf else 1 + int((change - begins) / frame_s))
        late.append(sum(t > DEADLINE_S for at, t in first if at >= begins))
    return {
        "frames until the change, median": statistics.median(frames),
        "at most": max(frames),
        "late frames, median": statistics.median(late),
        "late, at most": max(late),
    }


def hedged(requests: int, *, quantile: float = 95.0) -> dict[str, float]:
    """Return P99 of one machine and of two that are hedged, in milliseconds.

    A machine takes 50 ms and, 3 times of 100, as long as a Pareto distribution of shape 0.4 says.
    """
    rng = random.Random(1)

    def draw() -> float:
        return 0.05 * rng.lognormvariate(0, 0.15) if rng.random() > 0.03 else 0.05 * rng.paretovariate(0.4)

    single = [draw() for _ in range(requests)]
    limit = sorted(single)[int(requests * quantile / 100)]
    both = [first if first <= limit else min(first, limit + draw()) for first in single]
    extra = sum(first > limit for first in single) / requests

    def p99(values: Sequence[float]) -> float:
        return sorted(values)[int(len(values) * 0.99)] * 1e3

    return {"one": p99(single), "hedged": p99(both), "ratio": p99(single) / p99(both), "extra": 100 * extra}
