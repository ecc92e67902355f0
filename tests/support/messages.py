"""Strings as messages: their bytes, and samples of them."""

from __future__ import annotations

import struct
import time
from collections.abc import Sequence
from typing import Final

from ropeway.graph.base import SEQ_NONE, Publisher, Sample, Subscription
from tests.support.until import until

__all__ = ["STRING", "joined", "sample", "text"]

STRING: Final = "std_msgs/msg/String"


def text(value: str) -> bytes:
    """Return a std_msgs/msg/String as CDR."""
    raw = value.encode() + b"\0"
    return b"\0\1\0\0" + struct.pack("<I", len(raw)) + raw


def sample(value: str, type: str = STRING, seq: int = SEQ_NONE) -> Sample:
    """Return a sample with a std_msgs/msg/String."""
    return Sample(text(value), type, time.time_ns(), bytes(16), seq)


async def joined(publisher: Publisher, count: int = 1, *, read_by: Sequence[Subscription] = ()) -> None:
    """Wait until ``count`` readers are matched, where the network can tell, and so are the subscriptions given.

    With some middlewares the publisher knows its reader first, with others the reader its publisher.
    """
    if publisher.subscribers is not None:
        await until(lambda: (publisher.subscribers or 0) >= count)
    await until(lambda: all(map(_is_matched, read_by)))


def _is_matched(subscription: Subscription) -> bool:
    """True for a subscription whose middleware does not tell, or says that somebody writes to it."""
    readers = getattr(subscription, "_readers", ())
    return all(getattr(reader.raw, "matched", 1) > 0 for reader in readers)
