"""The server of IoRT nodes, as nodes on a socket see it."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import itertools
import json
import logging
import random
from pathlib import Path
from typing import Any

import pymongo
import pytest

from ropeway.errors import ConnectFailed, StoreUnavailable
from ropeway.iort import AsyncNode, Packet, pack
from ropeway.listener.authentication import Door, TokenRule
from ropeway.listener.authorization import EVERYTHING, Role
from ropeway.store import StoreLimits
from tests.iort.servers import Raw, ServerProcess, serving
from tests.store.mongo import mongo_database
from tests.support.ports import free_port
from tests.support.until import until


def request(op: str, n: int, system: str = "-", topic: str = "-", data: bytes = b"", **head: object) -> bytes:
    return pack("01", system, topic, op, {"n": n, **head}, data)


async def test_the_papers_conversation() -> None:
    """A node of the paper publishes in silence, reads what is there, and is told what is not."""
    async with serving() as served:
        node = await Raw.connect(served.port)
        node.send(b"%01/PEPPER/cmd_vel/p/0.1,0.0,0.0,0.0,0.0,0.2%")
        node.send(b"%01/PEPPER/cmd_vel/s%")
        assert await node.packet() == Packet("01", "PEPPER", "cmd_vel", "p", {}, b"0.1,0.0,0.0,0.0,0.0,0.2")
        answer = await node.ask(b"%01/NOBODY/cmd_vel/s%")
        assert (answer.op, answer.data) == ("e", b"no value of the system NOBODY is there")
        answer = await node.ask(b"%01/PEPPER/odom/s%")
        assert (answer.op, answer.data) == ("e", b"no value of PEPPER/odom is there")
        await node.close()


async def test_alice() -> None:
    """The form with the kind of system is answered in that form, and names the same topic as the form without."""
    async with serving() as served:
        node = await Raw.connect(served.port)
        node.send(b"%01/ALICE/COS/NAVI_ROBOT_MOVE_REQ/p/stop%")
        answer = await node.ask(b"%01/ALICE/COS/NAVI_ROBOT_MOVE_REQ/s%")
        assert answer.encode() == b"%01/ALICE/COS/NAVI_ROBOT_MOVE_REQ/p/stop%"
        answer = await node.ask(b"%01/ALICE/NAVI_ROBOT_MOVE_REQ/s%")
        assert answer.encode() == b"%01/ALICE/NAVI_ROBOT_MOVE_REQ/p/stop%"
        await node.close()


async def test_reads_go_through_to_the_database(tmp_path: Path) -> None:
    """What a program inserts into MongoDB is read at once, in the order of requests; the two errors stay two."""
    with mongo_database(tmp_path) as url:
        client: pymongo.MongoClient[dict[str, Any]] = pymongo.MongoClient(url)
        async with serving(mirror=url) as served:
            await until(lambda: not served.store.status()["mirror"]["fault"])
            robots = client.get_default_database()["ROBOT"]
            await asyncio.to_thread(robots.insert_one, {"_id": "pose", "data": "1,2,3"})
            robot = await Raw.connect(served.port)
            robot.send(b"%01/ROBOT/pose/s%%01/ROBOT/none/s%%01/NOBODY/none/s%%01/ROBOT/pose/s%")
            found = [await robot.packet(20) for _ in range(4)]
            assert [(p.id, p.op) for p in found] == [("00", "p"), ("00", "e"), ("00", "e"), ("00", "p")]
            assert found[0].data == found[3].data == b"1,2,3"
            assert b"ROBOT/none" in found[1].data
            assert b"system NOBODY" in found[2].data
            new = await Raw.connect(served.port)
            assert (await new.ask(request("+get", 1, "ROBOT", "other"))).head["code"] == "unknown-topic"
            await robot.close()
            await new.close()
        client.close()


async def test_identifier_of_answers() -> None:
    """The answer to a read begins with the two digits of the node that wrote the value, or with 00."""
    async with serving() as served:
        space = served.server.space
        space.publish(None, "A", "ros", b"1", origin="ros:01100332fe0d+0dd0")
        space.publish(None, "A", "other", b"2", origin="01.2@robot")
        robot = await Raw.connect(served.port)
        robot.send(b"%07/A/seven/p/3%%eleven/A/word/p/4%")
        async with AsyncNode("PEPPER", served.url, ident="42") as node:
            await node.publish("battery", "80", system="A")
        found = [(await robot.ask(b"%01/A/" + topic + b"/s%")).id for topic in (b"ros", b"other", b"seven", b"word")]
        assert found == ["00", "00", "07", "00"]
        assert (await robot.ask(b"%01/A/battery/s%")).id == "42"
        await robot.close()


async def test_disconnect() -> None:
    """A packet to disconnect closes the connection at once, and nothing that stands behind it is carried out."""
    async with serving() as served:
        robot = await Raw.connect(served.port)
        robot.send(b"%01/A/b/p/1%%01/A/b/s%%01/A/-/d%%01/A/b/p/2%")
        assert (await robot.packet()).data == b"1"
        assert await robot.closed()
        entry = served.store.get("A", "b")
        assert entry is not None
        assert entry.data == b"1"
        await until(lambda: not served.server.sessions)


async def test_kinds() -> None:
    """What a node is (robot or PC) is known in the status and beside its values: told by it, or configured."""
    async with serving(kinds={"02": "pc"}) as served:
        desk, unknown = await Raw.connect(served.port), await Raw.connect(served.port)
        await desk.ask(b"%02/A/desk/p/1%%02/A/desk/s%")
        await unknown.ask(b"%03/A/unknown/p/1%%03/A/unknown/s%")
        async with AsyncNode("PEPPER", served.url) as node:
            await node.publish("battery", "80", system="A")
            kinds = {value["topic"]: value["kind"] for value in await node.list("A")}
            assert kinds == {"desk": "pc", "unknown": "", "battery": "robot"}
            status = served.server.status()
            assert status["kinds"] == {"pc": 1, "unknown": 1, "robot": 1}
            assert {(one["identifier"], one["kind"], one["upgraded"]) for one in status["connected"]} == {
                ("02", "pc", False),
                ("03", "", False),
                ("01", "robot", True),
            }
        await desk.close()
        await unknown.close()


async def test_cut_and_joined() -> None:
    """1,000 reads are answered exactly once each, whether they come a byte at a time or all at once."""
    async with serving() as served:
        node = await Raw.connect(served.port)
        node.send(b"%01/A/b/p/1%")
        raw = b"%01/A/b/s%" * 1000
        for size in (1, 7, len(raw)):
            for i in range(0, len(raw), size):
                node.send(raw[i : i + size])
                if size == 1 and i % 100 == 0:
                    await node.writer.drain()
                    await asyncio.sleep(0)
            for _ in range(1000):
                assert (await node.packet()).data == b"1"
        assert served.server.counts["malformed"] == 0
        await node.close()


@pytest.mark.parametrize("path", ["/", "/%01/EVIL/cmd_vel/p/1%", "/" + "x" * 100_000 + "%01/EVIL/cmd_vel/p/1%"])
@pytest.mark.parametrize("method", ["GET", "POST", "PUT", "OPTIONS"])
async def test_a_web_page(method: str, path: str) -> None:
    """Packets in a request of a browser, wherever they stand in it, are no packets of a node."""
    async with serving() as served:
        node = await Raw.connect(served.port)
        body = "%01/EVIL/cmd_vel/p/1%"
        node.send(f"{method} {path} HTTP/1.1\r\nHost: {body}\r\nContent-Length: {len(body)}\r\n\r\n{body}".encode())
        with contextlib.suppress(ConnectionResetError):  # what it sent last was not read
            assert (await node.reader.read()).startswith(b"HTTP/1.1 400 ")
        assert served.server.counts["http"] == 1
        assert not list(served.store.entries())
        await node.close()


async def test_silent_connections_take_no_place() -> None:
    """Whoever connects and sends nothing is no node: all places are for those that do."""
    async with serving(max_clients=2) as served:
        silent = [await Raw.connect(served.port) for _ in range(10)]
        nodes = [await Raw.connect(served.port) for _ in range(2)]
        for node in nodes:
            assert (await node.ask(request("+ping", 1))).op == "+ok"
        assert len(served.server.sessions) == 2
        silent[0].send(b"%01/A/b/p/1%")
        assert await silent[0].closed()
        for node in (*silent, *nodes):
            await node.close()


async def test_silence_and_replies() -> None:
    """Bad packets are counted; a node of the paper hears nothing of them, one of the upgrade is told each."""
    bad = [b"01/A/b/s%", b"%01/A%", b"%01/A/b/x/1%", b"%\xff/A/b/s%", b"%01/A/b/p/" + b"x" * 3000 + b"%"]
    async with serving(max_packet_bytes=2000) as served:
        old = await Raw.connect(served.port)
        for raw in bad:
            old.send(raw)
        old.send(b"%01/A/b/p/ok%")
        assert (await old.ask(b"%01/A/b/s%")).data == b"ok"
        assert served.server.counts["malformed"] == 3
        assert served.server.counts["stray"] == 1
        assert served.server.counts["too-big"] == 1
        new = await Raw.connect(served.port)
        assert (await new.ask(request("+hello", 1, "NEW"))).op == "+ok"
        for raw in (b"%01/A%", b"%01/A/b/x/1%", b"%01/A/b/+what/n=7%", b"%01/A/b/p/" + b"x" * 3000 + b"%"):
            answer = await new.ask(raw)
            assert answer.op == "+err", raw
            assert answer.data
        assert (await new.ask(request("+ping", 9))).op == "+ok"
        await old.close()
        await new.close()


async def test_acknowledged(tmp_path: Path) -> None:
    """A publication is acknowledged once it is kept, with its version; a read has stamp, origin and type."""
    async with serving(str(tmp_path / "s.sqlite")) as served:
        node = await Raw.connect(served.port)
        await node.ask(request("+hello", 1, "ROBOT", o="ROBOT.1"))
        ok = await node.ask(request("+pub", 2, "ROBOT", "odom", b"50 % / ~", t=5, k="std_msgs/msg/String"))
        assert (ok.op, ok.head["n"]) == ("+ok", "2")
        value = await node.ask(request("+get", 3, "ROBOT", "odom"))
        assert value.data == b"50 % / ~"
        assert value.head == {"n": "3", "t": "5", "v": ok.head["v"], "o": "ROBOT.1", "k": "std_msgs/msg/String"}
        answer = await node.ask(b"%01/ROBOT/odom/s%")
        assert answer.op == "e"  # a percent sign has no place in a plain packet
        await node.close()


async def test_live_order() -> None:
    """Live values are the last in the order of their arrival, whatever the clocks of the nodes say."""
    async with serving() as served:
        node = await Raw.connect(served.port)
        for n, version in enumerate((10, 9_999_999_999_999_999, 5, 7), 1):
            assert (await node.ask(request("+pub", n, "A", "b", str(n).encode(), v=version))).op == "+ok"
        assert (await node.ask(request("+get", 9, "A", "b"))).data == b"4"
        await node.close()


async def test_merge() -> None:
    """What was written offline is merged by version: nothing older overwrites newer, the same twice is welcome."""
    async with serving() as served:
        node = await Raw.connect(served.port)
        assert (await node.ask(request("+pub", 1, "A", "b", b"first", v=100, o="x", m=1))).head["v"] == "100"
        stale = await node.ask(request("+pub", 2, "A", "b", b"older", v=50, o="y", m=1))
        assert (stale.op, stale.head["code"]) == ("+err", "stale")
        assert (await node.ask(request("+pub", 3, "A", "b", b"first", v=100, o="x", m=1))).op == "+ok"
        assert (await node.ask(request("+pub", 4, "A", "b", b"newer", v=150, o="y", m=1))).op == "+ok"
        assert (await node.ask(request("+get", 5, "A", "b"))).data == b"newer"
        await node.close()


async def test_pushes() -> None:
    """A subscription gets the value that is there, and every later one of others, not the node's own."""
    async with serving() as served:
        reader, writer = await Raw.connect(served.port), await Raw.connect(served.port)
        writer.send(b"%01/A/b/p/0%")
        assert (await writer.ask(b"%01/A/b/s%")).data == b"0"
        assert (await reader.ask(request("+sub", 1, "A", "*"))).op == "+ok"
        there = await reader.packet()
        assert (there.data, there.head["last"]) == (b"0", "1")
        reader.send(b"%01/A/b/p/mine%")
        writer.send(b"%01/A/b/p/1%%01/A/c/p/2%%01/B/b/p/3%")
        assert [(await reader.packet()).data for _ in range(2)] == [b"1", b"2"]
        assert (await reader.ask(request("+unsub", 2, "A", "*"))).op == "+ok"
        writer.send(b"%01/A/b/p/4%")
        assert (await writer.ask(b"%01/A/b/s%")).data == b"4"
        assert (await reader.ask(request("+ping", 3))).head["n"] == "3"
        await reader.close()
        await writer.close()


