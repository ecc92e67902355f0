"""Receives what one publisher sends: asks for its keys, opens its packets, and recovers what is missing."""

from __future__ import annotations

import asyncio
import logging
import os
import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Final, Protocol

from ropeway.errors import CallError, RopewayError, SealError
from ropeway.limits import OVERLAY_BATCH_BYTES, OVERLAY_HELD_BYTES_PER_PUBLISHER, OVERLAY_HISTORY_BYTES
from ropeway.networks.overlay.advert import Advertisement
from ropeway.networks.overlay.arrivals import Arrivals, Way
from ropeway.networks.overlay.crypto.certificate import Certificate
from ropeway.networks.overlay.crypto.seal import Grant, Opened, Opener, peek
from ropeway.networks.overlay.crypto.session_proof import SECRET_BYTES
from ropeway.networks.overlay.data_plane import DataPlane
from ropeway.networks.overlay.follower import Follower
from ropeway.networks.overlay.held_bytes import HeldBytes
from ropeway.networks.overlay.packet_assembly import PacketAssembly
from ropeway.networks.overlay.packet_item import PacketItem, read_items, read_packet
from ropeway.networks.overlay.packet_mark import Mark
from ropeway.networks.overlay.receipts import Receipts
from ropeway.networks.overlay.refusal import Refusal
from ropeway.networks.overlay.rpc import RemoteError, Rpc
from ropeway.tasks import Chores, background, describe, end

__all__ = ["FeedReader", "PublisherStream", "StreamHost"]

log = logging.getLogger("ropeway.overlay")

_ASK_S: Final = 2.0
_BRING_S: Final = (2.0, 10.0, 60.0)  # an answer may get lost, and another one has 64 MB to bring over a slow link
_AGAIN_S: Final = 1.0
_CATCH_UP_S: Final = 0.5  # later a gap has shown
_SPACING_S: Final = 0.5  # between two requests for keys: packets that name keys nobody has cost no more than that
_REMEMBERED: Final = 4096
_SEALED_BYTES: Final = OVERLAY_BATCH_BYTES  # what a packet may have beside its largest message


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


class StreamHost(Protocol):
    """The reading side of a name, as a stream of one of its publishers knows it."""

    limit_bytes: int
    held: HeldBytes
    fabric: DataPlane
    sessions: bool
    rpc: Rpc
    receipts: Receipts
    refused: Callable[[str, SealError], None]
    denied: Callable[[Advertisement, str], None]
    missed: int
    copies: int
    had: dict[tuple[bytes, bytes], int]


class PublisherStream:
    """Receives what one publisher sends us."""

    def __init__(self, feed: StreamHost, advert: Advertisement, certificate: Certificate) -> None:
        self.advert, self.certificate = advert, certificate
        self.lock = threading.Lock()
        self._secret = os.urandom(SECRET_BYTES) if feed.sessions else b""
        self.opener = Opener(advert.global_name, advert.endpoint, certificate.verify_signature, secret=self._secret)
        self.readers: dict[FeedReader, Follower | None] = {}
        self._feed = feed
        self._held: deque[tuple[bytes, Way]] = deque()
        self._held_bytes = 0
        self._epoch = -1
        self._granted_at = float("-inf")
        self._keying: asyncio.Task[None] | None = None
        self._recovering = Chores()
        self._catching_up = False
        self._arrivals: Arrivals | None = None
        self._parts: dict[Way, PacketAssembly] = {}

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
                    request = self._request([reader.endpoint for reader in waiting])
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

    def _request(self, endpoints: Sequence[bytes]) -> dict[str, Any]:
        """Return the request for keys for subscriptions and, unless we want signatures, for proofs to us alone."""
        request: dict[str, Any] = {"op": "key", "of": self.advert.endpoint, "for": endpoints}
        return request | {"by": self._feed.fabric.gateway, "session": self._secret} if self._secret else request

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
        for raw, way in self._let_go():
            self.take(raw, way, hold=False)

    def _let_go(self) -> deque[tuple[bytes, Way]]:
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

    def catch_up(self) -> None:
        """Ask for what may have been lost on its way, before a gap shows, if a reader wants what is lost."""
        last = [f.last for f in self.readers.values() if f is not None and f.reliable and f.missing is None]
        if last and not self._catching_up:
            self._catching_up = True
            self._recovering.start(self._catch_up(min(last)), f"latest of {self.advert.name}")

    async def _catch_up(self, after: int) -> None:
        request = {"op": "history", "of": self.advert.endpoint, "after": after, "upto": None}
        try:
            answer = await self._feed.rpc.ask(self.advert.gateway, request, _CATCH_UP_S)
            self.opened(self._epoch, read_items(_history(answer), self._feed.limit_bytes, OVERLAY_HISTORY_BYTES))
        except SealError as error:
            self._feed.refused(self.certificate.name, error)
        except RopewayError as error:  # then a gap shows
            log.debug("overlay: the latest of %s does not come: %s", self.advert.name, error)
        finally:
            self._catching_up = False

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

    def take(self, raw: bytes, way: Way, *, hold: bool = True) -> None:
        """Take a packet that could not be opened when it came, on the loop; it may wait for a key, once."""
        try:
            with self.lock:
                if hold and not self.opener.knows(raw):
                    self._hold(raw, way)
                    return
                opened = self.open(raw, way)
            if opened is not None:
                self.opened(opened.epoch, read_packet(opened.plain, opened.spans, self._feed.limit_bytes))
        except SealError as error:
            self.refused(error)

    def _hold(self, raw: bytes, way: Way) -> None:
        if self._held_bytes + len(raw) > OVERLAY_HELD_BYTES_PER_PUBLISHER or not self._feed.held.take(len(raw)):
            self._feed.refused(self.certificate.name, SealError(Refusal.NO_KEY, self.advert.name))
        else:
            self._held.append((raw, way))
            self._held_bytes += len(raw)
        self.want_key()

    def open(self, raw: bytes, way: Way) -> Opened | None:
        """Open a packet, with the lock held; return ``None`` for a copy of one that came by another way.

        Raises ``SealError`` for one that is not believed, a replay among them.
        """
        if self._arrivals is None:
            self._arrivals = Arrivals(self.opener.floor)
        try:
            opened = self.opener.open(raw)
        except SealError as error:
            if error.reason not in (Refusal.REPLAYED, Refusal.TOO_OLD):
                raise
            head = peek(raw)
            if not self._arrivals.is_copy(way, head.first, head.messages):
                raise
            self._feed.copies += 1
            return None
        self._arrivals.came(way, opened.first, len(opened.spans))
        return opened

    def assemble(self, mark: Mark, raw: bytes, way: Way) -> bytes | None:
        """Return the packet that a part completes, ``None`` until then; with the lock held."""
        parts = self._parts.get(way)
        if parts is None:
            parts = self._parts[way] = PacketAssembly(self._feed.limit_bytes + _SEALED_BYTES, self._feed.held)
        return parts.take(mark, raw)

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

    def refused(self, error: SealError) -> None:
        """Count a packet that is not believed; where it is proven to others, the publisher has lost sight of us."""
        self._feed.refused(self.certificate.name, error)
        if error.reason is Refusal.UNPROVEN:
            self.want_key()

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
            for parts in self._parts.values():
                parts.drop()
        for reader in list(self.readers):
            self.leave(reader)


def _history(answer: Any) -> list[bytes]:
    if not isinstance(answer, list) or any(type(raw) is not bytes for raw in answer):
        raise SealError(Refusal.MALFORMED, "a history")
    return answer
