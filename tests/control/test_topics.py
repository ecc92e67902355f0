"""Topics over the control API, as the caller's role allows; and who the caller is."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from tests.control.conftest import Begin, Controlled

JSON = {"content-type": "application/json"}
STRING = "std_msgs/msg/String"


@pytest.fixture
async def limited(begin: Begin, monkeypatch: pytest.MonkeyPatch) -> Controlled:
    """A gateway with a token whose role may read and publish one topic each."""
    monkeypatch.setenv("DRIVER", "0123456789abcdef")
    role = {"control": ["observe", "operate"], "subscribe": ["/seen"], "publish": ["/driven"]}
    return await begin(
        control={"listen": ["http://127.0.0.1:0"]},
        auth={"tokens": [{"token": {"env": "DRIVER"}, "role": "driver"}], "roles": {"driver": role}},
    )


def client_of(running: Controlled) -> httpx.AsyncClient:
    headers = {"authorization": "Bearer 0123456789abcdef"}
    return httpx.AsyncClient(base_url=running.control.addresses[0], headers=headers)


async def publish(client: httpx.AsyncClient, name: str, **more: Any) -> httpx.Response:
    body = {"name": name, "type": STRING, "message": {"data": "x"}, **more}
    return await client.post("/v1/topics/publish", json=body)


async def test_the_caller(limited: Controlled) -> None:
    """A caller learns the own name and rights: all on the socket, those of the role over TCP."""
    async with client_of(limited) as client:
        found = (await client.get("/v1/caller")).json()
    assert (found["name"], found["rights"]) == ("role driver", ["observe", "operate"])
    assert (await limited.client.get("/v1/caller")).json()["rights"] == ["configure", "observe", "operate"]


async def test_topics_follow_the_role(limited: Controlled) -> None:
    """What the role does not list is neither shown nor read nor published, and the answer says by which rule."""
    for name in ("/seen", "/driven", "/hidden"):
        assert (await publish(limited.client, name)).status_code == 200
    async with client_of(limited) as client:
        assert {topic["name"] for topic in (await client.get("/v1/topics")).json()} == {"/seen", "/driven"}
        assert (await client.get("/v1/topics/value", params={"name": "/seen"})).status_code == 200
        refused = await client.get("/v1/topics/value", params={"name": "/hidden"})
        assert refused.status_code == 403
        assert "role driver does not list it under subscribe" in refused.json()["error"]
        assert (await publish(client, "/driven")).status_code == 200
        assert (await publish(client, "/seen")).status_code == 403


@pytest.mark.parametrize(
    ("query", "status"),
    [({}, 422), ({"name": "a b"}, 422), ({"name": "/a", "after": "x"}, 422), ({"name": "/nothing"}, 409)],
)
async def test_what_cannot_be_read(begin: Begin, query: dict[str, str], status: int) -> None:
    """A name that is none, a number that is none and a topic that is not there are refused with a sentence."""
    running = await begin()
    answer = await running.client.get("/v1/topics/value", params=query)
    assert answer.status_code == status
    assert answer.json()["error"]


async def test_what_cannot_be_published(begin: Begin) -> None:
    """A message that does not fit its type, and a type that is not known, are refused with a sentence."""
    running = await begin()
    assert (await publish(running.client, "/a", message={"data": 7})).status_code == 409
    assert (await publish(running.client, "/a", type="no_such/msg/Type")).status_code == 409
    assert (await publish(running.client, "no name")).status_code == 422
    assert (await publish(running.client, "/a", other=1)).status_code == 422


async def test_a_gateway_without_a_store(begin: Begin) -> None:
    """Where nothing is kept, the list is empty."""
    running = await begin()
    assert (await running.client.get("/v1/store")).json() == []
