"""Makes volatile readers take what was written for them before they knew its writer.

A node of Fast DDS that finds a reader of ours may send it a request before we have found the node's writer. The node
keeps the request until it is acknowledged. Cyclone DDS, however, begins a volatile reader behind the newest sample of a
writer of another vendor, and acknowledges what it never delivered: the request is lost. A reader that wants the history
of a writer begins with the first sample that the writer still has, which for a volatile writer is the first that it
wrote for this reader. One bit of ``struct ddsi_reader`` tells the two apart.
"""

from __future__ import annotations

import ctypes as ct
import struct
from contextlib import ExitStack
from typing import Final

from ropeway.networks.dds import raw
from ropeway.networks.dds.endpoint_qos import reader_qos
from ropeway.networks.dds.fastdds.serdata_hook import HookError, find_end
from ropeway.networks.dds.memory import read
from ropeway.networks.dds.raw import check, lib
from ropeway.qos import QoS

__all__ = ["check_layout", "take_early"]

_RELIABLE: Final = 1
_WANTS_HISTORY: Final = 2
_BOTH: Final = _RELIABLE | _WANTS_HISTORY  # bits above may be anything
_ACKS: Final = 1  # the number of the first acknowledgement, which follows the flags
_HEAD = struct.Struct("=II")
_PLACES: Final = ((-24, bytes(16)), (-8, b""))
"""Where the flags lie, from the pointer to the type on, and what lies in between: the addresses of a network partition,
in libraries that have those.
"""
_TOPIC, _TYPE = "ropeway/layout", "ropeway::msg::dds_::Layout_"


def take_early(reader: int, sertype: int) -> None:
    """Make a reliable volatile reader that was just made take early samples. Raises ``HookError``, ``DdsError``."""
    at, flags = _flags(reader, sertype)
    if flags & _WANTS_HISTORY:
        raise HookError("a volatile reader wants a history")
    ct.c_uint32.from_address(at).value = flags | _WANTS_HISTORY


def check_layout(participant: int) -> None:
    """See that the bit is where it should be, by two readers that differ in it. Raises ``HookError``, ``DdsError``."""
    found = []
    with ExitStack() as stack:
        topic, sertype = raw.create_topic(participant, _TOPIC, _TYPE)
        stack.callback(lib.delete, topic)
        for durability in ("volatile", "transient_local"):
            with reader_qos(QoS(durability=durability), b"") as qos:
                reader = check(lib.create_reader(participant, topic, qos, None), f"create reader {_TOPIC}")
            stack.callback(lib.delete, reader)
            found.append(_flags(reader, sertype)[1])
    if [flags & _BOTH for flags in found] != [_RELIABLE, _BOTH]:
        raise HookError("the flags of a reader have another order")


def _flags(reader: int, sertype: int) -> tuple[int, int]:
    """Return where the flags of a reader are, and what they are."""
    at = find_end(reader, raw.guid_of(reader), sertype)
    for offset, between in _PLACES:
        head, rest = read(at + offset, _HEAD.size), read(at + offset + _HEAD.size, len(between))
        flags, acks = _HEAD.unpack(head) if len(head) == _HEAD.size else (0, 0)
        if rest == between and acks == _ACKS and flags & _RELIABLE:
            return at + offset, flags
    raise HookError("the flags of a reader are not where they should be")
