"""QoS profiles as Cyclone DDS takes and shows them, and what ROS and Ropeway write into USER_DATA."""

from __future__ import annotations

import ctypes as ct
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from ropeway.networks.dds.raw import INFINITY, lib, user_data_of
from ropeway.qos import QoS

__all__ = ["parse_user_data", "read_qos", "reader_qos", "user_data", "writer_qos"]

# DDS history of a reader, at least: a thread empties it, whose turn comes after 5 to 15 ms where others have the
# processor (900 messages of 60,000 a second), and what several publishers kept of a latched topic arrives in one burst.
# How many of them wait for a loop that is behind is bounded there, by the depth of the topic.
_LEAST_READER_DEPTH: Final = 1024
# DDS history of a reader that asks for all: the thread that empties it applies the bound in bytes.
_KEEP_ALL_DEPTH: Final = 8192
_DEPTH_MARK: Final = "depth"
_DEPTH_DIGITS: Final = 9  # more of them do not fit the number

_VOLATILE, _TRANSIENT_LOCAL = 0, 1
_KEEP_LAST, _KEEP_ALL = 0, 1
_BEST_EFFORT, _RELIABLE = 0, 1
_IGNORE_PARTICIPANT: Final = 1
_UNLIMITED: Final = -1
_XCDR1 = (ct.c_int16 * 1)(0)


@contextmanager
def writer_qos(qos: QoS, user_data: bytes) -> Iterator[int]:
    """Make a DDS qos object for a writer, for the length of the ``with`` block.

    A keep-all writer never waits for its readers: a write that its cache cannot take fails at once.
    """
    handle = _common(qos, user_data)
    try:
        keep_all = qos.history == "keep_all"
        depth = max(qos.depth, 1)
        lib.qset_reliability(handle, _RELIABLE if qos.reliable else _BEST_EFFORT, 0)
        lib.qset_history(handle, _KEEP_ALL if keep_all else _KEEP_LAST, _UNLIMITED if keep_all else depth)
        lib.qset_writer_data_lifecycle(handle, False)
        lib.qset_writer_batching(handle, True)  # small samples share datagrams; whoever writes flushes
        if qos.transient_local:
            lib.qset_durability_service(
                handle,
                0,
                _KEEP_ALL if keep_all else _KEEP_LAST,
                _UNLIMITED if keep_all else depth,
                _UNLIMITED,
                _UNLIMITED,
                _UNLIMITED,
            )
        if qos.lifespan_s is not None:
            lib.qset_lifespan(handle, _nanoseconds(qos.lifespan_s))
        yield handle
    finally:
        lib.delete_qos(handle)


@contextmanager
def reader_qos(qos: QoS, user_data: bytes) -> Iterator[int]:
    """Make a DDS qos object for a reader, for the length of the ``with`` block.

    Its history is deeper than the profile's, and the USER_DATA tells others the depth of the profile.
    """
    depth = _KEEP_ALL_DEPTH
    if qos.history != "keep_all":
        depth = max(qos.depth, _LEAST_READER_DEPTH)
        user_data += f"{_DEPTH_MARK}={max(qos.depth, 1)};".encode()
    handle = _common(qos, user_data)
    try:
        lib.qset_reliability(handle, _RELIABLE if qos.reliable else _BEST_EFFORT, INFINITY)
        lib.qset_history(handle, _KEEP_LAST, depth)
        yield handle
    finally:
        lib.delete_qos(handle)


def read_qos(handle: int, *, tells_history: bool = True) -> QoS:
    """Return the profile in a DDS qos object; without ``tells_history`` its depth is a default that nobody
    announced.
    """
    kind, depth, duration = ct.c_int(), ct.c_int32(), ct.c_int64()
    reliable = lib.qget_reliability(handle, ct.byref(kind), ct.byref(duration)) and kind.value == _RELIABLE
    transient = lib.qget_durability(handle, ct.byref(kind)) and kind.value >= _TRANSIENT_LOCAL
    has_history = lib.qget_history(handle, ct.byref(kind), ct.byref(depth))
    keep_all = has_history and kind.value == _KEEP_ALL
    told = parse_user_data(handle).get(_DEPTH_MARK, "")
    if len(told) <= _DEPTH_DIGITS and told.isdecimal():
        depth.value = int(told)
    deadline = duration.value if lib.qget_deadline(handle, ct.byref(duration)) else INFINITY
    lifespan = duration.value if lib.qget_lifespan(handle, ct.byref(duration)) else INFINITY
    return QoS(
        reliability="reliable" if reliable else "best_effort",
        durability="transient_local" if transient else "volatile",
        history="keep_all" if keep_all else "keep_last",
        depth=0 if not tells_history else max(depth.value, 1) if has_history and not keep_all else 1,
        deadline_s=None if deadline == INFINITY else deadline / 1e9,
        lifespan_s=None if lifespan == INFINITY else lifespan / 1e9,
    )


def user_data(*, type_hash: str = "", gateway_id: str = "", extra: str = "", since_ns: int = 0) -> bytes:
    """Return the USER_DATA of an endpoint: ``extra`` as it is, ROS's type hash, the mark of our gateway, and its start
    time.
    """
    marks = [extra]
    if type_hash:
        marks.append(f"typehash={type_hash};")
    if gateway_id:
        marks.append(f"ropeway={gateway_id};")
    if since_ns:
        marks.append(f"since={since_ns};")
    return "".join(marks).encode()


def parse_user_data(qos_handle: int) -> dict[str, str]:
    """Return the ``key=value;`` pairs in the USER_DATA of a DDS qos object; anything else is left out."""
    text = user_data_of(qos_handle).rstrip(b"\0").decode("utf-8", "replace")
    pairs = (item.partition("=") for item in text.split(";"))
    return {key: value for key, found, value in pairs if found}


def _common(qos: QoS, user_data: bytes) -> int:
    handle: int = lib.create_qos()
    lib.qset_durability(handle, _TRANSIENT_LOCAL if qos.transient_local else _VOLATILE)
    lib.qset_data_representation(handle, 1, _XCDR1)
    lib.qset_ignorelocal(handle, _IGNORE_PARTICIPANT)
    if qos.deadline_s is not None:
        lib.qset_deadline(handle, _nanoseconds(qos.deadline_s))
    if user_data:
        lib.qset_userdata(handle, user_data, len(user_data))
    return handle


def _nanoseconds(seconds: float) -> int:
    return min(max(round(seconds * 1e9), 1), INFINITY)
