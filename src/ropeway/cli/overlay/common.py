"""Joining the overlay for a look."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Annotated, Final

import typer

from ropeway import aio
from ropeway.cli.patience import patiently
from ropeway.networks.overlay.crypto.identity import Identity
from ropeway.networks.overlay.graph import OverlayGraph
from ropeway.networks.overlay.node import OverlayNode

__all__ = ["RoutersOption", "joined"]

RoutersOption = Annotated[
    list[str] | None,
    typer.Option("--router", "-r", help="A router to use instead of those of the bundle.", show_default=False),
]

_LINK_S: Final = 5.0


@asynccontextmanager
async def joined(identity: Path, routers: list[str] | None, spin_time_s: float) -> AsyncIterator[OverlayGraph]:
    """Join the overlay, and wait until it has announced what there is, or ``spin_time_s`` are over."""
    node = OverlayNode(Identity.load(identity), routers=routers, listen=())
    graph = OverlayGraph(node)
    await graph.open()
    try:
        where = ", ".join(node.routers) or "none: name one with --router"
        async with patiently(lambda: f"waiting for a router ({where}), {_LINK_S:g} s at most"):
            await node.links.wait(_LINK_S)
        try:
            async with aio.timeout(spin_time_s):
                await node.membership.settled()
        except TimeoutError:
            pass
        yield graph
    finally:
        await graph.close()
