"""The node library: online, offline, and back."""

from __future__ import annotations

import asyncio
import json
import re
import ssl
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from ropeway import iort
from ropeway.gateway.config.tls_model import ListenTls
from ropeway.gateway.tls import server_context
from ropeway.iort import AsyncNode, Node, NodeError, Value, text_of
from ropeway.listener.authentication import CertificateRule, Door
from ropeway.listener.authorization import EVERYTHING
from ropeway.store import StoreLimits
from tests.iort.servers import ServerProcess, old_python, serving
from tests.support.authority import Authority
from tests.support.ports import free_port
from tests.support.until import PATIENCE_S, until


async def test_publish_and_read() -> None:
    """A value that one node publishes another reads, with its origin and age."""
    began_s = time.monotonic()  # before the nodes compared clocks with the server, which errs by half of that time
    async with serving() as served, AsyncNode("PEPPER", served.url) as one, AsyncNode("PC", served.url) as other:
        sent = await one.publish("cmd_vel", [0.1, 0, 0, 0, 0, 0.5])
        value = await other.read("cmd_vel", system="PEPPER")
        assert value.floats == [0.1, 0, 0, 0, 0, 0.5]
        assert (value.version, value.origin, value.mode) == (sent.version, one.origin, "remote")
        assert 0 <= value.age_s <= time.monotonic() - began_s + 0.001  # it is told in milliseconds
        with pytest.raises(NodeError) as told:
            await other.read("odom", system="PEPPER")
        assert told.value.code == "unknown-topic"
        assert one.pending == 0


def test_contents() -> None:
    """Text, bytes, numbers, lists of numbers and objects may be published."""
    assert text_of("a") == b"a"
    assert text_of(b"\xff") == b"\xff"
    assert text_of(4) == b"4"
    assert text_of(0.5) == b"0.5"
    assert text_of([1, 2.5]) == b"1.0,2.5"
    assert json.loads(text_of({"x": [1]})) == {"x": [1]}


async def test_subscribe() -> None:
    """A subscription begins with the value that is there, gets every later one of others, and can be ended."""
    async with serving() as served, AsyncNode("A", served.url) as one, AsyncNode("B", served.url) as other:
        await one.publish("x", "0")
        got: list[Value] = []
        end = await other.subscribe("*", got.append, system="A")
        await until(lambda: len(got) == 1)
        await one.publish("x", "1")
        await one.publish("y", "2")
        await until(lambda: [v.text for v in got] == ["0", "1", "2"])
        assert [v.latest for v in got] == [True, False, False]
        await end()
        await one.publish("x", "3")
        assert (await other.read("x", system="A")).text == "3"
        assert len(got) == 3


async def test_failing_callback() -> None:
    """A callback that fails costs no other its values."""
    loop = asyncio.get_running_loop()
    told: list[Any] = []
    loop.set_exception_handler(lambda _, context: told.append(context))
    async with serving() as served, AsyncNode("A", served.url) as one, AsyncNode("B", served.url) as other:

        def fail(_: Value) -> None:
            raise RuntimeError("broken")

        got: list[Value] = []
        await other.subscribe("x", fail, system="A")
        await other.subscribe("x", got.append, system="A")
        await one.publish("x", "1")
        await until(lambda: len(got) == 1)
        assert told
        assert "broken" in other.last_error


async def test_failing_coroutine() -> None:
    """A callback that goes on by itself and fails then is told to the loop at once."""
    told: list[Any] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: told.append(context))

    async def fail(_: Value) -> None:
        await asyncio.sleep(0)
        raise RuntimeError("broken later")

    async with serving() as served, AsyncNode("A", served.url) as one, AsyncNode("B", served.url) as other:
        await other.subscribe("x", fail, system="A")
        await one.publish("x", "1")
        await until(lambda: told)
        assert "broken later" in told[0]["message"]
        assert "broken later" in other.last_error


