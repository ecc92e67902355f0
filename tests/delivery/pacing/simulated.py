"""A simulated link for the model of links: packets, a queue, a delay, losses, and others, without a clock."""

from __future__ import annotations

import heapq
import itertools
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from ropeway.delivery.pacing.model import LinkModel, LinkReading

__all__ = ["Path", "Tcp", "greedy", "images", "share", "simulate"]

SEGMENT_BYTES = 1448
HEADERS_BYTES = 52
LOOK_S = 0.001  # the resolution of timers


class Clock:
    """Events in the order of their times."""

    def __init__(self) -> None:
        self.now = 0.0
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._serial = itertools.count()

    def at(self, when: float, event: Callable[[], None]) -> None:
        """Call ``event`` at a time."""
        heapq.heappush(self._events, (max(when, self.now), next(self._serial), event))

    def run(self, until: float) -> None:
        """Run all events before ``until``."""
        while self._events and self._events[0][0] < until:
            self.now, _, event = heapq.heappop(self._events)
            event()
        self.now = until


@dataclass
class Path:
    """A bottleneck of ``rate`` bytes a second with a queue of ``buffer`` packets, and a delay behind it."""

    rate: float
    delay_s: float
    buffer: int = 1000
    jitter_s: float = 0.0
    loss: float = 0.0
    seed: int = 1
    cross: float = 0.0
    """The share of the rate that others use."""
    random: random.Random = field(init=False)
    free_at: float = 0.0
    drops: int = 0

    def __post_init__(self) -> None:
        self.random = random.Random(self.seed)

    def send(self, now: float, size: int) -> float | None:
        """When a packet arrives that is sent now; ``None`` if it is lost."""
        rate = self.rate * (1 - self.cross)
        waiting = (self.free_at - now) * rate / (SEGMENT_BYTES + HEADERS_BYTES)
        if waiting > self.buffer:
            self.drops += 1
            return None
        self.free_at = max(self.free_at, now) + (size + HEADERS_BYTES) / rate
        if self.random.random() < self.loss:
            return None
        return self.free_at + self.delay_s + self.random.uniform(-self.jitter_s, self.jitter_s)

    def queue_s(self, now: float) -> float:
        """How long a packet that is sent now would wait."""
        return max(0.0, self.free_at - now)


class Tcp:
    """A sender's TCP: ``reno`` halves its window at losses, ``open`` sends whatever it is given."""

    def __init__(self, clock: Clock, path: Path, congestion: str = "open") -> None:
        self.clock, self.path, self.congestion = clock, path, congestion
        self.window = 10.0
        self.threshold = float("inf")
        self.unsent: deque[int] = deque()
        self.again: deque[int] = deque()
        self.unsent_bytes = self.in_flight = self.delivered = self.packets = 0
        self.rtt = 2 * path.delay_s + 1500 / path.rate  # of the handshake
        self.deviation = self.rtt / 2
        self.lost = 0
        self.calm_until = 0.0
        self.arrived: list[tuple[float, int]] = []

    def hand(self, size: int) -> None:
        """Take bytes to send."""
        self.unsent_bytes += size
        while size > 0:
            self.unsent.append(min(size, SEGMENT_BYTES))
            size -= SEGMENT_BYTES
        self._push()

    def _push(self) -> None:
        while (self.again or self.unsent) and (self.congestion == "open" or self.packets < self.window):
            if self.again:
                size = self.again.popleft()
            else:
                size = self.unsent.popleft()
                self.unsent_bytes -= size
                self.in_flight += size
            self.packets += 1
            now = self.clock.now
            arrives = self.path.send(now, size)
            if arrives is None:  # noticed a round trip later, by those that follow
                late = max(self.rtt, 2 * self.path.delay_s) + 0.002
                self.clock.at(now + late, lambda size=size: self._lose(size))
            else:
                self.arrived.append((arrives, size))
                self.clock.at(arrives + self.path.delay_s, lambda size=size, sent=now: self._acknowledge(size, sent))

    def _lose(self, size: int) -> None:
        self.lost += 1
        self.packets -= 1
        if self.clock.now >= self.calm_until:
            self.threshold = self.window = max(self.window / 2, 2.0)
            self.calm_until = self.clock.now + self.rtt
        self.again.append(size)
        self._push()

    def _acknowledge(self, size: int, sent: float) -> None:
        rtt = self.clock.now - sent
        self.deviation += (abs(rtt - self.rtt) - self.deviation) / 4
        self.rtt += (rtt - self.rtt) / 8
        self.packets -= 1
        self.in_flight -= size
        self.delivered += size
        if self.packets + 1 >= self.window - 1:  # validated: it was used
            self.window += 1 if self.window < self.threshold else 1 / self.window
        self._push()

    def reading(self) -> LinkReading:
        """What a kernel would tell."""
        return LinkReading(
            self.clock.now,
            self.delivered,
            self.in_flight,
            self.unsent_bytes,
            self.rtt,
            self.deviation,
            self.lost,
            SEGMENT_BYTES,
        )


