"""ropeway.group.clock: the clock that latencies are measured with."""

from __future__ import annotations

import asyncio
import time

import uvloop

from ropeway.group.clock import steady_clock
from tests.support.clock import JumpingLoop


def test_loops_that_go_by_the_clock_of_the_system() -> None:
    """Their latencies are measured with that clock, which is finer than uvloop's."""
    for make in (asyncio.new_event_loop, uvloop.new_event_loop):
        loop = make()
        assert steady_clock(loop) is time.monotonic
        loop.close()


def test_a_loop_with_a_time_of_its_own() -> None:
    """Its latencies are measured in that time."""
    loop = JumpingLoop()
    before_s = steady_clock(loop)()
    loop.jump(5.0)
    assert steady_clock(loop)() - before_s == 5.0
    loop.close()
