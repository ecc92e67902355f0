"""Notes that repeat themselves become few entries, and nothing that happened goes uncounted."""

from __future__ import annotations

import hashlib
from typing import Any

from ropeway.audit.merging import Merger
from ropeway.audit.note import AuditNote


def _refused(port: int = 1, host: str = "10.0.0.7") -> AuditNote:
    return AuditNote("refused", "connect", where=f"{host}:{port}", outcome="refused", why="401", time_s=float(port))


def _counted(entries: list[dict[str, Any]]) -> int:
    return sum(entry.get("times", 1) for entry in entries)


def test_the_same_again_is_counted() -> None:
    """A thousand wrong tokens from one address are two entries: the first, and how many more there were until when."""
    merger = Merger(window_s=10.0)
    entries = [entry for port in range(1, 1001) for entry in merger.take(_refused(port), 0.0)]
    assert [entry["where"] for entry in entries] == ["10.0.0.7:1"]
    assert list(merger.end(9.9)) == []
    [rest] = merger.end(10.0)
    assert (rest["times"], rest["since"], rest["time"]) == (999, 1.0, 1000.0)
    assert merger.ends_s is None


def test_a_window_begins_with_what_comes_next() -> None:
    """After a window the same is an entry again."""
    merger = Merger(window_s=10.0)
    assert len(list(merger.take(_refused(), 0.0))) == 1
    assert list(merger.end(20.0)) == []
    assert len(list(merger.take(_refused(), 30.0))) == 1
    assert merger.ends_s == 40.0


def test_one_sender_does_not_fill_the_log() -> None:
    """Beyond a number of different entries, those of a sender are one, which has the hash over all their hashes."""
    merger = Merger(per_sender=3)
    payloads = [bytes([number]) for number in range(10)]
    entries = [
        entry
        for payload in payloads
        for entry in merger.take(AuditNote("command", "publish", "/cmd_vel", "role driver", payload=payload), 0.0)
    ]
    assert [entry["sha256"] for entry in entries] == [hashlib.sha256(payload).hexdigest() for payload in payloads[:3]]
    [rest] = merger.end(10.0)
    chain = hashlib.sha256(b"".join(hashlib.sha256(payload).digest() for payload in payloads[3:]))
    assert (rest["operation"], rest["times"], rest["sha256_of_hashes"]) == ("publish", 7, chain.hexdigest())


def test_many_senders_share_an_entry() -> None:
    """Addresses beyond a number share one entry, and the table of addresses does not grow."""
    merger = Merger(senders=4)
    entries = [entry for number in range(50) for entry in merger.take(_refused(host=f"10.0.{number}.1"), 0.0)]
    entries += merger.end(10.0)
    assert _counted(entries) == 50
    assert [entry["who"] for entry in entries if entry["outcome"] == "several"] == ["(others)"]


def test_what_a_peer_chose_is_short_and_printable() -> None:
    """A name with line ends or of any length cannot forge an entry."""
    [entry] = Merger().take(AuditNote("denied", "publish", "/a\n{" + "x" * 1000, "role web"), 0.0)
    assert "\n" not in entry["name"]
    assert len(entry["name"]) <= 512
