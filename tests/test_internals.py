"""Canaries for the interfaces of others that docs/internals.md lists: each is used here as the package uses it."""

from __future__ import annotations

import asyncio
import importlib.metadata
import inspect
import json
import os
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import aiofastnet
import httpx
import pytest
import zenoh
from rosbags.rosbag1 import Reader, Writer

from ropeway.control.app import PEER
from ropeway.control.server import ControlServer
from ropeway.listener.connection import Connection, Limits
from ropeway.listener.websocket import connect, listen
from ropeway.networks.dds import DdsGraph, library
from ropeway.networks.overlay import link_sockets
from ropeway.networks.overlay.zenoh_config import gateway_config, gateway_id, router_config
from tests.networks.overlay.fleet import member
from tests.support.isolation import isolated_dds
from tests.support.ports import free_port
from tests.support.until import until

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "internals.md").read_text()
PINNED = ("cyclonedds", "picows", "aiofastnet", "rosbags", "eclipse-zenoh", "uvicorn")


@contextmanager
def relied_on(package: str, section: str) -> Iterator[None]:
    """Say what to do if the block fails."""
    assert f"## {section}\n" in PAGE
    try:
        yield
    except Exception as error:
        version = importlib.metadata.version(package)
        pytest.fail(
            f"{package} {version} is not what Ropeway was written for. Read the section {section!r} of "
            f"docs/internals.md and adapt what it names, or pin the version before in pyproject.toml. {error!r}"
        )


@pytest.mark.parametrize("package", PINNED)
def test_pinned(package: str) -> None:
    """Each has an upper bound in pyproject.toml, and the page tells the same."""
    (wanted,) = set(re.findall(rf'^    "({package}\b[^";]*)', (ROOT / "pyproject.toml").read_text(), re.MULTILINE))
    assert "==" in wanted or "<" in wanted, f"{wanted} has no upper bound"
    assert f"`{wanted}`" in PAGE, f"docs/internals.md does not say {wanted}"


def test_failures_say_what_to_do() -> None:
    """A canary that fails names the version, the section of the page, and what to do."""
    with (
        pytest.raises(pytest.fail.Exception, match="Read the section 'rosbags' of"),
        relied_on("rosbags", "rosbags"),
    ):
        raise AttributeError("connections")


WHEEL = pytest.mark.skipif(find_spec("cyclonedds") is None, reason="the wheel cyclonedds is not for this machine")


@WHEEL
def test_cyclonedds_version() -> None:
    """The layouts of the pinned wheel are known."""
    version = importlib.metadata.version("cyclonedds")
    assert f"`cyclonedds=={version}`" in PAGE
    assert version.startswith(library.KNOWN)


async def test_cyclonedds_layouts() -> None:
    """The library has the functions and memory layouts that the raw path relies on."""
    with isolated_dds(), relied_on("cyclonedds", "Cyclone DDS"):
        graph = DdsGraph(58, name="canary", interface="lo")
        await graph.open()
        await graph.close()


@WHEEL
def test_cyclonedds_hook() -> None:
    """The hook for services of Fast DDS calls itself through the network."""
    program = (
        "from ropeway.networks.dds import raw; raw.load('canary')\n"
        "from ropeway.networks.dds.fastdds import selfcall; print(selfcall.wrong())"
    )
    with relied_on("cyclonedds", "Cyclone DDS"):
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=50, check=True)
        assert done.stdout == "\n"


