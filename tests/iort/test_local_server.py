"""The local server of ropeway.iort, in processes of its own that can be killed."""

from __future__ import annotations

import asyncio
import json
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from ropeway import aio, iort
from ropeway.iort import AsyncNode, LocalServer, NodeError, Value
from tests.iort.servers import Raw, ServerProcess, old_python, serving
from tests.support.ports import free_port, free_udp_port
from tests.support.until import PATIENCE_S, until


class Served:
    """A copy of the file alone, started as ``--serve``."""

    def __init__(self, directory: Path) -> None:
        directory.mkdir(exist_ok=True)
        self.file = directory / "iort.py"
        self.file.write_text(Path(iort.__file__).read_text())
        self.port = free_port()
        self.url = f"iort://127.0.0.1:{self.port}"
        self._process: subprocess.Popen[str] | None = None

    def start(self, *options: str, python: str = sys.executable) -> None:
        command = [python, "-W", "error", "-I", str(self.file), "--serve", f"127.0.0.1:{self.port}", *options]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        assert self._process.stdout.readline().startswith("serving")

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            assert self._process.stdout is not None
            self._process.stdout.close()
            self._process = None


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as made:
        yield made


@pytest.fixture
def local(tmp_path: Path, stack: ExitStack) -> Served:
    served = Served(tmp_path / "robot")
    stack.callback(served.kill)
    return served


async def test_the_papers_conversation(local: Served) -> None:
    """Plain nodes publish, read, are told two different errors, and disconnect, as at the server in the cloud."""
    local.start()
    one, other = await Raw.connect(local.port), await Raw.connect(local.port)
    one.send(b"%07/TURTLESIM/cmd_vel/p/0.0,0.5%%01/TURTLESIM/nothing/s%")
    missing = await one.packet()
    answer = await other.ask(b"%02/TURTLESIM/cmd_vel/s%")
    assert answer.encode() == b"%07/TURTLESIM/cmd_vel/p/0.0,0.5%"
    system = await other.ask(b"%02/NOBODY/cmd_vel/s%")
    assert (missing.op, system.op) == ("e", "e")
    assert missing.data != system.data
    one.send(b"%01/TURTLESIM/-/d%")
    assert await one.closed()
    await other.close()


async def test_robot_to_robot(local: Served) -> None:
    """Two robots hear each other through a third one's server, with acknowledgements, patterns and lists."""
    local.start()
    got: list[Value] = []
    async with AsyncNode("PEPPER", local.url) as pepper, AsyncNode("ALICE", local.url) as alice:
        await pepper.publish("battery", "80")
        await alice.subscribe("*", got.append, system="PEPPER")
        await until(lambda: [v.text for v in got] == ["80"])
        sent = await pepper.publish("battery", "79")
        await until(lambda: [v.text for v in got] == ["80", "79"])
        assert got[1].order == sent.order
        assert (await alice.read("battery", system="PEPPER")).text == "79"
        (told,) = await alice.list("PEPPER")
        assert (told["data"], told["kind"]) == ("79", "robot")
        with pytest.raises(NodeError, match="PEPPER/none"):
            await alice.read("none", system="PEPPER")
        with pytest.raises(NodeError, match="not known here"):
            await alice.request("A", "b", "+what", {})


async def test_serves_on_old_python(local: Served) -> None:
    """A copy of the file serves on Python 3.8, where there is one."""
    local.start(python=old_python())
    got: list[Value] = []
    async with AsyncNode("PEPPER", local.url) as pepper, AsyncNode("ALICE", local.url) as alice:
        await alice.subscribe("count", got.append, system="PEPPER")
        for number in range(100):
            await pepper.publish("count", number)
        await until(lambda: [value.text for value in got] == [str(number) for number in range(100)])