async def test_offline(tmp_path: Path) -> None:
    """Without a server a node publishes and reads locally; what it wrote is merged when the server comes."""
    port = free_port()
    modes: list[str] = []
    node = AsyncNode("A", f"iort://127.0.0.1:{port}", directory=str(tmp_path), on_mode=modes.append)
    await node.open()
    value = await node.publish("pose", "1,2,3")
    assert value.mode == "local"
    assert (await node.read("pose")).text == "1,2,3"
    with pytest.raises(NodeError, match="no server can be reached"):
        await node.read("nothing")
    assert node.pending == 1
    async with serving(port=port) as served:
        await until(lambda: node.mode == "remote" and node.pending == 0)
        kept = served.store.get("A", "pose")
        assert kept is not None
        assert kept.data == b"1,2,3"
    await until(lambda: node.mode == "local")
    await node.publish("pose", "4,5,6")
    async with serving(port=port) as served:
        await until(lambda: served.store.get("A", "pose") is not None)
        await until(lambda: node.pending == 0)
    await node.close()
    assert modes[:3] == ["remote", "local", "remote"]


async def test_offline_restart(tmp_path: Path) -> None:
    """What was written offline survives the end of the node's program, in the paper's layout of JSON files."""
    port = free_port()
    url = f"iort://127.0.0.1:{port}"
    node = AsyncNode("A", url, directory=str(tmp_path))
    await node.open()
    await node.publish("pose", "1")
    await node.publish("odd/name", b"\xff\xfe")
    await node.close()
    assert json.loads((tmp_path / "A" / "pose.json").read_text())["data"] == "1"
    async with serving(port=port) as served:
        again = AsyncNode("A", url, directory=str(tmp_path))
        await again.open()
        await until(lambda: again.pending == 0 and len(served.store.entries()) == 2)
        odd = served.store.get("A", "odd/name")
        assert odd is not None
        assert odd.data == b"\xff\xfe"
        await again.close()


async def test_offline_depth(tmp_path: Path) -> None:
    """What was written offline before the last value is brought to the server, too, where the node was told to."""
    port = free_port()
    url = f"iort://127.0.0.1:{port}"
    directory = str(tmp_path / "values")
    node = AsyncNode("A", url, directory=directory, offline_depth=3)
    await node.open()
    for number in range(5):
        await node.publish("pose", str(number))
    await node.close()
    async with serving(str(tmp_path / "s.sqlite"), port=port, limits=StoreLimits(history=10)) as served:
        again = AsyncNode("A", url, directory=directory, offline_depth=3)
        await again.open()
        await until(lambda: again.mode == "remote" and again.pending == 0)
        assert [e.data for e in served.store.entries()] == [b"4"]
        assert [e.data for e in await served.store.history("A", "pose")] == [b"3", b"2"]
        await again.close()
    assert "unsent" not in json.loads((tmp_path / "values" / "A" / "pose.json").read_text())


async def test_merge_newer_wins(tmp_path: Path) -> None:
    """At the merge the last writer wins: an older offline value replaces nothing, and the node learns the newer one."""
    port = free_port()
    url = f"iort://127.0.0.1:{port}"
    path = str(tmp_path / "s.sqlite")
    offline = AsyncNode("A", url, directory=str(tmp_path / "a"))
    await offline.open()
    await offline.publish("goal", "offline, first")
    await offline.publish("pose", "offline")
    await offline.close()
    async with serving(path, port=port) as served, AsyncNode("B", url) as other:
        await other.publish("goal", "online, later", system="A")
        again = AsyncNode("A", url, directory=str(tmp_path / "a"))
        await again.open()
        await until(lambda: again.pending == 0)
        assert (await again.read("goal")).text == "online, later"
        assert (await other.read("pose", system="A")).text == "offline"
        assert served.store.refused["stale"] == 1
        await again.close()


