"""Makes requests of many kinds that no client of the control API would send."""

from __future__ import annotations

import json
import random
from typing import Final

__all__ = ["hostile_request"]

_PATHS: Final = (
    "/v1/status",
    "/v1/config",
    "/v1/config/plan",
    "/v1/config/rollback",
    "/v1/config/history",
    "/v1/config/history/%s",
    "/v1/routes",
    "/v1/routes/%s",
    "/v1/routes/%s/pause",
    "/v1/sessions/%s",
    "/v1/events?after=%s",
    "/v1/events/stream?after=%s",
    "/v1/explain?name=%s&to=%s",
    "/v1/anycast/switch",
    "/metrics",
    "/openapi.json",
    "/%s",
)
_METHODS: Final = ("GET", "HEAD", "PUT", "POST", "DELETE", "PATCH", "OPTIONS", "TRACE", "CONNECT", "PRI", "get", "\x00")
_WORDS: Final = (
    "%00",
    "..%2f..%2fetc%2fpasswd",
    "9" * 400,
    "-1",
    "%ff%fe",
    "%",
    "x" * 3_000,
    "%F0%9F%9A%A0",
    "' OR 1=1 --",
    "{{7*7}}",
    "\u00e9",
    "\\",
    "//",
)
_HEADERS: Final = (
    "content-length: -1",
    "content-length: 99999999999999999999",
    "content-length: 5\r\ncontent-length: 6",
    "transfer-encoding: chunked\r\ncontent-length: 3",
    "transfer-encoding: gzip, chunked",
    "expect: 100-continue",
    "upgrade: websocket\r\nconnection: upgrade",
    "if-match: " + '"' * 500,
    "last-event-id: " + "9" * 500,
    "accept: application/openmetrics-text;version=x",
    "accept: " + "text/plain;version=1.0.0," * 300,
    "origin: null",
    "host: evil.example",
    "authorization: Bearer \xff\xfe",
    "authorization: Basic Og==",
    "content-type: application/json; charset=utf-7",
    "content-type: text/plain",
    "x: " + "y" * 20_000,
    "x y: z",
    " folded",
    "\x00: \x00",
)
_STRANGE: Final = (
    "[" * 100_000,
    '{"config":' * 20_000,
    '{"config": ' + "[" * 5_000 + "]" * 5_000 + "}",
    "9" * 50_000,
    '{"config": 1e999, "directory": "\\u0000"}',
    '{"config": {"gateway": ["\\ud800"]}}',
    "NaN",
    '"' + "\\" * 9_999,
    '{"a": 1, "a": 2}',
    "{" + ",".join(f'"k{i}": {i}' for i in range(5_000)) + "}",
    '{"number": 123456789012345678901234567890}',
    "\x00" * 1_000,
    "\xff\xfe\xfd",
    "",
)


def hostile_request(dice: random.Random) -> bytes:
    """Return the bytes of a request, or of what pretends to be one. None of them is a change that could be made."""
    kind = dice.randrange(10)
    if kind == 0:
        return dice.randbytes(dice.randrange(1, 2_000))
    if kind == 1:  # HTTP/2, TLS and others at the wrong door
        return dice.choice(
            (b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03", b"\r\n" * 500)
        )
    if kind == 2:  # one after the other without waiting
        return b"".join(_request(dice) for _ in range(dice.randrange(2, 8)))
    whole = _request(dice)
    if kind == 3:  # broken off
        return whole[: dice.randrange(1, len(whole))]
    if kind == 4:  # some bytes are others
        changed = bytearray(whole)
        for _ in range(dice.randrange(1, 8)):
            changed[dice.randrange(len(changed))] = dice.randrange(256)
        return bytes(changed)
    return whole


def _request(dice: random.Random) -> bytes:
    path = dice.choice(_PATHS)
    target = path.replace("%s", dice.choice(_WORDS)).replace(" ", "+")
    body = _body(dice)
    lines = [f"{dice.choice(_METHODS)} {target} HTTP/{dice.choice(('1.1', '1.1', '1.0', '2.0'))}", "host: x"]
    if dice.random() < 0.7:
        lines.append("content-type: application/json")
    for _ in range(dice.choice((0, 0, 1, 2, 200))):
        lines.append(dice.choice(_HEADERS))
    if dice.random() < 0.8:
        lines.append(f"content-length: {len(body) + dice.choice((0, 0, 0, 0, 1, -1)) * min(len(body), 1)}")
    return "\r\n".join(lines).encode("latin-1", "replace") + b"\r\n\r\n" + body


def _body(dice: random.Random) -> bytes:
    """Return a body; where it is a configuration, it has a key that there is not."""
    kind = dice.randrange(4)
    if kind == 0:
        return b""
    if kind == 1:
        return dice.choice(_STRANGE).encode("latin-1", "replace")
    value = _value(dice, 4)
    if kind == 2:
        return json.dumps({"config": {"gateway": {"hostile": value}}, "note": dice.choice(_WORDS)}).encode()
    return json.dumps({"remote": value, "operation": "publish", "item": {"hostile": value}, "number": -1}).encode()


def _value(dice: random.Random, depth: int) -> object:
    if depth and dice.random() < 0.5:
        return {dice.choice(_WORDS)[:50]: _value(dice, depth - 1) for _ in range(dice.randrange(4))}
    if depth and dice.random() < 0.3:
        return [_value(dice, depth - 1) for _ in range(dice.randrange(4))]
    return dice.choice((None, True, -1, 1 << 70, 1.5e300, dice.choice(_WORDS)))
