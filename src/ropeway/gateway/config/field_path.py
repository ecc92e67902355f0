"""Reads and writes a field of a JSON value by its path: ``header/stamp``, ``results[0].label``, ``names[]``."""

from __future__ import annotations

import re
from typing import Any, Final

from ropeway.limits import FIELD_PATH_CHARACTERS, FIELD_PATH_STEPS

__all__ = ["FieldPath", "parse_field_path"]

_STEP: Final = re.compile(r"[./]?(?:([^][./\s]+)|\[(\d{0,4})\])")
_WHOLE: Final = ("", "/", ".", "#value", "#body")
_END: Final = -1
"""Stands for the place behind the last element of a list: ``[]``."""


class FieldPath:
    """A way into a JSON value; the empty one is the value itself."""

    def __init__(self, text: str, steps: tuple[str | int, ...]) -> None:
        self.text, self.steps = text, steps

    def read(self, value: Any) -> Any:
        """Return what stands there. Raises ``LookupError`` with where there is nothing."""
        for step in self.steps:
            fits = isinstance(value, list) if isinstance(step, int) else isinstance(value, dict)
            try:
                if not fits:
                    raise KeyError
                value = value[step]
            except (KeyError, IndexError):
                raise LookupError(f"there is no {self.text}") from None
        return value

    def write(self, value: Any, into: Any) -> Any:
        """Return ``into``, ``None`` at first, with ``value`` there. Raises ``LookupError`` where that cannot be.

        Objects and lists are made on the way; a list grows by one element at most.
        """
        return self._write(self.steps, value, into)

    def _write(self, steps: tuple[str | int, ...], value: Any, into: Any) -> Any:
        if not steps:
            return value
        step, rest = steps[0], steps[1:]
        if isinstance(step, str):
            found = {} if into is None else into
            if not isinstance(found, dict):
                raise LookupError(f"{self.text} has no place: what is above it is no object")
            found[step] = self._write(rest, value, found.get(step))
            return found
        items = [] if into is None else into
        if not isinstance(items, list) or step > len(items):
            raise LookupError(f"{self.text} has no place: what is above it is no list, or too short a one")
        place = len(items) if step == _END else step
        if place == len(items):
            items.append(None)
        items[place] = self._write(rest, value, items[place])
        return items


def parse_field_path(text: str) -> FieldPath:
    """Parse a path. Raises ``ValueError``."""
    if text in _WHOLE:
        return FieldPath(text, ())
    if len(text) > FIELD_PATH_CHARACTERS:
        raise ValueError(f"expected a path of at most {FIELD_PATH_CHARACTERS} characters")
    steps: list[str | int] = []
    at = 0
    while at < len(text):
        found = _STEP.match(text, at)
        if found is None or len(steps) == FIELD_PATH_STEPS:
            raise ValueError(f"expected a path such as header/stamp, results[0].label or names[], got {text!r}")
        name, index = found.groups()
        steps.append(name if name is not None else int(index) if index else _END)
        at = found.end()
    return FieldPath(text, tuple(steps))
