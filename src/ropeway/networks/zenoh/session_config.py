"""Makes the configuration of a Zenoh session out of the address of a graph."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import zenoh

from ropeway.limits import ZENOH_MESSAGE_BYTES
from ropeway.networks.zenoh.address import ZenohAddress

__all__ = ["make_config"]

_LEASE_MS: Final = 10_000  # a node that is gone for so long is gone; rmw_zenoh waits a minute for its own
_FOREVER_MS: Final = -1
_CLIENT_LINK_MS: Final = 5000
_RETRY: Final = {"period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 2.0}
_WAIT_US: Final = 20_000  # a message waits so long for room in a batch; the loop does not, see ``sender``
_WAIT_FRAGMENTS_US: Final = 200_000
_BATCHES: Final = 8
_FILE_BYTES: Final = 1 << 20


def make_config(address: ZenohAddress) -> zenoh.Config:
    """Return a configuration. Raises ``ValueError`` for a file or a setting that cannot be used, with the reason."""
    try:
        config: zenoh.Config = zenoh.Config.from_file(address.config) if address.config else zenoh.Config()
        if not address.config:
            _insert(config, _defaults())
        _insert(config, _asked(address))
        for key, value in address.override:
            config.insert_json5(key, value)
    except zenoh.ZError as error:
        raise ValueError(f"{address.config or 'the configuration of Zenoh'} cannot be used: {error}") from error
    except OSError as error:
        raise ValueError(f"{error.filename}: {error.strerror}") from error
    return config


def _insert(config: zenoh.Config, options: dict[str, Any]) -> None:
    for key, value in options.items():
        config.insert_json5(key, json.dumps(value))


def _defaults() -> dict[str, Any]:
    """Return what applies where no file says otherwise: that of rmw_zenoh, with a shorter lease."""
    return {
        "connect/timeout_ms": _FOREVER_MS,
        "connect/exit_on_failure": False,
        "connect/retry": _RETRY,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        "open/return_conditions/connect_scouted": True,
        "open/return_conditions/declares": True,
        "timestamping/enabled": True,  # by it readers tell apart what two publishers keep for late joiners
        "transport/link/tx/lease": _LEASE_MS,
        "transport/link/tx/queue/size/data": _BATCHES,
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": _WAIT_US,
        "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments": _WAIT_FRAGMENTS_US,
        "transport/link/rx/max_message_size": ZENOH_MESSAGE_BYTES,
        "adminspace/enabled": False,
    }


def _asked(address: ZenohAddress) -> dict[str, Any]:
    """Return what the address says."""
    found: dict[str, Any] = {}
    if address.mode:
        found["mode"] = address.mode
    if address.mode == "client":  # which is nothing without a router, so opening it fails where there is none
        found |= {"connect/timeout_ms": _CLIENT_LINK_MS, "connect/exit_on_failure": True}
    if address.connect is not None:
        found["connect/endpoints"] = list(address.connect)
    if address.scout:
        found["scouting/multicast/enabled"] = True
    if address.listen is not None:
        found["listen/endpoints"] = [] if address.mode == "client" else list(address.listen)
    if address.ca:
        found["transport/link/tls/root_ca_certificate"] = address.ca
    if address.certificate:
        tls = "transport/link/tls"
        found |= {f"{tls}/connect_certificate": address.certificate, f"{tls}/connect_private_key": address.key}
        found |= {f"{tls}/listen_certificate": address.certificate, f"{tls}/listen_private_key": address.key}
        found[f"{tls}/enable_mtls"] = True
    if address.user:
        found["transport/auth/usrpwd/user"] = address.user
        found["transport/auth/usrpwd/password"] = _password(address.password_file)
    return found


def _password(path: str) -> str:
    if not path:
        raise ValueError("the password of a user stands in a file; name it with password_file=")
    with Path(path).open(encoding="utf-8") as file:
        return file.read(_FILE_BYTES).strip()
