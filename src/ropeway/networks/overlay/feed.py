"""The reading side of one global name: each message of its publishers is opened once and given to every reader here.

Packets are opened in Zenoh's own thread, so that a link is read no faster than its data can be checked. A packet whose
key is not here yet waits, within bounds, while the key is asked for.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Protocol

import zenoh

from ropeway.errors import CallError, RopewayError, SealError
from ropeway.graph.inlet import Inlet
from ropeway.limits import (
    OVERLAY_BATCH_BYTES,
    OVERLAY_COPY_BYTES,
    OVERLAY_HELD_BYTES_PER_PUBLISHER,
    OVERLAY_HISTORY_BYTES,
    OVERLAY_MESSAGE_BYTES,
    OVERLAY_WAITING_BYTES,
)
from ropeway.networks.overlay.advert import Advertisement
from ropeway.networks.overlay.crypto.certificate import Certificate
from ropeway.networks.overlay.crypto.seal import Grant, Opener
from ropeway.networks.overlay.data_key import data_key, publisher_of
from ropeway.networks.overlay.fabric import Fabric, Handle
from ropeway.networks.overlay.follower import Follower
from ropeway.networks.overlay.held_bytes import HeldBytes
from ropeway.networks.overlay.packet_assembly import PacketAssembly
from ropeway.networks.overlay.packet_item import PacketItem, read_item, read_items
from ropeway.networks.overlay.packet_mark import Mark
from ropeway.networks.overlay.receipts import Receipts
from ropeway.networks.overlay.refusal import Refusal
from ropeway.networks.overlay.rpc import RemoteError, Rpc
from ropeway.tasks import Chores, background, describe, end

__all__ = ["Feed", "FeedReader", "PublisherStream", "read_item"]

log = logging.getLogger("ropeway.overlay")

_ASK_S: Final = 2.0
_BRING_S: Final = (2.0, 10.0, 60.0)  # an answer may get lost, and another one has 64 MB to bring over a slow link
_AGAIN_S: Final = 1.0
_SPACING_S: Final = 0.5  # between two requests for keys: packets that name keys nobody has cost no more than that
_REMEMBERED: Final = 4096
_COPIES: Final = 256  # of one publisher: half a second of 500 messages a second
_SEALED_BYTES: Final = OVERLAY_BATCH_BYTES  # what a packet may have beside its largest message
_ITEM_BYTES: Final = 256  # what a message costs beside its payload


class FeedReader(Protocol):
    """Reads a name here."""

    endpoint: bytes

    @property
    def reliable(self) -> bool:
        """Whether gaps are requested again."""

    @property
    def history(self) -> bool:
        """Whether earlier messages are wanted."""

    def joined(self, stream: PublisherStream) -> None:
        """Note that a publisher has given its key."""

    def received(self, stream: PublisherStream, items: Sequence[PacketItem]) -> None:
        """Take messages, in order."""

    def overrun(self, count: int) -> None:
        """Count messages that were lost because the event loop was behind."""


class PublisherStream:
    """Receives what one publisher sends us."""

    def __init__(self, feed: Feed, advert: Advertisement, certificate: Certificate) -> None:
        self.advert, self.certificate = advert, certificate
        self.lock = threading.Lock()
        self.opener = Opener(advert.global_name, advert.endpoint, certificate.verify_signature)
        self.readers: dict[FeedReader, Follower | None] = {}
        self._feed = feed
        self._held: deque[bytes] = deque()
        self._held_bytes = 0
        self._epoch = -1
        self._granted_at = float("-inf")
        self._keying: asyncio.Task[None] | None = None
        self._recovering = Chores()
        self._copies: dict[bytes, None] = {}  # packets that came by the bypass, and will come by the links
        self.parts = PacketAssembly(feed.limit_bytes + _SEALED_BYTES, feed.held)

    # ── keys ───────────────────────────────────────────────────────────────────────────────────────────────────

    def want_key(self) -> None:
        """Ask the publisher for its keys, until it gives or refuses them."""
        if self._keying is None:
            self._keying = background(self._ask_key(), f"key of {self.advert.name}")

    async def _ask_key(self) -> None:
        feed, loop = self._feed, asyncio.get_running_loop()
        try:
            while True:
                await asyncio.sleep(max(self._granted_at + _SPACING_S - loop.time(), 0.0))
                try:
                    waiting = [reader for reader, follower in self.readers.items() if follower is None]
                    request = {"op": "key", "of": self.advert.endpoint, "for": [r.endpoint for r in waiting]}
                    self._granted(await feed.rpc.ask(self.advert.gateway, request, _ASK_S), waiting)
                    if None not in self.readers.values():
                        return
                    self._granted_at = float("-inf")  # who came meanwhile need not wait
                    continue
                except SealError as error:
                    feed.refused(self.certificate.name, error)
                except RemoteError as error:
                    if error.word == "SealError":
                        feed.denied(self.advert, error.text)
                        await asyncio.sleep(10 * _AGAIN_S)
                        continue
                except CallError as error:
                    log.debug("overlay: no key of %s yet: %s", self.advert.name, error)
                except Exception as error:  # of a reader's callback, or of ours: the others want their keys, too
                    log.debug("overlay: a grant of %s cannot be used", self.advert.name, exc_info=error)
                    unforeseen = SealError(Refusal.MALFORMED, f"a grant ({describe(error)})")
                    feed.refused(self.certificate.name, unforeseen)
                await asyncio.sleep(_AGAIN_S)
        finally:
            self._keying = None

    def _granted(self, answer: Any, waiting: Sequence[FeedReader]) -> None:
        if not isinstance(answer, dict) or type(answer.get("n")) is not int or type(answer.get("g")) is not bytes:
            raise SealError(Refusal.MALFORMED, "a grant")
        grant = Grant.from_cbor(answer["g"])
        with self.lock:
            self.opener.add(grant)
        self._epoch = grant.current.epoch
        self._feed.receipts.introduce(self.advert.gateway)
        for reader in waiting:
            if reader in self.readers:
                self._follow(reader, answer["n"])
        self._granted_at = asyncio.get_running_loop().time()
        for raw in self._let_go():
            self.take(raw, hold=False)

    def _let_go(self) -> deque[bytes]:
        """Hold nothing for a key any more; return what was held."""
        held, self._held = self._held, deque()
        self._feed.held.give(self._held_bytes)
        self._held_bytes = 0
        return held

    # ── readers ────────────────────────────────────────────────────────────────────────────────────────────────

    def reads(self, reader: FeedReader) -> bool:
        """Return whether a reader gets what comes."""
        return self.readers.get(reader) is not None

    def join(self, reader: FeedReader) -> None:
        """Add a reader, from what the publisher sends once it knows of this reader."""
        if reader not in self.readers:
            self.readers[reader] = None
            self._granted_at = float("-inf")
            self.want_key()

    def _follow(self, reader: FeedReader, newest: int) -> None:
        qos = self.advert.qos
        reliable = reader.reliable and (qos is None or qos.reliable)
        had = self._feed.had.pop((reader.endpoint, self.advert.endpoint), None)
        if had is not None and reliable:  # it read this publisher before a cut
            follower = Follower(reliable=True, history=False, start=min(had, newest), held=self._feed.held)
            follower.told(newest)
        else:
            latched = qos is not None and qos.transient_local and not self.advert.target
            history = reader.history and latched
            follower = Follower(reliable=reliable, history=history, start=newest, held=self._feed.held)
        self.readers[reader] = follower
        reader.joined(self)
        self._recover(reader, follower)

    def _recover(self, reader: FeedReader, follower: Follower) -> None:
        if follower.missing is not None and not follower.asked:
            follower.asked = True
            self._recovering.start(self._ask_missing(reader, follower), f"missing of {self.advert.name}")

    async def _ask_missing(self, reader: FeedReader, follower: Follower) -> None:
        assert follower.missing is not None
        after, upto = follower.missing
        request = {"op": "history", "of": self.advert.endpoint, "after": after, "upto": upto}
        items: list[PacketItem] = []
        for bring_s in _BRING_S:
            try:
                answer = await self._feed.rpc.ask(self.advert.gateway, request, bring_s, lane=4)
                items = read_items(_history(answer), self._feed.limit_bytes, OVERLAY_HISTORY_BYTES)
                break
            except SealError as error:
                self._feed.refused(self.certificate.name, error)
                break
            except RopewayError as error:
                log.debug("overlay: missing messages of %s cannot be recovered: %s", self.advert.name, error)
                if bring_s < _BRING_S[-1]:
                    await asyncio.sleep(_AGAIN_S)
        if self.readers.get(reader) is follower:
            self._give(reader, follower.recovered(items))
            self._recover(reader, follower)

    def leave(self, reader: FeedReader) -> None:
        """Remove a reader."""
        follower = self.readers.pop(reader, None)
        if follower is not None:
            follower.forget()

    def remember(self) -> None:
        """Keep in mind what each reader had: the publisher may come back."""
        for reader, follower in self.readers.items():
            if follower is not None:
                self._feed.had[reader.endpoint, self.advert.endpoint] = follower.last
        while len(self._feed.had) > _REMEMBERED:
            del self._feed.had[next(iter(self._feed.had))]

    def told(self, newest: int) -> None:
        """Take the number of the publisher's newest message."""
        for reader, follower in self.readers.items():
            if follower is not None:
                follower.told(newest)
                self._recover(reader, follower)

    # ── data ───────────────────────────────────────────────────────────────────────────────────────────────────

    def take(self, raw: bytes, *, hold: bool = True) -> None:
        """Take a packet that could not be opened when it came, on the loop; it may wait for a key, once. It may wait
        for a key, once.
        """
        try:
            with self.lock:
                if hold and not self.opener.knows(raw):
                    self._hold(raw)
                    return
                opened = self.opener.open(raw)
            self.opened(opened.epoch, read_items(opened.items, self._feed.limit_bytes))
        except SealError as error:
            self._feed.refused(self.certificate.name, error)

    def _hold(self, raw: bytes) -> None:
        if self._held_bytes + len(raw) > OVERLAY_HELD_BYTES_PER_PUBLISHER or not self._feed.held.take(len(raw)):
            self._feed.refused(self.certificate.name, SealError(Refusal.NO_KEY, self.advert.name))
        else:
            self._held.append(raw)
            self._held_bytes += len(raw)
        self.want_key()

    def opened(self, epoch: int, items: Sequence[PacketItem]) -> None:
        """Take messages that were checked."""
        if epoch != self._epoch:  # the next key is in use: the one after it is wanted
            self._epoch = epoch
            self.want_key()
        for reader, follower in list(self.readers.items()):
            if follower is None:
                continue
            lost = follower.lost
            self._give(reader, follower.arrived(items))
            if follower.missing is not None:
                self._recover(reader, follower)
            elif follower.lost != lost:
                self._feed.missed += follower.lost - lost

    def note_copy(self, packet: bytes) -> None:
        """Note that a packet came by the bypass; in Zenoh's thread."""
        self._copies[packet] = None
        if len(self._copies) > _COPIES:
            del self._copies[next(iter(self._copies))]

    def came_as_copy(self, packet: bytes) -> bool:
        """Return whether a packet came by the bypass; the next time it is a replay."""
        if not self._copies or len(packet) > OVERLAY_COPY_BYTES or packet not in self._copies:
            return False
        del self._copies[packet]
        return True

    def overrun(self, count: int) -> None:
        """Count messages that were lost because the event loop was behind."""
        for reader in list(self.readers):
            reader.overrun(count)

    def _give(self, reader: FeedReader, items: Sequence[PacketItem]) -> None:
        if items:
            reader.received(self, items)

    async def close(self) -> None:
        """Ask for nothing more, and hold nothing."""
        await end(self._keying)
        await self._recovering.close()
        self._let_go()
        with self.lock:
            self.parts.drop()
        for reader in list(self.readers):
            self.leave(reader)


