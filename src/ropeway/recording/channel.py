"""Describes a stream of messages in a recording, and a message on its way there."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import orjson

from ropeway.errors import TypesError
from ropeway.qos import QoS
from ropeway.recording.offered_qos import PROFILES_KEY, profiles_text
from ropeway.types import TypeRegistry

__all__ = ["Recorded", "RecordingChannel", "cdr_channel", "json_channel"]


@dataclass(frozen=True, eq=False, slots=True)
class RecordingChannel:
    """A stream of messages. ``encoding`` is that of MCAP (``cdr``, ``json``), ``schema`` the text of the definition in
    ``schema_encoding``; ``latched`` says how many of its last messages a clip begins with, however old they are.
    """

    topic: str
    type: str
    schema: str
    schema_encoding: str = "ros2msg"
    encoding: str = "cdr"
    latched: int = 0
    metadata: dict[str, str] = field(default_factory=dict)


class Recorded(NamedTuple):
    """A message: where it belongs, when it was received (ns since 1970), and its bytes."""

    channel: RecordingChannel
    time_ns: int
    payload: bytes


def cdr_channel(registry: TypeRegistry, topic: str, type: str, offered: Iterable[QoS]) -> RecordingChannel:
    """Make the channel of a topic; its definition and the QoS of its publishers are kept as rosbag2 keeps them.

    A type that nobody knows has no definition: its bytes are recorded, and can be read where the type is known.
    """
    profiles = list(offered)
    try:
        schema, schema_encoding = registry.full_text(type), "ros2msg"
    except TypesError:
        schema = schema_encoding = ""
    latched = max((q.depth or 1 for q in profiles if q.transient_local), default=0)
    metadata = {PROFILES_KEY: profiles_text(profiles)}
    return RecordingChannel(topic, type, schema, schema_encoding, latched=latched, metadata=metadata)


def json_channel(topic: str, type: str, /, **fields: str) -> RecordingChannel:
    """Make a channel of JSON objects, for what is no message of ROS: ``fields`` are the types of their keys."""
    properties = {name: {"type": kind} for name, kind in fields.items()}
    schema = orjson.dumps({"title": type, "type": "object", "properties": properties}).decode()
    return RecordingChannel(topic, type, schema, "jsonschema", "json")
