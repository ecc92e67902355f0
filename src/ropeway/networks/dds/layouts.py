"""Finds out which participant on a DDS network uses which layouts of types, from type hashes and the gids of older
nodes.

Nodes since Iron tell the hash of each type that they use; where all nodes of a participant write gids of 24 bytes, it
is of Humble or older.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Sequence
from typing import Final, Protocol

from ropeway.graph.base import Sample, SampleCallback
from ropeway.graph.layout_border import Border
from ropeway.types import TypeRegistry
from ropeway.types.translation import Translate

__all__ = ["OLD", "Layouts", "Signs"]

OLD: Final = "old"
"""The sign of an endpoint of Humble or older, in the place of a hash."""

_OLD_DISTRO: Final = "humble"  # the oldest that is still maintained, and the one that most robots have

log = logging.getLogger("ropeway.dds")


class Signs(Protocol):
    """Gives access to what discovery knows."""

    def signs(self, role: str, name: str, guid: bytes | None = None) -> Collection[str]:
        """Return the hashes, or ``OLD``, that others' endpoints in a ``role`` of a topic or service show.

        Roles are ``publisher``, ``subscription``, ``server`` and ``client``; ``guid`` selects one endpoint.
        """


class Layouts:
    """The border of a DDS network, at which each message gets the layout of who reads it."""

    def __init__(
        self, graph: str, border: Border, signs: Callable[[], Signs | None], is_old: Callable[[], bool]
    ) -> None:
        self._graph, self._border = graph, border
        self._signs, self._is_old = signs, is_old
        self._mixed: set[str] = set()

    @property
    def distro(self) -> str:
        """See ``Distributed.distro``."""
        network = self._border.network
        return network.given_distro if network is not None else _OLD_DISTRO if self._is_old() else ""

    @property
    def registry(self) -> TypeRegistry | None:
        """The definitions of the network, ours where none were given."""
        return self._border.network or self._border.ours

    def reading(self, topic: str, type: str, callback: SampleCallback) -> SampleCallback:
        """Return ``callback`` as it is to be called with what publishers of ``topic`` write."""
        if not self._border.touches(type):
            return callback

        def read(batch: Sequence[Sample]) -> None:
            callback([self._read(topic, sample) for sample in batch])

        return read

    def writing(self, topic: str, type: str) -> Translate | None:
        """Return what is to be done with messages for subscriptions of ``topic``, ``None`` for nothing."""
        if not self._border.touches(type):
            return None
        return lambda payload: self.write("subscription", topic, type, payload)

    def read(self, role: str, name: str, type: str, payload: bytes, guid: bytes | None = None) -> bytes:
        """Return what an endpoint in ``role`` of ``name`` has written, in our layout."""
        border = self._border
        ours = border.ours
        untouched = ours is None or (border.touched.get(type) is False and border.state == ours.changes)
        if untouched or not border.touches(type):
            return payload
        return border.incoming(type, payload, self._owner(role, name, type, guid, given=False))

    def write(self, role: str, name: str, type: str, payload: bytes, guid: bytes | None = None) -> bytes:
        """Return a message of ours in the layout of the endpoints in ``role`` of ``name``. Raises ``ValueMismatch``."""
        border = self._border
        ours = border.ours
        untouched = ours is None or (border.touched.get(type) is False and border.state == ours.changes)
        if untouched or not border.touches(type):
            return payload
        return border.outgoing(type, payload, self._owner(role, name, type, guid, given=True))

    def _read(self, topic: str, sample: Sample) -> Sample:
        return sample.carrying(self.read("publisher", topic, sample.type, sample.payload, sample.origin))

    def _owner(self, role: str, name: str, type: str, guid: bytes | None, *, given: bool) -> TypeRegistry | None:
        """Return whose types the endpoints have, ``None`` where nobody tells; ``given``: those of the network win."""
        border, known = self._border, self._signs()
        assert border.ours is not None
        others = border.ours.others
        if others is None or (given and border.network is not None):
            return None
        old = others.variant(_OLD_DISTRO) if border.network is None else None
        found: dict[int, TypeRegistry] = {}
        told = _told_type(type)
        tells = others.touches(told)
        for sign in known.signs(role, name, guid) if known is not None else ():
            owner = old if sign == OLD else others.by_hash(told, sign) if tells else None
            if owner is not None:
                found[id(owner)] = owner
        if len(found) > 1 and name not in self._mixed:
            self._mixed.add(name)
            log.warning("%s: %s of %s have different definitions of %s", self._graph, f"{role}s", name, type)
        if found:
            return next(iter(found.values()))
        return old if self._is_old() else None


def _told_type(type: str) -> str:
    """Return the type whose hash endpoints tell: of a service, that of the request."""
    return f"{type.removesuffix('_Response')}_Request" if type.endswith("_Response") and "/msg/" not in type else type
