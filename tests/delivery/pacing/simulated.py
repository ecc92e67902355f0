"""A simulated link for the model of links: packets, a queue, a delay, losses, and others, without a clock."""

from __future__ import annotations

import heapq
import itertools
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from ropeway.delivery.pacing.model import LinkModel
from ropeway.delivery.pacing.rounds import LinkReading

__all__ = ["Clock", "Crowd", "Kernel", "Path", "Tcp", "greedy", "images", "simulate"]

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
    burst_bytes: int = 0
    """So much passes at once after a pause, as a token bucket lets it."""
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
        self.free_at = max(self.free_at, now - self.burst_bytes / rate) + (size + HEADERS_BYTES) / rate
        if self.random.random() < self.loss:
            return None
        return max(self.free_at, now) + self.delay_s + self.random.uniform(-self.jitter_s, self.jitter_s)

    def queue_s(self, now: float) -> float:
        """How long a packet that is sent now would wait."""
        return max(0.0, self.free_at - now)


class Tcp:
    """A sender's TCP: ``reno`` halves its window at losses, ``open`` sends whatever it is given."""

    BETA = 0.5  # of the window is left after a loss

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
        self.used_at = float("-inf")
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
            self._yield()
            self.calm_until = self.clock.now + self.rtt
        self.again.append(size)
        self._push()

    def _yield(self) -> None:
        """Take a lost packet for a full link."""
        self.threshold = self.window = max(self.BETA * self.window, 2.0)

    def _grow(self) -> None:
        """Send more, as a packet was acknowledged and the window was used."""
        self.window += 1 if self.window < self.threshold else 1 / self.window

    def start_again(self) -> None:
        """Forget the losses."""
        self.threshold = float("inf")

    def _acknowledge(self, size: int, sent: float) -> None:
        rtt = self.clock.now - sent
        self.deviation += (abs(rtt - self.rtt) - self.deviation) / 4
        self.rtt += (rtt - self.rtt) / 8
        self.packets -= 1
        self.in_flight -= size
        self.delivered += size
        if self.packets + 1 >= self.window - 1:
            self.used_at = self.clock.now
        if self.clock.now - self.used_at <= self.rtt:  # validated, as Linux does it
            self._grow()
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


class Cubic(Tcp):
    """A sender's TCP with the growth of CUBIC (RFC 9438)."""

    BETA = 0.7
    GROWTH = 0.4  # packets per cubic second

    def __init__(self, clock: Clock, path: Path) -> None:
        super().__init__(clock, path, "cubic")
        self.most = 0.0  # the window before the last loss
        self.began: float | None = None  # to grow after it
        self.aim = self.wait_s = self.as_reno = 0.0

    def _yield(self) -> None:
        self.most = self.window if self.window >= self.most else self.window * (1 + self.BETA) / 2
        self.began = None
        super()._yield()

    def _grow(self) -> None:
        if self.window < self.threshold:
            self.window += 1
            return
        if self.began is None:
            self.began, self.as_reno = self.clock.now, self.window
            self.aim = max(self.most, self.window)
            self.wait_s = ((self.aim - self.window) / self.GROWTH) ** (1 / 3)
        self.as_reno += 3 * (1 - self.BETA) / (1 + self.BETA) / self.window
        seconds = self.clock.now - self.began + self.rtt - self.wait_s
        target = min(max(self.aim + self.GROWTH * seconds**3, self.as_reno), 1.5 * self.window)
        self.window += max((target - self.window) / self.window, 0.01 / self.window)

    def start_again(self) -> None:
        """Forget the losses."""
        super().start_again()
        self.most, self.began = 0.0, None


class Kernel(Tcp):
    """A sender's TCP that spreads packets at a ``rate``, and a receiver's that acknowledges them in pairs."""

    rate: float | None = None
    WAIT_S = 0.04

    def __init__(self, clock: Clock, path: Path) -> None:
        super().__init__(clock, path)
        self._next_at = 0.0
        self._waits = False
        self._there: list[tuple[int, float]] = []

    def _push(self) -> None:
        while self.unsent:
            now = self.clock.now
            if self.rate is not None and now < self._next_at:
                if not self._waits:
                    self._waits = True
                    self.clock.at(self._next_at, self._go_on)
                return
            size = self.unsent.popleft()
            self.unsent_bytes -= size
            self.in_flight += size
            self.packets += 1
            if self.rate is not None:
                self._next_at = max(self._next_at, now) + size / self.rate
            arrives = self.path.send(now, size)
            assert arrives is not None, "only for links that lose nothing"
            self.arrived.append((arrives, size))
            self.clock.at(arrives, lambda size=size, now=now: self._arrive(size, now))

    def _go_on(self) -> None:
        self._waits = False
        self._push()

    def _arrive(self, size: int, sent: float) -> None:
        self._there.append((size, sent))
        if len(self._there) > 1:
            self._tell()
        else:
            first = self._there[0]
            self.clock.at(self.clock.now + self.WAIT_S, lambda: self._tell() if first in self._there else None)

    def _tell(self) -> None:
        size, sent, count = sum(size for size, _ in self._there), self._there[0][1], len(self._there)
        self._there = []

        def acknowledged() -> None:
            self.packets -= count - 1
            self._acknowledge(size, sent)

        self.clock.at(self.clock.now + self.path.delay_s, acknowledged)