async def test_watch() -> None:
    """Who watches is told who publishes and reads, and when they leave."""
    async with serving() as served:
        watcher, node = await Raw.connect(served.port), await Raw.connect(served.port)
        await watcher.ask(request("+watch", 1, "*", "*"))
        await node.ask(request("+hello", 1, "ROBOT"))
        await node.ask(request("+sub", 2, "A", "cmd_vel"))
        event = await watcher.packet()
        assert (event.op, event.topic, event.head["kind"], event.head["here"]) == (
            "+evt",
            "cmd_vel",
            "subscription",
            "1",
        )
        assert event.head["node"] == "ROBOT"
        node.send(b"%01/A/odom/p/1%")
        assert (await watcher.packet()).head["kind"] == "publisher"
        await node.close()
        assert [(await watcher.packet()).head["here"] for _ in range(2)] == ["0", "0"]
        await watcher.close()


async def test_list_and_delete() -> None:
    """Values are listed with their ages, and can be removed."""
    async with serving() as served:
        node = await Raw.connect(served.port)
        await node.ask(request("+pub", 1, "A", "b", b"\xff\x00"))
        await node.ask(request("+pub", 2, "A", "c", b"text"))
        listed = json.loads((await node.ask(request("+list", 3, "A", "*"))).data)
        assert [(v["topic"], v.get("data"), v.get("base64")) for v in listed] == [
            ("b", None, "/wA="),
            ("c", "text", None),
        ]
        assert all(0 <= v["age_s"] < 5 for v in listed)
        assert (await node.ask(request("+del", 4, "A", "b"))).op == "+ok"
        assert (await node.ask(request("+del", 5, "A", "b"))).head["code"] == "unknown-topic"
        assert (await node.ask(request("+get", 6, "A", "b"))).head["code"] == "unknown-topic"
        await node.close()


