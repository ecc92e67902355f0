"""Waiting for discovery: endpoints are made when those are known that were there before.

A participant that is new tells of its endpoints at once, and learns of others' some time later, often a second. A node
that finds a service in this time calls it, and its request is lost, since nobody knows yet who sent it.
"""

from __future__ import annotations

import ctypes as ct
import time
from collections.abc import Iterable
from typing import Final

from ropeway.networks.dds import raw
from ropeway.networks.dds.raw import BuiltinEndpoint, SampleInfo, check, lib

__all__ = ["Census"]

_LEAST_S: Final = 1.2  # Cyclone DDS asks a participant that it finds what it has: at once, and after a second again
_LIMIT_S: Final = 3.0  # some may have left
_BATCH: Final = 64


class Census:
    """Looks for the endpoints ``guids`` with ``participant``; ``complete`` is called until it is true.

    That takes its time even if all are found: there may be some that nobody knows yet.
    """

    def __init__(self, participant: int, guids: Iterable[bytes]) -> None:
        self._missing = set(guids)
        self._began = time.monotonic()
        self._readers = [
            check(lib.create_reader(participant, topic, None, None), "create builtin reader")
            for topic in (raw.BUILTIN_PUBLICATION, raw.BUILTIN_SUBSCRIPTION)
        ]

    def complete(self) -> bool:
        """Return whether all are found, or the time is over."""
        samples, infos = (ct.c_uint64 * _BATCH)(), (SampleInfo * _BATCH)()
        for reader in self._readers:
            while True:
                samples[0] = 0
                count = check(lib.take(reader, samples, infos, _BATCH, _BATCH), "take builtin topic")
                if not count:
                    break
                self._missing.difference_update(bytes(BuiltinEndpoint.from_address(at).key) for at in samples[:count])
                lib.return_loan(reader, samples, count)
        if time.monotonic() - self._began < (_LIMIT_S if self._missing else _LEAST_S):
            return False
        for reader in self._readers:
            lib.delete(reader)
        self._readers.clear()
        return True
