"""Frames of rosbridge clients: text and binary ones, those cut at any place, and operations in fragments."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, Final

import cbor2

from fuzz.target import Target
from fuzz.targets.nested import NESTED_CBOR, NESTED_JSON
from ropeway.errors import InvalidFrame, InvalidOperation
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.protocol.fragment import Defragmenter
from ropeway.networks.rosbridge.protocol.frames import JsonAssembler, loads

__all__ = ["OPERATIONS", "TARGETS"]

_LIMIT_BYTES: Final = 1 << 16
_GOAL: Final[dict[str, Any]] = {"action": "/a", "action_type": "example_interfaces/Fibonacci", "id": "g"}

OPERATIONS: Final[tuple[dict[str, Any], ...]] = (
    {"op": "advertise", "topic": "/t", "type": "std_msgs/String", "latch": True, "queue_size": 5, "qos": {"depth": 2}},
    {"op": "publish", "topic": "/t", "msg": {"data": "x", "list": [1, -2.5e3, None, True]}, "id": 7},
    {
        "op": "subscribe",
        "topic": "/t",
        "throttle_rate": 5,
        "queue_length": 2,
        "fragment_size": 99,
        "compression": "png",
    },
    {"op": "unsubscribe", "topic": "/t", "id": "s", "ropeway": {"channel": 3}},
    {"op": "fragment", "id": "f", "data": '{"op":', "num": 0, "total": 2},
    {"op": "call_service", "service": "/s#1", "args": [1, 2], "timeout": 0.5},
    {"op": "service_response", "service": "/s", "values": {}, "result": True, "id": "c"},
    {"op": "send_action_goal", **_GOAL, "args": {"order": 1}, "feedback": True},
    {"op": "action_result", "action": "/a", "id": "g", "values": {}, "result": False, "status": 6},
    {"op": "action_feedback", "action": "/a", "id": "g", "values": {"sequence": [0]}},
    {"op": "png", "data": "iVBORw0KGgo="},
    {"op": "status", "level": "error", "msg": "no"},
)
"""One good operation of most kinds."""

_WORDS: Final = (
    b'{"op":"',
    b'"',
    b'":',
    b"},",
    b"[[",
    b"\\ud800",
    b"1e999",
    b"NaN",
    b"-Infinity",
    b"null",
    *(f'"{key}"'.encode() for key in ("op", "topic", "type", "id", "msg", "qos", "num", "total", "data", "ropeway")),
)


def _json(data: bytes) -> None:
    for message in loads(data, text=True):
        ops.parse(message)


def _stream(data: bytes) -> None:
    """Frames between bytes that no text has."""
    assembler = JsonAssembler(limit_bytes=_LIMIT_BYTES)
    for frame in data.split(b"\xff"):
        try:
            found = assembler.feed(frame, text=True)
        except InvalidFrame:
            continue
        finally:
            assert assembler.pending_bytes <= _LIMIT_BYTES
        assert all(isinstance(message, dict) for message in found)


def _cbor(data: bytes) -> None:
    for message in loads(data, text=False):
        ops.dumps({"id": ops.parse(message).to_dict().get("id")})  # an answer repeats it


def _fragments(data: bytes) -> None:
    """Lines of JSON, each a fragment as far as it goes."""
    together = Defragmenter(limit_bytes=_LIMIT_BYTES, limit_texts=16)
    for line in data.split(b"\n"):
        try:
            for message in loads(line, text=True):
                fragment = ops.parse(message)
                if isinstance(fragment, ops.Fragment):
                    together.add(fragment)
        except (InvalidFrame, InvalidOperation):
            continue
        finally:
            assert together.pending_bytes <= _LIMIT_BYTES
            assert together.pending <= 16


def _texts() -> Iterator[bytes]:
    yield from (json.dumps(operation).encode() for operation in OPERATIONS)
    yield from (b'{"op":"publish","topic":"/t","msg":{"data":' + value + b"}}" for value in NESTED_JSON)


def _maps() -> Iterator[bytes]:
    yield from map(cbor2.dumps, OPERATIONS)
    yield from (b"\xa1\x62op" + value for value in NESTED_CBOR)


def _pieces() -> Iterator[bytes]:
    text = json.dumps(OPERATIONS[1])
    parts = [{"op": "fragment", "id": 1, "num": n, "total": 3, "data": text[n * 30 : n * 30 + 30]} for n in range(3)]
    yield b"\n".join(json.dumps(part).encode() for part in parts)


TARGETS: Final = {
    "json-operations": Target(_json, (InvalidFrame, InvalidOperation), _texts, _WORDS),
    "json-stream": Target(_stream, (), lambda: [b"\xff".join(_texts()), b'{"op":\xff "x"}{}'], _WORDS),
    "cbor-operations": Target(_cbor, (InvalidFrame, InvalidOperation), _maps, (b"\xd8\x52", b"\xc2", b"\xfb")),
    "fragments": Target(_fragments, (), _pieces, _WORDS),
}
