"""ropeway.networks.rosbridge.client.far_figures: what a far gateway reports of a topic."""

from __future__ import annotations

from typing import Any

import pytest

from ropeway.graph.link_parts import FarFigures
from ropeway.limits import REPORTED_REASON_CHARACTERS, REPORTED_REASONS
from ropeway.networks.rosbridge.client.far_figures import read_figures, since


def test_figures() -> None:
    """Messages and drops are read, and a report of a gateway that tells neither is none."""
    assert read_figures({"messages": 3, "drops": {"too old": 2}}) == FarFigures(3, {"too old": 2})
    assert read_figures({"rate_hz": 10.0, "delay_ms": 1}) is None


@pytest.mark.parametrize(
    "message",
    [
        {"messages": -1, "drops": []},
        {"messages": True, "drops": {"x": "many", "\x1b[2J": 3, 5: 1, "y": -1}},
        {"messages": 1 << 80, "drops": {"x": 1 << 80}},
        {"messages": "9", "drops": {"x": None}},
    ],
)
def test_what_cannot_be_believed(message: dict[str, Any]) -> None:
    """What is no count, or no text for people, is left out."""
    assert read_figures(message) in (None, FarFigures())


def test_reports_are_bounded() -> None:
    """A report of many long reasons is cut."""
    figures = read_figures({"drops": {f"{number} {'x' * 1_000}": 1 for number in range(1_000)}})
    assert figures is not None
    assert len(figures.drops) == REPORTED_REASONS
    assert max(map(len, figures.drops)) == REPORTED_REASON_CHARACTERS


def test_since_when_nothing_has_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The time of the first report of so many messages stays until a report has more."""
    clock = iter((10.0, 20.0))
    monkeypatch.setattr("time.monotonic", lambda: next(clock))
    first = since(FarFigures(1), None)
    assert first == FarFigures(1, passed_s=10.0)
    assert since(FarFigures(1, {"x": 1}), first) == FarFigures(1, {"x": 1}, passed_s=10.0)
    assert since(FarFigures(2), first) == FarFigures(2, passed_s=20.0)
    assert since(None, first) is None