async def test_brings_all_to_the_cloud(local: Served, tmp_path: Path, stack: ExitStack) -> None:
    """A server that is killed while it holds values keeps them, and brings them to the cloud when that is back."""
    cloud = ServerProcess(tmp_path / "cloud.sqlite", free_port())
    stack.callback(cloud.kill)
    options = ("--cloud", cloud.url, "--directory", str(tmp_path / "kept"))
    local.start(*options)
    plain = await Raw.connect(local.port)
    plain.send(b"%01/TURTLE/pose/p/1,2%")
    async with AsyncNode("PEPPER", cloud.url, local_server=local.url) as pepper:
        await pepper.wait_mode("local-server", 10)
        sent = await pepper.publish("battery", "80")
        assert sent.mode == "local-server"
    assert (await plain.ask(b"%01/PEPPER/battery/s%")).data == b"80"
    local.kill()
    await plain.close()
    await asyncio.to_thread(local.start, *options)
    await asyncio.to_thread(cloud.start)
    async with AsyncNode("DESK", cloud.url, kind="pc") as desk:
        assert await desk.wait_mode("remote", 10)

        async def held() -> dict[str, Any]:
            return {f"{v['system']}/{v['topic']}": v for v in await desk.list()}

        async with aio.timeout(PATIENCE_S):
            while len(found := await held()) < 2:
                await asyncio.sleep(0.05)
        assert {name: value["data"] for name, value in found.items()} == {"TURTLE/pose": "1,2", "PEPPER/battery": "80"}
        assert found["PEPPER/battery"]["version"] == sent.version
        assert found["TURTLE/pose"]["origin"].startswith("01@")
        await desk.publish("goal", "kitchen", system="PEPPER")
        robot = await Raw.connect(local.port)
        assert (await robot.ask(b"%01/PEPPER/goal/s%")).data == b"kitchen"  # read through
        robot.send(b"%01/PEPPER/battery/p/70%")
        async with aio.timeout(PATIENCE_S):
            while (await desk.read("battery", system="PEPPER")).text != "70":
                await asyncio.sleep(0.05)
        await robot.close()


async def test_found_on_the_network(local: Served, tmp_path: Path) -> None:
    """A node finds the server that knows the token of its fleet, and none that does not, and goes back to the cloud."""
    port = free_udp_port()
    local.start("--announce", "--discovery-port", str(port), "--token", "fleet")
    cloud = free_port()
    where: dict[str, Any] = {"discover": f"127.0.0.1:{port}"}
    async with (
        AsyncNode("PEPPER", f"iort://127.0.0.1:{cloud}", token="fleet", **where) as member,
        AsyncNode("STRANGER", f"iort://127.0.0.1:{cloud}", token="other", **where) as stranger,
        AsyncNode("NOBODY", f"iort://127.0.0.1:{cloud}", **where) as nobody,
    ):
        assert await member.wait_mode("local-server", 10)
        await member.publish("battery", "80")
        assert (stranger.mode, nobody.mode) == ("local", "local")
        async with serving(port=cloud) as served:
            assert await member.wait_mode("remote", 20)
            await until(lambda: served.store.get("PEPPER", "battery") is not None)


async def test_bad_datagrams(local: Served) -> None:
    """What is no question of the fleet gets no answer, whatever it is, and the next good one does."""
    port = free_udp_port()
    local.start("--announce", "--discovery-port", str(port), "--token", "fleet")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        for bad in (
            b"",
            b"{",
            b"[" * 500,
            b"7",
            b"[]",
            json.dumps({"iort": 1, "nonce": "x" * 65}).encode(),
            b"x" * 2000,
        ):
            sock.sendto(bad, ("127.0.0.1", port))
        for wrong in ({"iort": 1, "nonce": 5}, {"iort": 1, "nonce": "n", "proof": ""}, {"iort": 1, "nonce": "n"}):
            sock.sendto(json.dumps(wrong).encode(), ("127.0.0.1", port))
        sock.settimeout(0.3)
        with pytest.raises(TimeoutError):
            await asyncio.to_thread(sock.recv, 1000)
    assert await iort._search(f"127.0.0.1:{port}", "fleet") == [local.url]
    assert await iort._search(f"127.0.0.1:{port}", "other") == []
    assert await iort._search(f"127.0.0.1:{free_udp_port()}", "fleet") == []


async def test_an_answer_that_is_passed_on(local: Served) -> None:
    """An answer that comes from another address than it was given at leads no node, and no token, there."""
    port = free_udp_port()
    local.start("--announce", "--discovery-port", str(port), "--token", "fleet")
    searcher = iort._Searcher("fleet")
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as victim,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as relay,
    ):
        for sock, host in ((victim, "127.0.0.1"), (relay, "127.0.0.2")):
            sock.bind((host, 0))
            sock.settimeout(10)
        victim.sendto(searcher.question(), relay.getsockname())
        question = await asyncio.to_thread(relay.recv, 2000)
        victim.sendto(question, ("127.0.0.1", port))
        genuine, server = await asyncio.to_thread(victim.recvfrom, 2000)
        searcher.datagram_received(genuine, relay.getsockname())
        assert not searcher.found
        searcher.datagram_received(genuine, server)
        assert list(searcher.found) == [local.url]


async def test_token(local: Served) -> None:
    """With a token nobody gets in without it: plain nodes are refused, wrong tokens end the connection."""
    local.start("--token", "fleet")
    plain = await Raw.connect(local.port)
    plain.send(b"%01/A/b/p/1%")
    assert (await plain.ask(b"%01/A/b/s%")).op == "e"
    wrong = await Raw.connect(local.port)
    refused = await wrong.ask(b"%01/X/-/+hello/n=1,token=wrong%")
    assert refused.head["code"] == "login"
    assert await wrong.closed()
    async with AsyncNode("X", local.url, token="fleet") as node:
        assert node.mode == "remote"
        with pytest.raises(NodeError, match="A/b"):
            await node.read("b", system="A")
    await plain.close()


