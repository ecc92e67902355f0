"""Viewers of a gateway: at the port of rosbridge, and at one of their own, with roles and tokens."""

from __future__ import annotations

import asyncio
import logging
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ropeway.control.resources.sessions import disconnect
from ropeway.gateway.config.config import parse
from ropeway.gateway.gateway import Gateway
from tests.networks.foxglove.viewer import SDK, WEBSOCKET, Viewer
from tests.support.messages import STRING, joined, sample, text
from tests.support.until import until
from tests.support.websocket import Client, fetch
from tests.support.world import World

AUTH = {
    "tokens": [{"token": {"env": "T_ALL"}, "role": "all"}, {"token": {"env": "T_LOOK"}, "role": "looker"}],
    "roles": {"looker": {"subscribe": ["/shown/*"]}},
}


@pytest.fixture(autouse=True)
def tokens(monkeypatch: pytest.MonkeyPatch) -> None:
    """Set the tokens of ``AUTH``."""
    monkeypatch.setenv("T_ALL", "sesame")
    monkeypatch.setenv("T_LOOK", "glass4u")


def ports(gateway: Gateway) -> list[int]:
    return [listener.port for server in gateway.listening for listener in server.listeners]


async def test_one_port_for_both(world: World) -> None:
    """A viewer and a rosbridge client share a port, and hear what each other publishes."""
    gateway = await world.gateway("robot", [])
    (port,) = ports(gateway)
    async with Viewer(port, subprotocol=f"{WEBSOCKET}, {SDK}") as viewer, Client(port) as client:
        assert viewer.headers["Sec-WebSocket-Protocol"] == SDK
        client.send({"op": "advertise", "topic": "/chatter", "type": STRING})
        await viewer.subscribe("/chatter")
        await until(lambda: "/chatter" in gateway.hubs[gateway.config.gateway.graphs[0]].subscriptions)
        client.send({"op": "publish", "topic": "/chatter", "msg": {"data": "hello"}})
        assert (await viewer.message()).payload == text("hello")
        assert {row["dialect"] for row in gateway.status()["sessions"]} == {"rosbridge", SDK}


async def test_a_port_of_their_own(world: World) -> None:
    """At foxglove:// only viewers are served, and others are told so; a robot's messages arrive."""
    gateway = await world.gateway("robot", [], listen=["foxglove://127.0.0.1:0"])
    (port,) = ports(gateway)
    robot = await world.robot("robot")
    publisher = await robot.create_publisher("/chatter", STRING)
    async with Viewer(port) as viewer, Client(port) as other:
        assert other.status.startswith("HTTP/1.1 400")
        await viewer.subscribe("/chatter")
        await joined(publisher)
        publisher.publish(sample("hello"))
        assert (await viewer.message()).payload == text("hello")
    assert gateway.servers == []
    assert gateway.missing() == []
    (row,) = gateway.status()["listen"]
    assert row["port"] == port


async def test_viewers_can_be_left_out(world: World) -> None:
    """With ``enabled`` false, viewers are refused on the port of rosbridge with what is served there."""
    gateway = await world.gateway("robot", [], foxglove={"enabled": False})
    (port,) = ports(gateway)
    async with Viewer(port) as viewer:
        assert viewer.status.startswith("HTTP/1.1 400")
    assert gateway.viewers is None


