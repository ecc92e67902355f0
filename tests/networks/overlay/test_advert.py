"""Advertisements, and what is known of them."""

from __future__ import annotations

import random
import time
from collections import Counter
from dataclasses import replace

import pytest

from ropeway.errors import SealError
from ropeway.networks.overlay.advert import Advertisement, advert_key, make_advert, read_advert
from ropeway.networks.overlay.names import Metadata, global_name
from ropeway.networks.overlay.refusal import Refusal
from ropeway.networks.overlay.rib import Rib
from ropeway.networks.overlay.rights import Rights
from ropeway.qos import LATCHED, QoS
from tests.networks.overlay.fleet import fleet, member
from tests.support.messages import STRING

OWNER = member("owner")
SECRET = fleet().name_secret
KEY = advert_key(SECRET)
GATEWAY = bytes(range(16))


def advert(name: str = "/a", kind: str = "publisher", number: int = 1, qos: QoS | None = LATCHED) -> Advertisement:
    now = time.time_ns()
    what = "topic" if kind in ("publisher", "subscription") else "service"
    metadata = Metadata(unique="x")
    return Advertisement(
        kind,
        global_name(SECRET, what, name, STRING, metadata),
        number.to_bytes(16, "big"),
        GATEWAY,
        name,
        STRING,
        qos,
        "auto",
        metadata,
        now,
        now + 10**12,
    )


def refused(raw: bytes, gateway: bytes = GATEWAY, owner: object = OWNER, now_ns: int | None = None) -> Refusal:
    with pytest.raises(SealError) as caught:
        read_advert(raw, gateway, owner.certificate, KEY, SECRET, now_ns)  # type: ignore[attr-defined]
    assert isinstance(caught.value.reason, Refusal)
    return caught.value.reason


@pytest.mark.parametrize("qos", [None, LATCHED, QoS(lifespan_s=1.5, deadline_s=0.1, history="keep_all")])
def test_round_trip(qos: QoS | None) -> None:
    """A member reads what another advertises; others see nothing of it."""
    made = advert(qos=qos)
    raw = make_advert(made, OWNER, KEY)
    assert read_advert(raw, GATEWAY, OWNER.certificate, KEY, SECRET) == made
    assert b"/a" not in raw
    assert made.global_name not in raw
    with pytest.raises(SealError):
        read_advert(raw, GATEWAY, OWNER.certificate, advert_key(bytes(32)), SECRET)


def test_refusals() -> None:
    """Forged, altered, expired, misnamed and unentitled advertisements are refused, each with its reason."""
    raw = make_advert(advert(), OWNER, KEY)
    assert refused(raw, gateway=bytes(16)) is Refusal.BAD_TAG
    assert refused(raw[:-1]) is Refusal.BAD_TAG
    assert refused(raw[:20]) is Refusal.TRUNCATED
    assert refused(raw, owner=member()) is Refusal.BAD_SIGNATURE
    assert refused(make_advert(advert(), member("mallory"), KEY)) is Refusal.BAD_SIGNATURE
    assert refused(raw, now_ns=time.time_ns() + 10**13) is Refusal.EXPIRED
    assert refused(make_advert(replace(advert(), name="/b"), OWNER, KEY)) is Refusal.WRONG_NAME
    assert refused(make_advert(replace(advert(), kind="robot"), OWNER, KEY)) is Refusal.MALFORMED
    assert refused(make_advert(replace(advert(), endpoint=b"x"), OWNER, KEY)) is Refusal.MALFORMED


@pytest.mark.parametrize("kind", ["publisher", "subscription", "service", "client"])
def test_rights(kind: str) -> None:
    """A certificate that does not allow it advertises nothing of that kind."""
    owner = member("reader", rights=Rights(publish=("/x",), subscribe=("/x",), call=("/x",), offer=("/x",)))
    assert refused(make_advert(advert("/a", kind, qos=None), owner, KEY), owner=owner) is Refusal.NO_RIGHT
    allowed = make_advert(advert("/x", kind, qos=None), owner, KEY)
    assert read_advert(allowed, GATEWAY, owner.certificate, KEY, SECRET).kind == kind


def test_random_bytes() -> None:
    """Whatever comes is refused with a reason."""
    rng, raw = random.Random(5), make_advert(advert(), OWNER, KEY)
    for _ in range(5000):
        altered = bytearray(raw)
        altered[rng.randrange(len(raw))] ^= 1 << rng.randrange(8)
        refused(bytes(altered))
        refused(rng.randbytes(rng.randrange(100)))


class Watch:
    """A rib that tells what it told."""

    def __init__(self) -> None:
        self.refusals: Counter[tuple[str, Refusal]] = Counter()
        self.changes: list[tuple[str, bool]] = []
        self.rib = Rib(SECRET, self.refused)
        self.end = self.rib.on_change(lambda advert, added: self.changes.append((advert.name, added)))

    def refused(self, who: str, error: SealError) -> None:
        assert isinstance(error.reason, Refusal)
        self.refusals[who, error.reason] += 1

    def read(self, *adverts: Advertisement) -> list[Advertisement | SealError]:
        return self.rib.read_all(GATEWAY, OWNER.certificate, [make_advert(a, OWNER, KEY) for a in adverts])


def test_rib() -> None:
    """What a gateway advertises is found by its global name until it is taken back, replaced, or the gateway goes."""
    watch = Watch()
    one, two, three = advert("/a"), advert("/b", number=2), advert("/a", "subscription", number=3)
    watch.rib.apply(GATEWAY, OWNER.certificate, watch.read(one, two), [])
    watch.rib.apply(GATEWAY, OWNER.certificate, watch.read(one, three), [two.endpoint, b"?", 7])
    assert watch.rib.by_name(one.global_name, "publisher") == [one]
    assert watch.rib.by_name(one.global_name, "subscription") == [three]
    assert watch.rib.all("publisher") == [one]
    assert watch.rib.count(GATEWAY) == 2
    watch.rib.replace(GATEWAY, OWNER.certificate, watch.read(two))
    watch.rib.gone(GATEWAY)
    watch.rib.gone(GATEWAY)
    assert watch.changes == [
        ("/a", True),
        ("/b", True),
        ("/b", False),
        ("/a", True),
        *[("/a", False)] * 2,
        ("/b", True),
        ("/b", False),
    ]
    watch.end()
    watch.rib.replace(GATEWAY, OWNER.certificate, watch.read(one))
    assert len(watch.changes) == 8
    assert not watch.refusals


def test_one_bad_among_good() -> None:
    """One advertisement that is not believed is counted under its sender and costs the others nothing."""
    watch = Watch()
    raws = [make_advert(advert(number=n), OWNER, KEY) for n in (1, 2)]
    found = watch.rib.read_all(GATEWAY, OWNER.certificate, [raws[0], b"junk", None, raws[1]])
    watch.rib.replace(GATEWAY, OWNER.certificate, found)
    assert watch.rib.count(GATEWAY) == 2
    assert watch.refusals == {(OWNER.name, Refusal.TRUNCATED): 2}