async def test_limits() -> None:
    """Values above a limit are refused with a word and the limit; the connection stays."""
    async with serving(limits=StoreLimits(max_value_bytes=100, max_values=2)) as served:
        node = await Raw.connect(served.port)
        answers = [
            await node.ask(request("+pub", 1, "A", "a", b"x" * 101)),
            await node.ask(request("+pub", 2, "A", "a", b"x")),
            await node.ask(request("+pub", 3, "A", "b", b"x")),
            await node.ask(request("+pub", 4, "A", "c", b"x")),
            await node.ask(request("+pub", 5, "A", "a" * 300, b"x")),
            await node.ask(request("+pub", 6, "A", "a", b"x", t="soon")),
        ]
        told = [answer.head.get("code", answer.op) for answer in answers]
        assert told == ["too-big", "+ok", "+ok", "full", "name", "malformed"]
        await node.close()


def door(**roles: Role) -> Door:
    rules = [TokenRule(hashlib.sha256(name.encode()).digest(), role) for name, role in roles.items()]
    return Door(tokens=rules, default=None)


async def test_login() -> None:
    """Without a token nothing is done, and a node of the upgrade is told so; with one its role decides."""
    role = Role("robot", {"publish": ("/ROBOT/*",), "subscribe": ("/ROBOT/*", "/cmd/*")})
    async with serving(door=door(secret=role)) as served:
        old = await Raw.connect(served.port)
        old.send(b"%01/ROBOT/odom/p/1%")
        assert (await old.ask(b"%01/ROBOT/odom/s%")).op == "e"
        node = await Raw.connect(served.port)
        assert (await node.ask(request("+pub", 1, "ROBOT", "odom", b"1"))).head["code"] == "login"
        assert (await node.ask(request("+hello", 2, "ROBOT", token="wrong"))).head["code"] == "login"
        assert (await node.ask(request("+hello", 3, "ROBOT", token="secret"))).op == "+ok"
        assert (await node.ask(request("+pub", 4, "ROBOT", "odom", b"1"))).op == "+ok"
        denied = await node.ask(request("+pub", 5, "OTHER", "odom", b"1"))
        assert denied.head["code"] == "denied"
        assert b"role robot" in denied.data
        assert (await node.ask(request("+get", 6, "OTHER", "odom"))).head["code"] == "denied"
        assert sum(served.server.denied.values()) == 2
        assert (await node.ask(request("+sub", 7, "*", "*"))).op == "+ok"
        await node.packet()
        served.server.space.publish(None, "OTHER", "secret", b"hidden", origin="x")
        served.server.space.publish(None, "cmd", "go", b"seen", origin="x")
        assert (await node.packet()).data == b"seen"
        await old.close()
        await node.close()


