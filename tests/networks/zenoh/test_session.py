"""ropeway.networks.zenoh.session: how a node comes to its network, by a router, with TLS, with a password."""

from __future__ import annotations

import json
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest
import zenoh

from ropeway.errors import GraphUnavailable
from ropeway.networks.zenoh import ZenohGraph
from ropeway.networks.zenoh.address import ZenohAddress, parse_address
from ropeway.networks.zenoh.session import ZenohPresence, ZenohSession
from ropeway.networks.zenoh.session_config import make_config
from ropeway.qos import QoS
from tests.support.authority import Authority
from tests.support.inbox import Inbox
from tests.support.messages import STRING, joined, sample
from tests.support.ports import free_port
from tests.support.until import until

from .network import endpoint


def router(where: str) -> zenoh.Session:
    """A router, as ``rmw_zenohd`` is one."""
    config = zenoh.Config()
    for key, value in {"mode": "router", "listen/endpoints": [where], "scouting/multicast/enabled": False}.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


async def test_router_returns() -> None:
    """Nodes find each other by a router that comes later than they, goes away and comes back."""
    where = endpoint()
    async with AsyncExitStack() as stack:
        inbox = Inbox()
        graphs = [
            ZenohGraph(parse_address(f"zenoh:{where}?{mode}", {}), name=name) for name, mode in (("a", ""), ("b", ""))
        ]
        for graph in graphs:
            await graph.open()
            stack.push_async_callback(graph.close)
        first, second = graphs
        await first.create_subscription("/t", STRING, QoS(), inbox)
        publisher = await second.create_publisher("/t", STRING)
        for number in range(2):
            session = router(where)
            await joined(publisher)
            publisher.publish(sample(f"{number}"))
            await inbox.wait(number + 1)
            session.close()
        assert inbox.texts == ["0", "1"]


async def test_client() -> None:
    """A client has everything through its router, and fails where there is none."""
    where = endpoint()
    with pytest.raises(GraphUnavailable, match="Zenoh"):
        await ZenohGraph(parse_address(f"zenoh:{where}?mode=client", {})).open()
    session = router(where)
    async with AsyncExitStack() as stack:
        stack.callback(session.close)
        graphs = [ZenohGraph(parse_address(f"zenoh:{where}?mode=client", {}), name=name) for name in ("a", "b")]
        for graph in graphs:
            await graph.open()
            stack.push_async_callback(graph.close)
        inbox = Inbox()
        await graphs[0].create_subscription("/t", STRING, QoS(), inbox)
        publisher = await graphs[1].create_publisher("/t", STRING)
        await joined(publisher)
        publisher.publish(sample("hello"))
        await inbox.wait(1)


async def test_tls(tmp_path: Path) -> None:
    """With certificates, nodes of one authority meet; one without a certificate does not come in."""
    authority = Authority(tmp_path, "fleet")
    files = [authority.sign(name) for name in ("near", "far")]
    where = f"tls/127.0.0.1:{free_port()}"

    def address(connect: str, listen: str, own: dict[str, str] | None) -> ZenohAddress:
        more = f"&certificate={own['certificate']}&key={own['key']}" if own else ""
        return parse_address(f"zenoh:{connect}?listen={listen}&ca={authority.file}{more}", {})

    near = ZenohGraph(address(endpoint(), where, files[0]), name="near")
    far = ZenohGraph(address(where, endpoint(), files[1]), name="far")
    stranger = ZenohGraph(address(where, endpoint(), None), name="stranger")
    async with AsyncExitStack() as stack:
        for graph in (near, stranger, far):
            await graph.open()
            stack.push_async_callback(graph.close)
        await until(lambda: "/far" in near.nodes() and "/near" in far.nodes())
        assert "/stranger" not in near.nodes()


async def test_password(tmp_path: Path) -> None:
    """A node with the password that a router asks for comes in, another one does not."""
    users = tmp_path / "users"
    users.write_text("robot:right\n")
    where = endpoint()
    config = zenoh.Config()
    settings: dict[str, Any] = {
        "mode": "router",
        "listen/endpoints": [where],
        "scouting/multicast/enabled": False,
        "transport/auth/usrpwd/user": "router",
        "transport/auth/usrpwd/password": "own",
        "transport/auth/usrpwd/dictionary_file": str(users),
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    async with AsyncExitStack() as stack:
        session = zenoh.open(config)
        stack.callback(session.close)
        graphs = []
        for word in ("right", "wrong"):
            (tmp_path / word).write_text(word)
            url = f"zenoh:{where}?user=robot&password_file={tmp_path / word}"
            graphs.append(ZenohGraph(parse_address(url, {}), name=word))
            await graphs[-1].open()
            stack.push_async_callback(graphs[-1].close)
        await until(lambda: len(session.info.peers_zid()) == 1)
        assert [str(zid) for zid in session.info.peers_zid()] == [graphs[0].session.id]


async def test_presence() -> None:
    """An endpoint shows itself under its own hash and those asked for, as many as the limit says, until it closes."""
    shown: dict[str, bool] = {}
    session = ZenohSession("zenoh", 0, "/n", "", shown.__setitem__)
    await session.open(make_config(ZenohAddress(0, (), (endpoint(),), "peer")), lambda _: None)
    presence = ZenohPresence(session, "publisher", "/t", STRING, "RIHS01_0", QoS())
    assert presence.follow(["RIHS01_1", "RIHS01_0"]) == ({"RIHS01_1"}, set())
    assert presence.follow(f"RIHS01_{number}" for number in range(2, 100))[1] == {"RIHS01_1"}
    assert len(presence.hashes) == 8
    assert len({presence.gid(type_hash) for type_hash in presence.hashes}) == 8
    presence.close()
    assert [alive for token, alive in shown.items() if "/MP/" in token] == [False] * 9
    await session.close()
    with pytest.raises(GraphUnavailable):
        _ = session.raw