async def test_clock_behind(tmp_path: Path) -> None:
    """A node whose clock is years behind still writes later than what it has seen, and its offline values win."""
    port = free_port()
    url = f"iort://127.0.0.1:{port}"
    async with serving(str(tmp_path / "s.sqlite"), port=port), AsyncNode("B", url) as other:
        await other.publish("goal", "1", system="A")
        node = AsyncNode("A", url, directory=str(tmp_path / "a"), clock_ns=lambda: 1_000_000)
        await node.open(3)
        assert (await node.read("goal")).text == "1"
    await until(lambda: node.mode == "local")
    await node.publish("goal", "2")
    async with serving(str(tmp_path / "s.sqlite"), port=port) as served:
        await until(lambda: node.pending == 0)
        kept = served.store.get("A", "goal")
        assert kept is not None
        assert kept.data == b"2"
    await node.close()


async def test_clock_jumps_back() -> None:
    """Versions of a node grow while its clock jumps back."""
    now = 1_700_000_000_000_000_000
    node = AsyncNode("A", "iort://127.0.0.1:9", clock_ns=lambda: now)
    first = await node.publish("x", "1")
    now -= 3_600_000_000_000
    second = await node.publish("x", "2")
    assert second.version > first.version
    assert (await node.read("x")).text == "2"
    await node.close()


async def test_a_callback_for_the_mode_fails() -> None:
    """A callback that fails is told to the loop, and the node connects and goes on."""
    told: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: told.append(context))

    def fail(mode: str) -> None:
        raise KeyError(mode)

    async with serving() as served, AsyncNode("A", served.url, on_mode=fail) as node:
        await node.publish("x", "1")
        assert node.mode == "remote"
        assert (await node.read("x")).text == "1"
    assert "a callback for the mode failed: KeyError('remote')" in [context["message"] for context in told]


async def test_a_connection_fails_unforeseen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever goes wrong while a node connects, it says so and connects again."""
    told: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: told.append(context))
    monkeypatch.setattr(iort, "_PAUSE_S", (0.01, 0.02))
    dial, calls = AsyncNode._dial, 0

    async def fail_once(node: AsyncNode, url: str, mode: str) -> Any:
        nonlocal calls
        calls += 1
        if calls == 1:
            raise RuntimeError("unforeseen")
        return await dial(node, url, mode)

    monkeypatch.setattr(AsyncNode, "_dial", fail_once)
    async with serving() as served, AsyncNode("A", served.url) as node:
        await until(lambda: node.mode == "remote")
    assert told[0]["message"] == "the connection failed: RuntimeError('unforeseen')"


async def test_local_server(tmp_path: Path) -> None:
    """While the server is away the one on the robot's network serves; back, it gets what was written, automatically."""
    port = free_port()
    async with serving() as nearby:
        node = AsyncNode("A", f"iort://127.0.0.1:{port}", local_server=nearby.url)
        await node.open()
        await until(lambda: node.mode == "local-server")
        value = await node.publish("pose", "1")
        assert value.mode == "local-server"
        assert nearby.store.get("A", "pose") is not None
        assert node.pending == 1
        async with serving(port=port) as cloud:
            await until(lambda: node.mode == "remote" and node.pending == 0)
            kept = cloud.store.get("A", "pose")
            assert kept is not None
            assert kept.data == b"1"
        await until(lambda: node.mode == "local-server")
        await node.close()


async def test_subscription_over_a_cut(tmp_path: Path) -> None:
    """After a cut a subscription gets the newest value of the meantime, once."""
    server = ServerProcess(tmp_path / "s.sqlite", free_port())
    await asyncio.to_thread(server.start)
    node, writer = AsyncNode("A", server.url), AsyncNode("B", server.url)
    got: list[str] = []
    try:
        await node.open(3)
        await writer.open(3)
        await node.subscribe("x", lambda v: got.append(v.text), system="B", latest=False)
        await writer.publish("x", "1")
        await until(lambda: got == ["1"])
        await asyncio.to_thread(server.kill)
        await until(lambda: writer.mode == "local" and node.mode == "local")
        await writer.publish("x", "2")
        await writer.publish("x", "3")
        await asyncio.to_thread(server.start)
        await until(lambda: got == ["1", "3"])
        await writer.publish("x", "4")
        await until(lambda: got == ["1", "3", "4"])
    finally:
        await node.close()
        await writer.close()
        server.kill()