async def test_login_in_time() -> None:
    """Where nodes have to log in, one that does not is closed after a time, counted and logged; who is in stays."""
    async with serving(door=door(secret=EVERYTHING), login_s=0.3) as served:
        good, silent = await Raw.connect(served.port), await Raw.connect(served.port)
        assert (await good.ask(request("+hello", 1, "A", token="secret"))).op == "+ok"
        assert await silent.closed()
        assert served.server.counts["no login"] == 1
        assert (await good.ask(request("+ping", 2))).op == "+ok"
        await good.close()


async def test_only_who_is_in_takes_a_place() -> None:
    """Connections that did not log in keep nobody out, and have no part in what others do."""
    async with serving(door=door(secret=EVERYTHING), max_clients=1) as served:
        silent = [await Raw.connect(served.port) for _ in range(5)]
        assert (await silent[0].ask(request("+watch", 1, "*", "*"))).head["code"] == "login"
        assert (await silent[0].ask(request("+unsub", 2, "*", "*"))).head["code"] == "login"
        node = await Raw.connect(served.port)
        assert (await node.ask(request("+hello", 1, "A", token="secret"))).op == "+ok"
        assert len(served.server.sessions) == 1
        assert (await silent[1].ask(request("+hello", 1, "B", token="secret"))).head["code"] == "full"
        await node.close()
        await until(lambda: not served.server.sessions)
        assert (await silent[2].ask(request("+hello", 1, "B", token="secret"))).op == "+ok"
        for one in silent:
            await one.close()
        await until(lambda: not len(served.server.entrance.lobby))