@dataclass
class Outcome:
    """What a run showed after its first part."""

    rate: float
    queue_s: float
    """The mean wait at the bottleneck."""
    unsent_bytes: float


def greedy(clock: Clock, tcp: Tcp, model: LinkModel) -> None:
    """Send as much as the model allows, always."""

    def look() -> None:
        model.observe(tcp.reading())
        while model.room_bytes > 0:
            pace = model.pace.bytes_per_s
            part = model.window_bytes // 4 if pace is None else int(min(pace * 0.002, 1 << 20))
            part = max(min(part, model.room_bytes), SEGMENT_BYTES)
            model.handed(part)
            tcp.hand(part)
            if model.room_bytes <= 0:
                model.observe(tcp.reading())
        clock.at(clock.now + max(model.look_in_s, LOOK_S), look)

    look()


def simulate(
    path: Path,
    *,
    congestion: str = "open",
    seconds: float = 5.0,
    skip_s: float = 1.0,
    change: Callable[[], None] | None = None,
    change_at: float = 0.0,
    luck_s: float = 0.0,
) -> Outcome:
    """Run a greedy sender for a while; its first round trip was shorter than others by ``luck_s``."""
    clock = Clock()
    tcp, model = Tcp(clock, path, congestion), LinkModel()
    tcp.rtt -= luck_s
    waits: list[float] = []
    unsent: list[int] = []

    def sample() -> None:
        if clock.now >= skip_s:
            waits.append(path.queue_s(clock.now))
            unsent.append(tcp.unsent_bytes)
        clock.at(clock.now + 0.0037, sample)

    clock.at(0.0, lambda: greedy(clock, tcp, model))
    clock.at(0.0, sample)
    if change is not None:
        clock.at(change_at, change)
    clock.run(seconds)
    got = sum(size for at, size in tcp.arrived if skip_s <= at < seconds)
    return Outcome(got / (seconds - skip_s), sum(waits) / len(waits), sum(unsent) / len(unsent))


def images(clock: Clock, tcp: Tcp, model: LinkModel, size: int, hz: float) -> None:
    """Send pictures of ``size`` bytes, ``hz`` a second, always the newest."""
    left = waiting = 0

    def new() -> None:
        nonlocal waiting
        waiting = size
        clock.at(clock.now + 1 / hz, new)
        pump()

    def pump() -> None:
        nonlocal left, waiting
        while model.room_bytes > 0 and (left or waiting):
            if not left:
                left, waiting = waiting, 0
            pace = model.pace.bytes_per_s or 0.0
            part = min(max(min(int(pace * 0.002), model.room_bytes), SEGMENT_BYTES), left)
            left -= part
            model.handed(part)
            tcp.hand(part)
            if model.room_bytes <= 0:
                model.observe(tcp.reading())

    def look() -> None:
        model.observe(tcp.reading())
        pump()
        clock.at(clock.now + max(model.look_in_s, LOOK_S), look)

    new()
    look()


def share(
    path: Path, *, size: int, hz: float, count: int, congestion: str, seconds: float, late_s: float = 0.0
) -> tuple[list[float], float]:
    """Run some senders of pictures, and from the third second on one that fills the link until it loses packets.

    The pictures begin ``late_s`` seconds after the beginning.

    Return the rates of the senders, and of the other, over the second half.
    """
    clock = Clock()
    ours = [Tcp(clock, path, congestion) for _ in range(count)]
    for number, tcp in enumerate(ours):
        clock.at(late_s + 0.01 * number, lambda tcp=tcp: images(clock, tcp, LinkModel(), size, hz))
    other = Tcp(clock, path, "reno")

    def feed() -> None:
        if other.unsent_bytes < 1 << 21:
            other.hand(1 << 19)
        clock.at(clock.now + 0.005, feed)

    clock.at(3.0, feed)
    clock.run(seconds / 2)
    before = [tcp.delivered for tcp in (*ours, other)]
    clock.run(seconds)
    *rates, rest = ((tcp.delivered - was) / (seconds / 2) for tcp, was in zip((*ours, other), before, strict=True))
    return rates, rest
