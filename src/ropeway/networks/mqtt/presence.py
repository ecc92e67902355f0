"""Tells other gateways at a broker what is published and read here, and reads what they tell.

MQTT itself knows neither types nor profiles, nor who publishes and reads. So each gateway keeps one retained message
below a topic of their own, ``ropeway/ID``, which the broker takes away when the gateway is gone (its will).
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

import orjson

from ropeway.errors import InvalidTypeName
from ropeway.limits import MQTT_PRESENCE_BYTES, MQTT_PRESENCE_ENDPOINTS, MQTT_TOPIC_BYTES
from ropeway.qos import QoS
from ropeway.types.definition import canonical_name
from ropeway.types.untrusted import json_value

__all__ = ["Announced", "Announcement", "id_of", "pack_announcement", "parse_announcement"]

_ID: Final = re.compile(r"[0-9a-f]{32}")
_NODE: Final = re.compile(r"/[A-Za-z_][A-Za-z0-9_]{0,63}")
_KINDS: Final = {"p": "publisher", "s": "subscription"}
_LETTERS: Final = {kind: letter for letter, kind in _KINDS.items()}


@dataclass(frozen=True)
class Announced:
    """A topic of the broker, or a filter, that a gateway publishes or reads."""

    kind: str  # "publisher" or "subscription"
    topic: str
    type: str
    qos: QoS


@dataclass(frozen=True)
class Announcement:
    """Lists what one gateway publishes and reads."""

    node: str
    endpoints: tuple[Announced, ...] = ()


def id_of(topic: str, prefix: str) -> str:
    """Return which gateway's announcement stands at a topic, ``""`` if it is none."""
    head, slash, id = topic.rpartition("/")
    return id if slash and head == prefix and _ID.fullmatch(id) else ""


def pack_announcement(node: str, endpoints: Iterable[Announced]) -> bytes:
    """Return an announcement as the broker gets it, with as many endpoints as others read."""
    rows: list[list[Any]] = []
    size = 256
    for end in endpoints:
        row = [_LETTERS[end.kind], end.topic, end.type, end.qos.to_json()]
        size += len(orjson.dumps(row)) + 1
        if len(rows) >= MQTT_PRESENCE_ENDPOINTS or size > MQTT_PRESENCE_BYTES:
            break
        rows.append(row)
    return orjson.dumps({"node": node, "endpoints": rows})


def parse_announcement(payload: bytes) -> Announcement | None:
    """Read an announcement, without those of its endpoints that cannot be used; ``None`` for what is none."""
    if len(payload) > MQTT_PRESENCE_BYTES:
        return None
    try:
        value = json_value(payload)
    except (ValueError, TypeError):
        return None
    if not isinstance(value, dict):
        return None
    node, rows = value.get("node"), value.get("endpoints")
    if not isinstance(node, str) or not _NODE.fullmatch(node) or not isinstance(rows, list):
        return None
    made = (_endpoint(row) for row in rows[:MQTT_PRESENCE_ENDPOINTS])
    return Announcement(node, tuple(dict.fromkeys(end for end in made if end is not None)))


def _endpoint(row: object) -> Announced | None:
    if not isinstance(row, list) or len(row) != 4:
        return None
    letter, topic, type, qos = row
    if not (isinstance(letter, str) and isinstance(topic, str) and isinstance(type, str)) or letter not in _KINDS:
        return None
    if not topic or len(topic) > MQTT_TOPIC_BYTES:
        return None
    try:
        return Announced(_KINDS[letter], topic, canonical_name(type, "msg"), QoS.parse(qos))
    except (ValueError, TypeError, InvalidTypeName):
        return None
