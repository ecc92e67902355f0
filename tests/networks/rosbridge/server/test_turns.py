"""listener.turns and rosapi_calls: who asks for much, or reads little, waits for it, and nobody else."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
from collections import Counter
from typing import Any

import pytest

from ropeway.limits import SEARCHES_PER_CLIENT, WAITING_ANSWERS, WAITING_OPERATIONS
from ropeway.listener import turns
from tests.support.actions import FIBONACCI
from tests.support.place import Place
from tests.support.until import until
from tests.support.websocket import TEXT, Client, ClosedByServer, frame

CALLS = 2000
BUFFER_BYTES = 16_384


def call(service: str, id: Any, **more: Any) -> bytes:
    return frame(TEXT, json.dumps({"op": "call_service", "service": service, "id": id, **more}).encode())


async def write(client: Client, data: bytes) -> None:
    """Write as fast as the server takes it."""
    client.raw(data)
    await client.writer.drain()


async def test_rosapi_is_answered_as_it_is_read(place: Place) -> None:
    """However much a client asks of rosapi before it reads, little is kept for it, and all is answered, in order."""
    client = await place.client()
    await client.done()
    session = place.session
    asking = asyncio.create_task(write(client, b"".join(call("/rosapi/interfaces", n) for n in range(CALLS))))
    await until(lambda: session.turns.paused)
    most = [0, 0]
    answered = 0
    while answered < CALLS:
        most = [max(most[0], session.turns.questions), max(most[1], session.peer.sender.outbox.bytes)]
        got = await client.json()
        assert got["id"] == answered
        assert got["result"] is True
        answered += 1
    await asking
    assert most[0] < 2 * WAITING_OPERATIONS + 1024  # what one read of the socket may bring besides
    assert most[1] < 4 << 20
    await until(lambda: not session.turns.paused)


@pytest.mark.parametrize("service", ["/nobody", "/rosapi/unknown"])
async def test_refusals_that_are_not_read(place: Place, service: str) -> None:
    """Calls that are refused are answered once each, and wait in the socket while that is not read."""
    client = await place.client()
    await client.done()
    session = place.session
    asking = asyncio.create_task(write(client, b"".join(call(service, n) for n in range(4 * CALLS))))
    await until(lambda: session.turns.paused)
    most = 0
    answers: Counter[int] = Counter()
    for _ in range(4 * CALLS):
        most = max(most, session.peer.op_sender.count)
        answers[(await client.json())["id"]] += 1
    await asking
    assert answers == Counter(range(4 * CALLS))
    assert most < 3 * WAITING_ANSWERS


async def test_answers_that_are_never_read(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """A client that takes none of many answers for long is closed, and told why."""
    monkeypatch.setattr(turns, "UNREAD_S", 0.0)
    client = await place.client()
    await client.done()
    connection = place.session.peer.connection
    transport: Any = client.writer.transport
    transport.pause_reading()
    ours = client.writer.get_extra_info("socket")
    for sock, buffer in ((ours, socket.SO_RCVBUF), (connection._socket, socket.SO_SNDBUF)):
        sock.setsockopt(socket.SOL_SOCKET, buffer, BUFFER_BYTES)  # they would hold megabytes of answers
    asking = asyncio.create_task(write(client, b"".join(call("/nobody", n) for n in range(4 * CALLS))))
    await until(lambda: not place.server.sessions)
    assert connection._close_reason == "answers are not read"
    with contextlib.suppress(ConnectionError):
        await asking
    transport.resume_reading()
    with pytest.raises(ClosedByServer):
        while True:
            await client.receive()


@pytest.mark.parametrize("kind", ["goals", "calls"])
async def test_few_are_looked_for_at_a_time(place: Place, kind: str) -> None:
    """What nobody serves is answered for each that asked, and takes parts of the graph for a few at a time."""
    client = await place.client()
    count = 10 * SEARCHES_PER_CLIENT
    for n in range(count):
        if kind == "goals":
            client.send(
                {"op": "send_action_goal", "action": f"/a{n}", "action_type": FIBONACCI, "args": {"order": 1}, "id": n}
            )
        else:
            client.send({"op": "call_service", "service": f"/s{n}", "type": "std_srvs/Trigger", "id": n})
    answers: Counter[Any] = Counter()
    most = 0

    async def read() -> None:
        while len(answers) < count:
            got = await client.json(30)
            assert got["result"] is False
            answers[got["id"]] += 1

    reading = asyncio.create_task(read())
    while not reading.done():
        found: Any = place.robot.actions() if kind == "goals" else place.robot.services()
        most = max(most, sum(len(info.clients) for name, info in found.items() if name[2:].isdigit()))
        await asyncio.sleep(0.001)
    await reading
    assert set(answers.values()) == {1}
    assert most <= 2 * SEARCHES_PER_CLIENT  # those that are being closed included


async def test_a_goal_whose_server_appears(place: Place) -> None:
    """A goal that was sent a moment before its server appears is carried out."""
    client = await place.client()
    client.send({"op": "send_action_goal", "action": "/fib", "action_type": FIBONACCI, "args": {"order": 2}, "id": "g"})
    await until(lambda: place.session.actions.goals)
    other = await place.client()
    other.send({"op": "advertise_action", "action": "/fib", "type": FIBONACCI})
    asked = await other.json()
    other.send(
        {"op": "action_result", "action": "/fib", "id": asked["id"], "values": {"sequence": [1]}, "status": 4,
         "result": True}
    )  # fmt: skip
    assert (await client.json())["values"] == {"sequence": [1]}


async def test_a_question_that_fails_unforeseen(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """A call of rosapi that fails in a way that nobody foresaw is answered, and those behind it, too."""
    client = await place.client()
    await client.done()

    def broken() -> Any:
        raise RuntimeError("a fault of ours")

    real = place.server.rosapi.question
    monkeypatch.setattr(
        place.server.rosapi, "question", lambda name, args: broken if "nodes" in name else real(name, args)
    )
    client.raw(call("/rosapi/nodes", "bad") + call("/rosapi/topics", "good"))
    first, second = await client.json(), await client.json()
    assert (first["id"], first["values"]) == ("bad", "internal error")
    assert (second["id"], second["result"]) == ("good", True)
    assert not place.session.turns.questions


async def test_depths_add_up(place: Place) -> None:
    """A client gets the depths that it asks for until all of its topics together are too deep, then shallow ones."""
    client = await place.client()
    for n in range(25):
        client.send({"op": "advertise", "topic": f"/t{n}", "type": "std_msgs/String", "qos": {"depth": 10_000}})
    client.send({"op": "advertise", "topic": "/shallow", "type": "std_msgs/String", "qos": {"depth": 7}})
    await client.done()
    await until(lambda: len(place.session.inputs) == 26)
    depths = [topic.publisher.qos.depth for topic in place.session.inputs.values() if topic.publisher is not None]
    assert depths == [10_000] * 20 + [100] * 5 + [7]
