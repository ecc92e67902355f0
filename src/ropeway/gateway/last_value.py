"""Keeps the last message of a route in the store."""

from __future__ import annotations

import contextlib

from ropeway.errors import ValueRefused
from ropeway.graph.base import Sample
from ropeway.networks.iort.maps import names_of
from ropeway.networks.iort.parts import ROS_ORIGIN
from ropeway.store import CDR, Entry, Store

__all__ = ["LastValue", "key_of"]


def key_of(name: str, gateway: str) -> tuple[str, str]:
    """Split a ROS name into system and topic: its first part and the rest; a name of one part belongs to the
    gateway.
    """
    system, topic = names_of(name)
    return (system, topic) if "/" in name.lstrip("/") else (gateway, topic)


class LastValue:
    """The last message of one topic, under ``system`` and ``topic``, as CDR with its type."""

    def __init__(self, store: Store, system: str, topic: str, type: str) -> None:
        self.store, self.system, self.topic, self.type = store, system, topic, type

    def put(self, sample: Sample) -> None:
        """Keep it; what the store refuses (too big, too many) is counted there."""
        store = self.store
        before = store.get(self.system, self.topic)
        version = store.versions.next(before.version if before is not None else 0)
        origin = f"{ROS_ORIGIN}{sample.origin.hex()}:{sample.seq}"
        entry = Entry(self.system, self.topic, bytes(sample.payload), version, sample.stamp_ns, origin, self.type, CDR)
        with contextlib.suppress(ValueRefused):
            store.put(entry)

    def last(self) -> Sample | None:
        """Return the message that was kept, unchanged."""
        entry = self.store.get(self.system, self.topic)
        if entry is None or entry.form != CDR or entry.type != self.type:
            return None
        origin, seq = bytes(16), entry.stamp_ns
        with contextlib.suppress(ValueError):
            raw, _, number = entry.origin.removeprefix(ROS_ORIGIN).partition(":")
            origin, seq = bytes.fromhex(raw), int(number)
        return Sample(entry.data, self.type, entry.stamp_ns, origin[:16].ljust(16, b"\0"), seq)
