"""ropeway.group.scheduler: who is asked, by the clock of the test."""

from __future__ import annotations

import itertools
import random
from collections import Counter
from collections.abc import Callable

import pytest

from ropeway.group.bound import LatencyBound
from ropeway.group.scheduler import Options, Phase, Scheduler

BOUND = LatencyBound.of({"p90": 0.038})
BOUND_90 = LatencyBound.of({"p90": 0.0274})
BOUND_MIN = LatencyBound.of({"min": 0.038})
PERIOD_S = 1 / 90


class Play:
    """A robot that asks 90 times a second, and machines that answer with the latencies that ``took`` says.

    ``delivered`` has the latency of each request as the robot sees it: of the first answer.
    """

    def __init__(
        self,
        machines: dict[str, Callable[[float], float]],
        *,
        stateless: bool = True,
        bound: LatencyBound = BOUND,
        options: Options = Options(),  # noqa: B008 - frozen
        period_s: float = PERIOD_S,
    ) -> None:
        self.machines, self.period_s = machines, period_s
        self.scheduler = Scheduler(list(machines), bound, stateless=stateless, options=options)
        self.now = 0.0
        self.delivered: list[float] = []
        self.asked: Counter[str] = Counter()
        self._numbers = itertools.count()
        self._answers: list[tuple[float, str, int]] = []
        for name in machines:
            self.scheduler.came(name, 0.0)

    def run(self, seconds: float) -> None:
        """Let the robot ask for so long."""
        end = self.now + seconds
        while self.now < end:
            self._answer()
            names, key = self.scheduler.targets(self.now), next(self._numbers)
            self.scheduler.asked(names, key, self.now)
            took = {name: self.machines[name](self.now) for name in names}
            self.asked.update(names)
            self._answers += [(self.now + latency, name, key) for name, latency in took.items()]
            if took:
                self.delivered.append(min(took.values()))
            self.now += self.period_s

    def _answer(self) -> None:
        due = sorted(answer for answer in self._answers if answer[0] <= self.now)
        self._answers = [answer for answer in self._answers if answer[0] > self.now]
        for at, name, key in due:
            self.scheduler.answered(name, key, at)

    def late(self, limit_s: float = 0.038) -> float:
        """Return the share of requests above the limit."""
        return sum(latency > limit_s for latency in self.delivered) / len(self.delivered)


def always(latency_s: float) -> Callable[[float], float]:
    return lambda now_s: latency_s


def after(start_s: float, before: float, then: float) -> Callable[[float], float]:
    return lambda now_s: before if now_s < start_s else then


def test_profile() -> None:
    """Each member is asked alone for a moment, then the best is used, by its median."""
    play = Play({"cloud": always(0.030), "edge1": always(0.012), "edge2": always(0.010)})
    play.run(0.5)
    assert play.scheduler.current == "edge2"
    assert play.scheduler.phase is Phase.STEADY
    assert play.asked["cloud"] <= 10 and play.asked["edge1"] <= 10
    assert "the best of the profile" in str(play.scheduler.decisions[-1])


def test_exactly_one() -> None:
    """While the bound is met exactly one member gets each request, from the first on, and nothing is tried."""
    play = Play({"edge1": always(0.010), "edge2": always(0.011)})
    play.run(20)
    assert sum(play.asked.values()) == len(play.delivered)
    assert play.scheduler.current == "edge1"


def test_no_bound() -> None:
    """Without a bound the first that is there is used, whatever its latency, and nobody else is asked."""
    play = Play({"edge1": always(0.5), "edge2": always(0.01)}, bound=LatencyBound())
    play.run(5)
    assert set(play.asked) == {"edge1"}


def test_a_machine_becomes_slow() -> None:
    """50 ms more are answered by a change within a few frames, and of the frames at most three are late."""
    play = Play({"edge1": after(5, 0.010, 0.060), "edge2": always(0.012), "cloud": always(0.030)})
    play.run(10)
    assert play.scheduler.current == "edge2"
    late = sum(latency > 0.038 for latency in play.delivered)
    assert late <= 8  # until the second late answer is here, 60 ms pass, in which five more frames are asked


def test_half_of_the_packets() -> None:
    """A machine that is slow every second time is left for a better one."""
    turns = itertools.cycle([0.010, 0.070])
    play = Play({"edge1": lambda _: next(turns), "edge2": always(0.020)})
    play.run(20)
    assert play.scheduler.current == "edge2"


