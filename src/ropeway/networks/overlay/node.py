"""Runs a member of the overlay in this process: its session, its identity, and what it knows of the others.

Several graphs may share a node (remotes of one gateway that differ in their metadata). The node itself knows no
topics: publishers register their ``PublisherSource``, services their ``Provider``, and readers a ``Feed``.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, Protocol

from ropeway import aio
from ropeway.errors import CallFailed, IdentityError, NotServed, RopewayError, SealError
from ropeway.limits import OVERLAY_CRL_BYTES, OVERLAY_MESSAGE_BYTES
from ropeway.networks.overlay.advert import VERB_OF, Advertisement, advert_key, make_advert
from ropeway.networks.overlay.asked import Asked
from ropeway.networks.overlay.askers import Askers
from ropeway.networks.overlay.bypass import Bypass
from ropeway.networks.overlay.crypto.certificate import Certificate
from ropeway.networks.overlay.crypto.identity import Identity
from ropeway.networks.overlay.crypto.trust import Trust
from ropeway.networks.overlay.data_key import data_key, name_of
from ropeway.networks.overlay.data_plane import CRL_KEY, Handle
from ropeway.networks.overlay.feed import Feed, catch_up
from ropeway.networks.overlay.held_bytes import HeldBytes
from ropeway.networks.overlay.links import Links
from ropeway.networks.overlay.membership import Membership
from ropeway.networks.overlay.publisher_source import PublisherSource
from ropeway.networks.overlay.reader_proofs import offered
from ropeway.networks.overlay.receipts import Receipts
from ropeway.networks.overlay.refusal import Refusal
from ropeway.networks.overlay.report import member_report
from ropeway.networks.overlay.rib import Rib
from ropeway.networks.overlay.rpc import Rpc, part
from ropeway.networks.overlay.states import States
from ropeway.networks.overlay.zenoh_config import gateway_id
from ropeway.tasks import Supervised, end

if TYPE_CHECKING:
    import zenoh

__all__ = ["OverlayNode", "Policy", "Provider", "new_endpoint"]

log = logging.getLogger("ropeway.overlay")

_CHECK_S: Final = 5.0
_ASK_CRL_S: Final = 20.0
_ACTIVE_S: Final = 15.0
_FIRST_PAUSES_S: Final = (0.0, 0.02, 0.05, 0.1, 0.2)
_REFUSALS: Final = 1024  # kinds of them that are told apart
_CRLS: Final = 4  # of the largest size that are looked at

Policy = Callable[[str, str, Certificate], bool]
"""Whether ``(verb, ROS name, certificate)`` is allowed here, beyond what the certificate says."""


class Provider(Protocol):
    """A service that is served here."""

    endpoint: bytes

    async def answer_remote(self, caller: Certificate, request: Mapping[str, Any]) -> Any:
        """Answer a call."""


def new_endpoint() -> bytes:
    """Return 16 random bytes that name a publisher, a subscription, a service or a client."""
    return os.urandom(16)


class OverlayNode:
    """A member: ``identity`` is its bundle.

    ``routers`` and ``listen`` are Zenoh endpoints (``tls/host:7447``); left out, the routers are those of the bundle,
    and direct links are taken on every interface at a free port, with mutual authentication as everywhere. Routers are
    dialled by the first of ``interfaces`` (names of network interfaces), and by the others once that fails; with
    ``links`` (``best`` or ``duplicate``) by all of them at once. ``policy`` is asked beyond certificates. ``rotate_s``:
    content keys serve so long. ``max_message_bytes``: what a message that is read may have, unpacked. ``sessions``:
    packets may be proven to each reader alone, not signed. ``clock_ns`` is the clock of this machine, for others.
    """

    def __init__(
        self,
        identity: Identity,
        *,
        routers: Sequence[str] | None = None,
        listen: Sequence[str] = ("tls/0.0.0.0:0",),
        interfaces: Sequence[str] = (),
        links: str | None = None,
        policy: Policy | None = None,
        rotate_s: float = 600.0,
        max_message_bytes: int = OVERLAY_MESSAGE_BYTES,
        sessions: bool = False,
        clock_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        if identity.name_secret is None:
            raise IdentityError(identity.name, "it is a router, which reads and writes nothing; take a member's bundle")
        self.identity = identity
        self.trust = Trust(identity.ca, identity.crl)
        self.secret = identity.name_secret
        self.gateway = gateway_id()
        self.routers, self.listen = tuple(identity.routers if routers is None else routers), tuple(listen)
        self.rotate_s, self.max_message_bytes, self.sessions = rotate_s, max_message_bytes, sessions
        self.held = HeldBytes()
        self.refusals: Counter[tuple[str, Refusal]] = Counter()
        self.denials: dict[str, str] = {}
        self.closed = False  # its last user has left: it is not opened again
        self.trouble = ""  # why others refuse us
        self.policy = policy or (lambda verb, name, certificate: True)
        self.links = Links(
            identity, self.trust, self.gateway, self.routers, self.listen, max_message_bytes, interfaces, links=links
        )
        self.fabric = self.links.fabric
        self.rib = Rib(self.secret, refused=self.refused)
        self.rpc = Rpc(self.fabric, identity, self.trust, self.refused)
        self.membership = Membership(
            self.fabric,
            identity,
            self.trust,
            self.rib,
            ask_list=lambda gateway, timeout_s: self.rpc.ask(gateway, {"op": "list"}, timeout_s),
            tails=self._tails,
            on_tails=self._on_tails,
            on_newer_crl=lambda: self._ask_crl.set(),
            on_gone=self._gone,
            refused=self.refused,
            ways=max(len(self.links.at_once), 1),
            clock_ns=clock_ns,
        )
        self.receipts = Receipts(self.fabric, self.rpc, self.membership.certificate, self.refused)
        self.states = States(self.rpc)
        copied_by = () if self.links.at_once else self.routers  # several links carry small messages well enough
        self.bypass = Bypass(self.fabric, self.links.client_config, copied_by, self._copy_came)
        self.sources: dict[bytes, PublisherSource] = {}
        self.askers: dict[str, Askers] = {}
        self.on_granted: dict[bytes, Callable[[Sequence[bytes]], None]] = {}
        self.providers: dict[bytes, Provider] = {}
        self.feeds: dict[bytes, Feed] = {}
        self.links.on_doubt = lambda: catch_up(self.feeds)
        self._advert_key = advert_key(self.secret)
        self._ends: list[Handle] = []
        self._checking: Supervised | None = None
        self._ask_crl = asyncio.Event()
        self._opened = 0
        self._opening = asyncio.Lock()

    # ── life ───────────────────────────────────────────────────────────────────────────────────────────────────

    async def open(self) -> None:
        """Join the overlay, or add a user of it here. Raises ``IdentityError`` or ``GraphUnavailable``."""
        async with self._opening:
            if not self._opened:
                self.trust.check(self.identity.certificate.der)
                await self.fabric.open()
                self.rpc.answers("key", self._answer_key)
                self.rpc.answers("history", self._answer_history)
                self.rpc.answers("call", self._answer_call)
                self.rpc.answers("ping", self._answer_ping)
                self.rpc.answers("list", self._answer_list)
                self._ends.append(self.links.answer_probes())
                self.states.open()
                self.rpc.open()
                self.receipts.open()
                self.bypass.open()
                self._ends.append(self.fabric.serve(CRL_KEY, self._tell_crl))
                self._ends.append(self.fabric.subscribe(data_key(target=self.gateway), self._aimed_came))
                take = self.fabric.hear(CRL_KEY, lambda _, raw: self._take_crl(raw), limit_bytes=OVERLAY_CRL_BYTES)
                self._ends.append(take)
                if await self.links.first():
                    await self._learn_first()
                await self.membership.open()
                self._checking = Supervised(self._keep_checking, "overlay checks").start()
                self.links.watch()
            self._opened += 1

    async def close(self) -> None:
        """Remove a user; the last one leaves the overlay."""
        async with self._opening:
            self._opened = max(self._opened - 1, 0)
            if self._opened or self._checking is None:
                return
            await end(self._checking)
            self._checking = None
            self.closed = True
            await self.links.close()
            for feed in list(self.feeds.values()):
                await feed.close()
            self.feeds.clear()
            await self.membership.close()
            await self.bypass.close()
            await self.receipts.close()
            await self.states.close()
            await self.rpc.close()
            for handle in self._ends:
                handle()
            self._ends.clear()
            await self.fabric.close()

    async def _keep_checking(self) -> None:
        """Ask for revocations, now and then and when somebody has newer ones; see who lost its right meanwhile."""
        loop = asyncio.get_running_loop()
        asked = float("-inf")
        while True:
            if self._ask_crl.is_set() or loop.time() - asked > _ASK_CRL_S:
                self._ask_crl.clear()
                asked = loop.time()
                await self._ask_for_crl()
            self.recheck()
            await self.links.deny()
            self.links.in_company(len(self.membership.gateways()))
            await self.links.mend(self.membership.unreachable())
            with contextlib.suppress(TimeoutError):
                async with aio.timeout(_CHECK_S):
                    await self._ask_crl.wait()

    async def _learn_first(self) -> None:
        """Learn who was revoked before anybody learns of us; a way to a router is there a moment after its link."""
        for pause_s in _FIRST_PAUSES_S:
            await asyncio.sleep(pause_s)
            if await self._ask_for_crl() > 1:  # somebody beside ourselves
                break
        await self.links.deny()

    async def _ask_for_crl(self) -> int:
        """Ask for the newest list; return how many answered."""
        try:
            answers = await self.fabric.ask(CRL_KEY, b"", 2.0, limit_bytes=_CRLS * OVERLAY_CRL_BYTES)
        except RopewayError as error:
            log.debug("overlay: no member told which certificates are revoked: %s", error)
            self.links.heard(0)
            return 0
        if not self.links.heard(len(answers)):
            self._ask_crl.set()
        for raw in answers:
            self._take_crl(raw)
        return len(answers)

    def recheck(self) -> None:
        """See who lost its right: by revocation, by time. Keys that have served their time are replaced, too."""
        self._check_own()
        self.membership.recheck()
        self.rpc.recheck()
        for source in self.sources.values():
            source.recheck(self._good)

    def _check_own(self) -> None:
        """See whether we are in good standing ourselves, and say so if we are not."""
        try:
            self.trust.check(self.identity.certificate.der)
        except SealError as error:
            if not self.trouble:
                self.trouble = f"{error}; others refuse us: have a new one issued with: ropeway keys issue"
                log.error("overlay: our own certificate is no longer valid: %s", self.trouble)
        else:
            self.trouble = ""

    def _good(self, certificate: Certificate) -> bool:
        try:
            self.trust.check(certificate.der)
        except SealError:
            return False
        return True

    # ── who is believed ────────────────────────────────────────────────────────────────────────────────────────

    def refused(self, who: str, error: SealError) -> None:
        """Count something that is not believed."""
        assert isinstance(error.reason, Refusal)
        if len(self.refusals) >= _REFUSALS and (who, error.reason) not in self.refusals:
            who = "others"  # whoever invents names shall not fill our memory with them
        self.refusals[who, error.reason] += 1
        level = logging.WARNING if self.refusals[who, error.reason] == 1 else logging.DEBUG
        log.log(level, "overlay: refused what comes from %s: %s", who, error)

    def denied(self, advert: Advertisement, text: str) -> None:
        """Note that a publisher refuses us its key."""
        if self.denials.get(advert.name) != text:
            log.warning("overlay: %s cannot be read: %s", advert.name, text)
            while len(self.denials) >= _REFUSALS:
                del self.denials[next(iter(self.denials))]
            self.denials[advert.name] = text

    def _take_crl(self, raw: bytes) -> None:
        if not raw:
            return
        try:
            newer = self.trust.update(raw)
        except SealError as error:
            self.refused("a revocation list", error)
            return
        if newer:
            log.info("overlay: revocation list %d is in force", self.trust.crl_number)
            self.recheck()
            if self.trust.revokes:
                self.membership.turn_over()
            self.bypass.renew()
            self._ask_crl.set()  # what else it changes is done next

    def _tell_crl(self, asked: Asked) -> None:
        asked.answer(self.trust.crl)

    # ── what we advertise ──────────────────────────────────────────────────────────────────────────────────────

    def advertise(self, advert: Advertisement) -> None:
        """Tell everybody of an endpoint. Raises ``SealError`` where our own certificate does not allow it."""
        verb = VERB_OF[advert.kind]
        if not self.identity.certificate.rights.may(verb, advert.name):
            raise SealError(
                Refusal.NO_RIGHT, f"the certificate of {self.identity.name} has no right to {verb} {advert.name}"
            )
        raw = make_advert(advert, self.identity, self._advert_key)
        self.membership.advertise(advert, raw)

    def withdraw(self, endpoint: bytes) -> None:
        """Tell everybody that it is gone."""
        self.membership.withdraw(endpoint)

    # ── publishers and readers ─────────────────────────────────────────────────────────────────────────────────

    def feed(self, name: bytes) -> Feed:
        """Return the feed of what is published under a name, read from now on."""
        feed = self.feeds.get(name)
        if feed is None:
            feed = self.feeds[name] = Feed(
                self.fabric,
                self.rpc,
                self.receipts,
                name,
                self.refused,
                self.denied,
                limit_bytes=self.max_message_bytes,
                held=self.held,
                ways=self.membership.ways,
                sessions=self.sessions,
            )
            feed.open(asyncio.get_running_loop())
        return feed

    async def release(self, feed: Feed) -> None:
        """Release a reader's use of a feed; the last reader ends it."""
        if not feed.readers and self.feeds.get(feed.name) is feed:
            del self.feeds[feed.name]
            await feed.close()

    def _aimed_came(self, key: str, payload: zenoh.ZBytes, mark: zenoh.ZBytes | None, session: int) -> None:
        """Take a packet that is for us alone; runs in Zenoh's thread."""
        if (feed := self.feeds.get(name_of(key))) is not None:
            feed.came(key, payload, mark, session)

    def _copy_came(self, name: bytes, publisher: bytes, packet: bytes) -> None:
        """Take a packet that came by the bypass; runs in Zenoh's thread."""
        if (feed := self.feeds.get(name)) is not None:
            feed.copy_came(publisher, packet)

    def follow(self, feed: Feed) -> None:
        """Make a feed read all publishers of its name, whatever their QoS; readers join those that suit them."""
        found: dict[bytes, tuple[Advertisement, Certificate]] = {}
        for advert in self.rib.by_name(feed.name, "publisher"):
            certificate = self.membership.certificate(advert.gateway)
            if certificate is not None:
                found[advert.endpoint] = (advert, certificate)
        feed.follow(found)

    def _gone(self, gateway: bytes) -> None:
        self.rpc.forget(gateway)
        self.receipts.forget(gateway)

    def _tails(self) -> dict[bytes, int]:
        now = time.monotonic()
        return {endpoint: source.tail() for endpoint, source in self.sources.items() if now - source.active < _ACTIVE_S}

    def _on_tails(self, gateway: bytes, tails: Mapping[Any, Any]) -> None:
        for feed in self.feeds.values():
            for endpoint, stream in feed.streams.items():
                newest = tails.get(endpoint)
                if type(newest) is int and stream.advert.gateway == gateway:
                    stream.told(newest)

    # ── what we answer ─────────────────────────────────────────────────────────────────────────────────────────

    def _source(self, request: Mapping[str, Any]) -> PublisherSource:
        source = self.sources.get(part(request, "of", bytes))
        if source is None:
            raise CallFailed("key", "this publisher has gone")
        return source

    async def _answer_key(self, peer: Certificate, request: Mapping[str, Any]) -> Any:
        source = self._source(request)
        granted = source.grant(peer, *offered(request))
        on_granted = self.on_granted.get(source.endpoint)
        if on_granted is not None:
            on_granted([endpoint for endpoint in part(request, "for", list) if type(endpoint) is bytes])
        return granted

    async def _answer_history(self, peer: Certificate, request: Mapping[str, Any]) -> Any:
        upto = None if request.get("upto") is None else part(request, "upto", int)
        return self._source(request).history(peer, part(request, "after", int), upto)

    async def _answer_call(self, peer: Certificate, request: Mapping[str, Any]) -> Any:
        provider = self.providers.get(part(request, "of", bytes))
        if provider is None:
            raise NotServed(str(request.get("name", "")))
        return await provider.answer_remote(peer, request)

    async def _answer_list(self, peer: Certificate, request: Mapping[str, Any]) -> Any:
        return self.membership.told_list()

    async def _answer_ping(self, peer: Certificate, request: Mapping[str, Any]) -> Any:
        return time.time_ns()

    # ── where the others are ───────────────────────────────────────────────────────────────────────────────────

    def path(self, gateway: bytes) -> str:
        """Return ``direct`` if a gateway is linked with ours, else ``routed``."""
        return "direct" if gateway.hex() in self.fabric.links() else "routed"

    async def ping(self, gateway: bytes, timeout_s: float = 2.0) -> float:
        """Measure the round-trip time to another gateway, in seconds, over its sealed channel."""
        await self.rpc.ask(gateway, {"op": "ping"}, timeout_s)  # opens the channel
        began = time.perf_counter()
        await self.rpc.ask(gateway, {"op": "ping"}, timeout_s)
        return time.perf_counter() - began

    async def rtt_ms(self, gateway: bytes) -> float | None:
        """Return the round-trip time in milliseconds, ``None`` if there is no answer."""
        try:
            return round(1e3 * await self.ping(gateway), 3)
        except RopewayError:
            return None

    def owner(self, gateway: bytes) -> str:
        """Return the name in the certificate of a gateway, ``""`` if it is not known."""
        certificate = self.membership.certificate(gateway)
        return certificate.name if certificate is not None else ""

    def status(self) -> dict[str, Any]:
        """Return the state of everything as JSON."""
        return member_report(self)
