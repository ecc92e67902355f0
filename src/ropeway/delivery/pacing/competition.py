"""Decides whether a queue on a link is ours or that of others, and what we keep beside connections that fill the link.

A window that yields to every queue ends with nothing beside TCP connections that only take a lost packet for a full
link. So a long queue is put to the test: if it is ours, it becomes shorter with half of our window. A queue that does
not is part of the path, for now: others made it, or the path became longer; we go on at the pace that we had, and give
up no more than half of it. A queue that just stays longer than we want is tested the other way round: if it is ours, it
becomes longer as we send a little more; as long as it does not, we take more of the link, step by step.

Sans-I/O: ``advise`` is called once data that was sent after the last change of the window arrives.
"""

from __future__ import annotations

from typing import Final, NamedTuple

__all__ = ["Advice", "Competition", "Situation"]

_CUT: Final = 0.8  # of the window is left after a cut that should show
_HALF: Final = 0.5  # of the window is used while we look whose queue it is
_OURS: Final = 0.3  # of what we would change if we were alone on the link
_HELD_S: Final = 30.0  # others who fill the link make its queue longer at least so often
_SHARE: Final = 0.5  # of the pace that we had is not given up to them
_CROWDED: Final = 1.5  # targets: with us alone, the queue is one
_CROWDED_S: Final = 0.005  # the target where it is not our own slowness that sets it
_CROWDED_ROUNDS: Final = 4  # pairs of round trips
_SLOW_ROUNDS: Final = 48  # likewise, where we are so slow that the queue might be our target
_PLAIN: Final = 3  # pairs of segments that a queue of ours is longer with more of the window
_FIRST_PROBE: Final = 0.1  # of the window
_STEP: Final = 1.25  # the next probe is larger by so much


class Situation(NamedTuple):
    """The state of the link as its model sees it; ``long_s`` is a queue longer than anybody wants."""

    now_s: float
    window_bytes: int
    least_bytes: int
    bytes_per_s: float
    base_s: float
    queue_s: float
    target_s: float
    long_s: float


class Advice(NamedTuple):
    """The window to use instead of the usual law; ``base_s`` is the shortest round trip from now on, if it changes."""

    window_bytes: float
    base_s: float | None = None


