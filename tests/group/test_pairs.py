"""ropeway.group.pairs: which topics are asked and answered on, whatever members call them."""

from __future__ import annotations

from ropeway.group.pairs import Pairs
from ropeway.group.scheduler import Scheduler


def test_names_of_the_robot() -> None:
    """Without other names the members know the topics by those that the configuration pairs."""
    pairs = Pairs(Scheduler(["a"]), {"camera": "found"})
    assert pairs.asked() == ["/camera"] and pairs.answers("/camera") == "/found"
    assert pairs.asked_on("/camera") is pairs.answered_on("/found") is not None
    assert pairs.asked_on("/found") is pairs.answered_on("/camera") is None
    assert pairs.answers("/other") == ""


def test_names_change() -> None:
    """A topic that gets another name at the members keeps its requests, and what is answered elsewhere now is told."""
    pairs = Pairs(Scheduler(["a"]), {"/camera": "/found", "/ear": "/heard"})
    before = pairs.asked_on("/camera")
    assert pairs.crosses({"/camera": "/far/camera", "/found": "/found"}) == {"/far/camera"}
    assert pairs.asked_on("/far/camera") is before and pairs.asked_on("/camera") is None
    assert pairs.crosses({"/camera": "/far/camera", "/found": "/far/found"}) == {"/far/camera"}
    assert pairs.answers("/far/camera") == "/far/found" and pairs.answered_on("/far/found") is before
    assert pairs.crosses({"/camera": "/far/camera", "/found": "/far/found", "/more": "/more"}) == set()
    assert pairs.status() == {"/far/found": {}, "/heard": {}}