@pytest.mark.parametrize("listen", ["ws://127.0.0.1:0", "foxglove://127.0.0.1:0"])
@pytest.mark.parametrize(
    ("options", "role"),
    [
        ({}, ""),
        ({"path": "/?token=wrong"}, ""),
        ({"path": "/?token=glass4u"}, "looker"),
        ({"path": "/?access_token=sesame"}, "all"),
        ({"headers": {"Authorization": "Bearer glass4u"}}, "looker"),
        ({"subprotocol": f"{SDK}, bearer.glass4u"}, "looker"),
    ],
    ids=["none", "wrong", "query", "access_token", "header", "subprotocol"],
)
async def test_tokens(
    world: World, listen: str, options: dict[str, Any], role: str, caplog: pytest.LogCaptureFixture
) -> None:
    """A viewer shows its token as others do, gets its role, and the token stands in no log and no answer."""
    caplog.set_level(logging.DEBUG)
    gateway = await world.gateway("robot", [], listen=[listen], auth=AUTH)
    (port,) = ports(gateway)
    async with Viewer(port, **options) as viewer:
        if role:
            await viewer.op("serverInfo")
            (session,) = gateway.sessions
            assert session.access.role.name == role
            assert viewer.headers["Sec-WebSocket-Protocol"] == SDK
        else:
            assert viewer.status.startswith("HTTP/1.1 401")
    assert "glass4u" not in str(viewer.headers)
    assert not [line for line in caplog.messages if "glass4u" in line or "sesame" in line or "=wrong" in line]


async def test_roles_hide_channels(world: World) -> None:
    """A viewer sees the channels that its role lets it read, and can subscribe to no other."""
    gateway = await world.gateway("robot", [], auth=AUTH)
    robot = await world.robot("robot")
    for name in ("/shown/a", "/hidden/b"):
        await robot.create_publisher(name, STRING)
    async with AsyncExitStack() as stack:
        everything = await stack.enter_async_context(Viewer(ports(gateway)[0], path="/?token=sesame"))
        looker = await stack.enter_async_context(Viewer(ports(gateway)[0], path="/?token=glass4u"))
        hidden = await everything.channel("/hidden/b")
        shown = await looker.channel("/shown/a")
        looker.send({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": hidden["id"]}]})
        assert "there is no channel" in await looker.complaint()
        offer = {"id": 1, "topic": "/shown/a", "encoding": "cdr", "schemaName": STRING}
        looker.send({"op": "advertise", "channels": [offer]})
        assert "role looker does not list it under publish" in await looker.complaint()
        assert list(looker.channels) == [shown["id"]]
        assert sum(gateway.status()["access"]["denied"].values()) == 1


async def test_viewers_are_clients(world: World) -> None:
    """Viewers count towards the clients of the port, and an operator can disconnect one."""
    gateway = await world.gateway("robot", [], clients={"max_clients": 1})
    (port,) = ports(gateway)
    async with Viewer(port) as viewer:
        await viewer.op("serverInfo")
        async with Client(port) as second:
            assert second.status.startswith("HTTP/1.1 503")
        assert await disconnect(gateway, {"peer": gateway.sessions[0].connection.peer})
        assert (await viewer.closed())[0] == 1008
    await until(lambda: not gateway.sessions)


async def test_the_gateway_stops(world: World) -> None:
    """Viewers are told that the gateway goes away, and their sessions end."""
    async with AsyncExitStack() as stack:
        inner = World(stack)
        gateway = await inner.gateway("robot", [])
        viewer = await stack.enter_async_context(Viewer(ports(gateway)[0]))
        await viewer.op("serverInfo")
        ended = asyncio.create_task(viewer.closed())
        await gateway.__aexit__(None, None, None)
        assert await ended == (1001, "the gateway stops")
        assert gateway.sessions == []


async def test_rules_are_checked_again(world: World) -> None:
    """A viewer whose token counts no more is disconnected when the rules are read again."""
    gateway = await world.gateway("robot", [], auth=AUTH)
    async with Viewer(ports(gateway)[0], path="/?token=glass4u") as viewer:
        await viewer.op("serverInfo")
        settings = gateway.config.gateway.model_dump(mode="json", by_alias=True, exclude_unset=True)
        settings["auth"] = {"tokens": [{"token": {"env": "T_ALL"}}]}
        gateway.read_access(parse({"gateway": settings}))()
        assert (await viewer.closed())[0] == 1008


async def test_pages_of_the_port_stay(world: World) -> None:
    """The pages of the rosbridge port are there with viewers, too."""
    gateway = await world.gateway("robot", [])
    assert (await fetch(ports(gateway)[0], "/readyz")).status == 200
