"""Tracks what an endpoint is matched with, tells the loop of every change, and pairs matches that belong together."""

from __future__ import annotations

import ctypes as ct
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

from ropeway.networks.dds import raw
from ropeway.networks.dds.endpoint_qos import parse_user_data, read_qos
from ropeway.networks.dds.raw import check, lib, matched
from ropeway.networks.dds.records import MatchedEndpoint
from ropeway.networks.dds.vendors import HELPER_MARK, speaks_header
from ropeway.networks.dds.waitset import Pump

__all__ = ["Matches", "pair_of", "paired", "since_of"]

_PARTICIPANT_BYTES: Final = 12  # of a GUID: what all endpoints of one participant have in common


class Matches:
    """The far ends of the writer or reader ``entity``; ``tell`` gets all of them at each change, the last counts."""

    def __init__(
        self, pump: Pump, entity: int, tell: Callable[[list[tuple[MatchedEndpoint, ...]]], None], *, writer: bool
    ) -> None:
        self.closed = False
        self._pump, self._entity, self._tell = pump, entity, tell
        self._status = raw.PUBLICATION_MATCHED if writer else raw.SUBSCRIPTION_MATCHED
        self._list: Any = lib.get_matched_subscriptions if writer else lib.get_matched_publications
        self._look: Any = lib.get_matched_subscription_data if writer else lib.get_matched_publication_data
        self._known: dict[int, MatchedEndpoint] = {}
        check(lib.set_status_mask(entity, self._status), "set_status_mask")
        self.key = pump.attach(entity, self._on_status)

    def _on_status(self) -> None:
        """Read the new matches; runs in the pump's thread."""
        status = ct.c_uint32()
        code = lib.take_status(self._entity, ct.byref(status), self._status)
        if self.closed:
            return
        check(code, "take_status")
        known: dict[int, MatchedEndpoint] = {}
        for handle in matched(self._list, self._entity):
            peer = self._known.get(handle) or self._peer(handle)
            if peer is not None:
                known[handle] = peer
        self._known = known
        self._pump.push(self._on_loop, [tuple(known.values())])

    def _on_loop(self, batch: list[tuple[MatchedEndpoint, ...]]) -> None:
        if not self.closed:
            self._tell(batch)

    def _peer(self, handle: int) -> MatchedEndpoint | None:
        data = self._look(self._entity, handle)
        if not data:
            return None  # it left meanwhile, which is another change
        try:
            marks = parse_user_data(data.contents.qos)
            guid = bytes(data.contents.key)
            qos = read_qos(data.contents.qos, tells_history=speaks_header(guid))
        finally:
            lib.builtintopic_free_endpoint(data)
        return MatchedEndpoint(guid, pair_of(marks), qos.depth, ours="since" in marks, helper=HELPER_MARK in marks)


def pair_of(marks: Mapping[str, str]) -> str:
    """Return what the two endpoints of a service or client have in common in their USER_DATA, or ``""``."""
    for key in ("clientid", "serviceid"):
        if key in marks:
            return f"{key}={marks[key]}"
    return ""


def since_of(marks: Mapping[str, str]) -> int:
    """Return when a service began, according to its USER_DATA (``time.time_ns``), or 0."""
    text = marks.get("since", "")
    return int(text) if text.isascii() and text.isdigit() and len(text) < 20 else 0


def paired(ends: Iterable[MatchedEndpoint], others: Iterable[MatchedEndpoint]) -> dict[bytes, MatchedEndpoint]:
    """Return those of ``ends``, by GUID, whose other half is among ``others``.

    Halves know each other by what both tell, or, where they tell nothing, by their participant.
    """
    pairs, participants = set(), set()
    for other in others:
        pairs.add(other.pair)
        participants.add(other.guid[:_PARTICIPANT_BYTES])
    return {
        end.guid: end
        for end in ends
        if (end.pair in pairs if end.pair else end.guid[:_PARTICIPANT_BYTES] in participants)
    }