class Competition:
    """Tracks the competing traffic on one link."""

    def __init__(self) -> None:
        self._test: _Test | None = None
        self._held: _Held | None = None
        self._probe: _Probe | None = None
        self._crowded = 0  # how often the queue was longer than we want it
        self._lost = False  # since we sent more
        self._calm_bps = 0.0  # the pace before there was a long queue

    @property
    def tested(self) -> bool:
        """Return whether a queue is put to the test."""
        return self._test is not None

    def test(self, window_bytes: int, bytes_per_s: float, queue_s: float) -> None:
        """Begin a test with a window that is about to be cut."""
        if self._test is None:
            self._test = _Test(window_bytes, bytes_per_s, queue_s)

    def saw(self, queue_s: float) -> None:
        """Note how long the queue is."""
        if self._test is not None:
            self._test.queue_s = max(self._test.queue_s, queue_s)  # what was sent before a cut is a round trip late

    def least_cut_bytes(self) -> float:
        """Return the smallest window that a cut may leave while a queue is put to the test."""
        return 0.0 if self._test is None else _HALF * self._test.window_bytes

    def calm(self, bytes_per_s: float) -> None:
        """Note the pace while there is no long queue."""
        if self._held is None:
            self._calm_bps = bytes_per_s

    def lost(self) -> None:
        """Note that packets were lost."""
        self._lost = True

    def kept_bytes(self, now_s: float, base_s: float) -> float:
        """Return the window that we keep beside those who fill the link."""
        held = self._held
        return 0.0 if held is None or now_s >= held.until_s else _SHARE * held.bytes_per_s * base_s

    def advise(self, now: Situation) -> Advice | None:
        """Return what to do, ``None`` where the usual law is right."""
        if self._probe is not None:
            return self._answered(self._probe, now)
        crowded = now.queue_s > _CROWDED * min(now.target_s, _CROWDED_S) and self._test is None
        self._crowded = self._crowded + 1 if crowded else 0
        if now.queue_s > max(2 * now.target_s, now.long_s):
            return self._tested(now)
        test, self._test = self._test, None
        if test is not None and self._held is None:  # it was ours: back to what would have left the queue that we want
            fitting = test.window_bytes * (now.base_s + now.target_s) / (now.base_s + test.queue_s)
            if fitting > now.window_bytes:
                return Advice(fitting)
        return self._crowd(now)

    # ── long queues ────────────────────────────────────────────────────────────────────────────────────────────

    def _tested(self, now: Situation) -> Advice | None:
        test = self._test
        if now.window_bytes <= now.least_bytes:  # so little makes no long queue
            return self.hold(now.now_s, now.bytes_per_s, now.base_s, now.base_s + now.queue_s + now.target_s)
        if test is None:
            self.test(now.window_bytes, now.bytes_per_s, now.queue_s)
            return Advice(_HALF * now.window_bytes)
        if now.window_bytes >= _CUT * test.window_bytes:
            return self._crowd(now)
        if not test.is_ours(now):
            return self.hold(now.now_s, test.bytes_per_s, now.base_s, now.base_s + now.queue_s + now.target_s)
        self._test = None
        held, self._held = self._held, None
        if held is None:
            return self._crowd(now)
        rtt_s = now.base_s + now.queue_s
        return Advice(now.window_bytes * (held.base_s + now.target_s) / rtt_s, held.base_s)

    def hold(self, now_s: float, bytes_per_s: float, base_s: float, rtt_s: float) -> Advice:
        """Take a queue for part of the path, and go on at the pace from before."""
        self._test = None
        held, until_s = self._held, now_s + _HELD_S
        if held is not None and now_s < held.until_s:
            self._held = _Held(max(bytes_per_s, held.bytes_per_s), held.base_s, until_s)
            bytes_per_s = max(bytes_per_s, _SHARE * held.bytes_per_s)
        else:
            bytes_per_s = max(bytes_per_s, self._calm_bps)
            self._held = _Held(bytes_per_s, base_s, until_s)
        return Advice(bytes_per_s * rtt_s, rtt_s)

    # ── queues that stay ───────────────────────────────────────────────────────────────────────────────────────

    def _crowd(self, now: Situation) -> Advice | None:
        if self._crowded < (_CROWDED_ROUNDS if now.queue_s > _CROWDED * now.target_s else _SLOW_ROUNDS):
            return None
        plain = _PLAIN * now.least_bytes / (now.bytes_per_s * (now.base_s + now.queue_s))
        return self._ask(now.window_bytes, now.queue_s, min(max(_FIRST_PROBE, plain), 1.0), None)

    def _ask(self, window_bytes: int, queue_s: float, more: float, base_s: float | None) -> Advice:
        self._probe = _Probe(window_bytes, queue_s, more)
        self._lost = False
        return Advice((1 + more) * window_bytes, base_s)

    def _answered(self, probe: _Probe, now: Situation) -> Advice:
        """See whether a queue became longer as we sent more, or was full; if not, send still more."""
        self._probe = None
        self._crowded = 0
        if self._lost or now.queue_s - probe.queue_s >= _OURS * probe.more * (now.base_s + probe.queue_s):
            return Advice(probe.window_bytes)
        return self._ask(now.window_bytes, 0.0, min(_STEP * probe.more, 1.0), now.base_s + now.queue_s)


class _Test:
    """A long queue, and what we sent when it was seen."""

    __slots__ = ("bytes_per_s", "queue_s", "window_bytes")

    def __init__(self, window_bytes: int, bytes_per_s: float, queue_s: float) -> None:
        self.window_bytes, self.bytes_per_s, self.queue_s = window_bytes, bytes_per_s, queue_s

    def is_ours(self, now: Situation) -> bool:
        """Return whether it became shorter, as it does where much of what is on the link is ours."""
        cut = 1 - now.window_bytes / self.window_bytes
        alone_s = min(self.queue_s, cut * (now.base_s + self.queue_s))
        return self.queue_s - now.queue_s >= _OURS * alone_s


class _Probe(NamedTuple):
    """The window and the queue before we sent more, and how much more."""

    window_bytes: int
    queue_s: float
    more: float


class _Held(NamedTuple):
    """The share of a link that we had before others filled it, and its shortest round trip then."""

    bytes_per_s: float
    base_s: float
    until_s: float
