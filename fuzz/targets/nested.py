"""Inputs that no fuzzer finds by itself: containers within each other beyond what a stack holds, and long numbers."""

from __future__ import annotations

from typing import Final

__all__ = ["NESTED_CBOR", "NESTED_JSON"]

_LEVELS: Final = 2000  # twice what Python's own parser of JSON takes

NESTED_JSON: Final = (
    b"[" * _LEVELS + b"]" * _LEVELS,
    b'{"":' * (_LEVELS // 2) + b"1" + b"}" * (_LEVELS // 2),
    b"1" * (2 * _LEVELS),
)
NESTED_CBOR: Final = (
    b"\x81" * _LEVELS + b"\0",
    b"\xa1\0" * _LEVELS + b"\0",
    b"\xc6" * _LEVELS + b"\0",
    b"\x9f" * _LEVELS,
)
