"""Writes and parses profiles as rmw_zenoh puts them into tokens; what has its default value is left out.

``<reliability>:<durability>:<history>,<depth>:<deadline>:<lifespan>:<liveliness>,<lease>``, where a duration is
``<seconds>,<nanoseconds>`` and policies are the numbers of ``rmw/types.h``.
"""

from __future__ import annotations

from typing import Final

from ropeway.qos import QoS

__all__ = ["parse_qos", "qos_text"]

_RELIABILITY: Final = {"": "reliable", "0": "reliable", "1": "reliable", "2": "best_effort", "4": "reliable"}
_DURABILITY: Final = {"": "volatile", "0": "volatile", "1": "transient_local", "2": "volatile", "4": "volatile"}
_HISTORY: Final = {"": "keep_last", "0": "keep_last", "1": "keep_last", "2": "keep_all"}
_LIVELINESS: Final = ("", "0", "1", "3", "5")
_DEFAULT_DEPTH: Final = 42
_DIGITS: Final = 20  # of the largest number of 64 bits
_FOREVER_S: Final = 9_223_372_036  # RMW_DURATION_INFINITE in whole seconds
_PARTS: Final = 6


def qos_text(qos: QoS) -> str:
    """Return a profile as text."""
    policies = [
        "" if qos.reliable else "2",
        "1" if qos.transient_local else "",
        f"{'2' if qos.history == 'keep_all' else ''},{'' if qos.depth == _DEFAULT_DEPTH else qos.depth}",
        _duration_text(qos.deadline_s),
        _duration_text(qos.lifespan_s),
        ",,",
    ]
    return ":".join(policies)


def parse_qos(text: str) -> QoS | None:
    """Parse a profile; return ``None`` for what is none."""
    parts = text.split(":")
    if len(parts) < _PARTS:
        return None
    lists = [part.split(",") for part in parts[2:_PARTS]]
    if any(len(found) < wanted for found, wanted in zip(lists, (2, 2, 2, 3), strict=True)):
        return None
    history, deadline, lifespan, liveliness = lists
    numbers = [history[1], *deadline[:2], *lifespan[:2], *liveliness[1:3]]
    if liveliness[0] not in _LIVELINESS or not all(map(_is_number, numbers)):
        return None
    try:
        return QoS(
            _RELIABILITY[parts[0]],
            _DURABILITY[parts[1]],
            _HISTORY[history[0]],
            int(history[1] or _DEFAULT_DEPTH),
            _duration(*deadline[:2]),
            _duration(*lifespan[:2]),
        )
    except KeyError:
        return None


def _is_number(text: str) -> bool:
    return not text or (text.isascii() and text.isdigit() and len(text) <= _DIGITS)


def _duration(seconds: str, nanoseconds: str) -> float | None:
    if not seconds and not nanoseconds:
        return None
    whole, rest = int(seconds or _FOREVER_S), int(nanoseconds or 0)
    if whole >= _FOREVER_S or not (whole or rest):
        return None
    return whole + rest / 1e9


def _duration_text(duration_s: float | None) -> str:
    if duration_s is None or duration_s >= _FOREVER_S:
        return ","
    whole, rest = divmod(round(duration_s * 1e9), 1_000_000_000)
    return f"{whole},{rest}"
