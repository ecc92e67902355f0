"""The audit log says who changed, commanded, was denied, refused or disconnected; nothing secret is in it."""

from __future__ import annotations

import asyncio
import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from ropeway.audit.files import AuditFiles
from ropeway.audit.trail import AuditTrail
from tests.control.conftest import Begin, Controlled
from tests.support.websocket import Client

JSON = {"content-type": "application/json"}
TWIST = "geometry_msgs/msg/Twist"


@pytest.fixture
def trail(tmp_path: Path) -> Iterator[AuditTrail]:
    files = AuditFiles(tmp_path / "audit", file_bytes=1 << 20, files=2, file_days=1.0, keep_days=1.0)
    trail = AuditTrail(files)
    yield trail
    trail.close()


async def _entries(running: Controlled, count: int = 0, **query: Any) -> list[dict[str, Any]]:
    """Return the entries that fit, once there are so many."""
    while True:
        answer = await running.client.get("/v1/audit", params=query)
        assert answer.status_code == 200, answer.text
        found: list[dict[str, Any]] = answer.json()["entries"]
        if len(found) >= count:
            return found
        await asyncio.sleep(0.01)


def _route(name: str) -> dict[str, Any]:
    return {"remote": "ws://127.0.0.1:1?token=hidden", "operation": "publish", "item": {"name": name, "type": TWIST}}


async def test_changes_are_written_down(begin: Begin, trail: AuditTrail, tmp_path: Path) -> None:
    """Who planned, applied, added a route or failed to is in the log with what it was, and no token is."""
    running = await begin(trail=trail)
    client = running.client
    added = await client.post("/v1/routes", json=_route("/cmd_vel"))
    assert added.status_code == 200, added.text
    key = (await client.get("/v1/routes")).json()[0]["key"]
    await client.post(f"/v1/routes/{key}/pause", headers=JSON)
    config = (await client.get("/v1/config")).json()["config"]
    await client.post("/v1/config/plan", json={"config": {**config, "remotes": []}})
    await client.put("/v1/config", json={"config": {**config, "remotes": []}})
    await client.put("/v1/config", json={"config": {"gateway": {"nme": "a"}}})
    await client.put("/v1/config", json={"config": config}, headers={"if-match": '"other"'})
    await client.post("/v1/config/rollback", json={})
    found = await _entries(running, 7, kind="change")
    assert [(entry["operation"], entry["outcome"]) for entry in found] == [
        ("route add", "done"),
        ("route pause", "done"),
        ("plan", "done"),
        ("apply", "done"),
        ("apply", "refused"),
        ("apply", "refused"),
        ("rollback", "refused"),
    ]
    assert found[0]["name"] == "publish /cmd_vel ws://127.0.0.1:1?token=..."
    assert found[1]["name"] == found[0]["name"]
    assert found[0]["details"]["steps"][0] == "start remote ws://127.0.0.1:1?token=..."
    assert found[4]["why"] == "faults at gateway.nme"
    assert found[0]["details"].keys() == {"number", "etag", "steps", "step_count"}
    assert all(entry["where"].startswith("unix:") and entry["who"] for entry in found)
    assert "hidden" not in (tmp_path / "audit").read_text()


async def test_commands_denials_and_kicks_are_written_down(begin: Begin, trail: AuditTrail) -> None:
    """A role's commands are in the log with the hash of what was sent, its denials with the rule, and its end."""
    role = {"publish": ["/cmd_vel", "/odom"], "call": ["*"]}
    running = await begin(
        trail=trail,
        listen=["ws://127.0.0.1:0"],
        auth={"roles": {"driver": role}, "default_role": "driver"},
        audit={"commands": [{"roles": ["driver"], "names": ["/cmd_vel"]}]},
    )
    port = running.gateway.servers[0].listeners[0].port
    async with Client(port) as driver:
        for topic in ("/cmd_vel", "/odom", "/forbidden"):
            driver.send({"op": "advertise", "topic": topic, "type": TWIST})
            driver.send({"op": "publish", "topic": topic, "msg": {"linear": {"x": 0.5}}})
        [command] = await _entries(running, 1, kind="command")
        payload = running.gateway.registry.codec(TWIST).encode({"linear": {"x": 0.5}})
        expected = {"operation": "publish", "name": "/cmd_vel", "who": "role driver", "bytes": len(payload)}
        assert expected.items() <= command.items()
        assert command["sha256"] == hashlib.sha256(payload).hexdigest()
        denied = await _entries(running, 1, kind="denied", name="forbidden")
        assert denied[0]["why"] == "role driver does not list it under publish"
        peer = command["where"]
        assert (await running.client.delete(f"/v1/sessions/{peer}", headers=JSON)).status_code == 200
        [kicked] = await _entries(running, 1, kind="kicked")
        assert (kicked["operation"], kicked["name"]) == ("disconnect", peer)
    assert await _entries(running, name="/odom") == []