CONTROLS: dict[str, Callable[[Clock, Path], Tcp]] = {
    "open": Tcp,
    "kernel": Kernel,
    "reno": lambda clock, path: Tcp(clock, path, "reno"),
    "cubic": Cubic,
}


@dataclass
class Outcome:
    """What a run showed after its first part."""

    rate: float
    queue_s: float
    """The mean wait at the bottleneck."""
    unsent_bytes: float


def read(tcp: Tcp, model: LinkModel) -> None:
    """Let the model see what the kernel tells, and do what it asks for."""
    model.observe(tcp.reading())
    if model.squeezed():
        tcp.start_again()
    if isinstance(tcp, Kernel):
        pace = model.wanted_bps
        tcp.rate = None if pace is None or model.starting else model.spread_gain * pace


def greedy(clock: Clock, tcp: Tcp, model: LinkModel) -> None:
    """Send as much as the model allows, always."""

    def look() -> None:
        read(tcp, model)
        while model.room_bytes > 0:
            pace = model.pace.bytes_per_s
            part = model.window_bytes // 4 if pace is None else int(min(pace * 0.002, 1 << 20))
            part = max(min(part, model.room_bytes), SEGMENT_BYTES)
            model.handed(part)
            tcp.hand(part)
            if model.room_bytes <= 0:
                read(tcp, model)
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
    tcp, model = CONTROLS[congestion](clock, path), LinkModel()
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
                read(tcp, model)

    def look() -> None:
        read(tcp, model)
        pump()
        clock.at(clock.now + max(model.look_in_s, LOOK_S), look)

    new()
    look()


@dataclass
class Shared:
    """What senders of ours, and one that is not, got of a link, and the wait at its bottleneck."""

    ours: list[float]
    other: float
    queue_s: float


class Crowd:
    """Some senders on one link, and another that fills it from a moment on until it loses packets.

    Ours send pictures of ``size`` bytes, ``hz`` a second, or all that they can where ``size`` is 0, from ``late_s`` on.
    """

    def __init__(
        self,
        path: Path,
        *,
        count: int,
        congestion: str,
        other: str,
        size: int = 0,
        hz: float = 15.0,
        late_s: float = 0.0,
    ) -> None:
        self.clock = clock = Clock()
        self.path = path
        self.filling = False
        self._ours = [CONTROLS[congestion](clock, path) for _ in range(count)]
        self._other = CONTROLS[other](clock, path)
        for number, tcp in enumerate(self._ours):
            clock.at(late_s + 0.01 * number, lambda tcp=tcp: self._begin(tcp, size, hz))
        clock.at(0.0, self._feed)

    def _begin(self, tcp: Tcp, size: int, hz: float) -> None:
        if size:
            images(self.clock, tcp, LinkModel(), size, hz)
        else:
            greedy(self.clock, tcp, LinkModel())

    def _feed(self) -> None:
        other = self._other
        if self.filling and other.unsent_bytes < 1 << 21:
            other.hand(1 << 19)
        elif not self.filling:
            other.unsent.clear()
            other.unsent_bytes = 0
        self.clock.at(self.clock.now + 0.005, self._feed)

    def run(self, seconds: float) -> Shared:
        """Go on for so long; tell what each got."""
        began = self.clock.now
        before = [tcp.delivered for tcp in (*self._ours, self._other)]
        waits: list[float] = []
        while self.clock.now < began + seconds:
            self.clock.run(min(self.clock.now + 0.0037, began + seconds))
            waits.append(self.path.queue_s(self.clock.now))
        rates = [(t.delivered - was) / seconds for t, was in zip((*self._ours, self._other), before, strict=True)]
        return Shared(rates[:-1], rates[-1], sum(waits) / len(waits))
