"""ropeway.logs."""

from __future__ import annotations

import io
import logging
from collections.abc import Iterator

import pytest

from ropeway.errors import DecodeError
from ropeway.limits import LOG_BURST_LINES, LOG_LINE_CHARACTERS, LOG_LINES_PER_S
from ropeway.logs import LimitedHandler, failed


class Log:
    def __init__(self) -> None:
        self.now = 0.0
        self.stream = io.StringIO()
        self.logger = logging.getLogger("tests.limited")
        self.logger.setLevel(logging.DEBUG)
        self.handler = LimitedHandler(self.stream, clock=lambda: self.now)

    @property
    def lines(self) -> list[str]:
        return self.stream.getvalue().splitlines()


@pytest.fixture
def log() -> Iterator[Log]:
    made = Log()
    made.logger.addHandler(made.handler)
    yield made
    made.logger.removeHandler(made.handler)


def test_one_place_cannot_fill_the_log(log: Log) -> None:
    """Of what one place logs only so many lines pass; a later one tells how many did not."""
    for count in (10_000, 1):
        for number in range(count):
            log.logger.warning("again %d", number)
        log.now += 1.5 / LOG_LINES_PER_S
    assert len(log.lines) == LOG_BURST_LINES + 1
    assert log.lines[-1] == f"again 0 ({10_000 - LOG_BURST_LINES} more like it were left out)"


def test_other_places_are_heard(log: Log) -> None:
    """A place that logs too much costs no other place a line."""
    for _ in range(1000):
        log.logger.warning("noise")
    log.logger.warning("signal")
    assert log.lines[-1] == "signal"


def test_debugging(log: Log) -> None:
    """Who asks for lines of debugging gets all of them."""
    for number in range(1000):
        log.logger.debug("%d", number)
    assert len(log.lines) == 1000


def test_long_lines(log: Log) -> None:
    """A line is cut where nobody would read on."""
    log.logger.warning("%s", "x" * 1_000_000)
    assert len(log.lines[0]) == LOG_LINE_CHARACTERS


def test_tracebacks(log: Log) -> None:
    """A failure that comes again and again is told with its traceback a few times only."""
    for _ in range(1000):
        try:
            raise ValueError("no")
        except ValueError:
            failed(log.logger, "it failed with %s", "this")
    text = log.stream.getvalue()
    assert text.count("Traceback") == 5
    assert text.count("it failed with this") == LOG_BURST_LINES


def test_bad_input_has_no_traceback(log: Log) -> None:
    """An error of ours, as bad input raises it, is one line that says what it was."""
    try:
        raise DecodeError("std_msgs/msg/String", "CDR", "the bytes end too early")
    except DecodeError:
        failed(log.logger, "a callback for %s failed", "/a")
    assert log.lines == ["a callback for /a failed: CDR bytes are not a std_msgs/msg/String: the bytes end too early"]


def test_arguments_that_fail_as_texts(log: Log, capsys: pytest.CaptureFixture[str]) -> None:
    """A line whose arguments cannot be shown costs no other line."""
    log.handler.handle(logging.LogRecord("tests", logging.WARNING, "", 1, "%d", ("no number",), None))
    log.logger.warning("next")
    assert log.lines == ["next"]
    assert "no number" in capsys.readouterr().err
