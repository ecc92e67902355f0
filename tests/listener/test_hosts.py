"""ropeway.listener.hosts: which pages may talk to the server, and under which names it is reached."""

from __future__ import annotations

import pytest

from ropeway.listener.hosts import Hosts, host_of, own_names
from ropeway.listener.http import HttpRequest

NAMES = frozenset(("robot", "robot.local", "robot.example.com"))


WEBSOCKET = {"connection": "Upgrade", "upgrade": "websocket", "sec-websocket-key": "dGhlIHNhbXBsZSBub25jZQ=="}


def request(host: str = "127.0.0.1:9090", origin: str = "", local: str = "127.0.0.1", **more: str) -> HttpRequest:
    headers = {**({"host": host} if host else {}), **({"origin": origin} if origin else {}), **more}
    return HttpRequest("GET", "/", "HTTP/1.1", headers, local=local)


@pytest.mark.parametrize(
    ("authority", "host"),
    [
        ("Robot.Local.:9090", "robot.local"),
        ("[::1]:9090", "::1"),
        ("[FE80::1%25eth0]", "fe80::1"),
        ("10.0.0.7", "10.0.0.7"),
        ("a b", ""),
        ("::1", ""),
        ("robot:port", ""),
        ("user@robot", ""),
        ("", ""),
    ],
)
def test_one_spelling(authority: str, host: str) -> None:
    """A host has one spelling: without port, brackets, zone, capitals and the dot at its end."""
    assert host_of(authority) == host


@pytest.mark.parametrize(
    ("host", "local", "known"),
    [
        ("", "127.0.0.1", True),  # no browser leaves it out
        ("localhost:9090", "127.0.0.1", True),
        ("LOCALHOST.", "127.0.0.1", True),
        ("app.localhost:1", "127.0.0.1", True),
        ("127.0.0.2", "127.0.0.1", True),
        ("[::1]:9090", "::1", True),
        ("[::ffff:127.0.0.1]:9090", "::1", True),
        ("0.0.0.0:9090", "127.0.0.1", True),
        ("ROBOT.Local.:9090", "127.0.0.1", True),
        ("evil.example", "127.0.0.1", False),
        ("localhost.evil.example", "127.0.0.1", False),
        ("robot.local.evil.example", "10.0.0.7", False),
        ("127.0.0.1.evil.example", "10.0.0.7", False),
        ("192.0.2.1:9090", "127.0.0.1", False),
        ("10.0.0.7:9090", "10.0.0.7", True),
        ("192.0.2.1:9090", "10.0.0.7", True),  # ours as others have it, behind a router
        ("[2001:db8::1]:9090", "fd00::7", True),
        ("evil.example:9090", "10.0.0.7", False),
        ("gate.lan", "10.0.0.7", True),
        ("x.cloud.example:443", "10.0.0.7", True),
        ("not a host", "10.0.0.7", False),
    ],
)
def test_names(host: str, local: str, known: bool) -> None:
    """``Host`` has to be a name of ours, or an address; within the machine an address of the machine."""
    assert Hosts(NAMES, ("gate.lan", "*.cloud.example")).knows(request(host, local=local)) is known


@pytest.mark.parametrize(
    ("origin", "host", "local", "may"),
    [
        ("", "localhost", "127.0.0.1", True),
        ("http://localhost:3000", "robot.local:9090", "10.0.0.7", True),
        ("HTTPS://LocalHost.", "robot.local:9090", "10.0.0.7", True),
        ("http://[::1]:8000", "[::1]:9090", "::1", True),
        ("http://0.0.0.0:8000", "localhost:9090", "127.0.0.1", True),
        ("http://robot.local", "10.0.0.7:9090", "10.0.0.7", True),
        ("http://10.0.0.7:8000", "robot.local:9090", "10.0.0.7", True),
        ("http://192.0.2.1", "192.0.2.1:9090", "10.0.0.7", True),  # the same machine, behind a router
        ("http://192.0.2.9", "192.0.2.1:9090", "10.0.0.7", False),
        ("https://evil.example", "localhost:9090", "127.0.0.1", False),
        ("https://evil.example", "evil.example:9090", "10.0.0.7", False),
        ("http://localhost.evil.example", "localhost", "127.0.0.1", False),
        ("http://evil.example#@localhost", "localhost", "127.0.0.1", False),
        ("http://localhost@evil.example", "localhost", "127.0.0.1", False),
        ("null", "localhost", "127.0.0.1", False),
        ("file://", "localhost", "127.0.0.1", False),
        ("chrome-extension://localhost", "localhost", "127.0.0.1", False),
        ("nonsense", "localhost", "127.0.0.1", False),
    ],
)
def test_pages(origin: str, host: str, local: str, may: bool) -> None:
    """Without a list, pages of the browser's own machine and of ours may connect, and no others."""
    assert Hosts(NAMES).knows_page(request(host, origin, local)) is may


@pytest.mark.parametrize(
    ("origins", "origin", "may"),
    [
        (("*",), "https://evil.example", True),
        (("null",), "null", True),
        (("file://*",), "file://", True),
        (("https://a.example",), "https://A.example", True),
        (("https://a.example",), "http://localhost:3000", False),
        ((), "http://localhost:3000", False),
    ],
)
def test_listed_pages(origins: tuple[str, ...], origin: str, may: bool) -> None:
    """With a list, the pages on it may connect, and no others."""
    assert Hosts(NAMES, origins=origins).knows_page(request(origin=origin)) is may


def test_own_names() -> None:
    """The machine is known by its host name, and by that of multicast DNS."""
    names = own_names()
    assert any(name.endswith(".local") for name in names)
    assert all(name == name.lower() for name in names)


@pytest.mark.parametrize("origins", [None, ("*",), ("https://dash.example",)])
@pytest.mark.parametrize("local", ["127.0.0.1", "10.0.0.7"])
def test_a_rebound_page_stays_out(origins: tuple[str, ...] | None, local: str) -> None:
    """Whatever a page can send to a name that it has turned to us is refused, also where all pages may connect."""
    hosts = Hosts(NAMES, origins=origins)
    sent = [
        request("evil.example:9090", "http://evil.example:9090", local, **WEBSOCKET),  # new WebSocket
        request("evil.example:9090", "null", local, **WEBSOCKET),  # the same in a frame without an origin
        request("evil.example:9090", "", local),  # fetch of its own name
        request("evil.example:9090", "", local, **{"sec-fetch-site": "same-origin", "sec-fetch-mode": "cors"}),
        request("evil.example:9090", "http://evil.example:9090", local),  # a POST to its own name
        request("evil.example:9090", "", local, upgrade="websocket"),  # what no script may set, were it let
    ]
    assert [hosts.knows(each) for each in sent] == [False] * len(sent)


@pytest.mark.parametrize("local", ["127.0.0.1", "10.0.0.7"])
def test_a_program_may_know_us_by_any_name(local: str) -> None:
    """A request for a WebSocket that names no page is no browser's, and may have found us under any name."""
    asked = request("cloud.example:9090", "", local, **WEBSOCKET)
    assert Hosts(NAMES).knows(asked)
    assert Hosts(NAMES).knows_page(asked)
