"""The audit log, as a list and as a stream (server-sent events)."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator
from dataclasses import replace
from typing import Any, Final

import orjson
from pydantic import BaseModel

from ropeway.audit.merging import AuditEntry
from ropeway.audit.note import KINDS
from ropeway.audit.trail import AuditQuery, AuditTrail
from ropeway.control.resource import Answer, ControlRequest, Resources
from ropeway.errors import ControlRefused
from ropeway.gateway.config.suggest import one_of
from ropeway.limits import AUDIT_ANSWER_ENTRIES

__all__ = ["resources"]

resources = Resources()

_KEEP_ALIVE_S: Final = 10.0
_COMMENT: Final = b": still here\n\n"


class AuditExcerpt(BaseModel):
    """Entries, the oldest first. ``before``: ask again with it for older ones; ``null`` where there are none.

    ``lost`` notes did not fit, ``unwritten`` entries are only in memory, because of ``error``.
    """

    entries: list[dict[str, Any]]
    before: int | None
    lost: int
    unwritten: int
    error: str


@resources.get("/v1/audit", right="observe", gives=AuditExcerpt)
async def read_audit(asked: ControlRequest) -> Any:
    """Return the newest entries of the audit log that fit.

    ``?count=100``; ``kind=`` (several with commas between), ``who=``, ``where=``, ``name=`` by a part of the text;
    ``since=`` and ``until=`` in seconds since 1970; ``after=`` and ``before=`` by number.
    """
    trail = _trail(asked)
    entries, before = await asyncio.to_thread(trail.read, _query(asked))
    return {"entries": entries, "before": before, **trail.status()}


@resources.get("/v1/audit/stream", right="observe", media_type="text/event-stream")
async def follow_audit(asked: ControlRequest) -> Answer:
    """Stream entries as they come, chosen as in ``/v1/audit``.

    With ``?after=NUMBER`` or ``Last-Event-ID``, first those behind a number that are still in memory.
    """
    trail, query = _trail(asked), _query(asked)
    last = asked.headers.get("last-event-id", "")
    if "after" not in asked.query:
        query = replace(query, after=int(last) if last.isascii() and last.isdigit() else trail.last_number)
    return Answer(stream=_stream(trail, query), media_type="text/event-stream")


async def _stream(trail: AuditTrail, query: AuditQuery) -> AsyncIterator[bytes]:
    yield _COMMENT
    async with contextlib.aclosing(trail.follow(query, idle_s=_KEEP_ALIVE_S)) as following:
        async for entry in following:
            yield _COMMENT if entry is None else _text(entry)


def _text(entry: AuditEntry) -> bytes:
    data = orjson.dumps(entry, option=orjson.OPT_NON_STR_KEYS, default=str)
    return b"id: %d\nevent: %s\ndata: %s\n\n" % (entry["number"], entry["kind"].encode(), data)


def _trail(asked: ControlRequest) -> AuditTrail:
    if asked.manager.trail is None:
        raise ControlRefused(404, "no audit log is kept here: gateway.audit is false, or there is no file to run")
    return asked.manager.trail


def _query(asked: ControlRequest) -> AuditQuery:
    given = asked.query
    kinds = frozenset(kind for kind in given.get("kind", "").split(",") if kind)
    for kind in kinds - KINDS.keys():
        raise ControlRefused(422, f"kind: {one_of(kind, KINDS)}")
    before = int(_number(asked, "before", math.inf)) if given.get("before") else None
    return AuditQuery(
        count=min(int(_number(asked, "count", 100)), AUDIT_ANSWER_ENTRIES),
        kinds=kinds,
        who=given.get("who", ""),
        where=given.get("where", ""),
        name=given.get("name", ""),
        since_s=_number(asked, "since", 0.0),
        until_s=_number(asked, "until", math.inf),
        after=int(_number(asked, "after", 0)),
        before=before,
    )


def _number(asked: ControlRequest, key: str, default: float) -> float:
    text = asked.query.get(key, "")
    if not text:
        return default
    digits = text.replace(".", "", 1) if key in ("since", "until") else text
    if not (digits.isascii() and digits.isdigit() and len(text) < 18):
        raise ControlRefused(422, f"{key}: expected a number, got {text[:20]}")
    return float(text)
