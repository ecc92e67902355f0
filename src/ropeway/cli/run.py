"""``ropeway run``: a gateway, until it is told to stop."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from ropeway.cli.console import print_json
from ropeway.cli.logs import LEVELS, set_up
from ropeway.cli.loop import run

if TYPE_CHECKING:
    from ropeway.gateway.config import Config
    from ropeway.gateway.gateway import Gateway
    from ropeway.gateway.supervisor import Supervisor

__all__ = ["app"]

app = typer.Typer(add_completion=False)
log = logging.getLogger("ropeway")
_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


@app.command("run")
def run_command(
    config: Annotated[Path, typer.Argument(help="A configuration, JSON or YAML.", show_default=False)],
    for_s: Annotated[float, typer.Option("--for", min=0.0, help="End after so many seconds; 0: never.")] = 0.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the status as JSON, one line per --period.")] = False,
    period: Annotated[float, typer.Option("--period", min=0.05, help="Seconds between two lines of --json.")] = 1.0,
    log_level: Annotated[str, typer.Option("--log-level", help=f"{', '.join(LEVELS)}.")] = "info",
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Only warnings and errors.")] = False,
) -> None:
    """Run the gateway that CONFIG describes. Ctrl-C and SIGTERM end it in order, with exit status 0."""
    level = set_up("warning" if quiet else log_level)
    from ropeway.gateway.config import load

    loaded = load(config)
    try:
        run(_serve(loaded, for_s=for_s or None, period_s=period if as_json else None, level=level))
    except KeyboardInterrupt:  # before the handler was there: nothing had been started
        return


def _gateway(config: Config, level: str) -> Gateway | Supervisor:
    """One process, or a supervisor of workers, as the configuration says."""
    if config.gateway.workers == 0:
        from ropeway.gateway.gateway import Gateway

        return Gateway(config)
    from ropeway.gateway.supervisor import Supervisor

    return Supervisor(config, log_level=level)


async def _serve(config: Config, *, for_s: float | None, period_s: float | None, level: str) -> None:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()

    def stopped() -> None:
        stop.set()
        for number in _SIGNALS:  # a second signal does not wait for an orderly end
            loop.remove_signal_handler(number)

    for number in _SIGNALS:
        loop.add_signal_handler(number, stopped)
    serving = asyncio.create_task(_run(config, for_s, period_s, level), name="gateway")
    waiting = asyncio.create_task(stop.wait(), name="signals")
    try:
        await asyncio.wait([serving, waiting], return_when=asyncio.FIRST_COMPLETED)
    finally:
        waiting.cancel()
        serving.cancel()  # without effect where it has ended by itself
        with contextlib.suppress(asyncio.CancelledError):
            await serving
    log.info("%s has ended", config.gateway.name)


async def _run(config: Config, for_s: float | None, period_s: float | None, level: str) -> None:
    loop = asyncio.get_running_loop()
    async with _gateway(config, level) as gateway:
        _greet(config)
        ends = math.inf if for_s is None else loop.time() + for_s
        failing = asyncio.create_task(gateway.wait(), name="gateway failure")
        try:
            while not failing.done() and loop.time() < ends:
                pause = min(ends - loop.time(), math.inf if period_s is None else period_s)
                await asyncio.wait([failing], timeout=None if math.isinf(pause) else pause)
                if period_s is not None:
                    print_json(gateway.status())
            if failing.done():
                await failing
        finally:
            failing.cancel()
            await asyncio.wait([failing])


def _greet(config: Config) -> None:
    listen = ", ".join(config.gateway.listen) or "nowhere"
    remotes = sum(remote.active for remote in config.remotes)
    log.info(
        "%s stands on %s, listens at %s, and has %d route(s) to %d remote(s)",
        config.gateway.name,
        ", ".join(config.gateway.graphs),
        listen,
        len(config.routes()),
        remotes,
    )
