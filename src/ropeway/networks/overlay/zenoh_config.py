"""Configures Zenoh: mutual TLS and nothing else, small queues, quick recovery."""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Sequence
from typing import Any, Final

import zenoh

from ropeway.limits import OVERLAY_ROUTED_BYTES
from ropeway.networks.overlay.crypto.identity import Identity

__all__ = [
    "KEYS",
    "MEMBER_DEAD_MS",
    "PRIORITIES",
    "ROUTER_DEAD_MS",
    "by_interface",
    "client_config",
    "gateway_config",
    "gateway_id",
    "router_config",
]

KEYS: Final = "rw/**"
"""All that travels in an overlay lies under this key expression."""

_DENIED: Final = ("rw/a/**", "rw/d/**", "rw/g/**", "rw/h/**", "rw/k/**", "rw/l/**", "rw/m/**", "rw/p/**", "rw/x/**")
"""All of it but the revocation list."""

# A dead link is known within these times. A router knows it first: a member that comes again before its router has let
# go of the old link is taken off the routers' map, new link and all, once the old one is closed.
ROUTER_DEAD_MS: Final = 1000
MEMBER_DEAD_MS: Final = 1600
_CLIENT_LINK_MS: Final = 5000  # after which there is no router for a client, for now
PRIORITIES: Final = (
    zenoh.Priority.REAL_TIME,
    zenoh.Priority.INTERACTIVE_HIGH,
    zenoh.Priority.INTERACTIVE_LOW,
    zenoh.Priority.DATA_HIGH,
    zenoh.Priority.DATA,
    zenoh.Priority.DATA_LOW,
    zenoh.Priority.DATA_LOW,
    zenoh.Priority.BACKGROUND,
)
"""Of the lanes, as Zenoh calls them."""

_MESSAGES: Final = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "declare_queryable",
    "reply",
    "liveliness_token",
    "declare_liveliness_subscriber",
    "liveliness_query",
)


def gateway_id() -> bytes:
    """Return a new id: 16 random bytes; Zenoh takes an id without leading zeros, whichever end it counts from."""
    raw = bytearray(os.urandom(16))
    raw[0] |= 0x80
    raw[15] |= 1
    return bytes(raw)


def by_interface(endpoints: Sequence[str], interfaces: Sequence[str]) -> list[str]:
    """Return endpoints to connect to by network interfaces, all of them by the first one first.

    Zenoh has one link with a router. When that link is lost, it tries the others, so the next interface is used.
    """
    return [f"{endpoint}#iface={name}" for name in interfaces for endpoint in endpoints] or list(endpoints)


def gateway_config(
    identity: Identity,
    *,
    gateway: bytes,
    connect: Sequence[str],
    listen: Sequence[str],
    max_message_bytes: int = OVERLAY_ROUTED_BYTES,
    denied: Collection[str] = (),
) -> zenoh.Config:
    """Build the configuration of a gateway, which links with routers and with every other gateway that it can reach.

    ``denied`` are names in certificates whose links carry nothing but the revocation list.

    To Zenoh it is a router like the others: those of its kinds that are not, peers, get nothing through a router that
    stands between them.
    """
    more: dict[str, Any] = {
        "id": gateway.hex(),
        "scouting/gossip/autoconnect": {"router": ["router"]},
        "transport/link/tx/lease": ROUTER_DEAD_MS,  # what is announced: by it the far end judges
        "transport/link/rx/max_message_size": max_message_bytes,
    }
    if denied:
        more["access_control"] = _access(denied)
    return _config(identity, connect, listen, more)


def client_config(
    identity: Identity, *, id: bytes, connect: Sequence[str], denied: Collection[str] = ()
) -> zenoh.Config:
    """Build the configuration of a session that is linked with one router, forwards nothing and accepts nobody."""
    more: dict[str, Any] = {
        "id": id.hex(),
        "mode": "client",
        "connect/timeout_ms": _CLIENT_LINK_MS,
        "connect/exit_on_failure": True,
        "scouting/gossip/enabled": False,
    }
    if denied:
        more["access_control"] = _access(denied)
    return _config(identity, connect, (), more)


def router_config(
    identity: Identity, *, connect: Sequence[str], listen: Sequence[str], denied: Collection[str] = ()
) -> zenoh.Config:
    """Build the configuration of a router. ``denied`` are names in certificates that may do nothing but learn that they
    are.
    """
    more = {"access_control": _access(denied), "scouting/gossip/autoconnect": {"router": []}}
    return _config(identity, connect, listen, more)


def _access(denied: Collection[str]) -> dict[str, Any]:
    """Allow everything of the overlay to everybody except ``denied``, who only learn which certificates are revoked.

    Where one rule allows what another one denies, Zenoh allows it. So as soon as somebody is denied something, all else
    is allowed by default, and by no rule.
    """
    if denied:
        rule = _rule("revoked", "deny", list(_DENIED))
        subject: dict[str, Any] = {"id": "revoked", "cert_common_names": sorted(denied)}
    else:
        rule, subject = _rule("overlay", "allow", [KEYS]), {"id": "everybody"}
    return {
        "enabled": True,
        "default_permission": "allow" if denied else "deny",
        "rules": [rule],
        "subjects": [subject],
        "policies": [{"rules": [rule["id"]], "subjects": [subject["id"]]}],
    }


def _rule(id: str, permission: str, keys: list[str]) -> dict[str, Any]:
    flows = ["ingress", "egress"]
    return {"id": id, "messages": list(_MESSAGES), "flows": flows, "permission": permission, "key_exprs": keys}


def _config(identity: Identity, connect: Sequence[str], listen: Sequence[str], more: dict[str, Any]) -> zenoh.Config:
    tls = identity.tls() | {
        "enable_mtls": True,
        "verify_name_on_connect": False,  # names say nothing about place; that it is of the fleet is what counts
        "close_link_on_expiration": True,
    }
    options: dict[str, Any] = {
        "mode": "router",
        "connect/endpoints": list(connect),
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.5},
        "listen/endpoints": list(listen),
        "listen/exit_on_failure": True,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        "scouting/delay": 0,
        "open/return_conditions/connect_scouted": False,
        "open/return_conditions/declares": False,
        "adminspace/enabled": False,
        "timestamping/enabled": False,
        "transport/link/protocols": ["tls", "quic", "tcp"],
        "transport/link/tls": tls,
        "transport/link/tx/lease": MEMBER_DEAD_MS,
        "transport/link/tx/keep_alive": 4,
        "transport/link/rx/max_message_size": OVERLAY_ROUTED_BYTES,  # put together before it is passed on
        "transport/link/tx/queue/batching/enabled": False,  # what is sent is batched already, and would wait
        # Who writes to a link that takes nothing waits so long at most (microseconds), and holds up its end meanwhile:
        # 32 kB in half a second are 0.5 Mbit/s, and a slower link is none to Zenoh.
        "transport/link/tx/batch_size": 32768,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": 500_000,
        "transport/shared_memory/enabled": False,
        **more,
    }
    config: zenoh.Config = zenoh.Config()
    for key, value in options.items():
        config.insert_json5(key, json.dumps(value))
    return config
