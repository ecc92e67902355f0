"""Reads the address of a ``zenoh`` graph: ``zenoh``, ``zenoh:tcp/host:7447``, ``zenoh:tls/host:7447?ca=fleet.pem``."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final
from urllib.parse import parse_qsl

__all__ = ["KEYS", "ZenohAddress", "parse_address"]

KEYS: Final = (
    "ca",
    "certificate",
    "config",
    "distro",
    "domain",
    "key",
    "listen",
    "mode",
    "password_file",
    "user",
)
"""The keys that may stand behind the ``?`` of an address."""

_MODES: Final = ("peer", "client")
_LOCAL_ROUTER: Final = ("tcp/localhost:7447",)  # as rmw_zenoh has them
_LOCAL_LISTEN: Final = ("tcp/localhost:0",)
_ENDPOINT: Final = re.compile(r"(tcp|tls|quic|udp|ws)/[\w.\[\]:%-]+:\d{1,5}")
_MAX_DOMAIN: Final = 232
_CONFIG_VARIABLE: Final = "ZENOH_SESSION_CONFIG_URI"
_OVERRIDE_VARIABLE: Final = "ZENOH_CONFIG_OVERRIDE"


@dataclass(frozen=True, slots=True)
class ZenohAddress:
    """A network of rmw_zenoh and how it is reached.

    ``connect`` are the endpoints of routers or other nodes, ``None`` where the configuration file says it; ``listen``
    likewise. ``config`` is a configuration file of Zenoh's; ``ca``, ``certificate`` and ``key`` are files in PEM,
    ``password_file`` has the password of ``user``. ``scout`` finds other peers by multicast. ``override`` are settings
    of the environment, which count most.
    """

    domain: int
    connect: tuple[str, ...] | None = _LOCAL_ROUTER
    listen: tuple[str, ...] | None = _LOCAL_LISTEN
    mode: str = ""
    config: str = ""
    ca: str = ""
    certificate: str = ""
    key: str = ""
    user: str = ""
    password_file: str = ""
    distro: str = ""
    scout: bool = False
    override: tuple[tuple[str, str], ...] = ()


def parse_address(url: str, environ: Mapping[str, str] | None = None) -> ZenohAddress:
    """Parse the address of a graph; the domain is that of ``ROS_DOMAIN_ID`` unless it names one.

    Where neither an endpoint nor a file is named, the configuration that the nodes of this environment use counts, as
    ``ZENOH_SESSION_CONFIG_URI`` and ``ZENOH_CONFIG_OVERRIDE`` name it. Raises ``ValueError`` with what was expected.
    """
    around = os.environ if environ is None else environ
    path, _, query = url.removeprefix("zenoh").removeprefix(":").partition("?")
    given = dict(parse_qsl(query, keep_blank_values=True))
    if unknown := [key for key in given if key not in KEYS]:
        raise ValueError(f"{unknown[0]!r} is not an option of a zenoh graph; known are {', '.join(KEYS)}")
    domain, mode = _domain(given.pop("domain", None), around), given.pop("mode", "")
    if mode and mode not in _MODES:
        raise ValueError(f"the mode {mode!r} is not known; write {' or '.join(_MODES)}")
    alone = path == "peer"
    connect = () if alone else _endpoints(path)
    listen = _endpoints(given.pop("listen", ""))
    config = given.get("config", "")
    override: tuple[tuple[str, str], ...] = ()
    if not (path or config):
        config = given["config"] = around.get(_CONFIG_VARIABLE, "")
        override = _settings(around.get(_OVERRIDE_VARIABLE, ""))
    from_file = bool(config)
    return ZenohAddress(
        domain,
        connect if connect or alone else None if from_file else _LOCAL_ROUTER,
        listen or (None if from_file else ("tcp/0.0.0.0:0",) if alone else _LOCAL_LISTEN),
        mode or ("" if from_file else "peer"),
        scout=alone,
        override=override,
        **{key: value for key, value in given.items() if value},
    )


def _domain(text: str | None, environ: Mapping[str, str]) -> int:
    name = "domain" if text is not None else "ROS_DOMAIN_ID"
    text = (environ.get("ROS_DOMAIN_ID", "") if text is None else text).strip() or "0"
    if not (text.isascii() and text.isdigit()) or int(text) > _MAX_DOMAIN:
        raise ValueError(f'{name} is "{text}"; expected a number from 0 to {_MAX_DOMAIN}')
    return int(text)


def _endpoints(text: str) -> tuple[str, ...]:
    found = tuple(part for part in text.split(",") if part)
    for endpoint in found:
        if not _ENDPOINT.fullmatch(endpoint) or int(endpoint.rpartition(":")[2]) > 65535:
            raise ValueError(f"{endpoint!r} is not an endpoint of Zenoh; write tcp/host:7447 or tls/host:7447, or peer")
    return found


def _settings(text: str) -> tuple[tuple[str, str], ...]:
    pairs = [part.partition("=") for part in text.split(";") if part.strip()]
    if broken := next((key for key, equals, _ in pairs if not equals), None):
        raise ValueError(f"{_OVERRIDE_VARIABLE} has {broken!r}; expected key/path=value;key/path=value")
    return tuple((key.strip(), value) for key, _, value in pairs)
