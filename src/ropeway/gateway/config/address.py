"""Addresses of gateways and of graphs, checked and brought to one spelling.

A new kind of link or graph is one line in one of the two tables.
"""

from __future__ import annotations

import ipaddress
import os
import re
from collections.abc import Mapping
from typing import Final
from urllib.parse import SplitResult, parse_qsl, urlsplit

from ropeway.gateway.config.suggest import did_you_mean, one_of, show
from ropeway.networks.mqtt.address import PORTS as MQTT_PORTS
from ropeway.networks.mqtt.address import parse_address as parse_mqtt
from ropeway.networks.zenoh.address import parse_address
from ropeway.types.distros import ROS2_DISTROS

__all__ = [
    "GRAPHS",
    "LINKS",
    "LISTENERS",
    "default_graph",
    "is_foxglove",
    "is_iort",
    "is_loopback",
    "is_mqtt",
    "is_secure",
    "parse_graph",
    "parse_link",
    "parse_listen",
]

DEFAULT_PORT: Final = 9090

IORT_PORT: Final = 7410

FOXGLOVE_PORT: Final = 8765

_SERVED: Final[Mapping[str, int]] = {"ws": DEFAULT_PORT, "wss": DEFAULT_PORT, "iort": IORT_PORT, "iorts": IORT_PORT}

LINKS: Final[Mapping[str, int]] = {**_SERVED, **MQTT_PORTS}
"""The schemes a remote may have, and the port where the address names none."""

LISTENERS: Final[Mapping[str, int]] = {**_SERVED, "foxglove": FOXGLOVE_PORT, "foxgloves": FOXGLOVE_PORT}
"""The same of a listener."""

GRAPHS: Final[Mapping[str, str]] = {
    "dds": r"dds:(?P<domain>\d{1,3})(\?[\w.%,:/=&+-]+)?",
    "ros2": r"ros2(:(?P<domain>\d{1,3}))?",
    "auto": r"auto",
    "zenoh": r"zenoh(:(peer|[a-z]+/[\w.:\[\]%,/-]+)?)?(\?[\w.%,:/=&+~-]+)?",
    "ros1": r"ros1(:(http:)?//[\w.:\[\]-]+/?)?",
    "mqtt": r"mqtt://.+",
    "mqtts": r"mqtts://.+",
    "memory": r"memory:[A-Za-z0-9_.-]+",
}
"""The kinds of graph a gateway may stand on, and how each is written."""

_WRITTEN: Final = {
    "dds": "dds:0",
    "ros2": "ros2 or ros2:0",
    "auto": "auto",
    "zenoh": "zenoh, zenoh:tcp/host:7447 or zenoh:peer",
    "ros1": "ros1 or ros1:http://host:11311",
    "mqtt": "mqtt://host:1883",
    "mqtts": "mqtts://host:8883",
    "memory": "memory:name",
}
_DOMAINS: Final = {"dds": "DDS", "ros2": "ROS"}
_MAX_DOMAIN: Final = 232  # the highest whose UDP ports exist
_HOST: Final = re.compile(r"(?!-)[A-Za-z0-9_-]{1,63}(\.(?!-)[A-Za-z0-9_-]{1,63})*\.?")


def parse_link(text: str) -> str:
    """Normalise the address of a link: ``WS://Host`` becomes ``ws://host:9090``.

    Raises ``ValueError`` with what was expected.
    """
    parts = _split(text, ("overlay",))
    host, port = parts.hostname or "", parts.port if parts.port is not None else LINKS[parts.scheme]
    if not 1 <= port <= 65535:
        raise ValueError(f"expected a port from 1 to 65535, got {show(text)}")
    path = "" if parts.path == "/" else parts.path
    if parts.scheme in MQTT_PORTS:
        parse_mqtt(text)
    if parts.scheme in ("iort", "iorts") and (path or parts.query):
        raise ValueError(f"the address of a server of nodes has no path, got {show(text)}")
    return f"{parts.scheme}://{_bracketed(host)}:{port}{path}{'?' + parts.query if parts.query else ''}"


