"""Logs that nobody else can fill: of each kind of line only so many a minute, and no traceback for what a peer did."""

from __future__ import annotations

import copy
import logging
import os
import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, TextIO

from ropeway.errors import RopewayError
from ropeway.limits import LOG_BURST_LINES, LOG_LINE_CHARACTERS, LOG_LINES_PER_S

__all__ = ["LimitedHandler", "LoggerAdapter", "failed", "line_format"]

_KINDS = 4096  # places in the code that log; ours and those of libraries are fewer
_TRACEBACKS = 5  # at once, of one place
_Place = tuple[str, int, str, int]

if TYPE_CHECKING:
    LoggerAdapter = logging.LoggerAdapter[logging.Logger]
    _StreamHandler = logging.StreamHandler[TextIO]
else:  # these take no type in Python 3.10
    LoggerAdapter, _StreamHandler = logging.LoggerAdapter, logging.StreamHandler


def line_format(end: str = "") -> logging.Formatter:
    """Return the format of every line: the level, and the time where nobody else adds it; ``end`` closes each."""
    under_systemd = "JOURNAL_STREAM" in os.environ  # the journal has its own clock
    clock = "" if under_systemd else "%(asctime)s.%(msecs)03d "
    return logging.Formatter(f"{clock}%(levelname)-7s %(message)s{end}", "%H:%M:%S")


class LimitedHandler(_StreamHandler):
    """Writes the lines of each place in the code up to a rate; the next that passes tells how many did not.

    A place has ``LOG_BURST_LINES`` at once and ``LOG_LINES_PER_S`` on average; the first few may have tracebacks. Lines
    for debugging all pass: somebody asked for them. ``clock`` counts seconds.
    """

    def __init__(self, stream: TextIO, *, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(stream)
        self._clock = clock
        self._left: dict[_Place, tuple[float, float]] = {}  # lines that a place still has, and when that was
        self._left_out: dict[_Place, int] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line, if its place has not had too many."""
        place = (record.name, record.levelno, record.pathname, record.lineno)
        left = self._take(place) if record.levelno > logging.DEBUG else float(LOG_BURST_LINES)
        if left < 1:
            self._left_out[place] = self._left_out.get(place, 0) + 1
            return
        left_out = self._left_out.pop(place, 0)
        try:
            text = record.getMessage()
        except Exception:  # the arguments are somebody else's, and any of them may fail as a text
            self.handleError(record)
            return
        brief = record.exc_info is not None and left <= LOG_BURST_LINES - _TRACEBACKS
        if left_out or brief or len(text) > LOG_LINE_CHARACTERS:
            record = copy.copy(record)
            short = text if len(text) <= LOG_LINE_CHARACTERS else f"{text[: LOG_LINE_CHARACTERS - 1]}…"
            record.msg = f"{short} ({left_out} more like it were left out)" if left_out else short
            record.args = ()
            if brief:
                record.exc_info = record.exc_text = None
        super().emit(record)

    def _take(self, place: _Place) -> float:
        """Take one of the lines that a place has left; return how many it had, less than one for none."""
        now = self._clock()
        left, at = self._left.get(place, (float(LOG_BURST_LINES), now))
        left = min(LOG_BURST_LINES, left + (now - at) * LOG_LINES_PER_S)
        if len(self._left) >= _KINDS and place not in self._left:
            self._left.clear()
        self._left[place] = (max(left - 1, 0.0) if left >= 1 else left, now)
        return left


def failed(log: logging.Logger, text: str, *args: object, error: BaseException | None = None) -> None:
    """Log an exception, that which is being handled unless another is named: one line if it is an error of ours, as
    for bad input, else all of it.
    """
    error = error or sys.exc_info()[1]
    if isinstance(error, RopewayError):
        log.warning("%s: %s", text % args, error, stacklevel=2)
    else:
        log.error(text, *args, exc_info=error, stacklevel=2)
