"""Compiles patterns with possessive quantifiers (``*+``).

``re`` lacks them in Python 3.10, and gets them wrong before 3.11.5, as in Debian 12; ``regex`` stands in there.
"""

from __future__ import annotations

import re
import sys

if sys.version_info < (3, 11, 5):
    import regex as engine
else:
    engine = re

__all__ = ["compile_possessive"]


def compile_possessive(pattern: bytes, flags: int = 0) -> re.Pattern[bytes]:
    """Return ``pattern`` compiled. What a possessive quantifier has taken is never given back or searched again."""
    compiled: re.Pattern[bytes] = engine.compile(pattern, flags)
    return compiled
