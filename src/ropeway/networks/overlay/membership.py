"""Tracks who is in the overlay and what each advertises: every gateway keeps a copy of everybody's list.

A gateway declares a liveliness token, and each second puts a signed heartbeat with the version of its list. A change is
put as a delta; a gateway that misses a version asks for the whole list. Only what a certificate of the fleet has signed
is believed; a gateway that has been silent for the lease time ``LEASE_S`` is gone, whatever a router says.

Once a member was revoked, a gateway sends its list, and the key of its notes, only over sealed channels to members in
good standing (see ``ropeway.networks.overlay.announcement``).
"""

from __future__ import annotations

import asyncio
import logging
import os
import time
from collections.abc import Awaitable, Callable, Iterator
from typing import Any, Final

from ropeway.errors import CallError, SealError
from ropeway.graph.signal import Signal
from ropeway.limits import OVERLAY_GATEWAYS_PER_MEMBER, OVERLAY_LIST_BYTES, OVERLAY_STRANGERS
from ropeway.networks.overlay.advert import Advertisement
from ropeway.networks.overlay.announcement import NoteKey, note_key_id
from ropeway.networks.overlay.asked import Asked
from ropeway.networks.overlay.crypto.certificate import Certificate
from ropeway.networks.overlay.crypto.identity import Identity
from ropeway.networks.overlay.crypto.trust import Trust
from ropeway.networks.overlay.data_plane import DataPlane, Handle
from ropeway.networks.overlay.known_gateway import (
    CHALLENGE_BYTES,
    KnownGateway,
    clock_ahead_s,
    gateway_of,
    read_told,
    unreachable,
)
from ropeway.networks.overlay.known_gateway import SHAPES as _SHAPES
from ropeway.networks.overlay.own_adverts import Notes, OwnAdverts, notes_of, read_raws, with_notes
from ropeway.networks.overlay.refusal import Refusal
from ropeway.networks.overlay.rib import Rib
from ropeway.tasks import Supervised, background, describe, end

__all__ = ["LEASE_S", "Membership"]

log = logging.getLogger("ropeway.overlay")

LEASE_S: Final = 8.0
"""A gateway that was not heard of for so long is gone."""

_BEAT_S: Final = 1.0
_AGAIN_S: Final = 0.02  # a way to a new gateway is there a moment after its token
_SUSPECT_S: Final = 3.0  # a token that is gone may come back by another router
_WRONG_CLOCK_S: Final = 5.0  # clocks that differ by more are told of
_ASK_SEALED: Final = b"rw-list2"
"""Told in place of a list: it is told over sealed channels only."""
_ASK_S: Final = 5.0
_TAILS: Final = 512