def test_never_worse_than_the_best() -> None:
    """Beside a slow cloud, an edge that is slow every second time is no worse than alone."""
    turns = random.Random(1)
    edge = lambda _: 0.060 if turns.random() < 0.5 else 0.010  # noqa: E731
    play = Play({"edge1": edge, "cloud": always(0.055)})
    play.run(60)
    assert play.scheduler.current == "edge1"
    assert play.late() <= 0.55


def test_a_member_is_gone() -> None:
    """The next request after a member has left goes to another, and to nobody if there is none."""
    play = Play({"edge1": always(0.010), "edge2": always(0.012)})
    play.run(1)
    play.scheduler.left("edge1", play.now)
    assert play.scheduler.targets(play.now) == ("edge2",)
    play.scheduler.left("edge2", play.now)
    assert play.scheduler.targets(play.now) == ()
    assert play.scheduler.phase is Phase.IDLE
    play.scheduler.came("edge1", play.now)
    assert play.scheduler.targets(play.now) == ("edge1",)


def test_a_silent_machine() -> None:
    """A machine that answers nothing any more is left, though no answer tells that it is slow."""
    play = Play({"edge1": after(3, 0.010, 1e6), "edge2": always(0.012)})
    play.run(6)
    assert play.scheduler.current == "edge2"


@pytest.mark.parametrize("stateless", [True, False])
def test_flapping(stateless: bool) -> None:
    """Machines that are good and bad in turns are not followed each time: changes per minute are few."""
    machines = {
        "edge1": lambda now_s: 0.010 if int(now_s) % 2 else 0.080,
        "edge2": lambda now_s: 0.080 if int(now_s) % 2 else 0.010,
    }
    play = Play(machines, stateless=stateless)
    play.run(60)
    changes = [d for d in play.scheduler.decisions if d.before != d.after]
    assert len(changes) <= 14


def test_stateful_requests_go_to_one() -> None:
    """Requests that must not be carried out twice are never sent to two, and a slow machine is left all the same."""
    play = Play({"edge1": after(3, 0.010, 0.090), "edge2": always(0.012)}, stateless=False)
    play.run(10)
    assert sum(play.asked.values()) == len(play.delivered)
    assert play.scheduler.current == "edge2"


def test_back_at_once() -> None:
    """A change that could not be compared beforehand and proves worse is taken back, and not tried again soon."""
    play = Play({"edge1": after(3, 0.010, 0.050), "edge2": after(1, 0.012, 0.200)}, stateless=False)
    play.run(8)
    assert play.scheduler.current == "edge1"
    assert play.asked["edge2"] < 60


def test_by_hand() -> None:
    """Somebody may choose a member that is there, and no other."""
    play = Play({"edge1": always(0.010), "edge2": always(0.012)})
    play.run(1)
    play.scheduler.switch("edge2", play.now)
    play.run(1)
    assert play.scheduler.current == "edge2"
    play.scheduler.left("edge1", play.now)
    with pytest.raises(KeyError):
        play.scheduler.switch("edge1", play.now)


def test_held() -> None:
    """While it is held nothing is switched, however slow the member in use is, unless it is gone."""
    play = Play({"edge1": after(2, 0.010, 0.090), "edge2": always(0.012)})
    play.run(1)
    play.scheduler.held = True
    play.run(5)
    assert play.scheduler.current == "edge1"
    play.scheduler.left("edge1", play.now)
    assert play.scheduler.current == "edge2"


def test_measured_elsewhere() -> None:
    """Latencies that a topic tells count like those that were measured here."""
    scheduler = Scheduler(["edge1", "edge2"], BOUND)
    scheduler.came("edge1", 0.0)
    scheduler.came("edge2", 0.0)
    for i in range(30):
        scheduler.measured("edge1", 0.200, i * 0.1)
        scheduler.measured("edge2", 0.010, i * 0.1)
        scheduler.targets(i * 0.1)
    assert scheduler.current == "edge2"


def test_a_bound_on_the_spread() -> None:
    """A bound on the standard deviation alone is looked at, too: a steady machine is preferred to one that jumps."""
    turns = itertools.cycle([0.010, 0.030])
    machines = {"edge1": lambda _: next(turns), "edge2": always(0.030)}
    play = Play(machines, bound=LatencyBound.of({"stddev": 0.005}), options=Options(profile_s=0.0))
    play.run(10)
    assert "stddev" in str(play.scheduler.decisions[-1]) or play.scheduler.current == "edge2"