async def test_refused() -> None:
    """A value that no server takes is told and not offered again; the connection stays."""
    limits = StoreLimits(max_values=2)
    async with serving(max_packet_bytes=1000, limits=limits) as served, AsyncNode("A", served.url) as node:
        codes = []
        for topic, content in (("", "x"), ("a\n", "x"), ("big", "x" * 2000), ("a", "1"), ("b", "1"), ("c", "1")):
            try:
                await node.publish(topic, content)
            except NodeError as error:
                codes.append(error.code)
        assert codes == ["name", "name", "too-big", "full"]
        node.publish_nowait("big", "x" * 2000)
        await until(lambda: node.refused == {"too-big": 2, "full": 1})
        assert node.pending == 0
        assert node.mode == "remote"
        assert (await node.read("b")).text == "1"


async def test_wrong_server() -> None:
    """A server that is none of ours leaves the node in local mode, with the reason."""
    visitors: set[asyncio.StreamWriter] = set()

    async def silent(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        visitors.add(writer)
        await reader.read(10)
        writer.write(b"HTTP/1.1 400 Bad Request\r\n\r\n")
        writer.close()
        visitors.remove(writer)

    server = await asyncio.start_server(silent, "127.0.0.1", 0)
    node = AsyncNode("A", f"iort://127.0.0.1:{server.sockets[0].getsockname()[1]}")
    await node.open()
    await until(lambda: node.last_error)
    assert node.mode == "local"
    await node.close()
    await until(lambda: not visitors)
    server.close()
    bad = AsyncNode("A", "http://127.0.0.1")
    await bad.open()
    await until(lambda: "write iort://host:7410" in bad.last_error)
    await bad.close()


async def test_tls(tmp_path: Path) -> None:
    """Over iorts:// the server's certificate is checked, and a certificate of the node stands for a login."""
    authority = Authority(tmp_path, "authority")
    listen = {**authority.sign("server"), "ca": authority.file, "client_certificates": "optional"}
    context = server_context(ListenTls.model_validate(listen))
    door = Door(certificates=[CertificateRule(EVERYTHING, common_name="robot")], default=None)
    robot = authority.sign("robot")
    trusted = ssl.create_default_context(cafile=authority.file)
    trusted.load_cert_chain(robot["certificate"], robot["key"])
    async with serving(ssl_context=context, door=door) as served:
        url = served.url.replace("iort:", "iorts:")
        async with AsyncNode("A", url, tls=trusted) as node:
            assert node.mode == "remote"
            await node.publish("x", "1")
        other = AsyncNode("B", url, tls=authority.file)
        await other.open()
        await until(lambda: "certificate is needed" in other.last_error)
        await other.close()
        plain = AsyncNode("C", url)
        await plain.open()
        await until(lambda: "certificate verify failed" in plain.last_error.lower())
        await plain.close()


def test_sync(tmp_path: Path) -> None:
    """Without asyncio a node does the same, from a thread of its own."""
    server = ServerProcess(tmp_path / "s.sqlite", free_port())
    server.start()
    try:
        with Node("A", server.url) as one, Node("B", server.url, directory=str(tmp_path / "b")) as other:
            assert (one.mode, other.mode) == ("remote", "remote")
            came = threading.Event()
            end = other.subscribe("x", lambda value: came.set(), system="A")
            assert one.publish("x", "1").mode == "remote"
            assert came.wait(PATIENCE_S)
            end()
            one.publish("x", "2", wait=False)
            assert one.read("x").text == "2"
            assert [v["topic"] for v in other.list("A", "*")] == ["x"]
            with pytest.raises(NodeError, match="no value"):
                other.read("nothing")
            server.kill()
            assert other.wait_mode("local", 10)
            assert other.publish("y", "3").mode == "local"
            assert other.pending == 1
            assert other.read("y").text == "3"
        with pytest.raises(NodeError, match="closed"):
            one.publish("x", "3")
    finally:
        server.kill()


def test_shell(tmp_path: Path) -> None:
    """The file publishes, reads and lists from a shell."""
    server = ServerProcess(tmp_path / "s.sqlite", free_port())
    server.start()
    copy = tmp_path / "iort.py"
    copy.write_text(Path(iort.__file__).read_text())

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, str(copy), server.url, *words]
        return subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE_S)

    try:
        assert run("publish", "PEPPER/cmd_vel", "0,0,0,0,0,0").returncode == 0
        assert run("read", "PEPPER/cmd_vel").stdout == "0,0,0,0,0,0\n"
        assert json.loads(run("list").stdout)[0]["system"] == "PEPPER"
        missing = run("read", "PEPPER/odom")
        assert missing.returncode == 1
        assert "no value of PEPPER/odom" in missing.stderr
        server.kill()
        gone = run("read", "PEPPER/cmd_vel")
        assert gone.returncode == 1
        assert server.url in gone.stderr
    finally:
        server.kill()