async def test_a_thousand_wrong_tokens_are_few_entries(
    begin: Begin, trail: AuditTrail, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Guessing of tokens is refused, later and later, and is counted in few entries without any token."""
    monkeypatch.setenv("AUDIT_TOKEN", "right-and-long")
    tokens = [{"token": {"env": "AUDIT_TOKEN"}, "role": "watcher"}]
    running = await begin(
        trail=trail,
        auth={"tokens": tokens, "roles": {"watcher": {"control": ["observe"]}}},
        control={"listen": ["http://127.0.0.1:0"]},
    )
    [url] = running.control.addresses
    statuses = []
    async with httpx.AsyncClient(base_url=url) as client:
        for number in range(1000):
            answer = await client.get("/v1/status", headers={"authorization": f"Bearer guess-{number}"})
            statuses.append(answer.status_code)
    assert statuses[0] == 401
    assert statuses[-1] == 429
    trail.close()
    found = await _entries(running, kind="refused")
    assert sum(entry.get("times", 1) for entry in found) == 1000
    assert len(found) < 20
    assert "guess" not in json.dumps(found)


async def test_rights_that_are_missing_are_written_down(
    begin: Begin, trail: AuditTrail, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who only may observe reads the log, and what it was denied at the control API is in it."""
    monkeypatch.setenv("AUDIT_TOKEN", "right-and-long")
    tokens = [{"token": {"env": "AUDIT_TOKEN"}, "role": "watcher"}]
    running = await begin(
        trail=trail,
        auth={"tokens": tokens, "roles": {"watcher": {"control": ["observe"]}}},
        control={"listen": ["http://127.0.0.1:0"]},
    )
    [url] = running.control.addresses
    token = {"authorization": "Bearer right-and-long"}
    async with httpx.AsyncClient(base_url=url, headers=token) as client:
        assert (await client.get("/v1/config")).status_code == 403
        assert (await client.post("/v1/routes", json=_route("/a"))).status_code == 403
        found = await _entries(running, 2, kind="denied")
        assert [entry["operation"] for entry in found] == ["GET /v1/config", "route add"]
        assert {entry["who"] for entry in found} == {"role watcher"}
        assert (await client.get("/v1/audit", params={"kind": "denied"})).json()["entries"] == found


async def test_wrong_questions_are_answered(begin: Begin, trail: AuditTrail) -> None:
    """A filter that makes no sense is refused with what is expected, and a gateway without a log says so."""
    running = await begin(trail=trail)
    for query, word in (({"kind": "comand"}, "command"), ({"count": "x"}, "number"), ({"since": "1.2.3"}, "number")):
        answer = await running.client.get("/v1/audit", params=query)
        assert answer.status_code == 422
        assert word in answer.json()["error"]
    other = await begin()
    answer = await other.client.get("/v1/audit")
    assert answer.status_code == 404
    assert "gateway.audit" in answer.json()["error"]


async def test_entries_are_followed(begin: Begin, trail: AuditTrail) -> None:
    """A reader of the stream gets entries as they come, chosen by kind."""
    running = await begin(trail=trail)
    async with running.client.stream("GET", "/v1/audit/stream", params={"kind": "change"}) as answer:
        lines = answer.aiter_lines()
        assert (await anext(lines)).startswith(":")
        await running.client.post("/v1/routes", json=_route("/a"))
        line = ""
        while not line.startswith("data: "):
            line = await anext(lines)
        assert json.loads(line.removeprefix("data: "))["operation"] == "route add"
