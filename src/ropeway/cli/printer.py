"""Prints JSON from a thread of its own: a reader of the pipe who does not read misses lines and holds up nothing."""

from __future__ import annotations

import os
import threading
from typing import Any, Final

import orjson

__all__ = ["Printer"]

_LAST_S: Final = 1.0  # how long the last line may take at the end: a reader that has stopped will not take it


class Printer:
    """Prints one line per value to the file ``descriptor``, at most one at a time; ``missed`` counts the others."""

    def __init__(self, descriptor: int) -> None:
        self.missed = 0
        self._descriptor = descriptor
        self._thread: threading.Thread | None = None
        self._error: OSError | None = None

    def put(self, value: Any) -> None:
        """Print a value, unless the one before it is not printed yet. Raises the ``OSError`` of the one before it."""
        if self._error is not None:
            raise self._error
        if self._thread is not None and self._thread.is_alive():
            self.missed += 1
            return
        line = orjson.dumps(value, option=orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS) + b"\n"
        self._thread = threading.Thread(target=self._print, args=(line,), name="ropeway status", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Wait a moment for the last line. Raises the ``OSError`` that it met."""
        if self._thread is not None:
            self._thread.join(_LAST_S)
        if self._error is not None:
            raise self._error

    def _print(self, line: bytes) -> None:
        try:
            left = memoryview(line)
            while left:
                left = left[os.write(self._descriptor, left) :]
        except OSError as error:
            self._error = error
