"""Frames of Foxglove viewers: text and binary ones, cut and changed at any place."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from typing import Any, Final

from fuzz.target import Target
from fuzz.targets.nested import NESTED_JSON
from ropeway.errors import InvalidFrame, InvalidOperation
from ropeway.networks.foxglove import wire

__all__ = ["TARGETS", "VIEWER_FRAMES", "VIEWER_OPERATIONS"]

VIEWER_OPERATIONS: Final[tuple[dict[str, Any], ...]] = (
    {"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 2}, {"id": 3, "channelId": 1}]},
    {"op": "unsubscribe", "subscriptionIds": [1, 3]},
    {
        "op": "advertise",
        "channels": [
            {"id": 1, "topic": "/t", "encoding": "json", "schemaName": "std_msgs/msg/String"},
            {
                "id": 2,
                "topic": "/u",
                "encoding": "cdr",
                "schemaName": "own_msgs/msg/Thing",
                "schema": "int32[] x\nOther[<=2] y\n===\nMSG: own_msgs/Other\nstring<=5 z\n",
                "schemaEncoding": "ros2msg",
            },
        ],
    },
    {"op": "unadvertise", "channelIds": [1, 2]},
    {"op": "getParameters", "parameterNames": ["/node.x", "/node.y"], "id": "q"},
    {"op": "setParameters", "parameters": [{"name": "/node.x", "value": [1, 2.5], "type": "float64_array"}], "id": "q"},
    {"op": "setParameters", "parameters": [{"name": "/node.b", "value": "AAE=", "type": "byte_array"}]},
    {"op": "subscribeParameterUpdates", "parameterNames": ["/node.x"]},
    {"op": "unsubscribeParameterUpdates", "parameterNames": ["/node.x"]},
    {"op": "subscribeConnectionGraph"},
    {"op": "unsubscribeConnectionGraph"},
    {"op": "fetchAsset", "uri": "package://robot/meshes/arm.stl", "requestId": 7},
)
"""One good operation of every kind."""

VIEWER_FRAMES: Final = (
    struct.pack("<BI", 1, 1) + b'{"data":"x"}',
    struct.pack("<BI", 1, 2) + b"\0\1\0\0\0\0\0\0",
    struct.pack("<BIII", 2, 1, 7, 3) + b"cdr" + b"\0\1\0\0" + bytes(16),
    struct.pack("<BIII", 2, 1, 8, 4) + b'json{"a":1}',
)
"""One good binary frame of every kind."""

_WORDS: Final = (
    *(b'{"op":"', b'"', b'":', b"},", b"[]", b"null", b"true", b"-1", b"1e999", b"4294967296"),
    *(b'"id":', b'"channelId":', b'"channels":[', b'"parameterNames":[', b'"type":"float64"', b"\xff\xff\xff\xff"),
)


def _texts() -> Iterator[bytes]:
    for operation in VIEWER_OPERATIONS:
        yield json.dumps(operation).encode()
    yield from NESTED_JSON


def _read(data: bytes) -> None:
    """Read a frame, and check that what came out is within bounds."""
    found = wire.read_text(data)
    assert found.op


def _read_binary(data: bytes) -> None:
    found = wire.read_binary(data)
    assert len(found.data) < len(data)


TARGETS: Final = {
    "viewer-operations": Target(_read, (InvalidFrame, InvalidOperation), _texts, _WORDS),
    "viewer-frames": Target(_read_binary, (InvalidFrame,), lambda: VIEWER_FRAMES),
}
