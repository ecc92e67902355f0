"""Say what parts whose messages and calls go over a link can tell beyond the contract of all graphs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Generic, NamedTuple, Protocol, TypeGuard, TypeVar, runtime_checkable

if TYPE_CHECKING:
    from ropeway.graph.base import Sample

__all__ = [
    "NO_LOSSES",
    "Contended",
    "Departing",
    "Draining",
    "Encoded",
    "FarFigures",
    "LinkStatistics",
    "LinkedPublisher",
    "Refusable",
    "ToldByPeer",
    "is_departing",
    "is_encoded",
    "is_linked",
    "is_refusable",
]

P = TypeVar("P")

NO_LOSSES: Final[Mapping[str, int]] = MappingProxyType({})
"""Where every message was sent."""


class LinkStatistics(NamedTuple):
    """Tells how a topic goes over a link.

    ``encoding`` is that of the last message, ``None`` before the first. ``lost`` counts messages by why they were not
    sent. ``delay_s`` is the time to the far gateway, where that tells. ``refused`` says why the far side does not take
    the topic, ``""`` where it does.
    """

    encoding: str | None = None
    lost: Mapping[str, int] = NO_LOSSES
    delay_s: float | None = None
    refused: str = ""


@dataclass(frozen=True, slots=True)
class FarFigures:
    """Tells what the far gateway says of a topic: messages that it passed on, and those that it dropped, by reason.

    ``passed_s`` is when so many messages were reported first, ``None`` where reports do not come regularly.
    """

    messages: int = 0
    drops: Mapping[str, int] = field(default_factory=dict)
    passed_s: float | None = None


@runtime_checkable
class ToldByPeer(Protocol):
    """Knows what the far gateway does with its messages."""

    far: FarFigures | None
    """The last report, ``None`` before the first, and where the far side makes none."""


@runtime_checkable
class LinkedPublisher(Protocol):
    """Publishes over a link."""

    def statistics(self) -> LinkStatistics:
        """Return how the topic goes over the link."""


@runtime_checkable
class Draining(Protocol):
    """Publishes over a link that may be slower than the topic."""

    @property
    def waiting(self) -> int:
        """The number of messages that wait to be sent."""

    async def arrived(self) -> None:
        """Wait until what was sent so far has arrived, or what the far side is told next cannot overtake it."""


@runtime_checkable
class Departing(Protocol):
    """Publishes over a link on which messages may wait, or be replaced by fresher ones."""

    def on_gone(self, callback: Callable[[Sample], None] | None) -> None:
        """Give each message that has gone out on the link to a callback from now on."""


@runtime_checkable
class Encoded(Protocol):
    """Encodes what goes over a link."""

    @property
    def encoding(self) -> str:
        """The encoding of messages, or of requests and answers."""


@runtime_checkable
class Refusable(Protocol):
    """Depends on a far side that may refuse it."""

    @property
    def refused(self) -> str:
        """The reason why the far side refuses it, ``""`` if it does not."""


@runtime_checkable
class Contended(Protocol):
    """Serves a name that another may hold."""

    def on_state(self, callback: Callable[[str], None]) -> None:
        """Call with who holds the name, ``""`` for this one, now and at each change."""


class _Ability(Generic[P]):
    """Knows which classes have what a protocol asks for: it looks at each class once.

    To look at every part would cost more than everything else that the table of a thousand routes says of them.
    """

    def __init__(self, has: Callable[[object], bool]) -> None:
        self._has = has
        self._known: dict[type, bool] = {}

    def __call__(self, part: object) -> TypeGuard[P]:
        """Return whether a part has it."""
        known = self._known.get(type(part))
        if known is None:
            known = self._known[type(part)] = self._has(part)
        return known


is_linked: Final = _Ability[LinkedPublisher](lambda part: isinstance(part, LinkedPublisher))
is_departing: Final = _Ability[Departing](lambda part: isinstance(part, Departing))
is_encoded: Final = _Ability[Encoded](lambda part: isinstance(part, Encoded))
is_refusable: Final = _Ability[Refusable](lambda part: isinstance(part, Refusable))
