"""The thread that prints the status."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator

import pytest

from ropeway.cli.printer import Printer
from tests.support.threads import new_threads
from tests.support.until import until

Pipe = tuple[int, int]


@pytest.fixture
def pipe() -> Iterator[Pipe]:
    """A reading and a writing end."""
    ends = os.pipe()
    yield ends
    for end in ends:
        with contextlib.suppress(OSError):  # the test may have closed it
            os.close(end)


async def test_lines(pipe: Pipe) -> None:
    """Each value is one line, the last one also where it is printed right before the end."""
    printer = Printer(pipe[1])
    printer.put({"a": 1})
    printer.close()
    printer.put({"a": 2})
    printer.close()
    assert os.read(pipe[0], 1000) == b'{"a":1}\n{"a":2}\n'


async def test_reader_that_stalls(pipe: Pipe) -> None:
    """A reader that does not read misses lines, which are counted, and has whole ones when it reads again."""
    started = new_threads()
    printer = Printer(pipe[1])
    printer.put("x" * (1 << 20))
    for number in range(100):
        printer.put(number)
    assert printer.missed == 100
    assert started() == ["ropeway status"]
    got = b""
    while len(got) < (1 << 20) + 3:
        got += os.read(pipe[0], 1 << 16)
    await until(lambda: not started())
    printer.put("next")
    printer.close()
    assert json.loads(got) == "x" * (1 << 20)
    assert os.read(pipe[0], 1000) == b'"next"\n'


async def test_reader_that_has_gone(pipe: Pipe) -> None:
    """Where nobody can read any more, the next line says so."""
    os.close(pipe[0])
    printer = Printer(pipe[1])
    printer.put(1)
    with pytest.raises(BrokenPipeError):
        printer.close()
    with pytest.raises(BrokenPipeError):
        printer.put(2)
