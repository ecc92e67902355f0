"""ropeway.listener.authentication: who comes in, and how the others are refused."""

from __future__ import annotations

import hashlib
import logging
from typing import Any

import pytest

from ropeway.listener.authentication import CertificateRule, Door, TokenRule, given_token, subprotocol, unserved
from ropeway.listener.authorization import EVERYTHING, Role
from ropeway.listener.hosts import Hosts
from ropeway.listener.http import HttpRequest, Response, parse_head
from tests.support.place import Place
from tests.support.until import until

OPERATOR = Role("operator", {"publish": ("*",), "call_service": ("*",)})
VIEWER = Role("viewer", {"subscribe": ("*",)})
TOKENS = (TokenRule.plain("open-sesame", OPERATOR), TokenRule.plain("just-looking", VIEWER))


def request(path: str = "/", **headers: str) -> HttpRequest:
    lines = [f"GET {path} HTTP/1.1", *(f"{name.replace('_', '-')}: {value}" for name, value in headers.items())]
    return parse_head("\r\n".join([*lines, "", ""]).encode())


@pytest.mark.parametrize(
    "asked",
    [
        request(authorization="Bearer open-sesame"),
        request(authorization="bearer   open-sesame"),
        request("/?token=open-sesame"),
        request("/?x=1&access_token=open-sesame"),
        request(sec_websocket_protocol="bearer.open-sesame"),
        request(sec_websocket_protocol="rosbridge, bearer.open%2Dsesame"),
        request("/?token=wrong", authorization="Bearer open-sesame"),
    ],
)
def test_ways_to_show_a_token(asked: HttpRequest) -> None:
    """A token comes as a header, in the query or as a subprotocol; the header goes first."""
    assert Door(TOKENS, default=None).role_of(asked) is OPERATOR


@pytest.mark.parametrize(
    "asked",
    [
        request(),
        request(authorization="Bearer"),
        request(authorization="Bearer wrong"),
        request(authorization="Basic open-sesame"),
        request("/?token="),
        request("/?token=open-sesam"),
        request(sec_websocket_protocol="bearer."),
        request(sec_websocket_protocol="open-sesame"),
    ],
)
def test_no_token(asked: HttpRequest) -> None:
    """Without the token the answer is 401, and says that a bearer token is wanted, but nothing of what was shown."""
    refused = Door(TOKENS, default=None).role_of(asked)
    assert isinstance(refused, Response)
    assert refused.status == 401
    assert refused.headers["WWW-Authenticate"].startswith('Bearer realm="ropeway"')
    assert b"sesam" not in refused.body


def test_default_role() -> None:
    """Who shows nothing has the default role; who shows a wrong token is refused all the same."""
    door = Door(TOKENS, default=VIEWER)
    assert door.role_of(request()) is VIEWER
    assert isinstance(door.role_of(request("/?token=wrong")), Response)
    assert Door().role_of(request("/?token=whatever")) is EVERYTHING


def test_hashes() -> None:
    """A token may be known by its hash only, with salt or without."""
    plain = hashlib.sha256(b"secret").hexdigest()
    salted = hashlib.sha256(b"pepper" + b"secret").hexdigest()
    for text in (f"sha256:{plain}", f"sha256:{plain.upper()}", f"sha256:pepper:{salted}"):
        rule = TokenRule.hashed(text, VIEWER)
        assert rule.fits("secret")
        assert not rule.fits("pepper")
    for text in ("secret", plain, f"md5:{plain}", f"sha256:{plain}0", "sha256:"):
        with pytest.raises(ValueError, match=r"^expected sha256:<64 hexadecimal digits>, or sha256:<salt>:<64"):
            TokenRule.hashed(text, VIEWER)


CERTIFICATE = {
    "subject": ((("organizationName", "Fleet"),), (("commonName", "robot-7"),)),
    "subjectAltName": (("DNS", "robot-7.fleet.example"), ("IP Address", "10.0.0.7")),
}


@pytest.mark.parametrize(
    ("rule", "fits"),
    [
        ({"common_name": "robot-*"}, True),
        ({"common_name": "robot-8"}, False),
        ({"san": "*.fleet.example"}, True),
        ({"san": "10.0.0.*"}, True),
        ({"san": "robot-7"}, False),
        ({"fingerprint": "AB:" * 31 + "AB"}, True),
        ({"fingerprint": "ac" * 32}, False),
        ({"common_name": "robot-*", "san": "*.other.example"}, False),
    ],
)
def test_certificates(rule: dict[str, str], fits: bool) -> None:
    """A certificate is known by name, alternative name or fingerprint; all that a rule names must fit."""
    made = CertificateRule(OPERATOR, **rule)
    asked = HttpRequest("GET", "/", "HTTP/1.1", {}, certificate=CERTIFICATE, fingerprint="ab" * 32)
    assert made.fits(asked) is fits
    assert not made.fits(request())
    role = Door(certificates=[made], default=None).role_of(asked)
    assert (role is OPERATOR) is fits


def test_token_before_certificate() -> None:
    """A token says more than the certificate beside it."""
    door = Door(TOKENS, [CertificateRule(OPERATOR, common_name="*")], None)
    headers = {"authorization": "Bearer just-looking"}
    assert door.role_of(HttpRequest("GET", "/", "HTTP/1.1", headers, certificate=CERTIFICATE)) is VIEWER
    assert door.role_of(HttpRequest("GET", "/", "HTTP/1.1", {}, certificate=CERTIFICATE)) is OPERATOR


