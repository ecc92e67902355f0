"""Which of several links is used."""

from __future__ import annotations

import pytest

from ropeway.group.link_choice import PROBE_S, LinkChoice


class Weather:
    """Two links and their round trips, probe by probe; ``None`` where a probe gets no answer."""

    def __init__(self) -> None:
        self.choice = LinkChoice(["wlan0", "wwan0"])
        self.now_s = 0.0
        self.changes = 0
        for name in ("wlan0", "wwan0"):
            self.choice.up(name, True)

    def pass_by(self, seconds: float, **round_trips_s: float | None) -> str:
        steps = max(1, round(seconds / PROBE_S))
        for _ in range(steps):
            before = self.choice.best
            for name, took_s in round_trips_s.items():
                self.choice.sent(name, self.now_s)
                if took_s is not None:
                    self.choice.came(name, took_s, self.now_s + took_s)
            self.now_s += PROBE_S
            self.changes += self.choice.step(self.now_s) != before
        return self.choice.best


@pytest.fixture
def weather() -> Weather:
    return Weather()


def test_the_quicker(weather: Weather) -> None:
    """Of two steady links the quicker one is used."""
    assert weather.pass_by(2, wlan0=0.005, wwan0=0.05) == "wlan0"


def test_the_steadier(weather: Weather) -> None:
    """A link whose round trips vary is left for one that is slower on the average and steady."""
    weather.pass_by(2, wlan0=0.005, wwan0=0.03)
    for _ in range(40):
        weather.pass_by(PROBE_S, wlan0=0.005, wwan0=0.03)
        weather.pass_by(PROBE_S, wlan0=0.08, wwan0=0.03)
    assert weather.choice.best == "wwan0"


def test_a_cut(weather: Weather) -> None:
    """A link that falls silent is left within 200 ms, though its connection stands."""
    weather.pass_by(2, wlan0=0.005, wwan0=0.05)
    assert weather.pass_by(0.17, wlan0=None, wwan0=0.05) == "wwan0"


def test_a_doubt(weather: Weather) -> None:
    """A link in use is doubted before two probes that got no answer are over, and trusted again later."""
    weather.pass_by(2, wlan0=0.005, wwan0=0.05)
    assert weather.choice.beside == ""
    weather.pass_by(2 * PROBE_S, wlan0=None, wwan0=0.05)
    assert (weather.choice.best, weather.choice.beside) == ("wlan0", "wwan0")
    weather.pass_by(PROBE_S, wlan0=0.005, wwan0=0.05)
    assert weather.choice.beside == "wwan0"
    weather.pass_by(1, wlan0=0.005, wwan0=0.05)
    assert (weather.choice.best, weather.choice.beside) == ("wlan0", "")


def test_a_look_that_is_late(weather: Weather) -> None:
    """Who looks later than was due may not have seen answers that came: nothing is decided until the next look."""
    weather.pass_by(2, wlan0=0.005, wwan0=0.05)
    choice, now_s = weather.choice, weather.now_s
    choice.sent("wlan0", now_s)
    late_s = now_s + choice.pause_s(now_s) + 0.2
    choice.step(late_s)
    assert (choice.best, choice.beside) == ("wlan0", "")
    choice.step(late_s + choice.pause_s(late_s))
    assert choice.best == "wwan0"


def test_when_to_look(weather: Weather) -> None:
    """The next look is when probes are due, or sooner if the link in use comes to be doubted before."""
    weather.pass_by(2, wlan0=0.005, wwan0=0.05)
    choice, now_s = weather.choice, weather.now_s
    assert choice.due(now_s)
    assert not choice.due(now_s + PROBE_S / 2)
    assert choice.pause_s(now_s) == pytest.approx(PROBE_S)
    choice.sent("wlan0", now_s - 0.02)
    assert choice.pause_s(now_s) == pytest.approx(0.01)


def test_both_silent(weather: Weather) -> None:
    """With no link that carries anything nothing changes."""
    weather.pass_by(2, wlan0=0.005, wwan0=0.05)
    changes = weather.changes
    weather.pass_by(1, wlan0=None, wwan0=None)
    assert weather.changes == changes


def test_no_thrashing(weather: Weather) -> None:
    """Links that are alike are not changed for chance, and no more often than the dwell time allows."""
    for number in range(600):
        spread_s = 0.004 if number % 3 else 0.0
        weather.pass_by(PROBE_S, wlan0=0.02 + spread_s, wwan0=0.024 - spread_s)
    assert weather.changes <= 2


def test_ended(weather: Weather) -> None:
    """When the connection in use ends, the other is used at once, and nothing while there is none."""
    weather.pass_by(1, wlan0=0.005, wwan0=0.05)
    weather.choice.up("wlan0", False)
    assert weather.choice.step(weather.now_s) == "wwan0"
    weather.choice.up("wwan0", False)
    assert weather.choice.step(weather.now_s) == ""
    weather.choice.up("wlan0", True)
    assert weather.choice.step(weather.now_s) == "wlan0"