async def test_three_wrong_tokens(caplog: pytest.LogCaptureFixture) -> None:
    """A connection is closed after three wrong tokens; after more from its address, the right one is refused, too."""
    async with serving(door=door(secret=EVERYTHING)) as served:
        for connection in range(4):
            node = await Raw.connect(served.port)
            for number in range(3):
                assert (await node.ask(request("+hello", number, "A", token=f"guess{connection}"))).head[
                    "code"
                ] == "login"
            assert await node.closed()
        node = await Raw.connect(served.port)
        answer = await node.ask(request("+hello", 1, "A", token="secret"))
        assert (answer.head["code"], b"too many wrong tokens" in answer.data) == ("login", True)
        assert served.server.entrance.lockout.status()["locked out"] == 1
        assert "bad token guesses" in caplog.text
        assert len([message for message in caplog.messages if "token is not known" in message]) == 1
        await node.close()


async def test_limits_of_roles() -> None:
    """The limits of a role on clients and on the size of a message hold for nodes."""
    role = Role("robot", EVERYTHING.allow, max_clients=1, max_message_bytes=2000)
    async with serving(door=door(secret=role)) as served:
        first, second = await Raw.connect(served.port), await Raw.connect(served.port)
        answer = await first.ask(request("+hello", 1, "A", token="secret"))
        assert answer.head["max"] == "2000"
        assert (await second.ask(request("+hello", 1, "B", token="secret"))).head["code"] == "full"
        assert (await first.ask(request("+pub", 2, "A", "x", b"0" * 1000))).op == "+ok"
        assert (await first.ask(request("+pub", 3, "A", "x", b"0" * 3000))).head["code"] == "too-big"
        await first.close()
        await until(lambda: not served.server.sessions)
        assert (await second.ask(request("+hello", 2, "B", token="secret"))).op == "+ok"
        await second.close()


