"""Asks queries of a Zenoh session: those of the overlay, and probes that tell how its link is."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable
from functools import partial
from typing import Any, Final

import zenoh

from ropeway import aio
from ropeway.errors import GraphUnavailable
from ropeway.networks.overlay.data_plane import probe_key
from ropeway.networks.overlay.zenoh_config import PRIORITIES
from ropeway.networks.overlay.zenoh_failures import zenoh_failures

__all__ = ["answer_probes", "ask", "probe"]

_OVERDUE_S: Final = 1.0  # after which a query is over though Zenoh, which keeps its time, does not say so
_ANSWER_BYTES: Final = 100  # what an answer costs beside its payload
_LARGE_BYTES: Final = 1 << 16  # more is sent from a thread


async def ask(
    session: zenoh.Session,
    key: str,
    payload: bytes,
    timeout_s: float,
    *,
    lane: int,
    limit_bytes: int,
    first: bool,
) -> list[bytes]:
    """Return every answer to a query, once all who can answer have, or the first if that is enough; fewer, or none,
    after ``timeout_s``. Answers beyond ``limit_bytes`` in all are not taken.
    """
    loop = asyncio.get_running_loop()
    answers: list[bytes] = []
    left = limit_bytes
    done: asyncio.Future[None] = loop.create_future()
    over = False

    def finish() -> None:
        if not done.done():
            done.set_result(None)

    def finish_soon() -> None:
        with contextlib.suppress(RuntimeError):  # the loop has closed
            loop.call_soon_threadsafe(finish)

    def take(reply: zenoh.Reply) -> None:
        nonlocal left
        if reply.ok is None:
            return
        left -= len(reply.ok.payload) + _ANSWER_BYTES
        if left >= 0:
            answers.append(bytes(reply.ok.payload))
            if first:
                finish_soon()

    def dropped() -> None:
        nonlocal over
        over = True
        finish_soon()

    cancel: Any = zenoh.CancellationToken()
    get = partial(
        session.get,
        key,
        zenoh.handlers.Callback(take, dropped, indirect=False),
        payload=payload,
        timeout=timeout_s,
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
        congestion_control=zenoh.CongestionControl.BLOCK,
        priority=PRIORITIES[lane],
        express=True,
        cancellation_token=cancel,
    )
    try:
        with zenoh_failures():
            if len(payload) > _LARGE_BYTES:
                await asyncio.to_thread(get)
            else:
                get()
        with contextlib.suppress(TimeoutError):
            async with aio.timeout(timeout_s + _OVERDUE_S):
                await done
    finally:
        if not over:
            cancel.cancel()
    return answers


def answer_probes(session: zenoh.Session) -> Any:
    """Answer probes of the links with a session, in Zenoh's thread; return what was declared."""

    def take(query: zenoh.Query) -> None:
        with contextlib.suppress(zenoh.ZError):  # who asked has left
            query.reply(query.key_expr, b"")
        query.drop()  # type: ignore[no-untyped-call]

    handler = zenoh.handlers.Callback(take, indirect=False)
    return session.declare_queryable(probe_key(str(session.info.zid())), handler)


def probe(
    session: zenoh.Session,
    router: str,
    timeout_s: float,
    answered: Callable[[float], None],
    loop: asyncio.AbstractEventLoop,
) -> None:
    """Ask the router with this id for a sign of life; call ``answered`` on the loop with the round trip in seconds."""
    began_s = time.monotonic()

    def take(_: zenoh.Reply) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has closed
            loop.call_soon_threadsafe(answered, time.monotonic() - began_s)

    with contextlib.suppress(zenoh.ZError, GraphUnavailable), zenoh_failures():  # it has closed this moment
        session.get(
            probe_key(router),
            zenoh.handlers.Callback(take, indirect=False),
            timeout=timeout_s,
            consolidation=zenoh.ConsolidationMode.NONE,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
            allowed_destination=zenoh.Locality.REMOTE,
        )
