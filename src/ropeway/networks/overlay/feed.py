"""The reading side of one global name: each message of its publishers is opened once and given to every reader here.

Packets are opened in Zenoh's own thread, so that a link is read no faster than its data can be checked. A packet whose
key is not here yet waits, within bounds, while the key is asked for.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

import zenoh

from ropeway.errors import SealError
from ropeway.graph.inlet import Inlet
from ropeway.limits import (
    OVERLAY_MESSAGE_BYTES,
    OVERLAY_WAITING_BYTES,
)
from ropeway.networks.overlay.advert import Advertisement
from ropeway.networks.overlay.arrivals import BYPASS, Way
from ropeway.networks.overlay.crypto.certificate import Certificate
from ropeway.networks.overlay.data_key import data_key, publisher_of
from ropeway.networks.overlay.data_plane import DataPlane, Handle
from ropeway.networks.overlay.held_bytes import HeldBytes
from ropeway.networks.overlay.packet_item import PacketItem, read_packet
from ropeway.networks.overlay.packet_mark import Mark
from ropeway.networks.overlay.publisher_stream import FeedReader, PublisherStream
from ropeway.networks.overlay.receipts import Receipts
from ropeway.networks.overlay.refusal import Refusal
from ropeway.networks.overlay.rpc import Rpc
from ropeway.tasks import Chores, describe

__all__ = ["Feed", "catch_up"]

log = logging.getLogger("ropeway.overlay")

_ITEM_BYTES: Final = 256  # what a message costs beside its payload


class _Opened(NamedTuple):
    """Messages of one publisher, and the epoch of the key that they were sealed with."""

    epoch: int
    items: list[PacketItem]


class _Sealed(NamedTuple):
    """A packet whose key is not here, and by which way it came."""

    raw: bytes
    way: Way


_Came = tuple[PublisherStream, _Sealed | SealError | _Opened]


class Feed:
    """Reads one name. ``refused`` is told of each packet that is not believed.

    A message may have ``limit_bytes``; what waits is taken from the budget ``held``. ``ways`` tells by how many ways a
    gateway sends; what comes by more is no copy. With ``sessions`` publishers need not sign for us.
    """

    def __init__(
        self,
        fabric: DataPlane,
        rpc: Rpc,
        receipts: Receipts,
        name: bytes,
        refused: Callable[[str, SealError], None],
        denied: Callable[[Advertisement, str], None],
        *,
        limit_bytes: int = OVERLAY_MESSAGE_BYTES,
        held: HeldBytes | None = None,
        ways: Callable[[bytes], int] = lambda _: 1,
        sessions: bool = False,
    ) -> None:
        self.limit_bytes, self.held = limit_bytes, held or HeldBytes()
        self.fabric, self.rpc, self.receipts, self.name = fabric, rpc, receipts, name
        self.refused, self.denied = refused, denied
        self.missed = self.copies = 0
        self._ways, self.sessions = ways, sessions
        self.had: dict[tuple[bytes, bytes], int] = {}
        self.readers: list[FeedReader] = []
        self.streams: dict[bytes, PublisherStream] = {}
        self._inlet: Inlet[_Came]
        self._end: Handle | None = None
        self._closing = Chores()

    def open(self, loop: asyncio.AbstractEventLoop) -> None:
        """Read from now on."""
        self._loop = loop
        self._inlet = Inlet(loop, self._deliver, limit_bytes=OVERLAY_WAITING_BYTES, on_lost=self._overrun)
        self._end = self.fabric.subscribe(data_key(self.name), self.came)

    async def close(self) -> None:
        """Stop reading."""
        self._inlet.closed = True
        if self._end is not None:
            self._end()
        for stream in self.streams.values():
            await stream.close()
        self.streams.clear()
        await self._closing.close()

    def follow(self, adverts: Mapping[bytes, tuple[Advertisement, Certificate]]) -> None:
        """Follow these publishers and no others."""
        for endpoint in [*self.streams.keys() - adverts.keys()]:
            stream = self.streams.pop(endpoint)
            stream.remember()
            self._closing.start(stream.close(), "end of a stream")
        for endpoint, (advert, certificate) in adverts.items():
            if endpoint not in self.streams:
                self.streams[endpoint] = PublisherStream(self, advert, certificate)

    def came(self, key: str, payload: zenoh.ZBytes, attachment: zenoh.ZBytes | None, session: int) -> None:
        """Take a packet that came by one of our sessions; runs in Zenoh's thread."""
        stream = self.streams.get(publisher_of(key))
        if stream is None or not stream.readers:
            return
        mark = Mark.read(bytes(attachment)) if attachment is not None else None
        sent_by = 0
        if mark is not None:
            self.receipts.came(stream.advert.gateway, mark)
            sent_by = mark.way if mark.way < self._ways(stream.advert.gateway) else 0
        self._open(stream, bytes(payload), mark, (session, sent_by))

    def copy_came(self, endpoint: bytes, packet: bytes) -> None:
        """Take a copy of a publisher's packet that came by the bypass; runs in Zenoh's thread."""
        stream = self.streams.get(endpoint)
        if stream is not None and stream.readers:
            self._open(stream, packet, None, BYPASS)

    def _open(self, stream: PublisherStream, raw: bytes, mark: Mark | None, way: Way) -> None:
        """Open a packet and hand its messages over, in the order in which they were opened, whoever else opens some."""
        bypass = way == BYPASS
        try:
            with stream.lock:
                if mark is not None and mark.size:
                    packet = stream.assemble(mark, raw, way)
                    if packet is None:
                        return
                    raw = packet
                if not stream.opener.knows(raw):
                    if not bypass:
                        self._inlet.put((stream, _Sealed(raw, way)), len(raw))
                    return
                opened = stream.open(raw, way)
                if opened is None:
                    return
                items = read_packet(opened.plain, opened.spans, self.limit_bytes)
                size = sum(len(item.payload) for item in items) + _ITEM_BYTES * len(items)
                self._inlet.put((stream, _Opened(opened.epoch, items)), size)
        except SealError as error:
            if not bypass or error.reason not in (Refusal.REPLAYED, Refusal.TOO_OLD):  # its router may repeat it
                self._inlet.put((stream, error))
        except Exception as error:  # Zenoh's thread would end with it, and nobody would see why
            log.debug("overlay: a packet of %s cannot be used", stream.advert.name, exc_info=error)
            self._inlet.put((stream, SealError(Refusal.MALFORMED, describe(error))))

    def _deliver(self, batch: list[_Came]) -> None:
        at = 0
        while at < len(batch):
            stream, what = batch[at]
            at += 1
            if isinstance(what, SealError):
                stream.refused(what)
            elif isinstance(what, _Sealed):
                stream.take(what.raw, what.way)
            else:
                epoch, items = what
                while at < len(batch) and batch[at][0] is stream and isinstance(batch[at][1], _Opened):
                    following = batch[at][1]
                    assert isinstance(following, _Opened)
                    if following.epoch != epoch:
                        break
                    items += following.items
                    at += 1
                stream.opened(epoch, items)

    def _overrun(self, lost: _Came) -> None:
        """Count a loss; runs in the thread that put something."""
        stream, what = lost
        count = len(what.items) if isinstance(what, _Opened) else 1
        with contextlib.suppress(RuntimeError):  # the loop has closed
            self._loop.call_soon_threadsafe(stream.overrun, count)


def catch_up(feeds: Mapping[bytes, Feed]) -> None:
    """Ask the publishers of all names for what may have been lost on its way."""
    for feed in feeds.values():
        for stream in feed.streams.values():
            stream.catch_up()