async def test_big_packet_after_hello() -> None:
    """What a node sends with its login counts as from one that is in, also if it is bigger than a login may be."""
    async with serving(door=door(secret=EVERYTHING)) as served:
        node = await Raw.connect(served.port)
        node.send(request("+hello", 1, "A", token="secret") + request("+pub", 2, "A", "x", b"0" * 100_000))
        assert [(await node.packet()).op, (await node.packet()).op] == ["+ok", "+ok"]
        stranger = await Raw.connect(served.port)
        stranger.send(request("+pub", 2, "A", "x", b"0" * 100_000))
        await until(lambda: served.server.counts["too-big"])
        await stranger.close()
        await node.close()


async def test_a_version_from_a_far_future() -> None:
    """A merged value with a version that leaves no room is refused, and a live one counts as written now."""
    async with serving() as served:
        node = await Raw.connect(served.port)
        poison = b"%%01/A/x/+pub/n=1,v=%d%s/poison%%"
        assert (await node.ask(poison % ((1 << 62) - 1, b",m=1"))).head["code"] == "malformed"
        answer = await node.ask(poison % ((1 << 62) - 1, b""))
        assert int(answer.head["v"]) < 1 << 52
        assert (await node.ask(request("+pub", 2, "A", "x", b"good"))).op == "+ok"
        await node.close()


async def test_two_of_one_name(caplog: pytest.LogCaptureFixture) -> None:
    """Two nodes of one name are both served; the second is told, and the log says which."""
    async with serving() as served:
        first, second = await Raw.connect(served.port), await Raw.connect(served.port)
        assert (await first.ask(request("+hello", 1, "PEPPER"))).data == b""
        with caplog.at_level(logging.WARNING):
            assert b"PEPPER" in (await second.ask(request("+hello", 1, "PEPPER"))).data
        assert "both are served" in caplog.text
        await first.close()
        await second.close()


async def test_slow_loris() -> None:
    """Who does not finish a packet is closed after a time, and told why; who is only quiet is not."""
    async with serving(unfinished_s=0.3) as served:
        quiet, slow = await Raw.connect(served.port), await Raw.connect(served.port)
        await slow.ask(request("+ping", 1))
        slow.send(b"%01/A/b/p/")
        answer = await slow.packet()
        assert (answer.op, answer.head["code"]) == ("+err", "malformed")
        assert await slow.closed()
        assert served.server.counts["slow"] == 1
        quiet.send(b"%01/A/b/p/1%")
        assert (await quiet.ask(b"%01/A/b/s%")).data == b"1"
        await quiet.close()


async def test_silent_node() -> None:
    """A node that pings and then says nothing for long is given up; one that only reads is not."""
    async with serving(silence_s=0.3) as served:
        node, reader, writer = [await Raw.connect(served.port) for _ in range(3)]
        assert (await reader.ask(request("+sub", 1, "A", "x"))).op == "+ok"
        await node.ask(request("+ping", 1))
        assert (await node.packet()).head["code"] == "timeout"
        assert await node.closed()
        writer.send(b"%01/A/x/p/1%")
        assert (await reader.packet()).data == b"1"
        await reader.close()
        await writer.close()
        await until(lambda: not served.server.sessions)


