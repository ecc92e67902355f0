"""ropeway.control.events: the ring of events and its readers."""

from __future__ import annotations

import asyncio

from typer.testing import CliRunner

from ropeway.cli import app
from ropeway.control.events import Event, Events
from ropeway.limits import CONTROL_EVENT_BYTES
from tests.control.conftest import Begin


async def read(events: Events, into: list[Event | None], after: int | None = None) -> None:
    async for event in events.follow(after=after):
        into.append(event)


async def test_readers_hear_what_happens() -> None:
    """A reader gets new events, and the kept ones behind a number first where it asks for them."""
    events = Events()
    events.tell("config", "robot", action="applied")
    events.tell("route", "/a", state="active")
    new: list[Event | None] = []
    all_of_them: list[Event | None] = []
    tasks = [asyncio.create_task(read(events, new)), asyncio.create_task(read(events, all_of_them, 1))]
    while events.readers < 2:
        await asyncio.sleep(0)
    events.tell("route", "/b", state="idle")
    events.close()
    await asyncio.gather(*tasks)
    assert [event.name for event in new if event] == ["/b"]
    assert [event.number for event in all_of_them if event] == [2, 3]
    assert events.readers == 0


async def test_a_stalled_reader_is_dropped() -> None:
    """A reader that takes nothing is dropped once too many bytes wait, and counted; others are not held up."""
    events = Events(reader_bytes=10_000)
    slow = events.follow()
    waiting = asyncio.ensure_future(anext(slow))
    await asyncio.sleep(0)
    events.tell("x", "first")
    assert (await waiting) is not None
    for number in range(100):
        events.tell("x", str(number), text="y" * 100)
    assert events.dropped_readers == 1
    assert events.readers == 0
    assert [event async for event in slow] == []


def test_the_ring_is_bounded() -> None:
    """Old events are forgotten, and an event with too much data is told without it."""
    events = Events(kept=3)
    for number in range(5):
        events.tell("x", str(number))
    assert [event.name for event in events.last()] == ["2", "3", "4"]
    assert [event.name for event in events.last(name="3")] == ["3"]
    event = events.tell("x", "big", text="y" * CONTROL_EVENT_BYTES)
    assert set(event.data) == {"left_out_bytes"}


async def test_idle_readers_are_told_so() -> None:
    """A reader hears from time to time that nothing happens."""
    async for event in Events().follow(idle_s=0.001):
        assert event is None
        break


async def test_on_the_command_line(begin: Begin) -> None:
    """The verb tells each event in a line, and of a change its first steps in words."""
    running = await begin()
    items = [{"name": f"/t{number}", "type": "std_msgs/msg/String"} for number in range(5)]
    config = running.manager.config.to_json()
    body = {"config": {**config, "remotes": [{"address": "ws://127.0.0.1:1", "publish": items}]}}
    assert (await running.client.put("/v1/config", json=body)).status_code == 200
    result = await asyncio.to_thread(CliRunner().invoke, app, ["events", running.control.name])
    assert result.exit_code == 0, result.output
    [line] = [line for line in result.output.splitlines() if "action=apply" in line]
    assert "steps: start remote ws://127.0.0.1:1, start route publish /t0" in line
    assert line.endswith("and 3 more")
