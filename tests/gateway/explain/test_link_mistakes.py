"""Mistakes about links are explained, each with its cause."""

from __future__ import annotations

import contextlib
import socket
from pathlib import Path
from typing import Any

import pytest

from ropeway.gateway.explain import Subject
from ropeway.gateway.gateway import Gateway
from ropeway.networks.overlay.crypto.identity import Identity, write_private
from ropeway.networks.overlay.fleet import Fleet
from ropeway.networks.overlay.rights import Rights
from ropeway.networks.overlay.router import Router
from tests.networks.overlay.conftest import Site
from tests.networks.overlay.conftest import site as site
from tests.networks.overlay.fleet import member
from tests.support.authority import Authority
from tests.support.messages import STRING
from tests.support.ports import free_endpoint, free_port
from tests.support.until import until
from tests.support.world import World

ROUTE = {"name": "/odom", "type": STRING}


async def told(world: World, address: str, **remote: Any) -> str:
    """Return what a gateway explains about a link that cannot be made."""
    robot = await world.gateway("robot", [{"address": address, "publish": [ROUTE], **remote}])
    here = await world.robot("robot")
    await here.create_publisher("/odom", STRING)
    await until(lambda: bool(robot.status()["remotes"][0]["error"]))
    (explanation,) = await robot.explain("/odom")
    (link,) = [finding for finding in explanation.findings if finding.subject is Subject.LINK]
    assert link.ok is False
    assert not explanation.crosses
    return link.text


def port(gateway: Gateway) -> int:
    """Return the port of the first listener."""
    return gateway.servers[0].listeners[0].port


async def test_an_unknown_host(world: World) -> None:
    """A host that has no address is told."""
    assert "nowhere.invalid" in await told(world, "ws://nowhere.invalid:9090")


