"""``ropeway router``: carries the overlay, for certificates of one fleet and nobody else."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
import signal
from pathlib import Path
from typing import Annotated

import typer

from ropeway.cli.console import fail, print_json
from ropeway.cli.logs import LEVELS, set_up
from ropeway.cli.loop import run
from ropeway.cli.notify import Notifier, notifying
from ropeway.cli.session import JsonOption
from ropeway.extras import require
from ropeway.networks.overlay.crypto.identity import Identity

__all__ = ["app"]

app = typer.Typer(add_completion=False)
log = logging.getLogger("ropeway")

_ENDPOINT = re.compile(r"(tls|quic)/(\[[0-9a-fA-F:.]+\]|[A-Za-z0-9._-]+):\d{1,5}")


@app.command("router")
def router_command(
    identity: Annotated[
        Path,
        typer.Option(
            "--identity",
            "-i",
            envvar="ROPEWAY_IDENTITY",
            help="Its bundle, as keys issue --router writes it.",
            show_default=False,
        ),
    ],
    listen: Annotated[
        list[str] | None,
        typer.Option("--listen", "-l", help="Where: tls/0.0.0.0:7447, quic/[::]:7447; may be repeated."),
    ] = None,
    connect: Annotated[
        list[str] | None, typer.Option("--connect", "-c", help="Another router to mesh with; may be repeated.")
    ] = None,
    crl: Annotated[
        Path | None, typer.Option("--crl", help="A revocation list (crl.pem of the fleet), read again as it changes.")
    ] = None,
    state: Annotated[
        Path | None,
        typer.Option(
            "--state", help="Where the newest list is kept; by default, next to the bundle.", show_default=False
        ),
    ] = None,
    log_level: Annotated[str, typer.Option("--log-level", help=f"{', '.join(LEVELS)}.")] = "info",
    as_json: JsonOption = False,
) -> None:
    """Run a router until Ctrl-C or SIGTERM. It lets in who has a certificate of its fleet, and sees no content.

    SIGHUP makes it read the revocation list at once.
    """
    set_up(log_level)
    where = listen or ["tls/127.0.0.1:7447"]
    for endpoint in (*where, *(connect or ())):
        if not _ENDPOINT.fullmatch(endpoint):
            fail(f"{endpoint!r} is not the endpoint of a router; write tls/host:7447 or quic/host:7447", 2)
    if crl is not None and not crl.exists():
        fail(f"{crl} does not exist", 2)
    kept = state or identity.with_name(f"{identity.name}.crl")
    require("overlay", "a router of the overlay")
    run(_serve(Identity.load(identity), kept, where, connect or [], crl, as_json))


async def _serve(
    identity: Identity, state: Path, listen: list[str], connect: list[str], crl: Path | None, as_json: bool
) -> None:
    from ropeway.networks.overlay.router import Router

    stop = asyncio.Event()
    notifier = Notifier()
    loop = asyncio.get_running_loop()

    def stopped() -> None:
        notifier.stopping()
        stop.set()

    def say(text: str) -> None:
        log.info("router %s: %s", identity.name, text)
        if as_json:
            print_json({"event": text, **router.status()})

    def hang_up() -> None:
        notifier.reloading()
        router.look()
        notifier.ready("running; the revocation list was read again")

    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stopped)
    router = Router(identity, listen=listen, connect=connect, crl=crl, state=state, on_change=say)
    async with notifying(notifier), router:
        loop.add_signal_handler(signal.SIGHUP, hang_up)
        say(f"it listens on {', '.join(listen)}")
        notifier.ready(f"listening on {', '.join(listen)}")
        running = asyncio.create_task(router.wait(), name="router")
        stopping = asyncio.create_task(stop.wait(), name="signals")
        await asyncio.wait({running, stopping}, return_when=asyncio.FIRST_COMPLETED)
        stopping.cancel()
        if running.done():
            running.result()
        running.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await running
    log.info("router %s has ended", identity.name)