def parse_listen(text: str) -> str:
    """Normalise a listener's address; port 0 takes any free port. Raises ``ValueError`` with what was expected."""
    parts = _split(text, among=LISTENERS)
    if parts.path not in ("", "/") or parts.query:
        raise ValueError(f"a listener has no path; expected ws://host:port, got {show(text)}")
    port = parts.port if parts.port is not None else LISTENERS[parts.scheme]
    return f"{parts.scheme}://{_bracketed(parts.hostname or '')}:{port}"


def parse_graph(text: str) -> str:
    """Normalise the address of a graph. Raises ``ValueError`` with what was expected."""
    kind = re.split("[:?]", text, maxsplit=1)[0]
    if kind not in GRAPHS:
        near = did_you_mean(kind, GRAPHS)
        raise ValueError(f"expected a graph such as dds:0 (kinds: {', '.join(GRAPHS)}), got {show(text)}{near}")
    match = re.fullmatch(GRAPHS[kind], text)
    if match is None:
        raise ValueError(f"expected {_WRITTEN[kind]}, got {show(text)}")
    domain = match.groupdict().get("domain")
    if domain is not None and int(domain) > _MAX_DOMAIN:
        raise ValueError(f"expected a {_DOMAINS[kind]} domain from 0 to {_MAX_DOMAIN}, got {show(text)}")
    if kind == "zenoh":
        parse_address(text, {})
    if kind in MQTT_PORTS:
        parse_mqtt(text)
    distro = dict(parse_qsl(text.partition("?")[2])).get("distro")
    if distro is not None and distro not in ROS2_DISTROS:
        raise ValueError(f"distro: {one_of(distro, ROS2_DISTROS)}")
    return text


def default_graph(environ: Mapping[str, str] | None = None) -> str:
    """Return the DDS graph of the domain that ROS is told to use.

    Raises ``ValueError`` where ``ROS_DOMAIN_ID`` is no domain.
    """
    domain = (os.environ if environ is None else environ).get("ROS_DOMAIN_ID", "").strip() or "0"
    if not domain.isdecimal() or int(domain) > _MAX_DOMAIN:
        raise ValueError(f'ROS_DOMAIN_ID is "{domain}"; expected a number from 0 to {_MAX_DOMAIN}')
    return f"dds:{int(domain)}"


def is_loopback(address: str) -> bool:
    """Return whether only this machine can reach the (parsed) address."""
    host = urlsplit(address).hostname or ""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost" or host.endswith(".localhost")


def is_secure(address: str) -> bool:
    """Return whether the (parsed) address uses TLS."""
    return address.startswith(("wss:", "iorts:", "foxgloves:", "mqtts:"))


def is_iort(address: str) -> bool:
    """Return whether the (parsed) address is that of a server of IoRT nodes."""
    return address.startswith(("iort:", "iorts:"))


def is_mqtt(address: str) -> bool:
    """Return whether the (parsed) address is that of an MQTT broker."""
    return address.startswith(("mqtt:", "mqtts:"))


def is_foxglove(address: str) -> bool:
    """Return whether the (parsed) address is that of a server of Foxglove viewers alone."""
    return address.startswith(("foxglove:", "foxgloves:"))


def _split(text: str, others: tuple[str, ...] = (), *, among: Mapping[str, int] = LINKS) -> SplitResult:
    wanted = f"expected {' or '.join((*(f'{scheme}://host:port' for scheme in among), *others))}, got {show(text)}"
    scheme, colon, _ = text.strip().partition("://")
    if not colon:
        raise ValueError(wanted)
    if scheme.lower() not in among:
        raise ValueError(f"{wanted}{did_you_mean(scheme, (*among, *others))}")
    try:
        parts = urlsplit(text.strip())
        _ = parts.port
    except ValueError as error:
        raise ValueError(f"{wanted} ({error})") from error
    if parts.username is not None or parts.password is not None:
        raise ValueError("an address holds no user name and no password")
    if parts.fragment or "#" in text:
        raise ValueError(f"an address has no #fragment; {wanted}")
    host = parts.hostname or ""
    if not _HOST.fullmatch(host) and not _is_ip(host):
        raise ValueError(wanted)
    return parts


def _is_ip(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host
