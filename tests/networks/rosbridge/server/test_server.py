"""ropeway.networks.rosbridge.server.server: what is left when a server has stopped."""

from __future__ import annotations

import psutil
import pytest

from ropeway.networks.rosbridge.link.express import HEADER
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY_SUBPROTOCOL
from tests.support.place import Place

pytestmark = pytest.mark.jumping


def sockets(port: int) -> list[object]:
    """The server's ends of the connections to a port."""
    found = psutil.Process().net_connections("tcp")
    return [c for c in found if c.raddr and c.laddr.port == port]


@pytest.mark.parametrize("headers", [{}, {HEADER: "0" * 32}], ids=["a client", "one that is sent away"])
async def test_no_connection_outlives_the_server(bare: Place, headers: dict[str, str]) -> None:
    """A server that has stopped has no connection left, whether it let the client in or not, and whatever that does."""
    await bare.start()
    await bare.client(subprotocol=ROPEWAY_SUBPROTOCOL, headers=headers)  # which never answers
    assert len(sockets(bare.port)) == 1
    await bare.server.close()
    assert sockets(bare.port) == []


async def test_no_second_connection_outlives_the_server(bare: Place) -> None:
    """The second connection of a gateway, too, has ended when the server has stopped."""
    await bare.start()
    first = await bare.client(subprotocol=ROPEWAY_SUBPROTOCOL)
    secret = (await first.json())["express"]
    second = await bare.client(subprotocol=ROPEWAY_SUBPROTOCOL, headers={HEADER: secret})
    assert second.status.split()[1] == "101"
    assert len(sockets(bare.port)) == 2
    await bare.server.close()
    assert sockets(bare.port) == []
