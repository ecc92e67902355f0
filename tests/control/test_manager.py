"""ropeway.control.manager: changes of a running gateway, over its API; the journal, and two editors."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest

from ropeway.control.caller import Caller
from ropeway.control.record import ChangeRecord
from ropeway.errors import ConfigError, JournalError, RopewayError
from ropeway.gateway.journal import Journal
from tests.control.conftest import Begin, Controlled
from tests.support.messages import STRING
from tests.support.until import until

ME = Caller("me", "test")
FAR = "ws://127.0.0.1:9"


def item(name: str, **more: Any) -> dict[str, Any]:
    return {"name": name, "type": STRING, **more}


def remotes(*names: str) -> list[dict[str, Any]]:
    return [{"address": FAR, "publish": [item(name) for name in names]}]


@pytest.fixture
async def robot(begin: Begin, tmp_path: Path) -> Controlled:
    """A gateway with one route, and a journal."""
    made = await begin(remotes("/a"))
    file = tmp_path / "robot.json"
    file.write_text(json.dumps(made.gateway.config.to_json()))
    made.manager.record = ChangeRecord(Journal(tmp_path / "robot.journal"), file)
    return made


async def wanted(robot: Controlled, *names: str, **more: Any) -> dict[str, Any]:
    """Return the configuration that runs, with other routes."""
    document: dict[str, Any] = (await robot.client.get("/v1/config")).json()["config"]
    return {"gateway": {**document["gateway"], **more}, "remotes": remotes(*names)}


def names(robot: Controlled) -> list[str]:
    return [row.name for row in robot.gateway.routes()]


async def test_plan_apply_and_go_back(robot: Controlled) -> None:
    """A plan does nothing; what is applied runs, is in the history with who did it, and can be taken back."""
    body = {"config": await wanted(robot, "/a", "/b"), "note": "one more"}
    plan = (await robot.client.post("/v1/config/plan", json={"config": body["config"]})).json()
    assert [(step["action"], step["path"]) for step in plan["steps"]] == [("start", "remotes[0].publish[1]")]
    assert names(robot) == ["/a"]
    done = await robot.client.put("/v1/config", json=body)
    assert done.status_code == 200
    assert done.json()["applied"]
    assert names(robot) == ["/a", "/b"]
    again = (await robot.client.put("/v1/config", json=body)).json()
    assert (again["applied"], again["number"]) == (False, 0)
    await robot.client.delete(f"/v1/routes/{robot.gateway.config.routes()[0].key}", headers=JSON)
    assert names(robot) == ["/b"]
    assert (await robot.client.post("/v1/config/rollback", json={})).status_code == 200
    assert names(robot) == ["/a", "/b"]
    history = (await robot.client.get("/v1/config/history")).json()
    assert [(entry["action"], entry["state"]) for entry in history] == [
        ("rollback", "up"),
        ("route rm", "up"),
        ("apply", "up"),
    ]
    assert history[2]["note"] == "one more"
    assert history[2]["who"]
    assert history[2]["from"].startswith("unix:")
    (one,) = (await robot.client.get(f"/v1/config/history/{history[2]['number']}")).json()["config"]["remotes"]
    assert [entry["name"] for entry in one["publish"]] == ["/a", "/b"]
    assert [event.kind for event in robot.manager.events.last()].count("config") == 3


JSON = {"content-type": "application/json"}


async def test_single_routes(robot: Controlled) -> None:
    """A route is added to a remote that is there, or to a new one; paused, resumed, and removed by its key."""
    for remote in (FAR, "ws://127.0.0.1:10", "0"):
        body = {"remote": remote, "operation": "publish", "item": item(f"/n{remote[-1]}")}
        assert (await robot.client.post("/v1/routes", json=body)).status_code == 200
    assert [(row.name, row.path) for row in robot.gateway.routes()] == [
        ("/a", "remotes[0].publish[0]"),
        ("/n9", "remotes[0].publish[1]"),
        ("/n0", "remotes[0].publish[2]"),
        ("/n0", "remotes[1].publish[0]"),
    ]
    key = robot.gateway.config.routes()[1].key
    await robot.client.post(f"/v1/routes/{key}/pause", json={})
    states = {row["key"]: row["state"] for row in (await robot.client.get("/v1/routes")).json()}
    assert states[key] == "paused"
    await robot.client.post(f"/v1/routes/{key}/resume", json={})
    assert "paused" not in {row.state for row in robot.gateway.routes()}
    assert (await robot.client.delete(f"/v1/routes/{key}", headers=JSON)).status_code == 200
    assert "/n9" not in names(robot)
    assert (await robot.client.delete(f"/v1/routes/{key}", headers=JSON)).status_code == 404
    wrong = {"remote": "0", "operation": "publsh", "item": {}}
    assert 'did you mean "publish"' in (await robot.client.post("/v1/routes", json=wrong)).json()["error"]


async def test_two_editors(robot: Controlled) -> None:
    """Who changes what somebody else has changed meanwhile is refused, and told what was changed."""
    etag = (await robot.client.get("/v1/config")).headers["etag"]
    first = {"config": await wanted(robot, "/a", "/mine")}
    second = {"config": await wanted(robot, "/a", "/yours")}
    await robot.client.put("/v1/config", json=first)  # so that the journal knows the one that both saw
    await robot.client.post("/v1/config/rollback", json={"number": 1})
    answers = await asyncio.gather(
        *(robot.client.put("/v1/config", json=body, headers={"if-match": etag}) for body in (first, second)),
    )
    assert sorted(answer.status_code for answer in answers) == [409, 409]
    etag = (await robot.client.get("/v1/config")).headers["etag"]
    await robot.client.put("/v1/config", json={"config": await wanted(robot, "/a")})
    refused = await robot.client.put("/v1/config", json=second, headers={"if-match": etag})
    assert refused.status_code == 409
    assert [(step["action"], step["what"]) for step in refused.json()["meanwhile"]] == [("stop", "route")]
    fresh = {"if-match": refused.headers["etag"]}
    assert (await robot.client.put("/v1/config", json=second, headers=fresh)).status_code == 200
    assert names(robot) == ["/a", "/yours"]


async def test_two_at_once(robot: Controlled) -> None:
    """Of two changes at once that saw the same, one is made and the other refused."""
    etag = (await robot.client.get("/v1/config")).headers["etag"]
    bodies = [{"config": await wanted(robot, "/a", name)} for name in ("/mine", "/yours")]
    async with httpx.AsyncClient(transport=httpx.AsyncHTTPTransport(uds=str(robot.target.socket))) as other:
        answers = await asyncio.gather(
            robot.client.put("/v1/config", json=bodies[0], headers={"if-match": etag}),
            other.put("http://x/v1/config", json=bodies[1], headers={"if-match": etag}),
        )
    assert sorted(answer.status_code for answer in answers) == [200, 409]
    assert len(names(robot)) == 2


@pytest.mark.parametrize(
    ("document", "path"),
    [
        ({"gateway": {"wokers": 1}}, ".".join(("gateway", "wokers"))),
        ([{"address": FAR, "publsh": []}], "remotes[0].publsh"),
        (None, "(top level)"),
        (17, "(top level)"),
        ({"gateway": {"tls": {"certificate": "/no/such", "key": "/no/such"}}}, "gateway.tls.certificate"),
    ],
)
async def test_bad_configurations(robot: Controlled, document: Any, path: str) -> None:
    """A configuration that is no good changes nothing; the answer has the path of each fault."""
    before = names(robot)
    for send in (robot.client.post, robot.client.put):
        answer = await send("/v1/config/plan" if send == robot.client.post else "/v1/config", json={"config": document})
        assert answer.status_code == 422
        assert path in [fault["path"] for fault in answer.json()["problems"]]
    assert names(robot) == before
    assert await robot.manager.record.history(10, None) == []


@pytest.mark.parametrize(
    ("path", "body", "status"),
    [
        ("/v1/config/rollback", {"number": 99}, 404),
        ("/v1/config/rollback", {"number": -1}, 422),
        ("/v1/config/rollback", {"number": "x"}, 422),
        ("/v1/config/rollback", {}, 404),
        ("/v1/config/plan", {"config": [], "extra": 1}, 422),
        ("/v1/routes", {"remote": "7", "operation": "publish", "item": {}}, 404),
        ("/v1/routes", {"remote": FAR, "operation": "publish", "item": {"name": "/x"}}, 422),
        ("/v1/routes/nothing/pause", {}, 404),
    ],
)
async def test_bad_requests(robot: Controlled, path: str, body: Any, status: int) -> None:
    """What cannot be is refused with an error, and changes nothing."""
    answer = await robot.client.post(path, json=body)
    assert answer.status_code == status
    assert answer.json()["error"]
    assert names(robot) == ["/a"]


async def test_many_plans(robot: Controlled) -> None:
    """A hundred plans at once are all answered, one after the other, while the gateway goes on."""
    body = {"config": await wanted(robot, *(f"/n{i}" for i in range(50)))}
    async with httpx.AsyncClient(
        transport=httpx.AsyncHTTPTransport(uds=str(robot.target.socket), limits=httpx.Limits(max_connections=20)),
        timeout=60,
    ) as many:
        answers = await asyncio.gather(*(many.post("http://x/v1/config/plan", json=body) for _ in range(100)))
    assert {answer.status_code for answer in answers} == {200}
    assert {len(answer.json()["steps"]) for answer in answers} == {51}


async def test_what_cannot_be_written_down_is_not_done(robot: Controlled, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a full disk nothing is changed, and the answer says why; data flows on."""
    journal = robot.manager.record.journal
    assert journal is not None

    def full(*_: Any) -> Any:
        raise JournalError(str(journal.path), "database or disk is full")

    body = {"config": await wanted(robot, "/a", "/b")}
    with monkeypatch.context() as patch:
        patch.setattr(journal, "begin", full)
        refused = await robot.client.put("/v1/config", json=body)
        assert refused.status_code == 507
        assert "disk is full" in refused.json()["error"]
        assert names(robot) == ["/a"]
    with monkeypatch.context() as patch:
        patch.setattr(journal, "confirm", full)
        assert (await robot.client.put("/v1/config", json=body)).status_code == 507
        assert names(robot) == ["/a"]
    assert journal.last_up() is None
    assert (await robot.client.put("/v1/config", json=body)).status_code == 200


