"""What a viewer is told of mistakes and of what is lacking."""

from __future__ import annotations

import json
from typing import Any

from ropeway.limits import SHOWN_TEXT_CHARACTERS, UNREAD_STATUS_BYTES, VIEWER_STATUSES, VIEWER_STATUSES_PER_S
from ropeway.networks.foxglove.statuses import ERROR, WARNING, Statuses


class Sent:
    """A sender that keeps what it is given."""

    def __init__(self) -> None:
        self.told: list[dict[str, Any]] = []
        self.answers_bytes = 0

    def text(self, data: bytes) -> None:
        """Take an operation."""
        self.told.append(json.loads(data))


class Clock:
    """A clock that stands still until it is set."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_too_many() -> None:
    """As many statuses are told as a person reads; the next one says how many were left out."""
    sent, clock = Sent(), Clock()
    statuses = Statuses(sent, clock)  # type: ignore[arg-type]
    for number in range(VIEWER_STATUSES + 7):
        statuses.tell(ERROR, f"{number}")
    assert [told["message"] for told in sent.told] == [str(number) for number in range(VIEWER_STATUSES)]
    clock.now = 1 / VIEWER_STATUSES_PER_S
    statuses.tell(ERROR, "again")
    assert sent.told[-1] == {"op": "status", "level": ERROR, "message": "again (7 more were left out)"}


def test_who_does_not_read() -> None:
    """A viewer that does not read its answers is told nothing more, and a long text is cut."""
    sent = Sent()
    statuses = Statuses(sent)  # type: ignore[arg-type]
    statuses.tell(ERROR, "x" * (2 * SHOWN_TEXT_CHARACTERS))
    assert len(sent.told[0]["message"]) == SHOWN_TEXT_CHARACTERS
    sent.answers_bytes = UNREAD_STATUS_BYTES + 1
    statuses.tell(ERROR, "unsaid")
    assert len(sent.told) == 1


def test_warnings_that_stand() -> None:
    """A warning is told once, again when it changes, and taken back when it no longer holds."""
    sent = Sent()
    statuses = Statuses(sent)  # type: ignore[arg-type]
    statuses.stand({"a": "no a", "b": "no b"})
    statuses.stand({"a": "no a", "b": "still no b"})
    statuses.stand({"b": "still no b"})
    assert sent.told == [
        {"op": "status", "level": WARNING, "message": "no a", "id": "a"},
        {"op": "status", "level": WARNING, "message": "no b", "id": "b"},
        {"op": "status", "level": WARNING, "message": "still no b", "id": "b"},
        {"op": "removeStatus", "statusIds": ["a"]},
    ]