class Membership:
    """Tells others what we advertise, and fills ``rib`` with what they do.

    ``ask_list(gateway, timeout_s)`` asks another gateway for what ``told_list`` of its membership gives, over a sealed
    channel. ``tails()`` gives the newest number of each reliable publisher of ours that was active lately; ``on_tails``
    gets those of others, so that readers know what they miss. ``on_newer_crl`` is called where somebody has a newer
    revocation list than we, ``on_gone`` with the id of each gateway that has left. ``refused`` is told of everything
    that is not believed. ``ways``: by so many ways we may send the same packet.
    """

    def __init__(
        self,
        fabric: DataPlane,
        identity: Identity,
        trust: Trust,
        rib: Rib,
        *,
        ask_list: Callable[[bytes, float], Awaitable[Any]],
        tails: Callable[[], dict[bytes, int]],
        on_tails: Callable[[bytes, dict[bytes, int]], None],
        on_newer_crl: Callable[[], None],
        on_gone: Callable[[bytes], None],
        refused: Callable[[str, SealError], None],
        ways: int = 1,
        clock_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._clock_ns, self._ways = clock_ns, ways
        self._fabric, self._identity, self._trust = fabric, identity, trust
        self._rib, self._ask_list = rib, ask_list
        assert identity.name_secret is not None
        self._fleet_notes = NoteKey(identity.name_secret)
        self._notes = NoteKey.fresh() if trust.revokes else self._fleet_notes
        self._tails, self._on_tails, self._refused = tails, on_tails, refused
        self._on_newer_crl, self._on_gone = on_newer_crl, on_gone
        self._own = OwnAdverts()
        self._scheduled = False
        self._known: dict[bytes, KnownGateway] = {}
        self._ends: list[Handle] = []
        self._beat = Supervised(self._keep_beating, "overlay heartbeat", longest_pause_s=_BEAT_S)
        self._loop: asyncio.AbstractEventLoop
        self._me = fabric.gateway.hex()
        self._news = asyncio.Event()
        self.doubts = Signal()
        """Notified when a gateway begins to look as if it were gone, or no longer does."""

    async def open(self) -> None:
        """Show ourselves, and look for others."""
        self._loop = asyncio.get_running_loop()
        fabric = self._fabric
        self._ends += [
            fabric.serve(f"rw/m/{self._me}", self._list),
            fabric.hear("rw/h/*", self._heard),
            fabric.hear("rw/a/*", self._changed),
            fabric.token(f"rw/l/{self._me}"),
            fabric.watch("rw/l/*", self._token),
        ]
        self._beat.start()

    async def close(self) -> None:
        """Say good-bye."""
        await end(self._beat, *(known.sync for known in self._known.values()))
        if self._ends:
            self._fabric.tell(f"rw/h/{self._me}", self._note("heartbeat", self._heartbeat(bye=True)))
        for handle in self._ends:
            handle()
        self._ends.clear()

    async def settled(self) -> None:
        """Wait until every gateway that is seen has told its list, and at least one was seen."""
        while not self._known or any(known.certificate is None for known in self._known.values()):
            self._news.clear()
            await self._news.wait()

    # ── what we tell ───────────────────────────────────────────────────────────────────────────────────────────

    def advertise(self, advert: Advertisement, raw: bytes) -> None:
        """Tell the others of an endpoint, with everything else that changes in this turn of the loop."""
        self._own.add(advert, raw, hidden=self.aims(advert.target))
        self._schedule()

    def withdraw(self, endpoint: bytes) -> None:
        """Tell the others that it is gone."""
        if self._own.remove(endpoint):
            self._schedule()

    def aims(self, gateway: bytes) -> bool:
        """Return whether a gateway knows advertisements that are for it alone, and data that goes to it alone."""
        return (known := self._known.get(gateway)) is not None and known.aims

    def ways(self, gateway: bytes) -> int:
        """Return by how many ways a gateway may send the same packet, 0 where it does not know of copies."""
        return 0 if (known := self._known.get(gateway)) is None else known.ways

    def _schedule(self) -> None:
        if not self._scheduled:
            self._scheduled = True
            self._loop.call_soon(self._tell)

    def _tell(self) -> None:
        self._scheduled = False
        if not self._ends:
            return
        for body in self._own.deltas():
            self._fabric.tell(f"rw/a/{self._me}", self._note("delta", body))

    def _note(self, kind: str, body: object) -> bytes:
        return self._notes.seal(self._fabric.gateway, kind, body, self._identity.sign)

    def _heartbeat(self, *, bye: bool = False) -> dict[str, Any]:
        tails = dict(list(self._tails().items())[:_TAILS])
        beat: dict[str, Any] = {"t": self._clock_ns(), "v": self._own.version, "w": tails, "r": self._trust.crl_number}
        if bye:
            beat["bye"] = True
        return beat

    async def _keep_beating(self) -> None:
        while True:
            self._fabric.tell(f"rw/h/{self._me}", self._note("heartbeat", self._heartbeat()))
            await asyncio.sleep(_BEAT_S)
            self._expire()

    def turn_over(self) -> None:
        """Change the key of our notes after a revocation, so that the revoked member cannot read them."""
        self._notes = NoteKey.fresh()
        if self._ends:
            self._fabric.tell(f"rw/h/{self._me}", self._note("heartbeat", self._heartbeat()))

    def _list(self, asked: Asked) -> None:
        """Answer a request for the whole list, or say where to ask for it."""
        if self._notes.id:
            asked.answer(_ASK_SEALED)
            return
        for note in self._list_notes(asked.payload[:CHALLENGE_BYTES]):
            asked.part(note)
        asked.done()

    def told_list(self) -> dict[str, Any]:
        """Return the whole list and the key of our notes, for a member in good standing."""
        return {"k": self._notes.secret, "i": self._notes.id, "n": list(self._list_notes())}

    def _list_notes(self, challenge: bytes = b"") -> Iterator[bytes]:
        hello = {
            "c": self._identity.certificate.der,
            "n": self._identity.name,
            "t": self._clock_ns(),
            "aims": True,
            "ways": self._ways,
            "q": challenge,  # of who asks: by it this is known to be no older list
            **self._own.head(),
        }
        yield self._note("hello", hello)
        for chunk in self._own.chunks():
            yield self._note("adverts", {"t": hello["t"], **chunk})

    # ── what we hear ───────────────────────────────────────────────────────────────────────────────────────────

    def gateways(self) -> dict[bytes, KnownGateway]:
        """Return the other gateways, by id; those without a certificate are still being asked who they are."""
        return {id: known for id, known in self._known.items() if known.certificate is not None}

    def doubted(self, gateway: bytes) -> bool:
        """Return whether a gateway looks as if it were gone, which is known for sure a little later."""
        known = self._known.get(gateway)
        return known is None or known.suspect is not None

    def unreachable(self) -> bytes | None:
        """Return a gateway that is heard of, but has not told who it is for so long that there must be no way to it."""
        return unreachable(self._known, self._loop.time())

    def certificate(self, gateway: bytes) -> Certificate | None:
        """Return the certificate of a gateway's owner, ``None`` if it is not known."""
        known = self._known.get(gateway)
        return known.certificate if known is not None else None

    def _token(self, key: str, alive: bool) -> None:
        gateway = gateway_of(key)
        if gateway is None or gateway == self._fabric.gateway:
            return
        known = self._known.get(gateway)
        if alive:
            if known is None:
                if self._crowded():
                    return
                self._sync(gateway, self._known.setdefault(gateway, KnownGateway(heard=self._loop.time())))
            else:
                known.suspect = None
            self.doubts.notify()
        elif known is not None:
            known.suspect = self._loop.time()
            self.doubts.notify()

    def _crowded(self) -> bool:
        """Return whether so many ids wait to be known that they are hardly gateways."""
        return sum(known.certificate is None for known in self._known.values()) >= OVERLAY_STRANGERS

    def _heard(self, key: str, raw: bytes) -> None:
        gateway = gateway_of(key)
        if gateway is None or gateway == self._fabric.gateway:
            return
        known = self._known.get(gateway)
        if known is None:
            if self._crowded():
                return
            known = self._known[gateway] = KnownGateway(heard=self._loop.time())
        if known.certificate is None:
            self._sync(gateway, known)
            return
        if self._turned_over(raw, gateway, known):
            return
        body = self._read(raw, gateway, "heartbeat", known)
        if body is None:
            return
        told_ns, version = body["t"], body["v"]
        if told_ns <= known.told_ns:
            self._refused(known.name, SealError(Refusal.REPLAYED, "a heartbeat"))
            return
        if body.get("bye"):
            self.gone(gateway)
            return
        known.told_ns, known.heard = told_ns, self._loop.time()
        if known.suspect is not None:
            known.suspect = None
            self.doubts.notify()
        if version != known.version:
            known.wanted = version
            self._sync(gateway, known)
        if body["r"] > self._trust.crl_number:
            self._on_newer_crl()
        if body["w"]:
            self._on_tails(gateway, body["w"])

    def _changed(self, key: str, raw: bytes) -> None:
        gateway = gateway_of(key)
        known = self._known.get(gateway) if gateway is not None else None
        if gateway is None or known is None or known.certificate is None:
            return  # it is being asked for everything
        if known.sync is not None:
            known.wanted = max(known.wanted, known.version + 1)
            return
        if self._turned_over(raw, gateway, known):
            return
        body = self._read(raw, gateway, "delta", known)
        if body is None or body["v"] <= known.version:
            return
        if body["v"] != known.version + 1:
            known.wanted = body["v"]
            self._sync(gateway, known)
            return
        try:
            raws, _ = read_raws(body, "add", self._fabric.gateway)
        except SealError as error:
            self._refused(known.name, error)
            return
        known.version = body["v"]
        found = self._rib.read_all(gateway, known.certificate, raws)
        found = with_notes(found, notes_of(body), self._fabric.gateway)
        self._rib.apply(gateway, known.certificate, found, body["del"])

    def _turned_over(self, raw: bytes, gateway: bytes, known: KnownGateway) -> bool:
        """Return whether a note is sealed with a key that we do not have; the gateway is asked for the key, now and
        then.
        """
        assert known.notes is not None
        if note_key_id(raw) == known.notes.id:
            return False
        if self._loop.time() - known.synced > _BEAT_S / 2:
            self._sync(gateway, known)
        return True

    def _read(self, raw: bytes, gateway: bytes, kind: str, known: KnownGateway) -> dict[str, Any] | None:
        assert known.certificate is not None
        assert known.notes is not None
        certificate = known.certificate
        try:
            body = known.notes.open(raw, gateway, kind, _SHAPES[kind], lambda _: self._trust.check(certificate.der))
        except SealError as error:
            self._refused(known.name, error)
            return None
        return body

    def _sync(self, gateway: bytes, known: KnownGateway) -> None:
        if known.sync is None:
            known.sync = background(self._ask(gateway, known), f"list of {gateway.hex()[:8]}")

    async def _ask(self, gateway: bytes, known: KnownGateway) -> None:
        """Ask a gateway for its whole list, until we have what it had when it was asked."""
        pause_s = _AGAIN_S
        try:
            while self._known.get(gateway) is known:
                key, notes, challenge = f"rw/m/{gateway.hex()}", None, os.urandom(CHALLENGE_BYTES)
                answers = await self._fabric.ask(key, challenge, _ASK_S, limit_bytes=OVERLAY_LIST_BYTES)
                try:
                    if answers == [_ASK_SEALED]:
                        answers, notes = read_told(await self._ask_list(gateway, _ASK_S))
                    version = await self._take_list(gateway, known, answers, notes, challenge)
                except CallError as error:  # it is not there, or does not answer us
                    log.debug("overlay: gateway %s sends no list: %s", gateway.hex()[:8], error)
                    version = None
                except SealError as error:
                    self._refused(known.name or f"gateway {gateway.hex()[:8]}", error)
                    version = None
                except Exception as error:  # whatever a gateway tells, it is asked again, and the others go on
                    log.debug("overlay: a list cannot be used", exc_info=error)
                    unforeseen = SealError(Refusal.MALFORMED, f"a list ({describe(error)})")
                    self._refused(known.name or f"gateway {gateway.hex()[:8]}", unforeseen)
                    version = None
                known.synced = self._loop.time()
                known.unanswered = 0.0 if answers else known.unanswered or known.synced
                if version is not None:
                    known.version = version
                    if known.wanted <= version:
                        return
                await asyncio.sleep(pause_s)  # also where it has less than it says: it may say so for ever
                pause_s = min(2 * pause_s, _BEAT_S)
        finally:
            known.sync = None

    async def _take_list(
        self, gateway: bytes, known: KnownGateway, answers: list[bytes], told: NoteKey | None, challenge: bytes
    ) -> int | None:
        if not answers:
            return None
        notes = told or self._fleet_notes
        hello = notes.open(answers[0], gateway, "hello", _SHAPES["hello"], lambda body: self._trust.check(body["c"]))
        certificate = self._trust.check(hello["c"])
        ahead_s = clock_ahead_s(hello, certificate.name, None if told is not None else challenge, self._clock_ns())
        others = sum(other.name == certificate.name for other in self._known.values() if other is not known)
        if others >= OVERLAY_GATEWAYS_PER_MEMBER:
            raise SealError(Refusal.NO_RIGHT, f"{certificate.name} has {others} gateways already")
        raws: list[Any] = []
        beside: Notes = ({}, {}, {})
        left = hello["of"] + int(hello.get("at", 0))
        for answer in answers[1:]:
            body = notes.open(answer, gateway, "adverts", _SHAPES["adverts"], lambda _: certificate)
            if body["t"] != hello["t"]:
                raise SealError(Refusal.REPLAYED, "a list")
            mine, others = read_raws(body, "a", self._fabric.gateway)
            raws += mine
            left -= len(mine) + others
            for all_of_them, some in zip(beside, notes_of(body), strict=True):
                all_of_them.update(some)
        if left:
            raise SealError(Refusal.TRUNCATED, "a list")
        found = await asyncio.to_thread(self._rib.read_all, gateway, certificate, raws)
        adverts = with_notes(found, beside, self._fabric.gateway)
        if self._known.get(gateway) is not known:
            return None
        first = known.certificate is None
        known.introduced(certificate, notes, hello, ahead_s, self._loop.time())
        self._rib.replace(gateway, certificate, adverts)
        self._news.set()
        if first:
            log.info("overlay: %s has joined with %d names", known.name, self._rib.count(gateway))
            if abs(ahead_s) > _WRONG_CLOCK_S:
                log.warning("overlay: the clock of %s is %+.0f s from ours; stamps will not fit", known.name, ahead_s)
        return int(hello["v"])

    # ── who goes ───────────────────────────────────────────────────────────────────────────────────────────────

    def gone(self, gateway: bytes) -> None:
        """Forget a gateway and what it advertised."""
        known = self._known.pop(gateway, None)
        if known is None:
            return
        if known.sync is not None:
            known.sync.cancel()
        if known.certificate is not None:
            log.info("overlay: %s has left", known.name)
        self._rib.gone(gateway)
        self._on_gone(gateway)
        self._news.set()

    def recheck(self) -> None:
        """Forget those whose certificates are good no longer."""
        for gateway, known in list(self._known.items()):
            if known.certificate is None:
                continue
            try:
                self._trust.check(known.certificate.der)
            except SealError as error:
                self._refused(known.name, error)
                self.gone(gateway)

    def _expire(self) -> None:
        now = self._loop.time()
        for gateway, known in list(self._known.items()):
            lost = known.suspect is not None and now - known.suspect > _SUSPECT_S
            if lost or now - known.heard > LEASE_S:
                self.gone(gateway)
