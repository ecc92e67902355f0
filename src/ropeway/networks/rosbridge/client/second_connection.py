"""Keeps the second connection of a link, for small messages, while the first one stands."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Final

from ropeway.errors import ConnectFailed

if TYPE_CHECKING:
    from ropeway.listener.connection import Connection
    from ropeway.networks.rosbridge.link.peer import Peer

__all__ = ["keep_second"]

log = logging.getLogger("ropeway.rosbridge")

_FIRST_RETRY_S: Final = 0.5
_LAST_RETRY_S: Final = 30.0  # of a server in several processes it may take some tries to reach the right one


async def keep_second(peer: Peer, connect: Callable[[Peer], Awaitable[Connection]]) -> None:
    """Open the second connection again and again, where the peer has offered it; run until cancelled.

    Nothing depends on it: without it everything goes by the first.
    """
    await peer.heard_hello.wait()
    if not peer.express.offered:
        return
    delay_s = _FIRST_RETRY_S
    while True:
        try:
            made = await connect(peer)
        except ConnectFailed as error:
            log.debug("no second connection: %s", error)
        else:
            began = time.monotonic()
            try:
                await made.wait_closed()
            finally:  # whoever ends the link may end the event loop next: no socket is to be left behind
                made.close(1000, "the link has closed")
                await made.wait_closed()
            if time.monotonic() - began > _LAST_RETRY_S:
                delay_s = _FIRST_RETRY_S
        await asyncio.sleep(delay_s)
        delay_s = min(2 * delay_s, _LAST_RETRY_S)