@pytest.mark.parametrize(
    ("origin", "in_"),
    [
        ("", True),
        ("https://dash.example.com", True),
        ("HTTPS://DASH.EXAMPLE.COM", True),
        ("http://dash.example.com", False),
        ("https://example.com.evil.org", False),
        ("null", False),
    ],
)
def test_origins(origin: str, in_: bool) -> None:
    """Pages of other origins are refused with 403, whatever their token; programs that are no page may come."""
    door = Door(hosts=Hosts(origins=("https://*.example.com", "https://example.com")))
    got = door.role_of(request(**({"origin": origin} if origin else {})))
    assert isinstance(got, Role) is in_
    if isinstance(got, Response):
        assert got.status == 403


@pytest.mark.parametrize(
    ("offered", "chosen"),
    [
        ("", ""),
        ("other", ""),
        ("ropeway.1", "ropeway.1"),
        ("bearer.x, ropeway.1", "ropeway.1"),
        ("bearer.x, rosbridge", "rosbridge"),
        ("bearer.x", ""),
    ],
)
def test_subprotocols(offered: str, chosen: str) -> None:
    """A client is told a subprotocol that it offered, but never the one that carries its token."""
    assert subprotocol(request(**({"sec_websocket_protocol": offered} if offered else {}))) == chosen


@pytest.mark.parametrize("offered", ["foxglove.websocket.v1", "foxglove.sdk.v1, x", "ropeway.2"])
def test_subprotocols_of_others(offered: str) -> None:
    """Who offers subprotocols of others alone is told which are served; what was offered is not repeated."""
    told = unserved(request(sec_websocket_protocol=offered))
    assert "ropeway.1, rosbridge and none at all" in told
    assert offered not in told
    assert unserved(request(sec_websocket_protocol=f"{offered}, rosbridge")) == unserved(request()) == ""


def test_two_readings() -> None:
    """A subprotocol may be percent-encoded, as a browser does it; a token that contains a percent sign still fits."""
    assert given_token(request(sec_websocket_protocol="bearer.a%2Fb")) == ["a%2Fb", "a/b"]


# ── the server ─────────────────────────────────────────────────────────────────────────────────────────────────────


async def refused(place: Place, status: int, **options: Any) -> None:
    client = await place.client(**options)
    assert client.status.split(" ")[1] == str(status), client.status


async def test_handshakes(bare: Place, caplog: pytest.LogCaptureFixture) -> None:
    """Who is refused gets an HTTP answer, and is counted; no token stands in the log, however it came."""
    caplog.set_level(logging.DEBUG)
    await bare.start(door=Door(TOKENS, default=None, hosts=Hosts(origins=("https://ok.org",))))
    await refused(bare, 401)
    await refused(bare, 401, path="/?token=my-wrong-token")
    await refused(bare, 401, headers={"Authorization": "Bearer my-wrong-token"})
    await refused(bare, 403, headers={"Origin": "https://no.org", "Authorization": "Bearer open-sesame"})
    await refused(bare, 404, path="/other?token=open-sesame")
    client = await bare.client(headers={"Origin": "https://ok.org"}, subprotocol="bearer.open-sesame, rosbridge")
    assert client.status.startswith("HTTP/1.1 101")
    assert client.headers["Sec-WebSocket-Protocol"] == "rosbridge"
    client = await bare.client(path="/?token=just-looking")
    await until(lambda: len(bare.server.sessions) == 2)
    assert {session.access.role.name for session in bare.server.sessions} == {"operator", "viewer"}
    assert sum(bare.entrance.refused.values()) == 4
    assert not any("sesame" in line or "wrong-token" in line or "looking" in line for line in caplog.messages)


async def test_unserved_subprotocol(place: Place) -> None:
    """A viewer of another protocol is refused with 400 and a reason, which is counted; the server goes on."""
    await refused(place, 400, subprotocol="foxglove.websocket.v1")
    ((reason, count),) = place.entrance.refused.items()
    assert (reason[:3], count) == ("400", 1)
    assert (await place.client(subprotocol="rosbridge")).status.startswith("HTTP/1.1 101")


async def test_full(bare: Place) -> None:
    """Where no more clients may come, of a role or at all, the answer is 503; who leaves makes room."""
    single = Role("single", VIEWER.allow, max_clients=1)
    await bare.start(door=Door([TokenRule.plain("single", single)], default=VIEWER, max_clients=2))
    first = await bare.client(path="/?token=single")
    await refused(bare, 503, path="/?token=single")
    await bare.client()
    await refused(bare, 503)
    first.abort()
    await until(lambda: len(bare.server.sessions) == 1)
    again = await bare.client(path="/?token=single")
    assert again.status.startswith("HTTP/1.1 101")


async def test_another_door(bare: Place) -> None:
    """When tokens change, clients whose token is gone or means another role are closed with 1008; others stay."""
    await bare.start(door=Door(TOKENS, default=None))
    operator, viewer = await bare.client(path="/?token=open-sesame"), await bare.client(path="/?token=just-looking")
    await until(lambda: len(bare.server.sessions) == 2)
    bare.entrance.door = Door(TOKENS[1:], default=None)
    bare.server.recheck()
    code, reason = await operator.closed()
    assert code == 1008
    assert "has changed" in reason
    await viewer.done()
    await refused(bare, 401, path="/?token=open-sesame")
