"""Writes and parses the tokens by which nodes of rmw_zenoh show themselves and their endpoints, and the keys of data.

A token is a key that is alive as long as its session:
``@ros2_lv/<domain>/<session>/<node id>/<id>/<kind>/<enclave>/<namespace>/<node>``, followed for endpoints by
``/<name>/<type>/<type hash>/<qos>``, where slashes within a part are written as ``%``. Nodes since Lyrical may append
a part about buffers, which does not matter here. Data travels under ``<domain>/<name>/<type>/<type hash>``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

import xxhash

from ropeway.errors import InvalidName
from ropeway.graph.base import resolve_name
from ropeway.limits import ZENOH_TOKEN_CHARACTERS
from ropeway.networks.dds.names import dds_type, demangle_type
from ropeway.networks.zenoh.qos_text import parse_qos, qos_text
from ropeway.qos import DEFAULT, QoS

__all__ = ["NO_HASH", "ZenohToken", "data_key", "enclave_of", "gid_of", "parse_token", "tokens_of"]

NO_HASH: Final = "TypeHashNotSupported"
"""The hash of a type that nobody knows, as nodes of Humble write it."""

_SPACE: Final = "@ros2_lv"
_KINDS: Final = {"NN": "node", "MP": "publisher", "MS": "subscription", "SS": "server", "SC": "client"}
_MARKS: Final = {kind: mark for mark, kind in _KINDS.items()}
_NODE_PARTS: Final = 9
_ENDPOINT_PARTS: Final = 13
_SESSION: Final = re.compile(r"[0-9a-f]{1,32}")
_ID: Final = re.compile(r"[0-9]{1,20}")
_HASH: Final = re.compile(r"[A-Za-z0-9_]{1,128}")
_LARGEST_DOMAIN: Final = 2**32
# Enclaves mark our own nodes; nothing else is done with them while security is off.
_OURS: Final = "ropeway"
_COPY: Final = "ropeway_copy"
_PLAIN_ID: Final = re.compile(r"[A-Za-z0-9_.-]+")
_HEX: Final = "~"


@dataclass(frozen=True, slots=True)
class ZenohToken:
    """A node or an endpoint of one, as it shows itself.

    ``kind`` is ``node``, ``publisher``, ``subscription``, ``server`` or ``client``; ``node`` its full name; what
    follows is for endpoints only. ``enclave`` tells our own nodes from others.
    """

    domain: int
    session: str
    node_id: str
    id: str
    kind: str
    node: str
    enclave: str = "/"
    name: str = ""
    type: str = ""
    type_hash: str = ""
    qos: QoS = DEFAULT

    @property
    def ours(self) -> bool:
        """Whether it is of Ropeway, of this process or another."""
        return self._mark in (_OURS, _COPY)

    @property
    def copy(self) -> bool:
        """Whether it is an endpoint of Ropeway's once more, under a hash that others know its type by."""
        return self._mark == _COPY

    @property
    def gateway(self) -> str:
        """The id of the gateway that it is of, ``""`` for others."""
        id = self.enclave[1:].partition("/")[2] if self.ours else ""
        try:
            return bytes.fromhex(id.removeprefix(_HEX)).decode() if id.startswith(_HEX) else id
        except ValueError:
            return id

    @property
    def _mark(self) -> str:
        return self.enclave[1:].partition("/")[0]

    def __str__(self) -> str:
        namespace, _, short = self.node.rpartition("/")
        parts = [_SPACE, str(self.domain), self.session, self.node_id, self.id, _MARKS[self.kind]]
        parts += [_flat(self.enclave), _flat(namespace or "/"), short]
        if self.kind != "node":
            parts += [_flat(self.name), dds_type(self.type), self.type_hash, qos_text(self.qos)]
        return "/".join(parts)


def enclave_of(gateway_id: str, *, copy: bool = False) -> str:
    """Return the enclave by which others know the nodes of a gateway, or of a program without an id.

    ``copy`` is for endpoints that are shown once more.
    """
    mark = f"/{_COPY if copy else _OURS}"
    if not gateway_id:
        return mark
    return f"{mark}/{gateway_id if _PLAIN_ID.fullmatch(gateway_id) else _HEX + gateway_id.encode().hex()}"


def parse_token(key: str) -> ZenohToken | None:
    """Parse a token; return ``None`` for one that is malformed, too long, or of names that ROS does not allow."""
    if len(key) > ZENOH_TOKEN_CHARACTERS:
        return None
    parts = key.split("/")
    if len(parts) < _NODE_PARTS or parts[0] != _SPACE or not all(parts):
        return None
    domain, session, node_id, id = parts[1:5]
    kind = _KINDS.get(parts[5])
    if kind is None or not (_ID.fullmatch(domain) and _SESSION.fullmatch(session) and int(domain) < _LARGEST_DOMAIN):
        return None
    if not (_ID.fullmatch(node_id) and _ID.fullmatch(id)) or "/" in parts[8].replace("%", "/"):
        return None
    try:
        node = resolve_name(f"{_deep(parts[7]).rstrip('/')}/{parts[8]}")
        made = (int(domain), session, node_id, id, kind, node, _deep(parts[6]))
        if kind == "node":
            return ZenohToken(*made)
        if len(parts) < _ENDPOINT_PARTS:
            return None
        name, type = resolve_name(_deep(parts[9])), demangle_type(parts[10])
    except InvalidName:
        return None
    qos = parse_qos(parts[12])
    if qos is None or type == parts[10] or not _HASH.fullmatch(parts[11]) or not parts[9].startswith("%"):
        return None
    return ZenohToken(*made, name, type, parts[11], qos)


def gid_of(token: str) -> bytes:
    """Return the gid of an endpoint, which rmw_zenoh derives from its token."""
    return int(xxhash.xxh3_128_intdigest(token.encode())).to_bytes(16, "little")


def tokens_of(domain: int) -> str:
    """Return the expression that all tokens of a domain match."""
    return f"{_SPACE}/{domain}/**"


def data_key(domain: int, name: str, type: str, type_hash: str) -> str:
    """Return the key under which a topic or service has its data; ``*`` stands for any hash.

    Raises ``InvalidTypeName``.
    """
    return f"{domain}/{name.strip('/')}/{dds_type(type)}/{type_hash}"


def _flat(name: str) -> str:
    return name.replace("/", "%")


def _deep(part: str) -> str:
    return part.replace("%", "/")
