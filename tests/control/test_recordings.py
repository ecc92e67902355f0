"""ropeway.control.resources.recordings and ``ropeway record --gateway``: recorders as people see and command them."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import httpx
from typer.testing import CliRunner

from ropeway.audit.files import AuditFiles
from ropeway.audit.trail import AuditTrail
from ropeway.cli import app
from tests.control.conftest import Begin, Controlled
from tests.support.until import until

HEADERS = {"content-type": "application/json"}


async def recording(begin: Begin, tmp_path: Path, **more: Any) -> Controlled:
    """Begin a gateway with a recorder that has a ring, and one that has none and waits for an order."""
    ring = {"name": "incident", "directory": str(tmp_path), "ring_s": 30, "after_s": 0}
    plain = {"name": "all", "directory": str(tmp_path), "active": False}
    return await begin(record=[ring, plain], **more)


async def post(gateway: Controlled, order: str, **body: Any) -> httpx.Response:
    """Give an order."""
    return await gateway.client.post(f"/v1/recordings/{order}", content=json.dumps(body), headers=HEADERS)


async def rows(gateway: Controlled) -> dict[str, dict[str, Any]]:
    return {row["name"]: row for row in (await gateway.client.get("/v1/recordings")).json()}


async def test_orders(begin: Begin, tmp_path: Path) -> None:
    """Recorders are listed with their files, started and stopped, and write a clip when told; events say who asked."""
    gateway = await recording(begin, tmp_path)
    assert {name: row["state"] for name, row in (await rows(gateway)).items()} == {
        "incident": "waiting",
        "all": "stopped",
    }
    assert (await post(gateway, "trigger", why="a bump")).json() == {"triggered": ["incident"]}
    await until(lambda: gateway.gateway.recorders.status()[0]["clips"] == 1)
    (file,) = (await rows(gateway))["incident"]["files"]
    written = await asyncio.to_thread(Path(file["path"]).read_bytes)
    assert len(written) == file["bytes"]
    assert b"a bump" in written
    (started,) = (await post(gateway, "start", name="all")).json()
    assert started["state"] == "recording"
    assert [row["state"] for row in (await post(gateway, "stop")).json()] == ["stopped", "stopped"]
    told = [(one.name, one.data["state"]) for one in gateway.manager.events.last() if one.kind == "recording"]
    assert ("incident", "triggered") in told and ("all", "started") in told and ("incident", "stopped") in told
    status = (await gateway.client.get("/v1/status")).json()
    assert [row["name"] for row in status["recordings"]] == ["incident", "all"]


async def test_mistakes(begin: Begin, tmp_path: Path) -> None:
    """A recorder that there is not is answered with those that there are; one without a ring writes no clip."""
    gateway = await recording(begin, tmp_path)
    answer = await post(gateway, "trigger", name="accident")
    assert answer.status_code == 404 and "there are: incident, all" in answer.json()["error"]
    answer = await post(gateway, "trigger", name="all")
    assert answer.status_code == 409 and "ring_s" in answer.json()["error"]
    alone = await begin()
    assert (await alone.client.get("/v1/recordings")).json() == []
    assert (await post(alone, "start")).status_code == 404


async def test_the_audit_log(begin: Begin, tmp_path: Path) -> None:
    """Who gave which order to which recorder, and why, is in the audit log."""
    trail = AuditTrail(AuditFiles(tmp_path / "audit", file_bytes=1 << 20, files=2, file_days=1, keep_days=1))
    gateway = await recording(begin, tmp_path, trail=trail)
    await post(gateway, "trigger", name="incident", why="a bump")
    await asyncio.to_thread(trail.close)
    text = await asyncio.to_thread((tmp_path / "audit").read_text)
    assert "recording trigger" in text and "a bump" in text and "incident" in text


async def run(*args: str) -> tuple[int, str]:
    """Run the command, and return its status and what it prints."""
    result = await asyncio.to_thread(CliRunner().invoke, app, args)
    return result.exit_code, result.output


async def test_the_verb(begin: Begin, tmp_path: Path) -> None:
    """``ropeway record --gateway`` shows recorders with their files, and gives orders."""
    gateway = await recording(begin, tmp_path)
    name = gateway.control.name
    assert "incident" in (await run("record", "--gateway", name))[1]
    status, said = await run("record", "-G", name, "--trigger", "--why", "a bump", "--recorder", "incident")
    assert (status, said.strip()) == (0, "a clip is written by incident")
    await until(lambda: gateway.gateway.recorders.status()[0]["clips"] == 1)
    status, said = await run("record", "-G", name, "--start", "--json")
    assert [row["state"] for row in json.loads(said)] == ["waiting", "recording"]
    assert str(tmp_path) in (await run("record", "-G", name, "--stop"))[1].replace("\n", "")
    assert (await run("record", "-G", name, "--stop", "--start"))[0] == 2
    assert (await run("record", "/a", "-G", name))[0] == 2
    assert (await run("status", name))[1].count("stopped") == 2
