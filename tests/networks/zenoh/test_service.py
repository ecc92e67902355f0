"""ropeway.networks.zenoh.service: what we serve to Ropeways and strangers."""

from __future__ import annotations

import asyncio

import pytest
import zenoh

from ropeway.errors import CallFailed
from ropeway.graph.base import Undelivered
from ropeway.graph.calls import Request
from ropeway.networks.zenoh.attachment import Attachment, pack, parse
from ropeway.networks.zenoh.tokens import data_key
from tests.support.services import ADD, Gate, add, addends, total
from tests.support.until import until

from .network import foreign_session, open_pair


async def test_node_gets_default() -> None:
    """A node that asks for what fails gets the default response, since ROS 2 has no errors of services."""

    async def fail(request: Request) -> bytes:
        raise RuntimeError("broken")

    async with open_pair() as (near, _, where):
        await near.create_service("/add", ADD, fail)
        session = foreign_session(where)
        answers: list[bytes] = []
        session.get(
            data_key(0, "/add", ADD, near.layouts.own_hash(ADD)),
            lambda reply: answers.append(bytes(reply.ok.payload)),
            payload=addends(1),
            attachment=pack(7, 8, bytes(16)),
            target=zenoh.QueryTarget.ALL_COMPLETE,
        )
        await until(lambda: answers == [total(0)])
        session.close()


async def test_caller() -> None:
    """A handler learns which node calls, and a call has the same id wherever it is served."""
    seen: list[Request] = []

    async def note(request: Request) -> bytes:
        seen.append(request)
        return await add(request)

    async with open_pair() as (near, far, _):
        await near.create_service("/add", ADD, note)
        client = await far.create_client("/add", ADD)
        assert await client.wait_available(60)
        await asyncio.gather(*(client.call(Request(addends(number))) for number in range(3)))
        assert {request.caller for request in seen} == {"/far"}
        assert len({request.id for request in seen}) == 3


async def test_answer_has_the_number_of_its_request() -> None:
    """An answer carries the number and the gid of its request, by which nodes tell whose it is."""
    async with open_pair() as (near, _, where):
        await near.create_service("/add", ADD, add)
        session = foreign_session(where)
        answers: list[Attachment | None] = []

        def take(reply: zenoh.Reply) -> None:
            if reply.ok is not None and reply.ok.attachment is not None:
                answers.append(parse(bytes(reply.ok.attachment)))

        key, gid = data_key(0, "/add", ADD, near.layouts.own_hash(ADD)), bytes(range(16))
        session.get(key, take, payload=addends(1), attachment=pack(7, 8, gid), target=zenoh.QueryTarget.ALL_COMPLETE)
        await until(lambda: answers)
        assert [(one.number, one.gid) for one in answers if one is not None] == [(7, gid)]
        session.close()


async def test_ropeway_gets_the_error() -> None:
    """Another Ropeway that asks for what fails is told why, and the fault is counted."""

    async def fail(request: Request) -> bytes:
        raise RuntimeError("broken")

    async with open_pair() as (near, far, _):
        await near.create_service("/add", ADD, fail)
        client = await far.create_client("/add", ADD)
        with pytest.raises(CallFailed, match="broken"):
            await client.call(Request(addends(1)))
        assert near.drops["/add", Undelivered.CALLBACK] == 1


async def test_closed_in_mid_call() -> None:
    """Calls that are under way when the service closes end at once."""
    async with open_pair() as (near, far, _):
        gate = Gate()
        service = await near.create_service("/add", ADD, gate)
        client = await far.create_client("/add", ADD)
        calls = [asyncio.ensure_future(client.call(Request(addends(number)), timeout_s=60)) for number in range(3)]
        await until(lambda: len(gate.seen) == 3)
        await service.close()
        outcomes = await asyncio.gather(*calls, return_exceptions=True)
        assert all(isinstance(outcome, Exception) for outcome in outcomes)
        assert "/add" not in near.services() or not near.services()["/add"].servers
