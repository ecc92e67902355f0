"""Words for faults: the nearest valid word to a mistyped one, a value as its writer knows it."""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterable, Mapping

__all__ = ["did_you_mean", "nearest", "one_of", "show", "unknown_key"]


def nearest(word: object, valid: Iterable[str]) -> str:
    """Return the valid word that ``word`` most likely stands for, ``""`` if none is near.

    Case and the difference between ``-`` and ``_`` count for nothing; a whole part of a valid word
    (``namespace`` for ``local_namespace``) is near when nothing is nearer.
    """
    if not isinstance(word, str) or not word:
        return ""
    folded = {_fold(option): option for option in reversed(list(valid))}
    given = _fold(word)
    found = difflib.get_close_matches(given, folded, n=1, cutoff=0.66)
    if found:
        return folded[found[0]]
    parts = [option for fold, option in folded.items() if given in fold.split("-") or fold in given.split("-")]
    return min(parts, key=len, default="")


def did_you_mean(word: object, valid: Iterable[str]) -> str:
    """Return ``; did you mean "x"?``, ready to follow a sentence, or ``""``."""
    near = nearest(word, valid)
    return f'; did you mean "{near}"?' if near else ""


def one_of(word: object, valid: Iterable[str]) -> str:
    """Return ``expected one of a, b, got "c"; did you mean "b"?`` for a value that is not valid."""
    options = list(valid)
    return f"expected one of {', '.join(options)}, got {show(word)}{did_you_mean(word, options)}"


def unknown_key(word: object, valid: Iterable[str]) -> str:
    """Return the sentence for a key that is not valid."""
    options = list(valid)
    near = did_you_mean(word, options)
    return f"unknown key{near + ' Expected' if near else '; expected'} one of {', '.join(options)}"


def show(value: object) -> str:
    """Return a value as JSON, cut to a length that fits a line; for values with parts, only their kind is named."""
    if isinstance(value, Mapping):
        return "an object"
    if isinstance(value, list | tuple):
        return "a list"
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _fold(word: str) -> str:
    return word.strip().lower().replace("_", "-")
