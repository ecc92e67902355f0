"""Binary records between gateways."""

from __future__ import annotations

from typing import Final

from fuzz.target import Target
from ropeway.errors import InvalidFrame
from ropeway.networks.rosbridge.protocol.records import RecordReader, RecordWriter

__all__ = ["TARGETS"]

_LIMIT_BYTES: Final = 64 << 20  # as in a gateway: what is announced is not what may be held
_END: Final = b"end of frame"


def _records(data: bytes) -> None:
    """Frames with a mark between them; a malformed one ends the connection."""
    reader = RecordReader(_LIMIT_BYTES, lambda channel, error: None)
    for frame in data.split(_END):
        for arrival in reader.read(frame):
            assert len(arrival.origin) == 16
            assert len(arrival.body) <= len(data)


def _seeds() -> list[bytes]:
    writer, out = RecordWriter(), []  # type: ignore[var-annotated]
    origin = bytes(range(16))
    writer.message(out, 1, 0, b'{"data":"x"}', origin, 1, 2)
    writer.first(out, 2, 3, 10, b"begin", origin, 2, 3, True)
    writer.more(out, 2, b"ended")
    whole = b"".join(out)
    return [whole, whole[:44] + _END + whole[44:]]


TARGETS: Final = {"records": Target(_records, (InvalidFrame,), _seeds, (_END, b"\0\0\0\4", b"\xff\xff\xff\xff"))}
