"""ropeway.networks.zenoh.client: calls of what others serve."""

from __future__ import annotations

import asyncio

import pytest
import zenoh

from ropeway.errors import CallFailed, CallTimeout, NotServed, ProviderLost
from ropeway.graph.calls import Request
from ropeway.networks.zenoh import ZenohGraph
from ropeway.networks.zenoh.attachment import parse
from ropeway.networks.zenoh.tokens import ZenohToken, data_key
from tests.support.services import ADD, Gate, add, addends, total
from tests.support.until import until

from .network import foreign_session, open_pair


def serve(session: zenoh.Session, graph: ZenohGraph, answer: object) -> list[object]:
    """Serve /add as a stranger whose callback is ``answer``; return what keeps it alive."""
    type_hash = graph.layouts.own_hash(ADD)
    token = ZenohToken(0, str(session.info.zid()), "0", "1", "server", "/other", "/", "/add", ADD, type_hash)
    handler = zenoh.handlers.Callback(answer, indirect=False)  # type: ignore[arg-type]
    queryable = session.declare_queryable(data_key(0, "/add", ADD, type_hash), handler, complete=True)
    shown = session.liveliness().declare_token(str(token))
    return [queryable, shown]


async def test_many_calls() -> None:
    """Calls under way at a time each get their own answer."""
    async with open_pair() as (near, far, _):
        await near.create_service("/add", ADD, add)
        client = await far.create_client("/add", ADD)
        calls = [client.call(Request(addends(number, 1))) for number in range(50)]
        assert await asyncio.gather(*calls) == [total(number + 1) for number in range(50)]
        assert client.available


async def test_nobody_serves() -> None:
    """A call of what nobody serves fails soon, and so does one whose time is over."""
    async with open_pair() as (near, far, _):
        client = await far.create_client("/add", ADD)
        assert not client.available
        with pytest.raises(NotServed):
            await client.call(Request(addends(1)))
        gate = Gate()
        await near.create_service("/add", ADD, gate)
        assert await client.wait_available(60)
        with pytest.raises(CallTimeout):
            await client.call(Request(addends(1)), timeout_s=0.1)
        gate.open.set()
        assert await client.call(Request(addends(2))) == total(2)


async def test_request() -> None:
    """A request goes under the key of the server's hash, with a number and the gid of the client."""
    async with open_pair() as (near, _, where):
        session = foreign_session(where)
        asked: list[zenoh.Query] = []

        def answer(query: zenoh.Query) -> None:
            asked.append(query)
            query.reply(query.key_expr, total(5), attachment=query.attachment)

        kept = serve(session, near, answer)
        client = await near.create_client("/add", ADD)
        assert await client.wait_available(60)
        for _ in range(2):
            assert await client.call(Request(addends(2, 3))) == total(5)
        found = [parse(bytes(query.attachment)) for query in asked if query.attachment is not None]
        numbers = [one.number for one in found if one is not None]
        assert numbers[1] == numbers[0] + 1
        (client_info,) = near.services()["/add"].clients
        assert {one.gid for one in found if one is not None} == {client_info.gid}
        assert bytes(asked[0].payload or b"") == addends(2, 3)
        assert len(kept) == 2
        session.close()


@pytest.mark.parametrize(("payload", "said"), [(b"", "not CDR"), (b"\0\1\0", "not CDR")])
async def test_malformed_answer(payload: bytes, said: str) -> None:
    """An answer that is no CDR fails the call that it is of."""
    async with open_pair() as (near, _, where):
        session = foreign_session(where)
        kept = serve(session, near, lambda query: query.reply(query.key_expr, payload))
        client = await near.create_client("/add", ADD)
        assert await client.wait_available(60)
        with pytest.raises(CallFailed, match=said):
            await client.call(Request(addends(1)))
        assert kept
        session.close()


async def test_server_leaves() -> None:
    """A call whose server leaves in the middle ends with that, not with its time."""
    async with open_pair() as (near, _, where):
        session = foreign_session(where)
        held: list[zenoh.Query] = []
        kept = serve(session, near, held.append)
        client = await near.create_client("/add", ADD)
        assert await client.wait_available(60)
        call = asyncio.ensure_future(client.call(Request(addends(1)), timeout_s=600))
        await until(lambda: held)
        session.close()
        with pytest.raises(ProviderLost):
            await call
        assert kept