def test_documented(tmp_path: Path) -> None:
    """The example of the documentation works as it stands, but for the port."""
    page = (Path(__file__).parents[2] / "docs" / "robots.md").read_text()
    (code,) = re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    server = ServerProcess(tmp_path / "s.sqlite", free_port())
    server.start()
    try:
        code = code.replace("iort://127.0.0.1:7410", server.url)
        command = [sys.executable, "-c", code]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE_S, cwd=tmp_path)
        assert done.stdout == "80 remote\n", done.stderr
        assert (tmp_path / "values" / "PEPPER" / "battery.json").exists()
    finally:
        server.kill()


def test_old_python(tmp_path: Path) -> None:
    """A copy of the file runs on Python 3.8, where there is one."""
    old = old_python()
    (tmp_path / "iort.py").write_text(Path(iort.__file__).read_text())
    server = ServerProcess(tmp_path / "s.sqlite", free_port())
    server.start()
    code = (
        "import sys; sys.path.insert(0, '.'); from iort import Node\n"
        f"with Node('A', '{server.url}', directory='values') as node:\n"
        "    node.publish('x', [1, 2]); print(sys.version_info[:2], node.read('x').floats, node.mode)\n"
    )
    try:
        command = [old, "-W", "error", "-c", code]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE_S, cwd=tmp_path)
        assert done.stdout == "(3, 8) [1.0, 2.0] remote\n", done.stderr
    finally:
        server.kill()


async def test_a_server_that_tells_no_numbers() -> None:
    """A version or a list that is none is a fault of the server, and the next value is taken."""
    got: list[Value] = []
    left = asyncio.Event()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        parser = iort.Parser()
        while data := await reader.read(65536):
            for packet in parser.feed(data):
                assert isinstance(packet, iort.Packet)
                number = packet.head.get("n", "0")
                if packet.op == "+sub":
                    for version in ("\u00b2", "9" * 5000, "-1", "7"):
                        writer.write(iort.pack("01", "S", "t", "+val", {"v": version}, b"x"))
                text = b"[" * 5000 if packet.op == "+list" else b""
                writer.write(iort.pack("01", "-", "-", "+ok", {"n": number}, text))
        writer.close()
        left.set()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    async with server, AsyncNode("A", f"iort://127.0.0.1:{port}") as node:
        await node.wait_mode("remote", 10)
        await node.subscribe("t", got.append, system="S")
        await until(lambda: got)
        assert ([value.version for value in got], node.faults) == ([7], 3)
        with pytest.raises(NodeError, match="not JSON") as told:
            await node.list()
        assert told.value.code == "malformed"
    await left.wait()
