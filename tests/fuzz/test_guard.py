"""What counts as a fault."""

from __future__ import annotations

import time

import pytest
from fuzz.guard import Fault, Guard
from fuzz.target import Target

from ropeway.errors import DecodeError


def refuse(data: bytes) -> None:
    raise DecodeError("message", "CDR", "no")


def hold(data: bytes) -> None:
    bytearray(len(data) << 20)


def spin(data: bytes) -> None:
    end = time.thread_time() + 0.1
    while time.thread_time() < end:
        pass


def test_lets_own_errors_pass() -> None:
    """An error that is the parser's own is an answer, any other is a fault."""
    Guard(Target(refuse, (DecodeError,))).check(b"x")
    with pytest.raises(DecodeError):
        Guard(Target(refuse)).check(b"x")


def test_measures_memory() -> None:
    """An input that makes the process grow by more than it may is a fault, a smaller one is none."""
    guard = Guard(Target(hold, memory_bytes=32 << 20))
    guard.check(bytes(1))
    with pytest.raises(Fault, match="MiB of memory"):
        guard.check(bytes(100))


def test_measures_time() -> None:
    """An input that takes more CPU time than it may is a fault."""
    with pytest.raises(Fault, match="s of CPU time"):
        Guard(Target(spin, cpu_s=0.01)).check(b"x")
