"""Packets for auditors: what passed is written down, and who signed it is told to people who cannot read it.

A capture has a line for each packet, as JSON: ``key`` (where it was put: the global name and the publisher), ``packet``
and ``certificate`` (of whoever advertises the publisher), both in base64, and ``time_ns``, when it came.
"""

from __future__ import annotations

import base64
import datetime
import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ropeway.errors import SealError
from ropeway.networks.overlay.crypto.seal import check_signature
from ropeway.networks.overlay.crypto.trust import Trust

__all__ = ["Verdict", "captured", "verdicts"]


@dataclass(frozen=True, slots=True)
class Verdict:
    """The verdict on one packet of a capture; ``fault`` is ``""`` if its publisher signed it."""

    line: int
    fault: str = ""
    member: str = ""
    fingerprint: str = ""
    name: str = ""
    publisher: str = ""
    first: int = 0
    messages: int = 0
    bytes: int = 0


def captured(key: str, packet: bytes, certificate: bytes, time_ns: int) -> str:
    """Return the line of a capture."""
    coded = {"packet": packet, "certificate": certificate}
    return json.dumps(
        {"key": key, "time_ns": time_ns, **{name: base64.b64encode(raw).decode() for name, raw in coded.items()}}
    )


def verdicts(capture: str, trust: Trust) -> Iterator[Verdict]:
    """Judge every packet of a capture; certificates are those of the fleet of ``trust``, as they were when it came."""
    for number, line in enumerate(capture.splitlines(), 1):
        if line.strip():
            try:
                yield _judge(number, json.loads(line), trust)
            except SealError as error:
                yield Verdict(number, fault=str(error))
            except (ValueError, TypeError, KeyError, AttributeError, OverflowError, OSError, RecursionError):
                yield Verdict(number, fault="it is not a line of a capture")


def _judge(number: int, row: dict[str, Any], trust: Trust) -> Verdict:
    _, _, name, publisher = row["key"].split("/")
    packet, der = (base64.b64decode(row[field], validate=True) for field in ("packet", "certificate"))
    certificate = trust.check(der, now=datetime.datetime.fromtimestamp(row["time_ns"] / 1e9, datetime.timezone.utc))
    head = check_signature(packet, bytes.fromhex(name), bytes.fromhex(publisher), certificate.verify_signature)
    return Verdict(
        number,
        member=certificate.name,
        fingerprint=certificate.fingerprint.hex(),
        name=name,
        publisher=publisher,
        first=head.first,
        messages=head.messages,
        bytes=len(packet),
    )
