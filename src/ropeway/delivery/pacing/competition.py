"""Decides whether a queue on a link is ours or that of others, and what we keep beside connections that fill the link.

A window that yields to every queue ends with nothing beside TCP connections that only take a lost packet for a full
link. So a long queue is put to the test: if it is ours, it becomes shorter with half of our window. A queue that does
not is part of the path, for now: others made it, or the path became longer; we go on at the pace that we had, and give
up no more than half of it. A queue that just stays longer than we want is tested the other way round: if it is ours, it
becomes longer as we send a little more; as long as it does not, we take more of the link, step by step.

A queue that is as long as ever though we yield to it is part of the path as well.

Once others are known to fill the link we *compete*: the window does not yield to their queue, and doubles while that
does not make it longer. Where it does, or where packets are lost, we doubt that there still are others, and send ever
less while the queue becomes shorter by it. If it does so twice it is ours, and we yield again. If TCP itself holds us
back, which lost packets as they filled the link, it is told to forget that now and then (``squeezed``).

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
_SLOW_ROUNDS: Final = 48  # likewise, at most, where we are so slow that the queue might be our target
_FAR_S: Final = 0.01  # nearer, where commands are to be fast, we do not doubt at once whose a short queue is
_TAKEN: Final = 0.75  # of what we had before is left where others on a near link take from us
_FORGOTTEN: Final = 0.9995  # of that is remembered per round trip of at least 10 ms
_NO_QUEUE_S: Final = 0.01  # others who fill a link leave more
_LITTLE: Final = 2  # times the least window
_LESS: Final = 0.9  # of the window is left once we have yielded to a queue in vain
_PLAIN: Final = 3  # pairs of segments that a queue of ours is longer with more of the window
_FIRST_PROBE: Final = 0.1  # of the window
_STEP: Final = 1.25  # the next probe is larger by so much
_DOUBLE: Final = 1.0  # of the window: what others who fill the link leave us is looked for in leaps
_REST_ROUNDS: Final = 3  # after a loss, or a test
_SURE_S: Final = 5.0  # so long a lost packet says nothing new
_TRIED_ROUNDS: Final = 3  # until what TCP sends more shows
_SURE: Final = 2  # answers in a row: others who lose packets, or send more, change a queue as well


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
    """Tracks the competing traffic on one link; ``precise`` tells whether its round trips are.

    Where they are not, a queue of ours may look as if it stayed, so that it takes longer until we doubt that it is.
    """

    def __init__(self, *, precise: bool = True) -> None:
        self._precise = precise
        self._test: _Test | None = None
        self._held: _Held | None = None
        self._probe: _Probe | None = None
        self._crowded = 0  # how often the queue was longer than we want it
        self._patience = (
            _CROWDED_ROUNDS if precise else _SLOW_ROUNDS
        )  # where we are so slow that the queue might be our target
        self._crowds = 0  # how often, in a row, more of ours made it no longer
        self._yielded: _Test | None = None  # when we began to yield to a queue
        self._yields = 0  # how often since
        self._lost = False  # since we sent more
        self._competing = False
        self._rest = 0  # so often no more is tried
        self._doubts = False  # the link has lost packets, and may be ours alone
        self._sure_until_s = 0.0  # that it is not
        self._ours = 0  # how often the queue has proved to be ours
        self.squeezed = False
        """TCP leaves us less than our share, as it lost packets when others filled the link."""
        self._calm_bps = 0.0  # the pace before there was a long queue
        self._most_bps = 0.0  # the fastest pace of the last seconds

    @property
    def tested(self) -> bool:
        """Return whether a queue is put to the test."""
        return self._test is not None

    @property
    def competing(self) -> bool:
        """Return whether others fill the link: to yield to their queue would leave us nothing."""
        return self._competing

    def test(self, window_bytes: int, bytes_per_s: float, queue_s: float, base_s: float = 0.0) -> None:
        """Begin a test with a window that is about to be cut."""
        if self._competing:
            queue_s += base_s
        if self._test is None:
            self._test = _Test(window_bytes, bytes_per_s, queue_s)
            self._ours = 0

    def saw(self, queue_s: float) -> None:
        """Note how long the queue is."""
        if self._test is not None and not self._competing:
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
        if self._competing:
            self._rest, self._doubts = max(self._rest, _REST_ROUNDS), True

    def kept_bytes(self, now_s: float, base_s: float) -> float:
        """Return the window that we keep beside those who fill the link."""
        held = self._held
        return 0.0 if held is None or now_s >= held.until_s else _SHARE * held.bytes_per_s * base_s

    def advise(self, now: Situation) -> Advice | None:
        """Return what to do, ``None`` where the usual law is right."""
        self._most_bps = max(now.bytes_per_s, _FORGOTTEN * self._most_bps)
        if self._probe is not None and (self._test is None or not self._competing):
            return self._answered(self._probe, now)
        if self._competing:
            self._probe = None
            advice = self._compete(now)
            if advice is not None or self._competing:
                return advice
        crowded = now.queue_s > _CROWDED * min(now.target_s, _CROWDED_S) and self._test is None
        self._crowded = self._crowded + 1 if crowded else 0
        if now.queue_s > max(2 * now.target_s, now.long_s):
            return self._tested(now)
        test, self._test = self._test, None
        if test is not None and self._held is None:  # it was ours: back to what would have left the queue that we want
            fitting = test.window_bytes * (now.base_s + now.target_s) / (now.base_s + test.queue_s)
            if fitting > now.window_bytes:
                return Advice(fitting)
        return self._crowd(now) or self._in_vain(now)

    # ── long queues ────────────────────────────────────────────────────────────────────────────────────────────

    def _tested(self, now: Situation) -> Advice | None:
        test = self._test
        if now.window_bytes <= _LITTLE * now.least_bytes:  # so little makes no long queue
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
        self._competing = True
        held, until_s = self._held, now_s + _HELD_S
        if held is not None and now_s < held.until_s:
            self._held = _Held(max(bytes_per_s, held.bytes_per_s), held.base_s, until_s)
            bytes_per_s = max(bytes_per_s, _SHARE * held.bytes_per_s)
        else:
            bytes_per_s = max(bytes_per_s, self._calm_bps)
            self._held = _Held(bytes_per_s, base_s, until_s)
        return Advice(bytes_per_s * rtt_s, rtt_s)

    def _in_vain(self, now: Situation) -> Advice | None:
        """See whether a queue is as long as before though we send less and less: then it is part of the path."""
        yielded = self._yielded
        if now.queue_s <= now.target_s or now.base_s < _FAR_S or not self._precise:
            self._yielded = None
            return None
        grown = yielded is not None and now.queue_s > yielded.queue_s + now.target_s / 2
        if yielded is None or grown or now.window_bytes >= yielded.window_bytes:
            self._yielded, self._yields = _Test(now.window_bytes, now.bytes_per_s, now.queue_s), 0
            return None
        self._yields += 1
        if self._yields < _CROWDED_ROUNDS or now.window_bytes > _LESS * yielded.window_bytes:
            return None
        self._yielded = None
        if yielded.is_ours(now):
            return None
        rtt_s = now.base_s + now.queue_s
        return Advice(yielded.window_bytes * rtt_s / (now.base_s + yielded.queue_s), rtt_s)

    # ── beside others who fill the link ────────────────────────────────────────────────────────────────────────

    def held_back(self, now: Situation) -> Advice | None:
        """Return what to do where TCP, and not the window, bounds what is sent; ``window_bytes`` are what it sends.

        ``squeezed`` tells whether it is to forget the losses that it has seen.
        """
        self._probe = None  # what was asked was not done
        held = self._held_now(now)
        if held is None or self._rests():
            return None
        if self._doubts and now.now_s >= self._sure_until_s:
            return self._doubt(now, now.window_bytes)
        self.squeezed, self._rest = True, _TRIED_ROUNDS
        return None

    def _compete(self, now: Situation) -> Advice | None:
        """Take more of the link in leaps, until its queue is ours as well, or the others have gone."""
        held = self._held_now(now)
        if held is None:
            self._test = None
            return None
        test, self._test = self._test, None
        if test is not None and now.window_bytes < _CUT * test.window_bytes:
            return self._judged(test, held, now)
        if self._rests():
            return None
        if self._doubts and now.now_s >= self._sure_until_s:
            return self._doubt(now, now.window_bytes)
        return self._ask(now.window_bytes, now.queue_s, _DOUBLE, None)

    def _held_now(self, now: Situation) -> _Held | None:
        """Return what we held before others filled the link, ``None`` once they do not any more."""
        held = self._held
        if not self._competing or held is None:
            return None
        if now.now_s < held.until_s and now.base_s + now.queue_s >= held.base_s + _NO_QUEUE_S:
            return held
        self._competing = False
        return None

    def _rests(self) -> bool:
        if not self._rest:
            return False
        self._rest -= 1
        return True

    def _doubt(self, now: Situation, window_bytes: int) -> Advice:
        """See whether there still are others: a link that loses, or whose queue we make longer, may be ours alone."""
        self._doubts, self._ours = False, 0
        self._test = _Test(now.window_bytes, now.bytes_per_s, now.base_s + now.queue_s)
        return Advice(_HALF * window_bytes)

    def _judged(self, test: _Test, held: _Held, now: Situation) -> Advice:
        """Send ever less while that makes the queue shorter; then go on beside others, or yield if it was ours."""
        rtt_s = now.base_s + now.queue_s
        if test.queue_s - rtt_s >= _OURS * (1 - now.window_bytes / test.window_bytes) * test.queue_s:
            self._ours += 1
            self._test = _Test(now.window_bytes, test.bytes_per_s, rtt_s)
            return Advice(_HALF * now.window_bytes)
        self._rest = _REST_ROUNDS
        if self._ours >= _SURE:
            self._competing, self._held = False, None
            return Advice(now.window_bytes * (held.base_s + now.target_s) / rtt_s, held.base_s)
        advice = self.hold(now.now_s, test.bytes_per_s, now.base_s, rtt_s)
        self._sure_until_s = now.now_s + _SURE_S
        self._competing = not self._ours  # if it was, once, the path is as long as it is now
        return advice

    # ── queues that stay ───────────────────────────────────────────────────────────────────────────────────────

    def _crowd(self, now: Situation) -> Advice | None:
        patience = self._patience
        if now.base_s < _FAR_S:
            if now.bytes_per_s >= _TAKEN * self._most_bps:  # as little as we send makes such a queue
                return None
            patience = _SLOW_ROUNDS
        if self._crowded < (_CROWDED_ROUNDS if now.queue_s > _CROWDED * now.target_s else patience):
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
        longer = now.queue_s - probe.queue_s >= _OURS * probe.more * (now.base_s + probe.queue_s)
        if self._lost or longer:
            if self._competing:
                return self._doubt(now, probe.window_bytes)
            self._patience = min(2 * self._patience, _SLOW_ROUNDS)
            self._crowds = 0
            return Advice(probe.window_bytes)
        self._crowds += 1
        if self._crowds >= _SURE:
            self._meet(now)
        more = _DOUBLE if self._competing else min(_STEP * probe.more, 1.0)
        return self._ask(now.window_bytes, 0.0, more, now.base_s + now.queue_s)

    def _meet(self, now: Situation) -> None:
        """Note that there are others."""
        held, until_s = self._held, now.now_s + _HELD_S
        self._held = _Held(now.bytes_per_s, now.base_s, until_s) if held is None else held._replace(until_s=until_s)
        self._competing = True
        self._patience = _CROWDED_ROUNDS if self._precise else _SLOW_ROUNDS


class _Test:
    """A long queue, and what we sent when it was seen; beside others, the round trip with it."""

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
