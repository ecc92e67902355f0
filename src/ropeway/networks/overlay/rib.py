"""The routing information base: who advertises what, as far as it is to be believed. Sans-I/O."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from ropeway.errors import SealError
from ropeway.limits import OVERLAY_ADVERTISEMENTS_PER_GATEWAY
from ropeway.networks.overlay.advert import Advertisement, advert_key, read_advert
from ropeway.networks.overlay.crypto.certificate import Certificate
from ropeway.networks.overlay.refusal import Refusal

__all__ = ["Rib"]

log = logging.getLogger("ropeway.overlay")

OnChange = Callable[[Advertisement, bool], None]


class Rib:
    """Holds every advertisement of the others. ``secret`` is the fleet's name secret.

    ``refused`` is told, with the name of the sender, of each that is not believed.
    """

    def __init__(self, secret: bytes, refused: Callable[[str, SealError], None]) -> None:
        self._secret, self._key = secret, advert_key(secret)
        self._refused = refused
        self._adverts: dict[bytes, dict[bytes, Advertisement]] = {}  # gateway, endpoint
        self._names: dict[tuple[bytes, str], dict[bytes, Advertisement]] = {}  # global name and kind, endpoint
        self._asking: dict[str, dict[bytes, Advertisement]] = {}  # topic of answers, endpoint
        self._callbacks: list[OnChange] = []

    def on_change(self, callback: OnChange) -> Callable[[], None]:
        """Call with every advertisement that comes (true) or goes (false); returns what ends that."""
        self._callbacks.append(callback)

        def end() -> None:
            with contextlib.suppress(ValueError):
                self._callbacks.remove(callback)

        return end

    # ── what comes ─────────────────────────────────────────────────────────────────────────────────────────────

    def read_all(
        self, gateway: bytes, certificate: Certificate, raws: Iterable[Any]
    ) -> list[Advertisement | SealError]:
        """Check many, in whatever thread: what is to be believed, and why the rest is not."""
        found: list[Advertisement | SealError] = []
        for raw in raws:
            try:
                found.append(read_advert(raw, gateway, certificate, self._key, self._secret))
            except SealError as error:
                found.append(error)
        return found

    def replace(self, gateway: bytes, certificate: Certificate, found: Sequence[Advertisement | SealError]) -> None:
        """Take it that a gateway has these and no others."""
        known = self._adverts.setdefault(gateway, {})
        kept = {advert.endpoint for advert in found if isinstance(advert, Advertisement)}
        for endpoint in [*known.keys() - kept]:
            self._remove(gateway, endpoint)
        self._add(gateway, certificate, found)

    def apply(
        self,
        gateway: bytes,
        certificate: Certificate,
        found: Sequence[Advertisement | SealError],
        removed: Iterable[Any],
    ) -> None:
        """Apply a gateway's new and removed advertisements."""
        for endpoint in removed:
            if isinstance(endpoint, bytes):
                self._remove(gateway, endpoint)
        self._add(gateway, certificate, found)

    def gone(self, gateway: bytes) -> None:
        """Remove a gateway that has left."""
        for endpoint in list(self._adverts.get(gateway, ())):
            self._remove(gateway, endpoint)
        self._adverts.pop(gateway, None)

    def _add(self, gateway: bytes, certificate: Certificate, found: Iterable[Advertisement | SealError]) -> None:
        known = self._adverts.setdefault(gateway, {})
        for advert in found:
            if isinstance(advert, SealError):
                self._refused(certificate.name, advert)
                continue
            if advert.endpoint in known:
                continue
            if len(known) >= OVERLAY_ADVERTISEMENTS_PER_GATEWAY:
                text = f"{certificate.name} advertises more than {OVERLAY_ADVERTISEMENTS_PER_GATEWAY} names"
                self._refused(certificate.name, SealError(Refusal.NO_RIGHT, text))
                return
            known[advert.endpoint] = advert
            self._names.setdefault((advert.global_name, advert.kind), {})[advert.endpoint] = advert
            if advert.answers:
                self._asking.setdefault(advert.answers, {})[advert.endpoint] = advert
            self._tell(advert, True)

    def _remove(self, gateway: bytes, endpoint: bytes) -> None:
        advert = self._adverts.get(gateway, {}).pop(endpoint, None)
        if advert is None:
            return
        same = self._names[advert.global_name, advert.kind]
        del same[endpoint]
        if not same:
            del self._names[advert.global_name, advert.kind]
        if advert.answers:
            asking = self._asking[advert.answers]
            del asking[endpoint]
            if not asking:
                del self._asking[advert.answers]
        self._tell(advert, False)

    def _tell(self, advert: Advertisement, added: bool) -> None:
        for callback in list(self._callbacks):
            callback(advert, added)

    # ── what is there ──────────────────────────────────────────────────────────────────────────────────────────

    def by_name(self, global_name: bytes, kind: str) -> list[Advertisement]:
        """Return the advertisements of a global name."""
        return list(self._names.get((global_name, kind), {}).values())

    def asking(self, topic: str) -> set[bytes]:
        """Return the gateways that want answers on a topic to what they publish for us alone."""
        return {advert.gateway for advert in self._asking.get(topic, {}).values()}

    def all(self, kind: str) -> list[Advertisement]:
        """Return all advertisements of one kind."""
        return [advert for known in self._adverts.values() for advert in known.values() if advert.kind == kind]

    def count(self, gateway: bytes) -> int:
        """Return how many endpoints a gateway advertises."""
        return len(self._adverts.get(gateway, ()))