async def test_stalled_reader() -> None:
    """Who does not read costs bounded memory; others go on, and it gets the newest value of each topic at the end."""
    async with serving(limits=StoreLimits(max_value_bytes=1 << 20)) as served:
        stalled = await Raw.connect(served.port)
        stalled.send(request("+sub", 1, "A", "*"))
        await until(lambda: any(True for _ in served.server.space.endpoints()))
        writer, reader = await Raw.connect(served.port), await Raw.connect(served.port)
        await reader.ask(request("+sub", 1, "A", "small"))
        block = b"x" * 500_000
        for i in range(60):
            assert (await writer.ask(request("+pub", i, "A", f"big{i % 3}", block + str(i).encode()))).op == "+ok"
        await writer.ask(request("+pub", 99, "A", "small", b"hello"))
        assert (await reader.packet()).data == b"hello"
        session = next(s for s in served.server.sessions if s.superseded)
        assert session._pushes.bytes <= 16 << 20
        found: dict[str, bytes] = {}
        while b"hello" not in found.values():
            packet = await stalled.packet()
            found[packet.topic] = packet.data[-2:] if packet.topic.startswith("big") else packet.data
        assert {found[f"big{i}"] for i in range(3)} == {b"57", b"58", b"59"}
        for node in (stalled, writer, reader):
            await node.close()


async def test_flood_without_reading() -> None:
    """Who asks without end and reads nothing is read no further, and is answered everything once it reads."""
    async with serving() as served:
        node = await Raw.connect(served.port)
        node.send(b"%01/A/b/p/" + b"y" * 1000 + b"%")
        raw = b"%01/A/b/s%" * 100
        for _ in range(200):
            node.send(raw)
        answers = 0
        while answers < 20_000:
            assert (await node.packet(30)).op == "p"
            answers += 1
        await node.close()


async def test_hostile_bytes(caplog: pytest.LogCaptureFixture) -> None:
    """20,000 packets of nonsense cost no connection, no error in the log, and nobody else's values."""
    rng = random.Random(5)
    words = [b"%", b"%%", b"/", b"~2", b"~", b"=", b",", b"p", b"s", b"+pub", b"+sub", b"+get", b"+hello", b"+list"]
    words += [
        b"+del",
        b"+watch",
        b"+adv",
        b"+unsub",
        b"n=1",
        b"v=x",
        b"t=-5",
        b"m=1",
        b"last=1",
        b"*",
        b"[",
        b"A",
        b"b",
    ]
    words += [b"\xff\x00", b"01", b"\r\n", b"q={", b"k=std_msgs/msg/String", b"v=99999999999999999999"]
    async with serving(limits=StoreLimits(max_values=50)) as served:
        served.server.space.publish(None, "SAFE", "value", b"kept", origin="test")
        hostile = await Raw.connect(served.port)

        async def swallow() -> None:
            with contextlib.suppress(ConnectionError):  # we leave while answers still come
                while await hostile.reader.read(65536):
                    pass

        swallowing = asyncio.create_task(swallow())
        for _ in range(20_000):
            hostile.send(b"%" + b"/".join(rng.choices(words, k=rng.randrange(1, 8))) + b"%")
            if hostile.writer.transport.get_write_buffer_size() > 1 << 16:
                await hostile.writer.drain()
        await hostile.writer.drain()
        friend = await Raw.connect(served.port)
        assert (await friend.ask(b"%01/SAFE/value/s%")).data == b"kept"
        await until(lambda: served.server.counts["malformed"] > 1000)
        assert not [record for record in caplog.records if record.levelno >= logging.ERROR]
        await hostile.close()
        await friend.close()
        await swallowing


async def test_many_big_answers() -> None:
    """A thousand requests at once for a big value are answered as the node reads, not all at once into memory."""
    async with serving(limits=StoreLimits(max_value_bytes=1 << 20), silence_s=3600) as served:
        node = await Raw.connect(served.port)
        await node.ask(request("+pub", 1, "A", "big", b"x" * 1_000_000))
        node.send(b"%01/A/big/s%" * 1000)
        await until(lambda: any(session._items for session in served.server.sessions))
        (session,) = served.server.sessions
        assert session.transport is not None
        assert session.transport.get_write_buffer_size() < 8 << 20
        for _ in range(1000):
            assert len((await node.packet(30)).data) == 1_000_000
        await node.close()