async def test_a_wrong_token(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    """A token that the remote does not know is told as such."""
    monkeypatch.setenv("ROPEWAY_TEST_TOKEN", "for-tests-only")
    monkeypatch.setenv("ROPEWAY_TEST_WRONG", "another-for-tests")
    auth = {"tokens": [{"token": {"env": "ROPEWAY_TEST_TOKEN"}, "role": "all"}]}
    cloud = await world.gateway("cloud", [], auth=auth)
    text = await told(world, f"ws://127.0.0.1:{port(cloud)}", token={"env": "ROPEWAY_TEST_WRONG"})
    assert "401" in text
    assert "token" in text


async def test_nobody_there(world: World) -> None:
    """A port at which nobody listens is told as such."""
    assert "refused" in await told(world, f"ws://127.0.0.1:{free_port()}")


async def test_a_token_that_is_missing(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    """A remote that wants a token is told as such to who shows none."""
    monkeypatch.setenv("ROPEWAY_TEST_TOKEN", "for-tests-only")
    auth = {"tokens": [{"token": {"env": "ROPEWAY_TEST_TOKEN"}, "role": "all"}]}
    cloud = await world.gateway("cloud", [], auth=auth)
    text = await told(world, f"ws://127.0.0.1:{port(cloud)}")
    assert "401" in text
    assert "token" in text


async def test_a_certificate_of_another_host(world: World, tmp_path: Path) -> None:
    """A certificate that was made out to another name is told with the name that was dialled."""
    ours = Authority(tmp_path, "ours")
    tls = ours.sign("cloud", host="other.example")
    cloud = await world.gateway("cloud", [], listen=["wss://127.0.0.1:0"], tls=tls)
    text = await told(world, f"wss://127.0.0.1:{port(cloud)}", tls={"ca": ours.file})
    assert "not valid for" in text or "mismatch" in text, text


async def test_an_authority_that_is_not_trusted(world: World, tmp_path: Path) -> None:
    """A certificate of another authority is told, with the key that names the right one."""
    tls = Authority(tmp_path, "ours").sign("cloud")
    cloud = await world.gateway("cloud", [], listen=["wss://127.0.0.1:0"], tls=tls)
    other = Authority(tmp_path, "another").file
    text = await told(world, f"wss://127.0.0.1:{port(cloud)}", tls={"ca": other})
    assert "not trusted" in text
    assert "tls.ca" in text


async def test_ws_and_wss_mixed_up(world: World, tmp_path: Path) -> None:
    """A remote that speaks the other of ws and wss is told."""
    tls = Authority(tmp_path, "ours").sign("cloud")
    cloud = await world.gateway("cloud", [], listen=["wss://127.0.0.1:0"], tls=tls)
    assert "wss://" in await told(world, f"ws://127.0.0.1:{port(cloud)}")


async def test_wss_where_ws_is_spoken(world: World) -> None:
    """A remote that speaks no TLS is told with what it speaks."""
    cloud = await world.gateway("cloud", [])
    assert "ws://" in (await told(world, f"wss://127.0.0.1:{port(cloud)}")).partition(": ")[2]


@pytest.mark.parametrize("shown", ["nothing", "a stranger's"])
async def test_a_client_certificate_that_is_missing_or_wrong(world: World, tmp_path: Path, shown: str) -> None:
    """A remote that asks for a certificate of its own authority is told as such."""
    ours = Authority(tmp_path, "ours")
    tls = {**ours.sign("cloud"), "ca": ours.file}
    cloud = await world.gateway("cloud", [], listen=["wss://127.0.0.1:0"], tls=tls)
    mine = {} if shown == "nothing" else Authority(tmp_path, "another").sign("robot")
    text = await told(world, f"wss://127.0.0.1:{port(cloud)}", tls={"ca": ours.file, **mine})
    assert "certificate" in text
    assert "tls.certificate" in text


async def test_packets_that_vanish(world: World) -> None:
    """An address that answers nothing at all, as behind a firewall, is told as such."""
    with socket.create_server(("127.0.0.1", 0), backlog=0) as hole, contextlib.ExitStack() as stack:
        address = hole.getsockname()
        for _ in range(4):  # what waits to be accepted fills it: from then on the kernel drops what comes
            filler = stack.enter_context(socket.socket())
            filler.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                filler.connect(address)
        text = await told(world, f"ws://127.0.0.1:{address[1]}")
    assert "no answer" in text


async def in_the_overlay(world: World, directory: Path, endpoint: str, identity: Identity | None = None) -> str:
    """Return what a member explains about its way into the overlay through a router that does not take it."""
    bundle = directory / "robot.ropeway"
    write_private(bundle, (identity or member("robot")).to_text())
    overlay = {"identity": str(bundle), "routers": [endpoint], "listen": []}
    remote = {"address": "overlay", "publish": [ROUTE]}
    robot = await world.gateway("robot", [remote], overlay=overlay, listen=[], insecure=True)
    here = await world.robot("robot")
    await here.create_publisher("/odom", STRING)
    await until(lambda: bool(robot.status()["remotes"][0]["error"]))
    (explanation,) = await robot.explain("/odom")
    return next(finding.text for finding in explanation.findings if finding.subject is Subject.LINK)


async def test_a_router_that_is_away(world: World, tmp_path: Path) -> None:
    """A router of the overlay that cannot be reached is told with its address."""
    endpoint = f"tls/127.0.0.1:{free_port()}"
    assert endpoint.removeprefix("tls/") in await in_the_overlay(world, tmp_path, endpoint)


async def test_a_router_of_another_fleet(world: World, tmp_path: Path) -> None:
    """A router of the overlay that belongs to another fleet is told as such."""
    endpoint = free_endpoint()
    router = Router(member("router", role="router"), listen=[endpoint])
    await world.stack.enter_async_context(router)
    stranger = Fleet.create("other", tmp_path / "other").issue("robot")
    assert "another fleet" in await in_the_overlay(world, tmp_path, endpoint, stranger)


async def test_a_certificate_without_the_right(world: World, site: Site, tmp_path: Path) -> None:
    """A member whose certificate does not let it publish a name is told which right it lacks."""
    bundle = tmp_path / "robot.ropeway"
    write_private(bundle, member("robot", rights=Rights(publish=("/camera/*",))).to_text())
    overlay = {"identity": str(bundle), "routers": [site.endpoint], "listen": []}
    remote = {"address": "overlay", "publish": [ROUTE]}
    robot = await world.gateway("robot", [remote], overlay=overlay, listen=[], insecure=True)
    here = await world.robot("robot")
    await here.create_publisher("/odom", STRING)
    await until(lambda: bool(robot.routes()[0].error))
    (explanation,) = await robot.explain("/odom")
    (said,) = [finding.text for finding in explanation.findings if finding.subject is Subject.RIGHTS]
    assert "publish" in said
    assert "/odom" in said


async def test_a_member_that_was_revoked(world: World, tmp_path: Path) -> None:
    """A member whose certificate was revoked is told so."""
    fleet = Fleet.create("revoking", tmp_path / "revoking")
    identity = fleet.issue("robot")
    fleet.revoke("robot")
    endpoint = free_endpoint()
    await world.stack.enter_async_context(Router(fleet.issue("router", role="router"), listen=[endpoint]))
    assert "revoked" in await in_the_overlay(world, tmp_path, endpoint, identity)
