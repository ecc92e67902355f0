"""Carries a peer's answer to a request: accepted, or refused and why."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

__all__ = ["Answering", "Answers", "Settling", "Telling"]


@runtime_checkable
class Answering(Protocol):
    """A part or a graph that depends on a peer, which may refuse it."""

    def on_answer(self, callback: Callable[[str], None]) -> None:
        """Call with each answer, now where there was one: the reason of a refusal, or ``""`` for what is taken."""


@runtime_checkable
class Telling(Protocol):
    """A graph that knows what there is from a peer alone, which may keep it to itself."""

    @property
    def untold(self) -> str:
        """The reason why the peer has not told what there is, ``""`` if it has."""


@runtime_checkable
class Settling(Protocol):
    """A graph that knows whether there is more to come of what it discovers."""

    @property
    def settled(self) -> bool:
        """Whether all that was seen has been told of in full."""


class Answers:
    """Keeps the last answer of a peer and tells each to those who want to know. ``reason`` is ``""`` unless refused."""

    def __init__(self) -> None:
        self.reason = ""
        self._given = False
        self._callbacks: list[Callable[[str], None]] = []

    def on_answer(self, callback: Callable[[str], None]) -> None:
        """See ``Answering.on_answer``."""
        self._callbacks.append(callback)
        if self._given:
            callback(self.reason)

    def tell(self, reason: str) -> bool:
        """Take an answer of the peer; return True where somebody was told."""
        self._given, self.reason = True, reason
        for callback in list(self._callbacks):
            callback(reason)
        return bool(self._callbacks)