def test_status() -> None:
    """Status is JSON with what is known of each member, and the last decisions as sentences."""
    play = Play({"edge1": always(0.010), "edge2": always(0.012)})
    play.run(1)
    status = play.scheduler.status(play.now)
    assert (status["current"], status["phase"]) == ("edge1", "steady")
    assert status["members"]["edge1"]["latency_s"]["median"] == pytest.approx(0.010)
    assert any("nobody → edge1" in text for text in status["decisions"])


@pytest.mark.parametrize("seed", range(20))
def test_random_machines(seed: int) -> None:
    """With stateless requests no more frames are late than at the best single machine, whatever the machines do.

    The start is left out, when each is asked in turn, and the frames that pass until a first answer is late.
    """
    rng = random.Random(seed)

    def machine() -> Callable[[float], float]:
        base, extra, share = rng.uniform(0.005, 0.06), rng.uniform(0, 0.1), rng.choice([0.0, 0.0, 0.5, 1.0])
        begins = rng.uniform(0, 20)
        own = random.Random(rng.random())
        return lambda now_s: base + (extra if now_s > begins and own.random() < share else 0) + own.expovariate(500)

    play = Play({f"m{i}": machine() for i in range(rng.randint(2, 4))})
    play.run(1)
    play.delivered.clear()
    start = play.now
    alone = dict.fromkeys(play.machines, 0)
    times = [start + i * PERIOD_S for i in range(int(30 / PERIOD_S))]
    for name, took in play.machines.items():
        alone[name] = sum(took(now_s) > 0.038 for now_s in times)
    play.run(30)
    late = sum(latency > 0.038 for latency in play.delivered)
    assert late <= min(alone.values()) + 0.05 * len(times)


def test_within_three_frames() -> None:
    """At 30 Hz the machine is changed within three frames of the first that takes 50 ms more, and one frame is late."""
    frame_s = 1 / 30
    slow_from_s = 90 * frame_s - 1e-6
    play = Play({"edge1": after(slow_from_s, 0.012, 0.062), "edge2": always(0.014)}, period_s=frame_s)
    play.run(6)
    change = next(d.at_s for d in play.scheduler.decisions if d.after == "edge2")
    assert round((change - slow_from_s) / frame_s) <= 3
    assert sum(latency > 0.038 for latency in play.delivered) <= 2


def test_within_three_frames_at_90_hz() -> None:
    """At 90 Hz the machine is changed within three frames, when the first is late and the second has no answer."""
    slow_from_s = 270 * PERIOD_S - 1e-6
    play = Play({"edge1": after(slow_from_s, 0.012, 0.062), "edge2": always(0.014)}, bound=BOUND_90)
    play.run(1.0)
    play.scheduler.switch("edge1", play.now)
    play.run(slow_from_s + 1.5 * PERIOD_S - play.now)
    late_s = play.scheduler.late_at_s(play.now)
    assert late_s - slow_from_s <= 3 * PERIOD_S
    play.scheduler.step(late_s)
    status = play.scheduler.status(late_s)
    assert (status["current"], status["phase"]) == ("edge2", "comparing")
    play.run(1.0)
    status = play.scheduler.status(play.now)
    assert (status["current"], status["phase"]) == ("edge2", "steady")
    assert status["members"]["edge1"]["alone_for_s"] > 0


def test_a_hiccup() -> None:
    """One late answer has the rival asked for a request or two, and nothing is changed."""
    play = Play({"edge1": lambda now_s: 0.070 if 3 < now_s < 3.011 else 0.010, "edge2": always(0.012)})
    play.run(6)
    assert play.scheduler.current == "edge1" and play.scheduler.phase is Phase.STEADY
    assert not [d for d in play.scheduler.decisions if d.before != d.after and d.at_s > 0]
    assert sum(play.asked.values()) - len(play.delivered) <= 8


def test_answers_that_take_longer_than_the_profile() -> None:
    """The profile waits for answers that take longer than it asks, and finds the best all the same."""
    bound = LatencyBound.of({"median": 0.6})
    play = Play({"edge1": always(0.5), "edge2": always(0.2), "cloud": always(0.4)}, bound=bound)
    play.run(2)
    assert play.scheduler.current == "edge2"


def test_requests_that_are_passed_over() -> None:
    """A machine that answers every third picture in time is not left for the others."""
    turns = itertools.count()
    play = Play({"edge1": lambda _: 1e6 if next(turns) % 3 else 0.010, "edge2": always(0.011)}, bound=BOUND_MIN)
    play.run(3)
    assert not [d for d in play.scheduler.decisions if d.at_s > 1]


