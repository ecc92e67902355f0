"""ropeway.group.hedge: when a second member is asked, too."""

from __future__ import annotations

import pytest

from ropeway.group.bound import LatencyBound
from ropeway.group.hedge import HedgeDelay
from ropeway.group.scheduler import Scheduler


def scheduler(**limits: float) -> Scheduler:
    """Return a scheduler of two members that are there."""
    made = Scheduler(["a", "b"], LatencyBound.of(limits))
    for name in ("a", "b"):
        made.came(name, 0.0)
    return made


def test_nothing_is_known() -> None:
    """While nothing is known the bound says what is late, or a tenth of a second."""
    assert HedgeDelay(scheduler()).seconds(0.0) == 0.1
    assert HedgeDelay(scheduler(p99=0.03)).seconds(0.0) == 0.03


def test_as_long_as_usual() -> None:
    """The first has as long as 95 of 100 of its answers take, and a tenth more; found anew a moment later."""
    made = scheduler()
    delay = HedgeDelay(made)
    for index in range(100):
        made.measured("a", 0.01 if index < 95 else 0.5, 0.0)
    assert delay.seconds(0.01) == pytest.approx(0.011)
    for _ in range(100):
        made.measured("a", 0.5, 0.02)
    assert delay.seconds(0.03) == pytest.approx(0.011)
    assert delay.seconds(0.08) == pytest.approx(0.55)


def test_another_member() -> None:
    """A change of the member changes the delay at once."""
    made = scheduler()
    delay = HedgeDelay(made)
    made.measured("a", 0.01, 0.0)
    made.measured("b", 0.1, 0.0)
    assert delay.seconds(0.01) == pytest.approx(0.011)
    made.switch("b", 0.02)
    assert delay.seconds(0.02) == pytest.approx(0.11)
