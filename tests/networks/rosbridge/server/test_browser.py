"""A browser as client of the server: which pages may talk to it; skipped where there is no Chromium."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any

import pytest

from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.listener.authentication import Door
from ropeway.listener.hosts import Hosts, own_names
from ropeway.qos import LATCHED, QoS
from tests.networks.rosbridge.server.browser import CHROMIUM, browser, pages
from tests.support.inbox import Inbox
from tests.support.place import Place

if CHROMIUM is None:
    pytest.skip("needs Chromium, which .ci/run installs on Debian", allow_module_level=True)

STRING = "std_msgs/msg/String"
STRANGER = "evil.example"

TRY = """<script>
const tell = (told) => fetch("/told", {method: "POST", body: JSON.stringify(told)});
const socket = new WebSocket(%(ws)s);
socket.onopen = () => {
  socket.send(JSON.stringify({op: "publish", topic: "/cmd_vel", type: "std_msgs/String", msg: {data: "go"}}));
  tell({socket: "open"});
};
socket.onerror = () => tell({socket: "refused"});
fetch(%(http)s).then(async (got) => tell({get: [got.status, await got.text()]})).catch(() => tell({get: "refused"}));
fetch(%(http)s, {method: "DELETE"}).then((got) => tell({delete: got.status})).catch(() => tell({delete: "refused"}));
</script>"""
"""A page that tries everything it can with the server."""

ECHO = {
    "roslib1": """<script src="/roslib1/build/roslib.min.js"></script><script>%s</script>""",
    "roslib2": """<script type="importmap">{"imports": {
  "roslib": "/roslib2/dist/RosLib.js", "bson": "/bson/lib/bson.mjs", "cbor2": "/cbor2/lib/index.js",
  "eventemitter3": "/eventemitter3/dist/eventemitter3.esm.js", "fast-png": "/fast-png/lib/index.js",
  "uuid": "/uuid/dist/index.js", "@cto.af/wtf8": "/@cto.af/wtf8/lib/index.js", "fflate": "/fflate/esm/browser.js",
  "iobuffer": "/iobuffer/lib/iobuffer.js"
}}</script><script type="module">import * as ROSLIB from "roslib"; %s</script>""",
}
"""How a page loads roslibjs, as one script or as a module."""

DASHBOARD = """
const tell = (told) => fetch("/told", {method: "POST", body: JSON.stringify(told)});
const ros = new ROSLIB.Ros({url: "ws://localhost:%d"});
const topic = (name, options) => new ROSLIB.Topic({ros, name, messageType: "std_msgs/String", ...options});
const answer = topic("/answer");
for (const compression of ["none", "cbor", "png"])
  topic("/greeting", {compression}).subscribe((message) => {
    tell({[compression]: message});
    answer.publish({data: `${compression}: ${message.data}`});
  });
"""
"""What a dashboard does."""


def tries(port: int, host: str = "127.0.0.1") -> str:
    return TRY % {"ws": json.dumps(f"ws://{host}:{port}/"), "http": json.dumps(f"http://{host}:{port}/healthz")}


async def heard(place: Place) -> Inbox:
    """What arrives at the robot's wheels."""
    inbox = Inbox()
    await place.robot.create_subscription("/cmd_vel", STRING, QoS(), inbox)
    return inbox


async def test_a_page_of_a_stranger(place: Place, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A page from elsewhere can neither connect nor read an answer, and the log says which key would let it."""
    inbox = await heard(place)
    async with pages(tries(place.port)) as shown:
        origin = f"http://{STRANGER}:{shown.port}"
        async with browser(f"{origin}/page", tmp_path, names=[STRANGER]):
            assert [await shown.wait(what) for what in ("socket", "get", "delete")] == ["refused"] * 3
    assert f'add "{origin}" to gateway.auth.origins' in caplog.text
    assert set(place.entrance.refused) == {"403 web pages of this origin may not connect"}
    assert inbox.payloads == []
    assert not place.server.sessions


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1", socket.gethostname().lower()])
async def test_a_page_of_this_machine(bare: Place, tmp_path: Path, host: str) -> None:
    """A page that this machine serves, under any name of its own, connects, publishes, and reads answers."""
    await bare.start(unregister_timeout_s=0.1, door=Door(hosts=Hosts(own_names())))
    inbox = await heard(bare)
    async with (
        pages(tries(bare.port, host)) as shown,
        browser(f"http://{host}:{shown.port}/page", tmp_path, names=[host]),
    ):
        assert await shown.wait("socket") == "open"
        assert (await shown.wait("get"))[0] == 200
        await inbox.wait(1)
    assert bare.entrance.refused == {}


async def test_a_page_that_is_listed(bare: Place, tmp_path: Path) -> None:
    """The one key that the refusal names lets a page from elsewhere in."""
    async with pages("") as shown:
        origin = f"http://{STRANGER}:{shown.port}"
        await bare.start(unregister_timeout_s=0.1, door=Door(hosts=Hosts(origins=(origin,))))
        shown.page = tries(bare.port)
        inbox = await heard(bare)
        async with browser(f"{origin}/page", tmp_path, names=[STRANGER]):
            assert await shown.wait("socket") == "open"
            assert (await shown.wait("get"))[0] == 200
            await inbox.wait(1)


async def test_a_name_that_leads_here_by_now(place: Place, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A page whose name was made to lead to the server after it had loaded reaches nothing, though it asks its own."""
    inbox = await heard(place)
    async with pages("", behind=place.port) as shown:
        shown.page = tries(shown.port, STRANGER)
        async with browser(f"http://{STRANGER}:{shown.port}/page", tmp_path, names=[STRANGER]):
            assert await shown.wait("socket") == "refused"
            status, body = await shown.wait("get")
            assert status == 403
            assert f'"{STRANGER}" to gateway.auth.hosts' in json.loads(body)["error"]
            assert await shown.wait("delete") == 403
    assert STRANGER in caplog.text
    assert inbox.payloads == []


@pytest.mark.parametrize("library", ["roslib1", "roslib2"])
async def test_a_dashboard(place: Place, tmp_path: Path, library: str) -> None:
    """A page with roslibjs hears a topic in every compression and publishes another."""
    modules = Path(__file__).parents[3] / "js" / "node_modules"
    if not (modules / library).is_dir():
        pytest.skip("needs roslibjs: npm ci --prefix tests/js")
    answers = Inbox()
    await place.robot.create_subscription("/answer", STRING, QoS(depth=10), answers)
    publisher = await place.robot.create_publisher("/greeting", STRING, LATCHED)
    codec = place.registry.codec(STRING)
    publisher.publish(Sample(codec.from_json({"data": "grüße"}), STRING, 0, bytes(16), SEQ_NONE))
    async with (
        pages(ECHO[library] % (DASHBOARD % place.port), modules) as shown,
        browser(f"http://localhost:{shown.port}/page", tmp_path),
    ):
        for compression in ("none", "cbor", "png"):
            assert await shown.wait(compression) == {"data": "grüße"}
        await answers.wait(3)
    got: list[Any] = [json.loads(codec.json(payload))["data"] for payload in answers.payloads]
    # The greeting is latched, so each subscription may bring it, and roslibjs gives it to all listeners of the topic.
    assert set(got) == {"cbor: grüße", "none: grüße", "png: grüße"}
    assert place.complaints == {}
