"""Keeps what a gateway advertises, and puts it into the forms in which others are told. Sans-I/O.

Some advertisements are for one gateway alone, their *target*. They stand in a list of their own, which older members do
not look at. A target that is such an older member is told among the others; who else reads that finds the target beside
it and ignores the advertisement, or, if it is an older member as well, is refused when it asks for the key.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from ropeway.errors import SealError
from ropeway.limits import NAME_CHARACTERS
from ropeway.networks.overlay.advert import Advertisement
from ropeway.networks.overlay.refusal import Refusal

__all__ = ["Notes", "OwnAdverts", "notes_of", "read_raws", "with_notes"]

_CHUNK: Final = 500  # advertisements in one note
_GATEWAY_BYTES: Final = 16

Notes = tuple[dict[Any, Any], dict[Any, Any], dict[Any, Any]]
"""Told beside advertisements: nodes, targets and topics of answers, by endpoint; not checked yet."""


@dataclass(frozen=True, slots=True)
class _Own:
    raw: bytes  # sealed
    node: str
    target: bytes
    answers: str  # the topic on which what is published is answered
    hidden: bool  # from all but its target


class OwnAdverts:
    """The advertisements of a gateway, with the version of their list, and what of it was not told yet."""

    def __init__(self) -> None:
        self.version = 0
        self._own: dict[bytes, _Own] = {}
        self._added: dict[bytes, _Own] = {}
        self._removed: list[bytes] = []

    def add(self, advert: Advertisement, raw: bytes, *, hidden: bool = False) -> None:
        """Add an advertisement, ``raw`` as it is told; ``hidden`` from all but its target."""
        own = _Own(raw, advert.node, advert.target, advert.answers, hidden)
        self._own[advert.endpoint] = self._added[advert.endpoint] = own

    def remove(self, endpoint: bytes) -> bool:
        """Remove an advertisement; return whether there was one."""
        if self._own.pop(endpoint, None) is None:
            return False
        if self._added.pop(endpoint, None) is None:
            self._removed.append(endpoint)
        return True

    def deltas(self) -> Iterator[dict[str, Any]]:
        """Return what was not told yet, as the bodies of notes."""
        added, removed = list(self._added.items()), self._removed
        self._added, self._removed = {}, []
        while added or removed:
            self.version += 1
            told = _told(added[:_CHUNK])
            yield {"v": self.version, "add": told.pop("a"), "del": removed[: 16 * _CHUNK], **told}
            added, removed = added[_CHUNK:], removed[16 * _CHUNK :]

    def head(self) -> dict[str, int]:
        """Return what is told before the whole list: its version, and how many there are."""
        hidden = sum(own.hidden for own in self._own.values())
        version = self.version - bool(self._added or self._removed)  # what waits comes as a delta, too
        return {"v": version, "of": len(self._own) - hidden, "at": hidden}

    def chunks(self) -> Iterator[dict[str, Any]]:
        """Return the whole list, as parts of the bodies of notes."""
        own = list(self._own.items())
        for at in range(0, len(own), _CHUNK):
            yield _told(own[at : at + _CHUNK])


def _told(adverts: list[tuple[bytes, _Own]]) -> dict[str, Any]:
    """Return advertisements with what is told beside them; older members ignore all but those under ``a``."""
    more: dict[str, Any] = {
        "x": {endpoint: own.node for endpoint, own in adverts if own.node},
        "to": {endpoint: own.target for endpoint, own in adverts if own.target},
        "re": {endpoint: own.answers for endpoint, own in adverts if own.answers},
        "at": [[own.target, own.raw] for _, own in adverts if own.hidden],
    }
    return {"a": [own.raw for _, own in adverts if not own.hidden], **{key: part for key, part in more.items() if part}}


def read_raws(body: dict[str, Any], plain: str, me: bytes) -> tuple[list[Any], int]:
    """Return the advertisements of a note that are to be read here, and how many are for others.

    Those for everybody stand under the key ``plain``. Raises ``SealError``.
    """
    hidden = body.get("at", [])
    if not isinstance(hidden, list) or any(
        not isinstance(pair, list) or len(pair) != 2 or type(pair[0]) is not bytes for pair in hidden
    ):
        raise SealError(Refusal.MALFORMED, "advertisements with targets")
    mine = [raw for target, raw in hidden if target == me]
    return [*body[plain], *mine], len(hidden) - len(mine)


def notes_of(body: Mapping[str, Any]) -> Notes:
    """Return what is told beside advertisements: their nodes, targets and topics of answers, by endpoint."""
    nodes, targets, answers = (part if isinstance(part := body.get(key), dict) else {} for key in ("x", "to", "re"))
    return nodes, targets, answers


def with_notes(found: Iterable[Advertisement | SealError], notes: Notes, me: bytes) -> list[Advertisement | SealError]:
    """Return advertisements with what was told beside them.

    Those for another gateway than ``me`` are left out; notes that are not as they should be are ignored.
    """
    nodes, targets, answers = notes
    read: list[Advertisement | SealError] = []
    for advert in found:
        if not isinstance(advert, Advertisement):
            read.append(advert)
            continue
        node, target = nodes.get(advert.endpoint, ""), targets.get(advert.endpoint, b"")
        topic = answers.get(advert.endpoint, "")
        if type(target) is bytes and len(target) == _GATEWAY_BYTES:
            if target != me:
                continue
            advert = replace(advert, target=target)
        if isinstance(node, str) and 0 < len(node) <= NAME_CHARACTERS:
            advert = replace(advert, node=node)
        if isinstance(topic, str) and 0 < len(topic) <= NAME_CHARACTERS:
            advert = replace(advert, answers=topic)
        read.append(advert)
    return read
