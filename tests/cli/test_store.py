"""``ropeway store``, and the topic verbs on ``iort://``, as a user has them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from ropeway.cli.store.source import find_source
from ropeway.errors import ConnectFailed
from ropeway.iort import Node
from tests.cli.conftest import Ropeway
from tests.support.ports import free_port
from tests.support.until import PATIENCE_S


class Place:
    def __init__(self, ropeway: Ropeway, ws: int, nodes: int, store: str) -> None:
        self._ropeway = ropeway
        self.http, self.iort, self.store = f"http://127.0.0.1:{ws}", f"iort://127.0.0.1:{nodes}", store

    def run(self, *words: str, code: int = 0) -> str:
        result = self._ropeway(*words)
        assert result.returncode == code, result.stderr
        return result.stdout if code == 0 else result.stderr


@pytest.fixture
def place(tmp_path: Path, in_process: Ropeway, environment: dict[str, str]) -> Iterator[Place]:
    ws, nodes = free_port(), free_port()
    store = str(tmp_path / "s.sqlite")
    config = tmp_path / "config.json"
    gateway = {
        "name": "here",
        "graphs": ["memory:x"],
        "listen": [f"ws://127.0.0.1:{ws}", f"iort://127.0.0.1:{nodes}"],
        "store": {"path": store, "history": 3},
    }
    config.write_text(json.dumps({"gateway": gateway}))
    process = subprocess.Popen(
        [sys.executable, "-m", "ropeway", "run", str(config), "--json"],
        stdout=subprocess.PIPE,
        pipesize=1 << 20,  # one line is read
        text=True,
        env={**os.environ, **environment},
    )
    assert process.stdout is not None
    process.stdout.readline()
    yield Place(in_process, ws, nodes, store)
    process.send_signal(signal.SIGTERM)
    process.stdout.close()
    assert process.wait(PATIENCE_S) == 0


def test_store(place: Place) -> None:
    """Values are listed, read, watched and removed, at a gateway, at its server of nodes, or in its file."""
    with Node("PEPPER", place.iort) as node:
        node.publish("battery", "80")
        node.publish("battery", "79")
        node.publish("pose", [1, 2, 3])
        for at in (place.http, place.iort, place.store):
            listed = place.run("store", "list", "--at", at)
            assert [line.split()[0] for line in listed.splitlines()] == ["PEPPER/battery", "PEPPER/pose"], at
            assert place.run("store", "get", "PEPPER/battery", "--at", at) == "79\n"
            value = json.loads(place.run("store", "get", "/PEPPER/pose", "--json", "--at", at))
            assert value["data"] == "1.0,2.0,3.0"
        assert place.run("store", "get", "PEPPER/battery", "--history", "--at", place.http) == "79\n80\n"
        assert place.run("store", "get", "PEPPER/pose", "--raw", "--at", place.http) == "1.0,2.0,3.0"
        for at in (place.http, place.iort):
            watched = place.run("store", "watch", "PEPPER", "-n", "2", "--at", at)
            assert watched == "PEPPER/battery  79\nPEPPER/pose  1.0,2.0,3.0\n"
        assert "forgotten" in place.run("store", "rm", "PEPPER/pose", "--at", place.http)
        assert "forgotten" in place.run("store", "rm", "PEPPER/battery", "--at", place.iort)
        assert place.run("store", "list", "--at", place.http) == ""


def test_mistakes(place: Place) -> None:
    """What cannot be done is said with what to do instead."""
    assert "no value of A/b is there" in place.run("store", "get", "A/b", "--at", place.http, code=1)
    assert "name one topic" in place.run("store", "get", "A", "--at", place.http, code=2)
    assert "a pattern removes nothing" in place.run("store", "rm", "A/*", "--at", place.http, code=2)
    assert "is a gateway running there?" in place.run("store", "list", "--at", "http://127.0.0.1:9", code=1)
    assert "does not exist" in place.run("store", "list", "--at", "/nowhere/x.sqlite", code=1)
    assert "no parameter but token" in place.run("store", "list", "--at", f"{place.http}/?tokn=abc", code=1)
    assert place.run("store", "list", "--at", f"{place.http}?token=abc") == ""
    assert "is watched at a gateway" in place.run("store", "watch", "--at", place.store, code=1)


@pytest.mark.parametrize("status", [301, 302, 303, 307, 308])
def test_a_gateway_that_points_elsewhere(status: int) -> None:
    """Where a gateway points to another address, the token does not go there, and nothing is asked there."""
    asked: list[str] = []

    class Pointing(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(self.path)
            self.send_response(status)
            self.send_header("Location", f"http://localhost:{self.headers['Host'].partition(':')[2]}/elsewhere")
            self.end_headers()

        do_DELETE = do_GET  # noqa: N815 - the name that the server looks for

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Pointing) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        source = find_source(f"http://127.0.0.1:{server.server_address[1]}", "secret", "")
        with pytest.raises(ConnectFailed, match=f"answered {status}; that is not followed"):
            source.values("*", "*")
        with pytest.raises(ConnectFailed, match="not followed"):
            source.remove("A", "b")
        server.shutdown()
    assert asked == ["/store", "/store/A/b"]


def test_topics_of_nodes(place: Place) -> None:
    """The topic verbs see the topics of nodes, and read and publish them."""
    with Node("PEPPER", place.iort) as node:
        node.publish("battery", "80")
        assert "/PEPPER/battery" in place.run("topic", "list", "--graph", place.iort)
        place.run(
            "topic", "pub", "--once", "--graph", place.iort, "/PEPPER/say", "std_msgs/msg/String", '{"data": "hello"}'
        )
        assert node.read("say").text == "hello"