async def test_database_refuses(tmp_path: Path) -> None:
    """While values cannot be kept they are served, and publishers of the upgrade are told that they are not kept."""
    async with serving(str(tmp_path / "s.sqlite")) as served:
        node = await Raw.connect(served.port)
        await node.ask(request("+pub", 1, "A", "b", b"1"))
        backend = served.store.backend
        good = backend.write

        def full(*_: object) -> None:
            raise StoreUnavailable(backend.url, "the disk is full")

        backend.write = full  # type: ignore[method-assign, assignment]
        answer = await node.ask(request("+pub", 2, "A", "b", b"2"))
        assert answer.head["code"] == "not-kept"
        assert b"disk is full" in answer.data
        assert (await node.ask(request("+get", 3, "A", "b"))).data == b"2"
        backend.write = good  # type: ignore[method-assign]
        await until(lambda: not served.store.fault)
        assert [e.data for e in await asyncio.to_thread(backend.load)] == [b"2"]
        await node.close()


async def test_killed(tmp_path: Path) -> None:
    """No value that was acknowledged is lost, however often the server is killed with -9 among writes."""
    server = ServerProcess(tmp_path / "s.sqlite", free_port())
    acknowledged: dict[str, int] = {}
    numbers = itertools.count(1)
    try:
        for _ in range(4):
            await asyncio.to_thread(server.start)
            node = await Raw.connect(server.port)
            for topic, number in acknowledged.items():
                answer = await node.ask(request("+get", 0, "A", topic))
                assert int(answer.data) >= number
            sent: dict[str, tuple[str, int]] = {}

            async def write(node: Raw = node, sent: dict[str, tuple[str, int]] = sent) -> None:
                for number in numbers:
                    topic = f"t{number % 7}"
                    sent[str(number)] = (topic, number)
                    node.send(request("+pub", number, "A", topic, str(number).encode()))
                    await node.writer.drain()
                    await asyncio.sleep(0)

            async def read(node: Raw = node, sent: dict[str, tuple[str, int]] = sent) -> None:
                try:
                    while True:
                        answer = await node.packet(10)
                        topic, number = sent[answer.head["n"]]
                        acknowledged[topic] = max(acknowledged.get(topic, 0), number)
                except (EOFError, ConnectionError):
                    pass

            writing = asyncio.create_task(write())
            reading = asyncio.create_task(read())
            before = sum(acknowledged.values())
            await until(lambda before=before: sum(acknowledged.values()) > before + 200 * 7)
            await asyncio.to_thread(server.kill)
            writing.cancel()
            await asyncio.wait([writing, reading])
            await node.close()
        await asyncio.to_thread(server.start)
        node = await Raw.connect(server.port)
        for topic, number in acknowledged.items():
            assert int((await node.ask(request("+get", 0, "A", topic))).data) >= number
        await node.close()
    finally:
        server.kill()


async def test_no_place() -> None:
    """Above the greatest number of nodes one more is closed, and counted."""
    async with serving(max_clients=2) as served:
        nodes = [await Raw.connect(served.port) for _ in range(2)]
        for node in nodes:
            await node.ask(request("+ping", 1))
        third = await Raw.connect(served.port)
        third.send(b"%01/A/b/p/1%")
        assert await third.closed()
        assert served.server.counts["no place"] == 1
        for node in (*nodes, third):
            await node.close()


async def test_port_taken() -> None:
    """A port that is taken is told with its address."""
    async with serving() as served:
        with pytest.raises(ConnectFailed, match=r":\d+: cannot listen"):
            async with serving(port=served.port):
                pass


async def test_nodes_for_whom_nothing_waits_hold_nothing() -> None:
    """Thousands of nodes that were answered share what is empty, and have no queues of their own."""
    async with serving() as served:
        nodes = [await Raw.connect(served.port) for _ in range(2)]
        for node in nodes:
            assert (await node.ask(request("+pub", 1, "A", "pose", b"1"))).op == "+ok"
            assert (await node.ask(request("+sub", 2, "A", "speed"))).op == "+ok"
        first, second = served.server.sessions
        assert first._items is second._items
        assert not first._items
        assert first._pushes._outbox is None
        assert not hasattr(first, "__dict__")
        for node in nodes:
            await node.close()