_Came = tuple[PublisherStream, bytes | SealError | tuple[int, list[PacketItem]]]


class Feed:
    """Reads one name. ``refused`` is told of each packet that is not believed.

    A message may have ``limit_bytes``; what waits is taken from the budget ``held``.
    """

    def __init__(
        self,
        fabric: Fabric,
        rpc: Rpc,
        receipts: Receipts,
        name: bytes,
        refused: Callable[[str, SealError], None],
        denied: Callable[[Advertisement, str], None],
        *,
        limit_bytes: int = OVERLAY_MESSAGE_BYTES,
        held: HeldBytes | None = None,
    ) -> None:
        self.limit_bytes, self.held = limit_bytes, held or HeldBytes()
        self.fabric, self.rpc, self.receipts, self.name = fabric, rpc, receipts, name
        self.refused, self.denied = refused, denied
        self.missed = 0
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

    def came(self, key: str, payload: zenoh.ZBytes, attachment: zenoh.ZBytes | None) -> None:
        """Take a packet; runs in Zenoh's thread."""
        stream = self.streams.get(publisher_of(key))
        if stream is None or not stream.readers:
            return
        mark = Mark.read(bytes(attachment)) if attachment is not None else None
        if mark is not None:
            self.receipts.came(stream.advert.gateway, mark)
        self._open(stream, bytes(payload), mark)

    def copy_came(self, endpoint: bytes, packet: bytes) -> None:
        """Take a copy of a publisher's packet that came another way; runs in Zenoh's thread."""
        stream = self.streams.get(endpoint)
        if stream is not None and stream.readers:
            self._open(stream, packet, None, copy=True)

    def _open(self, stream: PublisherStream, raw: bytes, mark: Mark | None, *, copy: bool = False) -> None:
        """Open a packet and hand its messages over, in the order in which they were opened, whoever else opens some."""
        try:
            with stream.lock:
                if mark is not None and mark.size:
                    packet = stream.parts.take(mark, raw)
                    if packet is None:
                        return
                    raw = packet
                if not copy and stream.came_as_copy(raw):
                    return
                if not stream.opener.knows(raw):
                    if not copy:
                        self._inlet.put((stream, raw), len(raw))
                    return
                opened = stream.opener.open(raw)
                if copy:
                    stream.note_copy(raw)
                items = read_items(opened.items, self.limit_bytes)
                size = sum(len(item.payload) for item in items) + _ITEM_BYTES * len(items)
                self._inlet.put((stream, (opened.epoch, items)), size)
        except SealError as error:
            if not copy or error.reason not in (Refusal.REPLAYED, Refusal.TOO_OLD):  # the other one came first
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
                self.refused(stream.certificate.name, what)
            elif isinstance(what, bytes):
                stream.take(what)
            else:
                epoch, items = what
                while at < len(batch) and batch[at][0] is stream and isinstance(batch[at][1], tuple):
                    following = batch[at][1]
                    assert isinstance(following, tuple)
                    if following[0] != epoch:
                        break
                    items += following[1]
                    at += 1
                stream.opened(epoch, items)

    def _overrun(self, lost: _Came) -> None:
        """Count a loss; runs in the thread that put something."""
        stream, what = lost
        count = len(what[1]) if isinstance(what, tuple) else 1
        with contextlib.suppress(RuntimeError):  # the loop has closed
            self._loop.call_soon_threadsafe(stream.overrun, count)


def _history(answer: Any) -> list[bytes]:
    if not isinstance(answer, list) or any(type(raw) is not bytes for raw in answer):
        raise SealError(Refusal.MALFORMED, "a history")
    return answer
