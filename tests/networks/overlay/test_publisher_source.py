"""ropeway.networks.overlay.publisher_source: what is numbered, kept and handed out."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import pytest

from ropeway.errors import SealError
from ropeway.networks.overlay import publisher_source as module
from ropeway.networks.overlay.crypto.certificate import Certificate
from ropeway.networks.overlay.packet_item import unpack
from ropeway.networks.overlay.publisher_source import PublisherSource
from ropeway.networks.overlay.rights import Rights
from tests.networks.overlay.fleet import member

READER = member("reader").certificate


def source(**options: Any) -> PublisherSource:
    given: dict[str, Any] = {"depth": 2, "lifespan_s": None, "may": lambda _: True}
    return PublisherSource(bytes(32), bytes(16), "/t", member().sign, **given | options)


def add(made: PublisherSource, *payloads: bytes, stamp_ns: int | None = None) -> None:
    for payload in payloads:
        made.add(time.time_ns() if stamp_ns is None else stamp_ns, 0, bytes(16), 0, payload)


def kept(made: PublisherSource, after: int = 0, upto: int | None = None, reader: Certificate = READER) -> list[bytes]:
    return [bytes(unpack(raw).payload) for raw in made.history(reader, after, upto)]


def test_keeps_its_depth() -> None:
    """The newest messages are kept, as many as the depth says, and given in order."""
    made = source()
    made.grant(READER)
    add(made, b"1", b"2", b"3")
    assert made.number == 3
    assert kept(made) == [b"2", b"3"]
    assert kept(made, after=2) == [b"3"]
    assert kept(made, upto=2) == [b"2"]


def test_keeps_nothing() -> None:
    """With a depth of 0 messages are numbered and not kept."""
    made = source(depth=0)
    made.grant(READER)
    add(made, b"1")
    assert (made.number, kept(made)) == (1, [])


def test_bytes_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """However deep, no more bytes than a bound are kept, but for one message."""
    monkeypatch.setattr(module, "_KEEP_BYTES", 10)
    made = source(depth=None)
    made.grant(READER)
    add(made, *(b"abcd" for _ in range(5)))
    assert kept(made) == [b"abcd"] * 2
    add(made, bytes(100))
    assert kept(made) == [bytes(100)]


def test_an_answer_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """One answer brings the newest messages up to a bound, beside the last of them."""
    monkeypatch.setattr(module, "OVERLAY_HISTORY_BYTES", 0)
    made = source(depth=None)
    made.grant(READER)
    add(made, b"1", b"2")
    assert kept(made) == [b"2"]


def test_lifespan() -> None:
    """Messages that have outlived their time are given to nobody."""
    made = source(depth=None, lifespan_s=60.0)
    made.grant(READER)
    add(made, b"old", stamp_ns=time.time_ns() - 61 * 10**9)
    add(made, b"new")
    assert kept(made) == [b"new"]


def test_without_replay() -> None:
    """Without a replay a reader gets what was sent since its grant, and no more for being granted twice."""
    made = source(depth=None, replay=False)
    add(made, b"before")
    made.grant(READER)
    add(made, b"after")
    made.grant(READER)
    assert kept(made) == [b"after"]


def test_rights() -> None:
    """Keys are for those who may read, and messages for those who have keys."""
    made = source(may=lambda reader: reader.fingerprint == READER.fingerprint)
    stranger = member("stranger").certificate
    with pytest.raises(SealError, match="may not read /t"):
        made.grant(stranger)
    with pytest.raises(SealError, match="has no key"):
        made.history(stranger, 0, None)
    deaf = member("deaf", rights=Rights(subscribe=("/other",))).certificate
    with pytest.raises(SealError, match="may not read /t"):
        source().grant(deaf)


def test_keys_change() -> None:
    """Keys change when a reader loses its right, who then has none, and when they have served their time."""
    made = source()
    made.grant(READER)
    assert not made.recheck(lambda _: True)
    assert made.recheck(lambda _: False)
    with pytest.raises(SealError, match="has no key"):
        made.history(READER, 0, None)
    assert source(rotate_s=0.0).recheck(lambda _: True)


def test_tail(monkeypatch: pytest.MonkeyPatch) -> None:
    """What went out a while ago should have come, what went out just now may be on the way."""
    now_s = 100.0
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now_s))
    made = source()
    add(made, b"1", b"2", stamp_ns=0)
    made.sent(2)
    made.sent(1)
    assert made.tail() == 0
    now_s += 0.5
    assert made.tail() == 0
    now_s += 0.5
    assert made.tail() == 2
