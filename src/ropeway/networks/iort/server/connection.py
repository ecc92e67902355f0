"""Carries the packets of one node, in both directions and within bounds; a session says what they mean."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from typing import Final, cast

from ropeway.delivery.pacing.flow import Flow
from ropeway.iort import Fault, Packet, Parser
from ropeway.limits import NODE_UNREAD_BYTES

__all__ = ["NodeConnection"]

_NOTHING: Final[deque[Packet | Fault]] = deque(maxlen=0)  # of all nodes: an empty deque of each takes 0.6 kB
_TURN_S: Final = 0.01  # so long one node's packets are answered before others have their turn


class NodeConnection(asyncio.Protocol):
    """The connection of one node. A node that reads slowly is not read from, until it has caught up.

    ``trusted`` says whether whoever it is was let in: of a stranger packet by packet is taken, since one may let it
    in, and with it bigger ones.
    """

    __slots__ = (
        "_flow",
        "_heard",
        "_items",
        "_looking",
        "_out",
        "_out_bytes",
        "_parser",
        "_paused",
        "_scheduled",
        "began",
        "last_heard",
        "transport",
        "trusted",
    )

    def __init__(self, max_packet_bytes: int) -> None:
        self.transport: asyncio.Transport | None = None
        self.trusted = False
        self.last_heard = time.monotonic()
        self.began: float | None = None  # when the packet that is coming in began
        self._parser = Parser(max_packet_bytes)
        self._items = _NOTHING  # what came, while the node does not read our answers
        self._out: list[bytes] = []
        self._out_bytes = 0
        self._scheduled = False
        self._heard = self._paused = False
        self._looking = False  # a value is looked up elsewhere, or deleted; what came after that request waits
        self._flow = Flow(self._catch_up)

    # ── what a session adds ────────────────────────────────────────────────────────────────────────────────────

    def began_to_speak(self, data: bytes) -> bool:
        """Return whether a node whose first bytes are ``data`` may go on."""
        raise NotImplementedError

    def came(self, item: Packet | Fault) -> None:
        """Take a packet, or what came in the place of one."""
        raise NotImplementedError

    def caught_up(self) -> bool:
        """Send one more of what waits; return whether there was any."""
        raise NotImplementedError

    # ── what the event loop calls ──────────────────────────────────────────────────────────────────────────────

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take a new node's connection."""
        self.transport = cast(asyncio.Transport, transport)
        self.transport.set_write_buffer_limits(high=NODE_UNREAD_BYTES)
        self._flow.open(self.transport.get_extra_info("socket"))

    def connection_lost(self, exc: Exception | None) -> None:
        """Clean up after a connection that is gone."""
        self.transport = None
        self._items.clear()
        self._out.clear()
        self._flow.close()

    def pause_writing(self) -> None:
        """Hold back: the node reads slower than we send."""
        self._paused = True
        if self.transport is not None:
            self.transport.pause_reading()

    def resume_writing(self) -> None:
        """Resume: the node caught up."""
        self._paused = False
        self._catch_up()
        self._work()

    def _catch_up(self) -> None:
        """Send what waits, as far as the link takes it."""
        while not self._paused and self._flow.free and self.caught_up():
            self.flush()

    def data_received(self, data: bytes) -> None:
        """Take what came; of a stranger packet by packet."""
        if not self._heard:
            if not self.began_to_speak(data):
                return
            self._heard = True
        while not self.trusted and data:
            cut = data.find(b"%") + 1 or len(data)
            self._take(data[:cut])
            data = data[cut:]
        if data:
            self._take(data)

    def _take(self, data: bytes) -> None:
        self.last_heard = now = time.monotonic()
        items = self._parser.feed(data)
        if items:
            if self._items is _NOTHING:
                self._items = deque()
            self._items += items
        self.began = (self.began or now) if self._parser.unfinished else None
        self._work()

    def _work(self) -> None:
        """Answer what came, as long as the node reads; what is left waits, and no more is read until then.

        After ``_TURN_S`` others have their turn. What a node asked that has left meanwhile is dropped.
        """
        items, until_s = self._items, time.monotonic() + _TURN_S
        while items and not self._paused and not self._looking:
            if self.transport is None or self.transport.is_closing():
                items.clear()
                break
            self.came(items.popleft())
            if self._out_bytes > NODE_UNREAD_BYTES:
                self.flush()
            if items and time.monotonic() > until_s:
                asyncio.get_running_loop().call_soon(self._work)
                break
        if not items:
            self._items = _NOTHING
        self.flush()
        if self.transport is None:
            return
        if self._looking or (items and not self._paused):
            self.transport.pause_reading()
        elif not self._paused:
            self.transport.resume_reading()

    # ── sending ────────────────────────────────────────────────────────────────────────────────────────────────

    def end(self) -> None:
        """Send what was collected, and close the connection; what came and was not answered is dropped."""
        self._items.clear()
        self.flush()
        if self.transport is not None:
            self.transport.close()

    def flush(self) -> None:
        """Send what was collected, in one write."""
        self._scheduled = False
        if self._out and self.transport is not None and not self.transport.is_closing():
            data = b"".join(self._out)
            self.transport.write(data)
            self._flow.sent(len(data))
        self._out.clear()
        self._out_bytes = 0

    def _send(self, raw: bytes) -> None:
        self._out.append(raw)
        self._out_bytes += len(raw)
        if not self._scheduled:
            self._scheduled = True
            asyncio.get_running_loop().call_soon(self.flush)
