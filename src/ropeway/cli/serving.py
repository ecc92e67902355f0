"""Runs a gateway until it is told to stop: signals, the status as JSON, and reading certificates again on SIGHUP.

A service manager is told how it is.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import logging
import math
import os
import signal
import sys
from collections.abc import Awaitable, Callable, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from ropeway.cli.notify import Notifier, notifying
from ropeway.cli.printer import Printer
from ropeway.errors import ConnectFailed, RopewayError
from ropeway.gateway.factory import make_gateway
from ropeway.loading import load
from ropeway.tasks import Chores, Supervised

if TYPE_CHECKING:
    from ropeway.audit.trail import AuditTrail
    from ropeway.cli.live_status import LiveStatus
    from ropeway.control.record import ChangeRecord
    from ropeway.gateway.config.config import Config
    from ropeway.gateway.gateway import Gateway
    from ropeway.gateway.process.supervisor import Supervisor

__all__ = ["Serving", "serve"]

log = logging.getLogger("ropeway")
_LIVE_S: Final = 1.0  # rates are those of the last second
_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


Reload = Callable[[], Awaitable[str]]
"""Reads files again, and says what came of it. Raises ``RopewayError``; nothing has changed then."""


@dataclass(frozen=True)
class Serving:
    """Says how a gateway is run: for how long, how often it prints its status as JSON, and what it says once it is up.

    ``beside`` is entered with the gateway and left before it ends. ``control``: others may see and change it over its
    control API, as its configuration says; ``trail`` is its audit log. ``watch``: the file is applied again when it has
    changed. ``live``: the status is drawn on the terminal once a second. ``retry_s``: an address that is taken is tried
    again after so many seconds, for ever; ``None`` gives up at once.
    """

    config: Config
    level: str
    for_s: float | None = None
    period_s: float | None = None
    retry_s: float | None = None
    up: Callable[[Gateway | Supervisor], None] | None = None
    beside: Callable[[Any], AbstractAsyncContextManager[None]] | None = None
    control: bool = False
    watch: bool = False
    trail: AuditTrail | None = None
    live: bool = False


async def serve(serving: Serving) -> None:
    """Run until the time is over, or a signal ends it in order. Raises ``RopewayError`` if it cannot be brought up."""
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    running: list[Reload] = []
    chores = Chores()
    notifier = Notifier()

    def stopped() -> None:
        notifier.stopping()
        stop.set()
        for number in _SIGNALS:  # a second signal does not wait for an orderly end
            loop.remove_signal_handler(number)

    on_terminal = _on_terminal()

    def hang_up() -> None:
        if on_terminal and not _on_terminal():
            stopped()  # it is the terminal that was closed
        else:
            chores.start(_reload(running, notifier), "SIGHUP")

    for number in _SIGNALS:
        loop.add_signal_handler(number, stopped)
    loop.add_signal_handler(signal.SIGHUP, hang_up)
    async with notifying(notifier):
        working = asyncio.create_task(_run(serving, running, notifier), name="gateway")
        waiting = asyncio.create_task(stop.wait(), name="signals")
        try:
            await asyncio.wait([working, waiting], return_when=asyncio.FIRST_COMPLETED)
        finally:
            waiting.cancel()
            working.cancel()  # without effect where it has ended by itself
            with contextlib.suppress(asyncio.CancelledError):
                await working
            await chores.close()
    log.info("%s has ended", serving.config.gateway.name)


def _on_terminal() -> bool:
    return any(os.isatty(number) for number in range(3))


async def _reload(running: Sequence[Reload], notifier: Notifier) -> None:
    """Read the files again, and say what came of it."""
    notifier.reloading()
    said = "running"
    for reload in running:
        try:
            said = f"running; {await reload()}"
        except RopewayError as error:
            log.error("SIGHUP: nothing has changed: %s", error)
            said = f"running; at the last reload nothing has changed: {error}"
    notifier.ready(said)


async def _plain_reload(gateway: Gateway | Supervisor) -> str:
    gateway.reload()
    return "certificates and tokens were read again"


async def _brought_up(serving: Serving, notifier: Notifier) -> Gateway | Supervisor:
    while True:
        gateway = make_gateway(serving.config, log_level=serving.level, audit=serving.trail)
        try:
            return await gateway.__aenter__()
        except ConnectFailed as error:
            if serving.retry_s is None:
                raise
            log.warning("%s; trying again in %g s", error, serving.retry_s)
            notifier.status(f"{error}; trying again in {serving.retry_s:g} s")
        await asyncio.sleep(serving.retry_s)


async def _managed(serving: Serving, notifier: Notifier, stack: AsyncExitStack) -> tuple[Gateway | Supervisor, Reload]:
    """Bring up what is to run, and the control API where it is wanted."""
    if not serving.control:
        gateway = await _brought_up(serving, notifier)
        stack.push_async_exit(gateway.__aexit__)
        return gateway, partial(_plain_reload, gateway)
    from ropeway.control.caller import Caller
    from ropeway.control.control import Control
    from ropeway.control.manager import Manager
    from ropeway.gateway.audit import open_trail

    trail = open_trail(serving.config)
    if trail is not None:
        stack.push_async_callback(asyncio.to_thread, trail.close)
    gateway, record = await _restored(replace(serving, trail=trail), notifier, stack)
    manager = Manager(gateway, record, trail)
    stack.push_async_callback(manager.close)
    if gateway.config.gateway.control.enabled:
        await stack.enter_async_context(Control(manager))
    if serving.watch and record.file is not None:
        watching = partial(manager.watch_file, Caller("--watch", str(record.file)))
        stack.push_async_callback(Supervised(watching, "watch the file").start().close)
    return gateway, partial(manager.apply_file, Caller("SIGHUP", f"process {os.getpid()}"))


async def _restored(
    serving: Serving, notifier: Notifier, stack: AsyncExitStack
) -> tuple[Gateway | Supervisor, ChangeRecord]:
    """Bring up what was applied last, or the file, as ``control/startup.py`` decides."""
    from ropeway.control.startup import audit_start, candidates, note_start, open_record

    record = await asyncio.to_thread(open_record, serving.config)
    stack.push_async_callback(record.close)
    failed = []
    left = await asyncio.to_thread(candidates, serving.config, record)
    while True:
        candidate = left.pop(0)
        try:
            gateway = await _brought_up(replace(serving, config=candidate.config), notifier)
        except RopewayError as error:
            if not left:
                raise
            log.error("what was applied at run time does not come up: %s", error)
            failed.append((candidate, str(error)))
        else:
            break
    stack.push_async_exit(gateway.__aexit__)
    await asyncio.to_thread(note_start, record, candidate, failed)
    if serving.trail is not None:
        audit_start(serving.trail, candidate)
    return gateway, record


async def _printer(serving: Serving) -> tuple[Printer | LiveStatus | None, float]:
    """Return what shows the status again and again, if anything does, and the seconds between two times."""
    if serving.period_s is not None:
        return Printer(sys.stdout.fileno()), serving.period_s
    if not serving.live:
        return None, math.inf
    live_status = await load("ropeway.cli.live_status")  # and with it what draws tables
    return live_status.LiveStatus(), _LIVE_S


async def _run(serving: Serving, running: list[Reload], notifier: Notifier) -> None:
    loop = asyncio.get_running_loop()
    async with AsyncExitStack() as stack:
        gateway, reload = await _managed(serving, notifier, stack)
        running.append(reload)
        if serving.beside is not None:
            await stack.enter_async_context(serving.beside(gateway))
        if serving.up is not None:
            serving.up(gateway)
        notifier.ready("running")
        gc.freeze()  # what was loaded stays: looking for garbage in it would stop messages for 40 ms now and then
        ends = math.inf if serving.for_s is None else loop.time() + serving.for_s
        printer, period_s = await _printer(serving)
        failing = asyncio.create_task(gateway.wait(), name="gateway failure")
        try:
            while not failing.done() and loop.time() < ends:
                pause = min(ends - loop.time(), period_s)
                await asyncio.wait([failing], timeout=None if math.isinf(pause) else pause)
                if printer is not None:
                    printer.put(gateway.status())
            if failing.done():
                await failing
        finally:
            if printer is not None:
                printer.close()
            running.clear()
            failing.cancel()
            await asyncio.wait([failing])
