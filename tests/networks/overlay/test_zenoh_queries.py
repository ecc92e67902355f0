"""Queries of a Zenoh session."""

from __future__ import annotations

import asyncio

from ropeway.networks.overlay.asked import Asked
from ropeway.networks.overlay.fabric import Fabric
from ropeway.networks.overlay.zenoh_config import client_config, gateway_id
from tests.networks.overlay.conftest import Site
from tests.networks.overlay.conftest import site as site
from tests.networks.overlay.fleet import member
from tests.support.until import PATIENCE_S, until


async def test_a_probe(site: Site) -> None:
    """A router answers probes of the sessions that are linked with it; without a link there is nothing to probe."""
    fabric = Fabric(client_config(member(), id=gateway_id(), connect=[site.endpoint]), b"", routers=[site.endpoint])
    took: list[float] = []
    fabric.probe(PATIENCE_S, took.append)
    await fabric.open()
    while not took:
        fabric.probe(PATIENCE_S, took.append)
        await asyncio.sleep(0.01)
    assert min(took) > 0
    await fabric.close()


async def test_one_answer_is_enough(site: Site) -> None:
    """Who needs one answer has it at once, though another one that could answer does not."""
    near, quick, slow = await site.join(), await site.join(), await site.join()
    kept: list[Asked] = []
    quick.node.fabric.serve("rw/g/test", lambda asked: asked.answer(b"quick"))
    slow.node.fabric.serve("rw/g/test", kept.append)

    async def asked() -> bool:
        return await near.node.fabric.ask("rw/g/test", b"", PATIENCE_S, first=True) == [b"quick"] and bool(kept)

    while not await asked():
        pass
    await until(lambda: kept)
    for query in kept:
        query.done()
