"""Reads what a far gateway reports of a topic, as far as it can be believed."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from ropeway.graph.link_parts import FarFigures
from ropeway.limits import REPORTED_REASON_CHARACTERS, REPORTED_REASONS

__all__ = ["read_figures", "since"]

_MOST: Final = 1 << 63


def read_figures(message: Mapping[str, Any]) -> FarFigures | None:
    """Return the figures of a ``stats`` operation, ``None`` where it has none; what is no count is left out."""
    messages, drops = message.get("messages"), message.get("drops")
    if not _is_count(messages) and not isinstance(drops, Mapping):
        return None
    listed = list(drops.items())[:REPORTED_REASONS] if isinstance(drops, Mapping) else []
    counts = {
        reason[:REPORTED_REASON_CHARACTERS]: count
        for reason, count in listed
        if isinstance(reason, str) and reason.isprintable() and _is_count(count)
    }
    return FarFigures(messages if isinstance(messages, int) and _is_count(messages) else 0, counts)


def since(now: FarFigures | None, before: FarFigures | None) -> FarFigures | None:
    """Return figures of which a report comes every second, with the time of the first one that had as many messages."""
    if now is None:
        return None
    same = before is not None and before.messages == now.messages
    return replace(now, passed_s=before.passed_s if before is not None and same else time.monotonic())


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < _MOST
