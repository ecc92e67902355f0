"""The connection of a node: whose turn it is."""

from __future__ import annotations

import asyncio
import time

from ropeway.iort import Fault, Packet
from ropeway.networks.iort.server.connection import NodeConnection
from tests.support.until import until


class Slow(NodeConnection):
    """A node each of whose packets takes two milliseconds to answer."""

    def __init__(self) -> None:
        super().__init__(1000)
        self.answered = 0

    def began_to_speak(self, data: bytes) -> bool:
        """Let everybody speak."""
        self.trusted = True
        return True

    def came(self, item: Packet | Fault) -> None:
        """Count a packet, slowly."""
        self.answered += 1
        time.sleep(0.002)

    def caught_up(self) -> bool:
        """Return that nothing waits."""
        return False


async def connected() -> tuple[Slow, asyncio.StreamWriter, asyncio.Server]:
    """Return the connection of a node, the node's end of it, and what listens."""
    made: list[Slow] = []

    def make() -> Slow:
        made.append(Slow())
        return made[-1]

    server = await asyncio.get_running_loop().create_server(make, "127.0.0.1", 0)
    _, writer = await asyncio.open_connection("127.0.0.1", server.sockets[0].getsockname()[1])
    await until(lambda: made)
    return made[0], writer, server


PACKETS = b"%01/S/t/p/x%" * 100


async def test_others_have_their_turn() -> None:
    """Many packets that came at once are answered a few at a time, and all of them in the end."""
    node, writer, server = await connected()
    writer.write(PACKETS)
    await until(lambda: node.answered)
    assert node.answered < 100
    await until(lambda: node.answered == 100)
    writer.close()
    server.close()


async def test_a_node_that_has_left() -> None:
    """What a node asked that has left meanwhile is not answered any more."""
    node, writer, server = await connected()
    writer.write(PACKETS)
    await until(lambda: node.answered)
    assert node.transport is not None
    node.transport.abort()
    answered = node.answered
    await until(lambda: node.transport is None)
    assert node.answered == answered
    writer.close()
    server.close()
