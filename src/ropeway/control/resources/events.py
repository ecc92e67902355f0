"""Events of the gateway, as a list and as a stream (server-sent events)."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from typing import Any, Final

import orjson

from ropeway.control.events import Event, Events
from ropeway.control.resource import Answer, ControlRequest, Resources
from ropeway.errors import ControlRefused

__all__ = ["resources"]

resources = Resources()

_KEEP_ALIVE_S: Final = 10.0
_COMMENT: Final = b": still here\n\n"


@resources.get("/v1/events", gives=list[dict[str, Any]])
async def list_events(asked: ControlRequest) -> Any:
    """Return the last events, oldest first: ``?after=NUMBER`` those behind a number, ``?name=`` those of one object."""
    found = asked.manager.events.last(after=_number(asked, "after") or 0, name=asked.query.get("name", ""))
    return [event.to_json() for event in found]


@resources.get("/v1/events/stream", media_type="text/event-stream")
async def follow_events(asked: ControlRequest) -> Answer:
    """Stream events as they happen; with ``?after=NUMBER`` or ``Last-Event-ID``, first those behind a number."""
    after = _number(asked, "after")
    last = asked.headers.get("last-event-id", "")
    if after is None and last.isascii() and last.isdigit():
        after = int(last)
    return Answer(stream=_stream(asked.manager.events, after), media_type="text/event-stream")


async def _stream(events: Events, after: int | None) -> AsyncIterator[bytes]:
    """Yield events as text, and a comment where there is none for a while, so that both ends notice a lost one."""
    yield _COMMENT
    async with contextlib.aclosing(events.follow(after=after, idle_s=_KEEP_ALIVE_S)) as following:
        async for event in following:
            yield _COMMENT if event is None else _text(event)


def _text(event: Event) -> bytes:
    data = orjson.dumps(event.to_json(), option=orjson.OPT_NON_STR_KEYS, default=str)
    return b"id: %d\nevent: %s\ndata: %s\n\n" % (event.number, event.kind.encode(), data)


def _number(asked: ControlRequest, key: str) -> int | None:
    text = asked.query.get(key, "")
    if not text:
        return None
    if not (text.isascii() and text.isdigit()):
        raise ControlRefused(422, f"{key}: expected the number of an event, got {text[:20]}")
    return int(text)
