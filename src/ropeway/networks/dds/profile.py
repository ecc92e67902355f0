"""The transport profile: how Cyclone DDS talks to the network on our behalf.

Datagrams of 8 kB keep a burst of fragments within the receive buffer that Fast DDS leaves at the system's default
(208 kB), so that frames of 305 kB reach its readers at 60 Hz; for Cyclone peers the larger socket buffer and
writer cache of this profile matter more than the size of the datagrams. ``CYCLONEDDS_URI`` is applied after it.
"""

from __future__ import annotations

import contextlib
import ipaddress
import os
import re
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ropeway.errors import GraphUnavailable

__all__ = ["Profile", "make_profile"]

_MAX_MESSAGE_BYTES: Final = 8192
_FRAGMENT_BYTES: Final = 8000
_SOCKET_BUFFER: Final = "8MB"
_WRITER_CACHE: Final = "16MB"
# How many DDS processes can share a host where discovery has no multicast; the ports of a domain allow 120.
_MAX_PARTICIPANT_INDEX: Final = 119

_RANGES: Final = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")


_ENTITIES: Final = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;"})


@dataclass(frozen=True, slots=True)
class Profile:
    """The configuration of one domain: ``xml`` is what Cyclone DDS reads, ``interface`` what the user asked for."""

    xml: str
    interface: str = ""


def _quoted(text: str) -> str:
    """Return a text as the value of an attribute; the module of the standard library loads ``urllib.request``."""
    return f'"{text.translate(_ENTITIES)}"'


def make_profile(
    graph: str,
    interface: str | None = None,
    environ: Mapping[str, str] | None = None,
    *,
    answers_from_loopback: bool = True,
) -> Profile:
    """Make the profile for ``interface`` (a name or an address; ``None`` leaves the choice to Cyclone DDS).

    ROS's own variables are honoured: ``ROS_AUTOMATIC_DISCOVERY_RANGE``, ``ROS_LOCALHOST_ONLY``,
    ``ROS_STATIC_PEERS``. What ``CYCLONEDDS_URI`` selects goes before ``None`` and before ROS's variables.
    ``answers_from_loopback``: the library reaches, from the loopback interface, a node of this machine that tells the
    address of another interface, as those of Fast DDS do; one that does not is left the choice of its interface where
    ``ROS_AUTOMATIC_DISCOVERY_RANGE`` alone asks for this machine, as rmw_cyclonedds does. Raises ``GraphUnavailable``
    for an interface that this machine does not have, or that is not the one selected there.
    """
    env = os.environ if environ is None else environ
    reach = _discovery_range(graph, env)
    peers = []
    if reach in ("SUBNET", "LOCALHOST") and not _localhost_only(env):
        peers = [p.strip() for p in env.get("ROS_STATIC_PEERS", "").split(";") if p.strip()]
    theirs = env.get("CYCLONEDDS_URI", "").strip()
    selected = _selected_interfaces(theirs)
    if selected:
        if interface and not any(_is_same(interface, other) for other in selected):
            raise GraphUnavailable(
                graph,
                f"interface {interface} was asked for, but CYCLONEDDS_URI selects {', '.join(selected)}; "
                "take the interface out of one of the two",
            )
        interface = None  # naming it twice is an error for Cyclone DDS
    elif interface is None and reach == "LOCALHOST" and all(_is_loopback(p) for p in peers):
        interface = "lo" if answers_from_loopback or _localhost_only(env) else None
    element = _interface_element(graph, interface) if interface else ""
    loopback = any(_is_loopback(name) for name in selected or ((interface,) if interface else ()))
    unicast = loopback or reach in ("LOCALHOST", "OFF")
    if unicast and reach != "OFF":
        peers.append("127.0.0.1")

    general = [
        f"<Interfaces>{element}</Interfaces>" if element else "",
        "<AllowMulticast>false</AllowMulticast>" if unicast else "",
        f"<MaxMessageSize>{_MAX_MESSAGE_BYTES}B</MaxMessageSize>",
        f"<FragmentSize>{_FRAGMENT_BYTES}B</FragmentSize>",
    ]
    if reach == "OFF":
        discovery = [
            "<ParticipantIndex>none</ParticipantIndex>",
            f"<Tag>ros_discovery_off_{os.getpid()}</Tag>",
        ]
    else:
        discovery = [
            "<ParticipantIndex>auto</ParticipantIndex>",
            f"<MaxAutoParticipantIndex>{_MAX_PARTICIPANT_INDEX}</MaxAutoParticipantIndex>",
            f"<Peers>{''.join(f'<Peer Address={_quoted(p)}/>' for p in dict.fromkeys(peers))}</Peers>" if peers else "",
        ]
    internal = [
        # No minimum: where net.core.rmem_max is lower, a smaller buffer is better than no domain.
        f'<SocketReceiveBufferSize min="default" max="{_SOCKET_BUFFER}"/>',
        f"<Watermarks><WhcHigh>{_WRITER_CACHE}</WhcHigh></Watermarks>",
        # Fast DDS takes from a withdrawal only its key hash: without, what we withdraw stays listed at its nodes.
        # Topics of ROS have no keys, so that nothing but discovery gets longer.
        "<GenerateKeyhash>true</GenerateKeyhash>",
    ]
    ours = (
        '<CycloneDDS><Domain id="any">'
        f"<General>{''.join(general)}</General>"
        f"<Discovery>{''.join(discovery)}</Discovery>"
        f"<Internal>{''.join(internal)}</Internal>"
        "</Domain></CycloneDDS>"
    )
    return Profile(f"{ours},{theirs}" if theirs else ours, interface or ", ".join(selected))