async def test_what_fails_is_in_the_history(robot: Controlled, monkeypatch: pytest.MonkeyPatch) -> None:
    """A change that could not be made is in the history with its reason, and nothing goes back to it."""

    async def fails(*_: Any) -> Any:
        raise RopewayError("no such link")

    monkeypatch.setattr(robot.gateway, "open_remote", fails)
    document = await wanted(robot, "/a")
    document["remotes"].append({"address": "ws://127.0.0.1:10", "publish": [item("/c")]})
    answer = await robot.client.put("/v1/config", json={"config": document})
    assert answer.status_code == 500
    (entry,) = await robot.manager.record.history(10, None)
    assert (entry.state, entry.note) == ("failed", "no such link")
    assert names(robot) == ["/a"]


async def test_the_file_is_applied_again(robot: Controlled) -> None:
    """SIGHUP applies the file if it has changed, and leaves alone what was changed at run time if it has not."""
    file = robot.manager.record.file
    assert file is not None
    await robot.client.put("/v1/config", json={"config": await wanted(robot, "/a", "/b")})
    assert await robot.manager.apply_file(ME) == "certificates and tokens were read again"
    assert names(robot) == ["/a", "/b"]
    file.write_text(json.dumps(await wanted(robot, "/c")))
    assert "was applied" in await robot.manager.apply_file(ME)
    assert names(robot) == ["/c"]
    file.write_text("{")
    with pytest.raises(ConfigError, match="not JSON"):
        await robot.manager.apply_file(ME)
    assert names(robot) == ["/c"]


