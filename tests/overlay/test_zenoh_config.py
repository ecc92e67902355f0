"""How Zenoh is set up."""

from __future__ import annotations

import json

from ropeway.overlay.fabric import Fabric
from ropeway.overlay.zenoh_config import gateway_config, gateway_id
from tests.overlay.conftest import Site
from tests.overlay.conftest import site as site
from tests.overlay.fleet import fleet, member
from tests.support.until import until


def endpoints(*connect: str) -> list[str]:
    fleet()
    config = gateway_config(member(), gateway=gateway_id(), connect=connect, listen=())
    found: list[str] = json.loads(config.get_json("connect/endpoints"))
    return found


def test_two_connections_to_each() -> None:
    """Each endpoint is dialled twice, once for what is small or urgent; one that says what it carries is left alone."""
    assert endpoints("tls/[::1]:7447#iface=eth0") == [
        "tls/[::1]:7447?prio=0-4#iface=eth0",
        "tls/[::1]:7447?prio=5-7#iface=eth0",
    ]
    assert endpoints("tls/a:1?prio=1-7") == ["tls/a:1?prio=1-7"]


def carried(fabric: Fabric) -> list[tuple[int, int] | None]:
    """What the connections of a member carry."""
    return sorted((link.priorities for link in fabric.session.info.links()), key=str)


async def test_two_connections_stand(site: Site) -> None:
    """A member and its router are joined by two connections."""
    graph = await site.join(alone=True)
    await until(lambda: carried(graph.node.fabric) == [(0, 4), (5, 7)])