async def test_a_web_page(local: Served) -> None:
    """A packet in the body of a browser's request is no packet of a node."""
    local.start()
    page = await Raw.connect(local.port)
    page.send(b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 12\r\n\r\n%01/A/b/p/1%")
    assert (await page.reader.read()).startswith(b"HTTP/1.1 400 ")
    node = await Raw.connect(local.port)
    assert (await node.ask(b"%01/A/b/s%")).op == "e"
    await page.close()
    await node.close()


async def test_beyond_loopback() -> None:
    """Beyond loopback a server needs a token, or to be told that it needs none."""
    server = LocalServer("one")
    with pytest.raises(NodeError, match="token"):
        await server.listen("0.0.0.0", 0)
    await server.close()


def test_what_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of what waits for a slow peer the oldest goes where it is too much in number or in bytes, the last one never."""
    monkeypatch.setattr(iort, "_WAITING_LIMIT", 3)
    monkeypatch.setattr(iort, "_WAITING_BYTES", 100)
    waiting = iort._Newest()
    assert [waiting.put(("A", name), name, 10) for name in "abcd"] == [[], [], [], ["a"]]
    assert waiting.put(("A", "e"), "e", 95) == ["b", "c", "d"]
    assert waiting.put(("A", "f"), "f", 1000) == ["e"]
    assert (len(waiting), waiting.bytes) == (1, 1000)
    assert (waiting.pop(("A", "e")), waiting.pop(("A", "f")), waiting.bytes) == (None, "f", 0)
    assert waiting.put(("A", "g"), "g", 5) == []
    assert (waiting.clear(), len(waiting), waiting.bytes) == (["g"], 0, 0)


async def test_reader_that_stands_still(monkeypatch: pytest.MonkeyPatch) -> None:
    """Large values for a node that does not read wait in bounded memory; those that gave way are counted."""
    monkeypatch.setattr(iort, "_WAITING_BYTES", 3 << 20)
    server = LocalServer("one", max_packet_bytes=1 << 20)
    port = await server.listen(port=0)
    stalled, writer = await Raw.connect(port), await Raw.connect(port)
    assert (await stalled.ask(b"%01/A/*/+sub/n=1%")).op == "+ok"
    block = b"x" * 500_000
    for number in range(60):
        assert (await writer.ask(b"%01/A/" + b"%d" % number + b"/+pub/n=1/" + block + b"%")).op == "+ok"
    waiting = next(node.waiting for node in server.nodes if node.subscriptions)
    assert 0 < waiting.bytes <= 3 << 20
    assert server.superseded > 20
    await stalled.close()
    await writer.close()
    await until(lambda: not server.nodes)
    await server.close()


async def test_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """A server is full at its limits, refuses stale values and long names, and goes on with what it has."""
    monkeypatch.setattr(iort, "_SERVED_VALUES", 2)
    monkeypatch.setattr(iort, "_SERVED_NODES", 2)
    monkeypatch.setattr(iort, "_SERVED_BYTES", 100)
    monkeypatch.setattr(iort, "_SERVED_SUBSCRIPTIONS", 1)
    server = LocalServer("one", max_packet_bytes=1000)
    port = await server.listen(port=0)
    node = await Raw.connect(port)

    async def code(raw: bytes) -> str:
        return (await node.ask(raw)).head.get("code", "")

    assert await code(b"%01/A/1/+pub/n=1,v=5/x%") == ""
    assert await code(b"%01/A/2/+pub/n=2/x%") == ""
    assert await code(b"%01/A/3/+pub/n=3/x%") == "full"
    assert await code(b"%01/A/1/+pub/n=4/" + b"x" * 100 + b"%") == "full"
    assert await code(b"%01/A/1/+pub/n=5,v=4,m=1/old%") == "stale"
    assert await code(b"%01/A/1/+pub/n=6,v=x/y%") == "malformed"
    assert await code(b"%01/A/1/+pub/n=6,v=4611686018427387903,m=1/y%") == "malformed"
    assert await code(b"%01/" + b"A" * 201 + b"/1/+pub/n=7/y%") == "name"
    assert await code(b"%01/A/1/+sub/n=8,last=0%") == ""
    assert await code(b"%01/A/2/+sub/n=9,last=0%") == "full"
    assert await code(b"%01/A/1/+pub/n=10/" + b"x" * 2000 + b"%") == "too-big"
    second, third = await Raw.connect(port), await Raw.connect(port)
    assert await third.closed()
    assert (await second.ask(b"%01/A/1/s%")).data == b"x"
    await node.close()
    await second.close()
    await until(lambda: not server.nodes)
    await server.close()
