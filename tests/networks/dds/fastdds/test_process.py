"""The helper process as the gateway sees it."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import time
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest

from ropeway import processor_queue
from ropeway.networks.dds.fastdds import process as module
from ropeway.networks.dds.fastdds.frames import HelperFrame, Op
from ropeway.networks.dds.fastdds.process import HelperProcess, Unfit
from ropeway.networks.dds.profile import make_profile
from tests.support.until import PATIENCE_S, until


class Watch:
    """A helper, and what it told."""

    def __init__(self, domain: int, **order: Any) -> None:
        profile = make_profile("test", "lo")
        self.order = {"domain": domain, "xml": profile.xml, "interface": "lo", "gateway_id": "", "everyone": True}
        self.frames: list[HelperFrame] = []
        self.ups = self.downs = 0
        self.helper = HelperProcess("test", self.order | order, self.on_up, self.frames.append, self.on_down)

    def on_up(self) -> None:
        self.ups += 1

    def on_down(self) -> None:
        self.downs += 1


Start = Callable[..., Watch]


@pytest.fixture
async def watch(domain: int) -> AsyncIterator[Start]:
    """Makes helpers; all are ended."""
    made: list[Watch] = []

    def make(**order: Any) -> Watch:
        made.append(Watch(domain, **order))
        return made[-1]

    yield make
    for one in made:
        await one.helper.close()


def alive(pid: int) -> bool:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, 0)
        return True
    return False


async def test_life(watch: Start) -> None:
    """A helper is up once it has tested itself, and its process ends with it."""
    one = watch()
    assert not one.helper.send(HelperFrame(Op.PING))
    await one.helper.start()
    assert one.helper.up
    assert len(one.helper.guid) == 16
    pid = one.helper.pid
    assert alive(pid)
    await one.helper.close()
    assert not alive(pid)
    assert not one.helper.up
    await one.helper.close()
    assert (one.ups, one.downs) == (1, 1)


async def test_unfit(watch: Start) -> None:
    """A helper that cannot join the domain says why, and is not started again."""
    one = watch(xml='<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="none0"/>'
                    "</Interfaces></General></Domain></CycloneDDS>", interface="none0")  # fmt: skip
    with pytest.raises(Unfit, match="cannot start on interface none0"):
        await one.helper.start()
    assert not alive(one.helper.pid)
    assert one.helper.starts == 1
    assert (one.ups, one.downs) == (0, 0)


async def test_no_process(watch: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    """A program that cannot be started, or ends at once, makes a helper unfit."""
    monkeypatch.setattr(sys, "executable", "/no/such/program")
    with pytest.raises(Unfit, match="No such file"):
        await watch().helper.start()
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(Unfit, match="ended at once: exit code 1"):
        await watch().helper.start()


async def test_killed(watch: Start, caplog: pytest.LogCaptureFixture) -> None:
    """A helper that is killed is told of at once, and is back soon."""
    one = watch()
    await one.helper.start()
    os.kill(one.helper.pid, signal.SIGKILL)
    await until(lambda: one.downs == 1)
    assert not one.helper.up
    await until(lambda: one.ups == 2)
    assert one.helper.starts == 2
    assert "has ended (signal 9); it is started again" in caplog.text


async def test_hung(watch: Start, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    """A helper that answers nothing any more is ended, and another takes its place."""
    monkeypatch.setattr(module, "_PING_S", 0.02)
    monkeypatch.setattr(module, "_SILENCE_S", PATIENCE_S)
    monkeypatch.setattr(module, "_STOP_S", 0.1)
    one = watch()
    await one.helper.start()
    for _ in range(3):  # it answers several pings
        heard = one.helper._heard
        await until(lambda h=heard: one.helper._heard > h)
    assert one.downs == 0
    os.kill(one.helper.pid, signal.SIGSTOP)
    monkeypatch.setattr(module, "_SILENCE_S", 0.2)
    await until(lambda: one.downs == 1)
    monkeypatch.setattr(module, "_SILENCE_S", PATIENCE_S)
    await until(lambda: one.ups == 2)
    assert one.downs == 1
    assert "has ended (it hung)" in caplog.text


async def test_let_wait(watch: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    """A helper that gets no processor is waited for, when it starts and when it does not answer."""
    monkeypatch.setattr(module, "_READY_S", 0.001)
    monkeypatch.setattr(module, "_PING_S", 0.001)
    monkeypatch.setattr(module, "_SILENCE_S", 0.001)
    monkeypatch.setattr(processor_queue, "queued_s", lambda pid: time.monotonic())
    one = watch()
    await one.helper.start()
    heard = one.helper._heard
    await until(lambda: one.helper._heard > heard + 0.01)
    assert (one.helper.starts, one.downs) == (1, 0)


async def test_nonsense(watch: Start, caplog: pytest.LogCaptureFixture) -> None:
    """Frames that mean nothing to a helper are ignored; a description of an endpoint that is none ends it."""
    one = watch()
    await one.helper.start()
    for op in (Op.CALL, Op.REPLY, Op.FORGET, Op.CLOSE, Op.PONG):
        one.helper.send(HelperFrame(op, 9, 9, b"x"))
    one.helper.send(HelperFrame(Op.OPEN_CLIENT, 1, body=b"/add\0no type"))
    await until(lambda: one.frames)
    assert one.frames[0].op == Op.REFUSED
    assert b"is not a type name" in one.frames[0].body
    one.helper.send(HelperFrame(Op.OPEN_CLIENT, 2, body=b"\xff"))
    await until(lambda: one.ups == 2)
    assert "has ended (exit code 1)" in caplog.text


async def test_cancelled_start(watch: Start) -> None:
    """Who gives up waiting for a helper leaves no process behind."""
    one = watch()
    task = asyncio.create_task(one.helper.start())
    await until(lambda: one.helper.pid)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert not alive(one.helper.pid)
