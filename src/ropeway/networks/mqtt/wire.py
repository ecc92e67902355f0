"""Writes and reads what MQTT 5 carries beside a payload: who published a message first, its number, type and form."""

from __future__ import annotations

import hashlib
import math
import re
import time
from dataclasses import dataclass
from typing import Any, Final

from paho.mqtt.client import MQTTMessage
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from ropeway.graph.base import Sample

__all__ = ["PublishProperties", "Received", "connect_properties", "read_message"]

_CDR: Final = "application/cdr"  # the content type of messages as ROS 2 sends them
_KEY: Final = "ropeway"
_IDENTITY: Final = re.compile(r"([0-9a-f]{32}) ([1-9][0-9]{0,18}) ([A-Za-z0-9_/]{1,256})")
_LARGEST_EXPIRY_S: Final = 2**32 - 1


@dataclass(frozen=True)
class Received:
    """A message of a broker. ``type`` and ``form`` are ``""`` where it does not tell them.

    ``retained``: it is the last value that the broker keeps, and not news.
    """

    topic: str
    payload: bytes
    retained: bool
    origin: bytes
    seq: int
    type: str = ""
    form: str = ""
    told: bool = False
    """Whether its publisher says who it is; else origin and number are made here."""

    def repeats(self, other: Received | None) -> bool:
        """Return whether this is the same value as another of the same topic."""
        if other is None:
            return False
        if self.told or other.told:
            return (self.origin, self.seq) == (other.origin, other.seq)
        return self.payload == other.payload


def connect_properties(largest_packet_bytes: int) -> Any:
    """Return the properties with which a broker is asked for a connection: longer packets are not to be sent."""
    found: Any = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
    found.MaximumPacketSize = largest_packet_bytes
    return found


class PublishProperties:
    """Makes the properties of the messages of one topic; readers that are no gateways need none of them.

    They are one object, since making a new one costs more than all the rest of a small message: paho writes it out at
    once.
    """

    def __init__(self, type: str, form: str, lifespan_s: float | None) -> None:
        made: Any = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
        if form == "cdr":
            made.ContentType = _CDR
        if lifespan_s is not None:
            made.MessageExpiryInterval = min(max(math.ceil(lifespan_s), 1), _LARGEST_EXPIRY_S)
        made.UserProperty = (_KEY, "")
        self._type, self._made = type, made
        self._own: list[tuple[str, str]] = made.UserProperty

    def of(self, sample: Sample) -> Any:
        """Return the properties of a message, until those of the next are asked for."""
        self._own[0] = (_KEY, f"{sample.origin.hex()} {sample.seq} {self._type}")
        return self._made


def read_message(message: MQTTMessage, broker: str) -> Received | None:
    """Return a message, ``None`` for one whose topic is no text."""
    try:
        topic = message.topic
    except UnicodeDecodeError:
        return None
    properties = message.properties
    for key, value in getattr(properties, "UserProperty", ()) if properties is not None else ():
        found = _IDENTITY.fullmatch(value) if key == _KEY else None
        if found is not None:
            form = "cdr" if getattr(properties, "ContentType", "") == _CDR else ""
            origin = bytes.fromhex(found[1])
            return Received(topic, bytes(message.payload), message.retain, origin, int(found[2]), found[3], form, True)
    origin = hashlib.sha256(f"{broker} {topic}".encode(errors="surrogatepass")).digest()[:16]
    return Received(topic, bytes(message.payload), message.retain, origin, time.time_ns())
