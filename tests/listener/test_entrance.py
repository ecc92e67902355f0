"""ropeway.listener.entrance: how whoever may not come in is answered, counted and logged."""

from __future__ import annotations

import logging

import pytest

from ropeway.limits import WRONG_TOKENS
from ropeway.listener.authentication import Door, Rejection, TokenRule
from ropeway.listener.authorization import EVERYTHING, Role
from ropeway.listener.http import HttpRequest
from tests.support.place import Place
from tests.support.websocket import fetch

pytestmark = pytest.mark.jumping

TOKENS = [TokenRule.plain("open-sesame", EVERYTHING)]


async def answered(place: Place, **headers: str) -> tuple[int, int]:
    """The status of a WebSocket handshake and of a GET with these headers."""
    client = await place.client(headers=headers)
    return int(client.status.split(" ")[1]), (await fetch(place.port, "/", headers=headers)).status


async def test_a_page_of_a_stranger(place: Place, caplog: pytest.LogCaptureFixture) -> None:
    """By default a page of a stranger is refused over WebSocket and HTTP; the answer says which key it needs."""
    assert await answered(place, Origin="https://evil.example") == (403, 403)
    answer = await fetch(place.port, "/healthz", headers={"Origin": "https://evil.example"})
    assert b"gateway.auth.origins" in answer.body
    assert b"https://evil.example" in answer.body
    assert "Access-Control-Allow-Origin" not in answer.headers
    assert "gateway.auth.origins" in caplog.text
    assert place.entrance.refused == {"403 web pages of this origin may not connect": 3}


@pytest.mark.parametrize("origin", ["http://localhost:3000", "http://127.0.0.1:8000", "http://[::1]"])
async def test_a_page_of_this_machine(place: Place, origin: str) -> None:
    """A page that another port of this machine serves may connect, and read the answers."""
    assert await answered(place, Origin=origin) == (101, 200)
    answer = await fetch(place.port, "/", headers={"Origin": origin})
    assert answer.headers["Access-Control-Allow-Origin"] == origin


async def test_another_name(place: Place, caplog: pytest.LogCaptureFixture) -> None:
    """A page under a name that is not ours is refused, and told which key makes it ours; a program comes in."""
    assert (await fetch(place.port, "/", host="evil.example:9090")).status == 403
    answer = await fetch(place.port, "/", host="evil.example")
    assert b"gateway.auth.hosts" in answer.body
    client = await place.client(named="evil.example", headers={"Origin": "http://localhost"})
    assert client.status.split(" ")[1] == "403"
    assert (await place.client(named="cloud.example")).status.split(" ")[1] == "101"
    assert "gateway.auth.hosts" in caplog.text
    assert place.entrance.refused == {"403 this is not known as a name of this server": 3}


async def test_a_token_is_enough(bare: Place) -> None:
    """A page that shows a token may use any name for us; one that shows none may not."""
    await bare.start(door=Door(TOKENS, default=Role("viewer", {})))
    page = {"Origin": "http://localhost"}
    shown = {**page, "Authorization": "Bearer open-sesame"}
    assert (await bare.client(named="cloud.example", headers=shown)).status[9:12] == "101"
    assert (await bare.client(named="cloud.example", headers=page)).status[9:12] == "403"


async def test_guessing(bare: Place, caplog: pytest.LogCaptureFixture) -> None:
    """After too many wrong tokens no token of that address is looked at, not the right one either; others come in."""
    caplog.set_level(logging.WARNING)
    await bare.start(door=Door(TOKENS, default=Role("viewer", {})))
    request = {"Authorization": "Bearer wrong"}
    entrance = bare.entrance
    for _ in range(WRONG_TOKENS - 2):
        entrance.lockout.wrong("127.0.0.1")
    assert (await bare.client(headers=request)).status[9:12] == "401"
    assert (await bare.client(headers=request)).status[9:12] == "401"
    locked = await bare.client(headers={"Authorization": "Bearer open-sesame"})
    assert locked.status[9:12] == "429"
    assert int(locked.headers["Retry-After"]) >= 1
    assert (await bare.client()).status[9:12] == "101"
    assert entrance.status()["tokens"]["locked out"] == 1
    assert entrance.refused["429 too many wrong tokens"] == 1
    assert "too many wrong tokens" in caplog.text
    assert "sesame" not in caplog.text


def test_what_is_counted() -> None:
    """What refusals are counted under has no word of the client's, so the counts are bounded."""
    door = Door()
    found = {
        made.reason
        for name in ("a.example", "b.example")
        for made in [door.refuses(HttpRequest("GET", "/", "HTTP/1.1", {"host": name, "origin": f"http://{name}"}))]
        if isinstance(made, Rejection)
    }
    assert len(found) == 1
