"""Who may look at the dashboard."""

from __future__ import annotations

import asyncio

import httpx
import pytest

from tests.control.conftest import Begin
from tests.dashboard.conftest import KEY, Serve

HTML = {"accept": "text/html"}
TOKEN = "0123456789abcdef"


@pytest.fixture(autouse=True)
def token(monkeypatch: pytest.MonkeyPatch) -> None:
    """The token of the configurations here."""
    monkeypatch.setenv("WATCHER", TOKEN)


async def test_nobody_sees_a_page_without_a_login(begin: Begin, serve: Serve) -> None:
    """Pages lead to the login, and everything else is refused."""
    dashboard = await serve(await begin())
    async with httpx.AsyncClient(base_url=dashboard.root) as client:
        page = await client.get("/", headers=HTML)
        assert (page.status_code, page.headers["location"]) == (303, "/login")
        assert (await client.get("/_nicegui/anything")).status_code == 401
        assert "frame-ancestors 'none'" in (await client.get("/login")).headers["content-security-policy"]


async def test_a_wrong_token(begin: Begin, serve: Serve) -> None:
    """A wrong secret is refused with a sentence; after some no token is passed on, and the key goes on to work."""
    robot = await begin(
        control={"listen": ["http://127.0.0.1:0"]}, auth={"tokens": [{"token": {"env": "WATCHER"}, "role": "all"}]}
    )
    dashboard = await serve(robot.control.addresses[0])
    async with httpx.AsyncClient(base_url=dashboard.root) as client:
        refused = await client.post("/login", data={"secret": "<b>wrong</b>"})
        assert refused.status_code == 401, refused.text[-600:]
        assert "No gateway knows this token" in refused.text
        statuses = [(await client.post("/login", data={"secret": "wrong"})).status_code for _ in range(6)]
        assert statuses == [401] * 4 + [429] * 2
        assert (await client.post("/login", data={"secret": KEY})).status_code == 303
    assert robot.control.status()["tokens"] == {"wrong tokens": 5, "lockouts": 0, "locked out": 0}


async def test_a_wrong_key(begin: Begin, serve: Serve) -> None:
    """Whoever guesses the key is locked out, also with the right one."""
    dashboard = await serve(await begin())
    async with httpx.AsyncClient(base_url=dashboard.root) as client:
        tried = [(await client.post("/login", data={"secret": "wrong"})).status_code for _ in range(12)]
        assert tried[-1] == 429
        assert (await client.post("/login", data={"secret": KEY})).status_code == 429


@pytest.mark.parametrize("origin", ["http://evil.example", "null"])
async def test_sockets_of_strangers(begin: Begin, serve: Serve, origin: str) -> None:
    """A WebSocket that a page of another site opens is refused, with the cookie of who is logged in."""
    dashboard = await serve(await begin())
    async with httpx.AsyncClient(base_url=dashboard.root) as client:
        assert (await client.get(dashboard.url)).status_code == 303
        cookie = "; ".join(f"{name}={value}" for name, value in client.cookies.items())
    head = {
        "Host": f"127.0.0.1:{dashboard.port}",
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Version": "13",
        "Cookie": cookie,
        "Origin": origin,
    }
    reader, writer = await asyncio.open_connection("127.0.0.1", dashboard.port)
    lines = [f"{name}: {value}" for name, value in head.items()]
    writer.write("\r\n".join(["GET /socket.io/?EIO=4&transport=websocket HTTP/1.1", *lines, "", ""]).encode())
    assert b" 403 " in await reader.readline()
    writer.close()


async def test_a_token_of_a_gateway(begin: Begin, serve: Serve) -> None:
    """A token that a gateway takes lets its owner in."""
    robot = await begin(
        control={"listen": ["http://127.0.0.1:0"]},
        auth={
            "tokens": [{"token": {"env": "WATCHER"}, "role": "watcher"}],
            "roles": {"watcher": {"control": ["observe"]}},
        },
    )
    dashboard = await serve(robot.control.addresses[0])
    async with httpx.AsyncClient(base_url=dashboard.root) as client:
        let_in = await client.post("/login", data={"secret": TOKEN})
        assert (let_in.status_code, let_in.headers["location"]) == (303, "/")
        assert (await client.get("/", headers=HTML)).status_code == 200
        assert (await client.post("/logout")).status_code == 303
        assert (await client.get("/", headers=HTML)).status_code == 303


@pytest.mark.parametrize("headers", [{"host": "evil.example"}, {"origin": "http://evil.example"}])
async def test_names_and_pages_of_strangers(begin: Begin, serve: Serve, headers: dict[str, str]) -> None:
    """A name that was made to lead here, and a page of another site, get nothing, whatever they show."""
    dashboard = await serve(await begin())
    async with httpx.AsyncClient() as client:
        assert (await client.get(dashboard.url, headers=headers)).status_code == 403


async def test_a_login_that_is_too_long(begin: Begin, serve: Serve) -> None:
    """A login of megabytes is refused, and the next one works."""
    dashboard = await serve(await begin())
    async with httpx.AsyncClient(base_url=dashboard.root) as client:
        assert (await client.post("/login", data={"secret": "x" * (1 << 20)})).status_code == 401
        assert (await client.post("/login", data={"secret": KEY})).status_code == 303
