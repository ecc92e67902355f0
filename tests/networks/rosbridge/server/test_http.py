"""ropeway.networks.rosbridge.server.http: what a web page, a load balancer and a person with curl are told."""

from __future__ import annotations

import json
from typing import Any

import pytest

from ropeway import __version__
from ropeway.listener.authentication import Door, TokenRule
from ropeway.listener.authorization import EVERYTHING
from ropeway.listener.hosts import Hosts
from tests.support.place import Place
from tests.support.websocket import fetch

pytestmark = pytest.mark.jumping


async def test_versions(place: Place) -> None:
    """``/`` tells the version of the protocol and the server, with or without a query."""
    for path in ("/", "/?x=1"):
        answer = await fetch(place.port, path)
        assert answer.status == 200
        assert answer.headers["Content-Type"] == "application/json"
        assert json.loads(answer.body) == {
            "protocol": {"major": 2, "minor": 1, "patch": 0},
            "server": f"ropeway {__version__}",
        }


async def test_head(place: Place) -> None:
    """HEAD gives the head of the answer to GET, and no body."""
    got, head = await fetch(place.port, "/"), await fetch(place.port, "/", method="HEAD")
    assert (head.status, head.body) == (200, b"")
    assert head.headers == got.headers


async def test_health_and_readiness(bare: Place) -> None:
    """``/healthz`` is 200 while the server lives; ``/readyz`` is 503 with the reasons until there are none."""
    reasons = ["dds:0 is not open"]
    await bare.start(reasons=lambda: reasons)
    assert (await fetch(bare.port, "/healthz")).status == 200
    answer = await fetch(bare.port, "/readyz")
    assert answer.status == 503
    assert json.loads(answer.body) == {"status": "not ready", "reasons": ["dds:0 is not open"]}
    reasons.clear()
    assert (await fetch(bare.port, "/readyz")).status == 200


@pytest.mark.parametrize(
    ("path", "method", "status"),
    [("/other", "GET", 404), ("/other", "POST", 404), ("/", "POST", 405), ("/healthz", "DELETE", 405)],
)
async def test_other_requests(place: Place, path: str, method: str, status: int) -> None:
    """Other paths are 404 and other methods 405, in JSON."""
    answer = await fetch(place.port, path, method=method)
    assert answer.status == status
    assert json.loads(answer.body)["error"]
    assert ("Allow" in answer.headers) == (status == 405)


@pytest.mark.parametrize(
    ("origins", "allowed"),
    [(None, False), (("*",), True), (("https://*.example.com",), True), (("https://other.org",), False)],
)
async def test_web_pages(bare: Place, origins: Any, allowed: bool) -> None:
    """A page that may connect may also read the answers; a page that may not gets none."""
    await bare.start(door=Door(hosts=Hosts(origins=origins)))
    answer = await fetch(bare.port, "/", headers={"Origin": "https://dash.example.com"})
    assert answer.status == (200 if allowed else 403)
    assert answer.headers.get("Access-Control-Allow-Origin") == ("https://dash.example.com" if allowed else None)


async def test_no_token_is_needed(bare: Place) -> None:
    """Where clients need a token, these answers need none."""
    await bare.start(door=Door([TokenRule.plain("secret", EVERYTHING)], default=None))
    for path in ("/", "/healthz", "/readyz"):
        assert (await fetch(bare.port, path)).status == 200