async def test_watching_the_file(robot: Controlled, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file that is watched is applied when it changes; one that is no good is told once, and the next one applied."""
    monkeypatch.setattr("ropeway.control.manager._WATCH_S", 0.001)
    file = robot.manager.record.file
    assert file is not None
    good = json.dumps(await wanted(robot, "/c"))
    watching = asyncio.create_task(robot.manager.watch_file(ME))
    file.write_text("{")
    await asyncio.sleep(0.05)
    file.write_text(good)
    await until(lambda: names(robot) == ["/c"])
    watching.cancel()


async def test_without_a_journal(begin: Begin) -> None:
    """Without a journal changes are made and not remembered; who asks for the history is told why there is none."""
    made = await begin(remotes("/a"))
    assert (await made.client.put("/v1/config", json={"config": await wanted(made, "/b")})).json()["number"] == 0
    answer = await made.client.get("/v1/config/history")
    assert answer.status_code == 404
    assert "nothing is remembered" in answer.json()["error"]


async def test_a_part_of_a_file_is_applied_again(robot: Controlled, tmp_path: Path) -> None:
    """Of a file with many gateways, the part of the one that runs is applied again."""
    file = tmp_path / "fleet.json"
    robot.manager.record = ChangeRecord(Journal(tmp_path / "part.journal"), file, "robot")
    document = {"gateways": {"robot": await wanted(robot, "/a", "/part"), "other": {}}}
    file.write_text(json.dumps(document))
    assert "was applied" in await robot.manager.apply_file(ME)
    assert names(robot) == ["/a", "/part"]
    assert robot.gateway.config.part == "robot"


async def test_faults_of_what_was_sent_name_no_file(begin: Begin) -> None:
    """A fault of a configuration that somebody sent has its path, and not the file of the gateway."""
    robot = await begin()
    robot.gateway.config = replace(robot.gateway.config, source="/etc/robot.yaml")
    answer = await robot.client.post("/v1/config/plan", json={"config": {"gateway": {"nme": 1}}})
    assert answer.status_code == 422
    assert answer.json()["error"].startswith("gateway.nme: unknown key")
    assert [fault["path"] for fault in answer.json()["problems"]] == ["gateway.nme"]
