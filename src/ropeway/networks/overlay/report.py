"""Reports the state of a member of the overlay, for people and programs."""

from __future__ import annotations

from collections import Counter
from typing import Any, Protocol

from ropeway.networks.overlay.bypass import Bypass
from ropeway.networks.overlay.crypto.identity import Identity
from ropeway.networks.overlay.crypto.trust import Trust
from ropeway.networks.overlay.data_plane import DataPlane
from ropeway.networks.overlay.feed import Feed
from ropeway.networks.overlay.links import Links
from ropeway.networks.overlay.membership import Membership
from ropeway.networks.overlay.refusal import Refusal
from ropeway.networks.overlay.rib import Rib
from ropeway.networks.overlay.states import States

__all__ = ["Reported", "member_report"]


class Reported(Protocol):
    """Has what is reported of a member."""

    identity: Identity
    trust: Trust
    gateway: bytes
    trouble: str
    links: Links
    fabric: DataPlane
    rib: Rib
    membership: Membership
    bypass: Bypass
    states: States
    denials: dict[str, str]
    feeds: dict[bytes, Feed]
    refusals: Counter[tuple[str, Refusal]]


def member_report(node: Reported) -> dict[str, Any]:
    """Return the state of everything as JSON."""
    certificate = node.identity.certificate
    links = node.fabric.links()
    known = node.membership.gateways()
    return {
        "name": node.identity.name,
        "fleet": node.identity.fleet,
        "gateway": node.gateway.hex(),
        "expires": certificate.not_after.isoformat(),
        "trouble": node.trouble or node.links.unlinked,
        "routers": sorted(links - {gateway.hex() for gateway in known}),
        "bypass": node.bypass.connection > 0,
        "links": node.fabric.status(),
        "copies": sum(feed.copies for feed in node.feeds.values()),
        "revocations": node.trust.crl_number,
        "gateways": [
            {
                "name": other.name,
                "gateway": gateway.hex(),
                "path": "direct" if gateway.hex() in links else "routed",
                "names": node.rib.count(gateway),
                "clock_ahead_s": round(other.clock_ahead_s, 3),
            }
            for gateway, other in sorted(known.items(), key=lambda item: item[1].name)
        ],
        "states": node.states.status(),
        "denied": dict(node.denials),
        "missed": sum(feed.missed for feed in node.feeds.values()),
        "refused": [
            {"who": who, "reason": reason.value, "count": count} for (who, reason), count in node.refusals.items()
        ],
    }
