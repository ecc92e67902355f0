"""Heads of HTTP requests."""

from __future__ import annotations

from typing import Final

from fuzz.target import Target
from ropeway.errors import InvalidFrame
from ropeway.listener.http import parse_head

__all__ = ["TARGETS"]

_SEED: Final = (
    b"GET /store/a?watch=1&x=%2F HTTP/1.1\r\nHost: a:1\r\nUpgrade: websocket\r\nOrigin: http://b\r\n"
    b"Sec-WebSocket-Protocol: ropeway.1, rosbridge_v2\r\nAuthorization: Bearer x\r\n\r\n"
)


def _head(data: bytes) -> None:
    request = parse_head(data)
    assert request.path
    _ = request.query, request.subprotocols, request.upgrades


TARGETS: Final = {
    "http-heads": Target(_head, (InvalidFrame,), lambda: [_SEED], (b"\r\n", b"HTTP/1.0", b"//[", b"?", b": "))
}
