"""Counts how long messages take to be encoded and decoded in this process, by encoding."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Final, TypeVar

from ropeway.delivery.histogram import Histogram, HistogramJson

__all__ = ["DECODING", "ENCODING", "CodecTimes", "codec_status"]

T = TypeVar("T")


class CodecTimes:
    """Counts durations by encoding; threads that encode may count beside each other."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._histograms: dict[str, Histogram] = {}

    def timed(self, encoding: str, work: Callable[[], T]) -> T:
        """Return what ``work`` returns, and count how long it took; what fails is not counted."""
        began = time.perf_counter_ns()
        made = work()
        took_ns = time.perf_counter_ns() - began
        with self._lock:
            self._histograms.setdefault(encoding, Histogram()).add(took_ns)
        return made

    def to_json(self) -> dict[str, HistogramJson]:
        """Return the histograms by encoding."""
        with self._lock:
            shown = {encoding: histogram.to_json() for encoding, histogram in self._histograms.items()}
        return {encoding: histogram for encoding, histogram in shown.items() if histogram is not None}


ENCODING: Final = CodecTimes()
"""How long messages took to be encoded, of the whole process: raw CDR passes as it is and is not among them."""

DECODING: Final = CodecTimes()
"""How long messages took to be decoded, of the whole process."""


def codec_status() -> dict[str, Any]:
    """Return both as JSON, for the status of a gateway."""
    return {"encode": ENCODING.to_json(), "decode": DECODING.to_json()}