def _selected_interfaces(uri: str) -> tuple[str, ...]:
    """Return the network interfaces that a value of ``CYCLONEDDS_URI`` selects: inline XML and files,
    comma-separated.
    """
    texts = [uri]
    for part in _INLINE.sub("", uri).split(","):
        path = part.strip().removeprefix("file://")
        if path:
            with contextlib.suppress(OSError, UnicodeError, ValueError):
                texts.append(Path(path).read_text())
    names = (_NAME.search(element) for text in texts for element in _SELECTION.findall(_COMMENT.sub("", text)))
    return tuple(name.group(1) if name else "one by itself" for name in names)


_INLINE: Final = re.compile(r"<.*>", re.DOTALL)
_COMMENT: Final = re.compile(r"<!--.*?-->", re.DOTALL)
_SELECTION: Final = re.compile(r"<NetworkInterface\b[^>]*>", re.IGNORECASE)
_NAME: Final = re.compile(r"""\b(?:name|address)\s*=\s*["']([^"']+)""", re.IGNORECASE)


def _is_same(interface: str, other: str) -> bool:
    return interface == other or (_is_loopback(interface) and _is_loopback(other))


def _discovery_range(graph: str, env: Mapping[str, str]) -> str:
    given = env.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").strip().upper()
    if _localhost_only(env):
        return "LOCALHOST"
    if not given:
        return "SUBNET"
    if given not in _RANGES:
        raise GraphUnavailable(
            graph, f"ROS_AUTOMATIC_DISCOVERY_RANGE is {given!r}; set it to one of {', '.join(_RANGES)}, or unset it"
        )
    return given


def _localhost_only(env: Mapping[str, str]) -> bool:
    return env.get("ROS_LOCALHOST_ONLY", "").strip() == "1"


def _is_loopback(host: str) -> bool:
    if host in ("localhost", "lo"):
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _interface_element(graph: str, interface: str) -> str:
    known = [name for _, name in socket.if_nameindex()]
    if interface in known:
        return f"<NetworkInterface name={_quoted(interface)}/>"
    try:
        address = ipaddress.ip_address(interface)
    except ValueError:
        raise GraphUnavailable(
            graph,
            f"this machine has no network interface {interface!r}; give one of {', '.join(sorted(known))}, "
            "an address of one, or leave it out",
        ) from None
    if not _is_own(address):
        raise GraphUnavailable(
            graph, f"no network interface of this machine has the address {address}; see `ip addr`, or leave it out"
        )
    return f"<NetworkInterface address={_quoted(str(address))}/>"


def _is_own(address: ipaddress.IPv4Address | ipaddress.IPv6Address) -> bool:
    family = socket.AF_INET if address.version == 4 else socket.AF_INET6
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.bind((str(address), 0))
    except OSError:
        return False
    return True
