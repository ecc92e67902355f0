"""ropeway.listener.http: the heads of requests, and answers."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.errors import InvalidFrame
from ropeway.listener.http import Response, parse_head, reply, without_token

NAMES = st.text("abcXYZ-019!#$%&'*+.^_`|~", min_size=1, max_size=12)
VALUES = st.text(st.characters(min_codepoint=33, max_codepoint=126), max_size=30)


def head(*lines: str) -> bytes:
    return "\r\n".join([*lines, "", ""]).encode("latin-1")


def test_a_browser() -> None:
    """A head gives method, path, query, headers in lower case and subprotocols."""
    request = parse_head(
        head(
            "GET /ros?token=a%20b&x=1&token=c HTTP/1.1",
            "Host: robot:9090",
            "Connection: keep-alive, Upgrade",
            "UPGRADE:  websocket",
            "Sec-WebSocket-Protocol: rosbridge, bearer.x",
            "Sec-WebSocket-Protocol: ropeway.1",
        )
    )
    assert (request.method, request.path, request.version) == ("GET", "/ros", "HTTP/1.1")
    assert request.query == {"token": ["a b", "c"], "x": ["1"]}
    assert request.headers["host"] == "robot:9090"
    assert request.subprotocols == ("rosbridge", "bearer.x", "ropeway.1")
    assert request.upgrades


@pytest.mark.parametrize("target", ["", "?a=b", "http://robot:9090", "http://robot:9090/?x"])
def test_root(target: str) -> None:
    """An empty path is the root."""
    if target == "":
        with pytest.raises(InvalidFrame):
            parse_head(head("GET  HTTP/1.1"))
    else:
        assert parse_head(head(f"GET {target} HTTP/1.1")).path == "/"


@pytest.mark.parametrize(
    "lines",
    [
        [""],
        ["GET"],
        ["GET / HTTP/2"],
        ["GET / x HTTP/1.1"],
        ["G\x00T / HTTP/1.1"],
        ["GET /\xe9 HTTP/1.1"],
        ["GET http://[::1 HTTP/1.1"],
        ["GET / HTTP/1.1", "no colon"],
        ["GET / HTTP/1.1", " folded: line"],
        ["GET / HTTP/1.1", "name : value"],
        ["GET / HTTP/1.1", "name: a\x00b"],
        ["GET / HTTP/1.1", "name: a\nb: c"],
        ["GET / HTTP/1.1", "Authorization: Bearer a", "authorization: Bearer b"],
        ["GET / HTTP/1.1", *("a: b",) * 129],
    ],
)
def test_malformed(lines: list[str]) -> None:
    """What is no request, or can be read in two ways, is refused."""
    with pytest.raises(InvalidFrame):
        parse_head(head(*lines))


@given(st.binary(max_size=300))
def test_any_bytes(data: bytes) -> None:
    """Any bytes are a request or an ``InvalidFrame``."""
    try:
        request = parse_head(data + b"\r\n\r\n")
    except InvalidFrame:
        return
    assert request.path
    assert isinstance(request.query, dict)


@given(st.dictionaries(NAMES, VALUES, max_size=8))
def test_headers(given: dict[str, str]) -> None:
    """Every header comes out as it was written, whatever the case of its name."""
    lower = {name.lower(): value for name, value in given.items()}
    assert parse_head(head("GET / HTTP/1.0", *(f"{n}:\t{v} " for n, v in lower.items()))).headers == lower


def test_an_answer() -> None:
    """An answer names its length and closes; without body it is the answer to ``HEAD``."""
    response = reply(503, {"reasons": ["é"]}, Retry_After="10")
    top, body = response.encode().split(b"\r\n\r\n")
    assert json.loads(body) == {"reasons": ["é"]}
    lines = top.decode().split("\r\n")
    assert lines[0] == "HTTP/1.1 503 Service Unavailable"
    assert {"Retry-After: 10", "Connection: close", f"Content-Length: {len(body)}"} <= set(lines)
    assert response.encode(body=False) == top + b"\r\n\r\n"
    assert Response(200).encode().endswith(b"\r\n\r\n")


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("ws://host:9090/?token=secret", "ws://host:9090/?token=..."),
        ("ws://host/a?x=1&access_token=secret&y=2", "ws://host/a?x=1&access_token=...&y=2"),
        ("ws://host/?mytoken=1", "ws://host/?mytoken=1"),
        ("ws://host/", "ws://host/"),
    ],
)
def test_addresses_that_are_shown(url: str, shown: str) -> None:
    """An address is shown without the token in its query."""
    assert without_token(url) == shown