async def test_picows_protocol(caplog: pytest.LogCaptureFixture) -> None:
    """A connection is handed to picows in the middle, with a size limit of its own; bad frames are ours to log."""
    limits = Limits(max_message_bytes=1000, ping_interval_s=None)
    served: list[Connection] = []
    got: list[str | bytes] = []

    def on_connection(connection: Connection) -> None:
        served.append(connection)
        connection.on_text = lambda text: got.append(bytes(text))

    server = await listen("127.0.0.1", 0, on_connection, limits=limits)
    try:
        with relied_on("picows", "picows and aiofastnet"):
            client = await connect(f"ws://127.0.0.1:{server.port}", limits=Limits(ping_interval_s=None))
            client.send_text(b"hello")
            await until(lambda: got == [b"hello"])
            client.send_text(b"x" * 2000)
            await until(lambda: client.closed)
            caplog.clear()
            reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
            writer.write(b"GET / HTTP/1.1\r\nHost: a\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n")
            writer.write(b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n")
            assert (await reader.readuntil(b"\r\n\r\n")).startswith(b"HTTP/1.1 101")
            writer.write(b"\xff\xff\xff\xff")
            await until(lambda: served[-1].closed)
            assert [record for record in caplog.records if record.name == "ropeway.link.picows"] == []
            writer.close()
    finally:
        for connection in served:
            connection.abort("the test is over")
            await connection.wait_closed()
        await server.close()


def test_aiofastnet() -> None:
    """The function that takes over an accepted socket is there."""
    with relied_on("aiofastnet", "picows and aiofastnet"):
        assert inspect.iscoroutinefunction(aiofastnet.connect_accepted_socket)


def test_rosbags_reader(tmp_path: Path) -> None:
    """The reader of ROS 1 bags tells connections and messages."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer(tmp_path / "a.bag") as writer:
        channel = writer.add_connection("/a", "std_msgs/msg/String", typestore=store)
        writer.write(channel, 7, b"\x02\0\0\0hi")
    with relied_on("rosbags", "rosbags"), Reader(tmp_path / "a.bag") as reader:
        (connection,) = reader.connections
        told = (
            connection.topic,
            connection.msgtype,
            connection.msgdef.data,
            connection.msgcount,
            connection.ext.latching,
        )
        assert told == ("/a", "std_msgs/msg/String", "string data\n", 1, None)
        assert (reader.start_time, reader.end_time) == (7, 8)
        assert [(time_ns, bytes(raw)) for _, time_ns, raw in reader.messages(connections=[connection])] == [
            (7, b"\x02\0\0\0hi")
        ]


def test_zenoh_configuration() -> None:
    """Zenoh takes every key of our configurations."""
    with relied_on("eclipse-zenoh", "Zenoh"):
        gateway_config(member(), gateway=gateway_id(), connect=["tls/127.0.0.1:1"], listen=[], denied=["someone"])
        router_config(member(), connect=[], listen=["tls/127.0.0.1:1"])


async def test_zenoh_links() -> None:
    """Zenoh tells its links with their addresses, and their sockets are found by these."""
    where = f"tcp/127.0.0.1:{free_port()}"

    def session(key: str) -> zenoh.Session:
        config = zenoh.Config()
        for option, value in (("mode", "router"), ("scouting/multicast/enabled", False), (key, [where])):
            config.insert_json5(option, json.dumps(value))
        return zenoh.open(config)

    events: list[Any] = []
    with relied_on("eclipse-zenoh", "Zenoh"), session("listen/endpoints") as far, session("connect/endpoints") as near:
        listener = near.info.declare_link_events_listener(events.append, history=True)
        transports = near.info.declare_transport_events_listener(lambda _: None)
        await until(lambda: near.info.links() and near.info.routers_zid() and events)
        (link,) = near.info.links()
        assert link.auth_identifier is None
        assert str(link.dst) == where
        assert link_sockets.set_options(str(link.src), str(link.dst), 1000)
        assert {str(zid) for zid in near.info.routers_zid()} == {str(far.info.zid())}
        assert [(event.kind, str(event.link.dst)) for event in events] == [(zenoh.SampleKind.PUT, where)]
        listener.undeclare()
        transports.undeclare()


async def test_uvicorn(tmp_path: Path) -> None:
    """The control API is served by uvicorn's protocol, which tells the application who asks."""
    with relied_on("uvicorn", "uvicorn"), socket.socket(socket.AF_UNIX) as bound:
        path = str(tmp_path / "canary.sock")
        bound.bind(path)
        bound.listen()

        async def app(scope: Any, receive: Any, send: Any) -> None:
            body = str(scope[PEER].uid).encode()
            await send(
                {"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"%d" % len(body))]}
            )
            await send({"type": "http.response.body", "body": body})

        server = ControlServer(app)
        await server.listen(bound)
        async with httpx.AsyncClient(transport=httpx.AsyncHTTPTransport(uds=path)) as client:
            assert (await client.get("http://x/")).text == str(os.geteuid())
            assert server.connections == 1
        await server.close()
