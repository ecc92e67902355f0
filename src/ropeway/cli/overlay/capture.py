"""``ropeway overlay capture``: packets for an auditor."""

from __future__ import annotations

import asyncio
import contextlib
import time
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from ropeway import aio
from ropeway.cli.console import answer, fail
from ropeway.cli.loop import run
from ropeway.cli.name import IdentityOption
from ropeway.cli.overlay.common import RoutersOption, joined
from ropeway.cli.session import SpinOption, full_name
from ropeway.limits import OVERLAY_ROUTED_BYTES
from ropeway.networks.overlay.advert import Advertisement
from ropeway.networks.overlay.audit import captured
from ropeway.networks.overlay.data_key import data_key

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command()
def capture(
    topic: Annotated[str, typer.Argument(help="Its name.", show_default=False)],
    output: Annotated[Path, typer.Option("--output", "-o", help="The file to write.", show_default=False)],
    identity: IdentityOption,
    count: Annotated[int, typer.Option("--count", "-n", min=1, help="How many packets.")] = 1,
    timeout: Annotated[float, typer.Option("--timeout", min=0.0, help="Seconds to wait for them.")] = 30.0,
    router: RoutersOption = None,
    spin_time: SpinOption = 3.0,
) -> None:
    """Write packets of TOPIC down as they pass, sealed, for overlay verify. Somebody has to read it meanwhile."""
    name = full_name(topic)

    async def listen() -> list[str]:
        lines: list[str] = []
        enough = asyncio.Event()

        def take(certificate: bytes, key: str, packet: bytes) -> None:
            if len(lines) < count:
                lines.append(captured(key, packet, certificate, time.time_ns()))
            if len(lines) >= count:
                enough.set()

        async with joined(identity, router, spin_time) as graph:
            node = graph.node

            def follow(advert: Advertisement, added: bool) -> None:
                certificate = node.membership.certificate(advert.gateway)
                if added and (advert.kind, advert.name) == ("publisher", name) and certificate is not None:
                    key = data_key(advert.global_name, advert.endpoint)
                    node.fabric.hear(key, partial(take, certificate.der), limit_bytes=OVERLAY_ROUTED_BYTES)

            node.rib.on_change(follow)
            for advert in node.rib.all("publisher"):
                follow(advert, True)
            with contextlib.suppress(TimeoutError):
                async with aio.timeout(timeout):
                    await enough.wait()
        return lines

    lines = run(listen())
    if not lines:
        fail(f"no packet of {name} passed within {timeout:g} s: is it published, and does anybody subscribe to it?")
    output.write_text("\n".join(lines) + "\n")
    answer(f"{output}: {len(lines)} packet(s); whoever has ca.pem of the fleet can check them with: overlay verify")