def test_requests_in_flight_count() -> None:
    """Of two machines with the same latencies the one that owes fewer answers is more promising."""
    scheduler = Scheduler(["a", "b", "c"], BOUND)
    for name in ("a", "b", "c"):
        scheduler.came(name, 0.0)
    for key in range(4):
        scheduler.asked(("b", "c"), key, 0.0)
        scheduler.answered("b", key, 0.01)
        scheduler.answered("c", key, 0.01)
    scheduler.asked(("b",), "open", 0.0)
    assert scheduler.ranked(0.02) == ["a", "c", "b"]
    assert scheduler.status(0.02)["members"]["b"]["in_flight"] == 1


def test_nobody_meets_the_bound() -> None:
    """Where nobody meets the bound and one at a time is asked, the profile is longer, and the worst third decides."""
    turns = itertools.cycle([0.020, 0.060])
    play = Play({"jumpy": lambda _: next(turns), "steady": always(0.045)}, stateless=False)
    play.run(0.5)
    assert play.scheduler.phase is Phase.PROFILING
    play.run(2.5)
    assert play.scheduler.current == "steady"
    assert [d.after for d in play.scheduler.decisions] == ["jumpy", "steady"]


def test_a_pause_after_the_profile() -> None:
    """For the configured time after the profile nothing is judged."""
    machines = {"edge1": after(0.2, 0.010, 0.060), "edge2": always(0.012)}
    play = Play(machines, options=Options(pause_s=1.0))
    play.run(1.0)
    assert play.scheduler.current == "edge1" and play.scheduler.phase is Phase.STEADY
    play.run(1.0)
    assert play.scheduler.current == "edge2"


def test_what_was_known_is_forgotten() -> None:
    """A machine that was worse when it was asked last is asked again after a while, where one at a time is asked."""
    machines = {"edge1": after(2, 0.010, 0.090), "edge2": after(4, 0.200, 0.012)}
    play = Play(machines, stateless=False, options=Options(forgive_s=10.0))
    play.run(6)
    assert play.scheduler.current == "edge1"
    play.run(12)
    assert play.scheduler.current == "edge2"


def test_quiet() -> None:
    """While nothing is to be decided a request goes to the one in use without being asked for, until something happens.

    That is a late answer, a member that comes or goes, or a request that may be late by now.
    """
    scheduler = Scheduler(["a", "b"], LatencyBound.of({"p90": 0.05}), options=Options(profile_s=0.01))
    for name in ("a", "b"):
        scheduler.came(name, 0.0)
    now_s = 0.0
    for key in range(20):
        now_s = 0.01 * key
        names = scheduler.targets(now_s)
        scheduler.asked(names, key, now_s)
        scheduler.answered(names[0], key, now_s + 0.005)
    scheduler.step(now_s)
    current = scheduler.current
    assert scheduler.alone(now_s) == current
    scheduler.asked((current,), "late", now_s)
    scheduler.answered(current, "late", now_s + 0.06)
    assert scheduler.alone(now_s) == ""
    scheduler.asked((current,), "good", now_s)
    scheduler.answered(current, "good", now_s + 0.01)
    scheduler.step(now_s + 0.08)
    scheduler.asked((current,), "silent", now_s + 0.08)
    scheduler.step(now_s + 0.081)
    assert scheduler.alone(now_s + 0.2) == ""
    scheduler.left(next(name for name in ("a", "b") if name != current), now_s + 0.2)
    assert scheduler.alone(now_s + 0.2) == ""


def test_weather_that_all_share() -> None:
    """Where all machines become slower together, the one that is better stays in use, and no other one is tried."""
    rng = random.Random(7)
    for _ in range(40):
        weather = [rng.gauss(0, 0.004)]

        def all_take(now_s: float, weather: list[float] = weather) -> float:
            while len(weather) <= now_s / PERIOD_S:
                weather.append(0.9 * weather[-1] + rng.gauss(0, 0.00174))
            return weather[int(now_s / PERIOD_S)]

        near, far = (lambda now_s, base=base: base + all_take(now_s) for base in (0.036, 0.042))
        play = Play({"far": far, "near": near}, stateless=False)
        play.run(2.0)
        assert play.scheduler.current == "near"
        assert [d.after for d in play.scheduler.decisions if d.at_s > 1.1] == []


def test_a_rise_of_its_own() -> None:
    """A machine that alone becomes slower than all varied before is left, though requests have to go to one."""
    play = Play({"a": always(0.010), "b": always(0.012)}, stateless=False)
    play.run(1.0)
    play.machines["a"] = always(0.060)
    play.run(1.0)
    assert play.scheduler.current == "b"
