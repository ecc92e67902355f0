"""The ASGI application of topics and services: one request, one message or call.

Messages are the JSON of rosbridge: arrays of bytes are base64, NaN and infinities ``null`` where sent and taken in any
spelling; with ``?int64=text`` integers of 64 bits are texts.
"""

from __future__ import annotations

import contextlib
import logging
import math
import time
from collections.abc import AsyncIterator, Mapping
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import unquote

import orjson
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from ropeway.errors import (
    AccessDenied,
    CallError,
    CallTimeout,
    GraphUnavailable,
    InvalidFrame,
    InvalidName,
    NotServed,
    RopewayError,
    TypeConflict,
    TypesError,
    UnknownType,
)
from ropeway.gateway.rest.topics import RestTopics, TopicUnknown
from ropeway.graph.base import resolve_name
from ropeway.graph.calls import Request as Call
from ropeway.limits import LONGEST_CALL_S, REST_BODY_BYTES, REST_WAIT_S
from ropeway.tasks import describe
from ropeway.types.untrusted import json_loads

if TYPE_CHECKING:
    from ropeway.graph.base import Sample
    from ropeway.hub.hub import Hub
    from ropeway.listener.authorization import Access
    from ropeway.types import MessageCodec, TypeRegistry

__all__ = ["ACCESS", "RestApp"]

log = logging.getLogger("ropeway.server")

ACCESS: Final = "ropeway.access"
"""The key under which the rights of who asks stand in the scope of a request."""

_JSON: Final = "application/json"
_EVENTS: Final = "text/event-stream"
_ALWAYS: Final = {"cache-control": "no-store", "x-content-type-options": "nosniff", "connection": "close"}
_IDLE_S: Final = 10.0
_FIRST_S: Final = 5.0
_COMMENT: Final = b": still here\n\n"
_STATUS: Final[tuple[tuple[type[Exception], int], ...]] = (
    (AccessDenied, 403),
    (NotServed, 404),
    (CallTimeout, 504),
    (CallError, 502),
    (GraphUnavailable, 503),
    (InvalidName, 422),
    (InvalidFrame, 400),
    (TypeConflict, 409),
    (UnknownType, 422),
    (TypesError, 422),
)


class _Refused(Exception):
    """A request that is answered with a status and a sentence."""

    def __init__(self, status: int, text: str, **headers: str) -> None:
        super().__init__(text)
        self.status, self.headers = status, headers


class RestApp:
    """Answers requests for the topics and services of a graph."""

    def __init__(self, hub: Hub, registry: TypeRegistry, *, unregister_timeout_s: float, call_timeout_s: float) -> None:
        self._view = hub.view("requests")
        self._registry = registry
        self._call_timeout_s = call_timeout_s
        self._topics = RestTopics(self._view, registry, unregister_timeout_s=unregister_timeout_s)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            return
        request = Request(scope, receive, send)
        headers = {**_ALWAYS, **_readable(request)}
        try:
            response = await self._answer(request, scope[ACCESS])
        except ClientDisconnect:
            return
        except _Refused as error:
            response = _refusal(error.status, str(error))
            headers |= error.headers
        except (RopewayError, ValueError) as error:
            response = _refusal(next((status for kind, status in _STATUS if isinstance(error, kind)), 500), str(error))
        except Exception as error:  # whoever asks is told, and the gateway goes on
            log.error("%s %s failed: %s", request.method, request.url.path, describe(error), exc_info=error)
            response = _refusal(500, "this failed for a reason that is in the log")
        for key, value in headers.items():
            response.headers[key] = value
        with contextlib.suppress(ClientDisconnect):
            await response(scope, receive, send)

    async def close(self) -> None:
        """Withdraw what was made for requests."""
        await self._topics.close()
        await self._view.close()

    async def _answer(self, request: Request, access: Access) -> Response:
        kind, _, name = request.scope["path"].removeprefix("/ros").strip("/").partition("/")
        if kind == "topics" and not name:
            _methods(request, "GET")
            return _json([{"name": t.name, "types": list(t.types)} for t in self._listed(access)])
        if kind not in ("topics", "services") or not name:
            raise _Refused(404, "there are /ros/topics, /ros/topics/NAME and /ros/services/NAME")
        name = resolve_name("/" + unquote(name))
        if kind == "services":
            _methods(request, "POST")
            return await self._call(request, access, name)
        _methods(request, "GET", "POST")
        return await (self._publish if request.method == "POST" else self._read)(request, access, name)

    def _listed(self, access: Access) -> list[Any]:
        return [topic for name, topic in sorted(self._view.topics().items()) if access.sees("topics", name)]

    # ── topics ─────────────────────────────────────────────────────────────────────────────────────────────────

    async def _publish(self, request: Request, access: Access, name: str) -> Response:
        access.check("publish", name)
        body = await _body(request)
        if access.limited:
            access.spend("publish", name, len(body))
        type = await self._type(request, name)
        payload = self._codec(request, type).from_json(json_loads(body))
        access.command("publish", name, payload)
        readers = await self._topics.publish(name, type, payload)
        return _json({"topic": name, "type": type, "readers": readers})

    async def _read(self, request: Request, access: Access, name: str) -> Response:
        access.check("subscribe", name)
        type = await self._type(request, name)
        codec = self._codec(request, type)
        if _EVENTS in request.headers.get("accept", "") or request.query_params.get("stream"):
            return StreamingResponse(self._stream(name, type, codec), media_type=_EVENTS)
        timeout_s = min(_seconds(request, "timeout", _FIRST_S), REST_WAIT_S)
        sample = await self._topics.last(name, type, timeout_s)
        if sample is None:
            raise _Refused(504, f"no message of {name} came within {timeout_s:g} s")
        return Response(codec.json(sample.payload), headers=_about(sample), media_type=_JSON)

    async def _stream(self, name: str, type: str, codec: MessageCodec) -> AsyncIterator[bytes]:
        """Yield messages as server-sent events; a reader that is slower gets the newest, and how many it missed."""
        yield _COMMENT
        async with contextlib.aclosing(self._topics.follow(name, type, _IDLE_S)) as following:
            async for sample, skipped in following:
                if sample is None:
                    yield _COMMENT
                    continue
                missed = b": %d skipped\n" % skipped if skipped else b""
                yield b"%sevent: message\ndata: %s\n\n" % (missed, codec.json(sample.payload))

    async def _type(self, request: Request, name: str) -> str:
        try:
            return await self._topics.type_of(name, request.query_params.get("type", ""))
        except TopicUnknown:
            raise _Refused(404, f"nobody has {name}, so its type is not known; add ?type=pkg/msg/Name") from None

    # ── services ───────────────────────────────────────────────────────────────────────────────────────────────

    async def _call(self, request: Request, access: Access, name: str) -> Response:
        access.check("call_service", name)
        body = await _body(request)
        if access.limited:
            access.spend("call_service", name, len(body))
        types = self._view.service_types(name)
        given = request.query_params.get("type", "")
        type = self._registry.canonical(given, "srv") if given else (types[0] if types else "")
        if types and type not in types:
            raise TypeConflict(name, types[0], type)
        if not type:
            raise NotServed(name)
        if not self._registry.has(type):
            await self._view.learn(type)
        payload = self._codec(request, f"{type}_Request").from_json(json_loads(body or b"{}"))
        answer = self._codec(request, f"{type}_Response")
        default_s = self._call_timeout_s if self._call_timeout_s > 0 else LONGEST_CALL_S
        timeout_s = min(_seconds(request, "timeout", default_s), LONGEST_CALL_S)
        access.command("call_service", name, payload)
        client = await self._view.create_client(name, type)
        try:
            if client.available is False:
                if not client.listed:
                    raise NotServed(name)
                await client.wait_available(timeout_s)
            response = await client.call(Call(payload, timeout_s=timeout_s, caller=access.client), timeout_s)
        finally:
            await client.close()
        return Response(answer.json(response), media_type=_JSON)

    def _codec(self, request: Request, type: str) -> MessageCodec:
        codec = self._topics.codec(type)
        return codec.with_long_texts() if request.query_params.get("int64") == "text" else codec


async def _body(request: Request) -> bytes:
    """Return the body. Raises ``_Refused`` for one that is too long, or is no JSON by its header."""
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != _JSON:
        raise _Refused(415, f"the header content-type: {_JSON} is needed")
    too_long = _Refused(413, f"the body is longer than {REST_BODY_BYTES} bytes")
    announced = request.headers.get("content-length", "")
    if announced.isascii() and announced.isdigit() and int(announced) > REST_BODY_BYTES:
        raise too_long
    parts: list[bytes] = []
    size = 0
    async for part in request.stream():
        size += len(part)
        if size > REST_BODY_BYTES:
            raise too_long
        parts.append(part)
    return b"".join(parts)


def _methods(request: Request, *known: str) -> None:
    if request.method not in known and not (request.method == "HEAD" and "GET" in known):
        raise _Refused(405, f"{request.method} is not known here", allow=", ".join(known))


def _seconds(request: Request, key: str, default: float) -> float:
    text = request.query_params.get(key, "")
    try:
        value = float(text) if text else default
    except ValueError:
        value = math.nan
    if not 0 <= value < math.inf:
        raise _Refused(422, f"{key}: expected seconds, got {text[:20]}")
    return value


def _json(value: Any) -> Response:
    return Response(orjson.dumps(value), media_type=_JSON)


def _refusal(status: int, text: str) -> Response:
    return Response(orjson.dumps({"error": text}), status, media_type=_JSON)


def _about(sample: Sample) -> Mapping[str, str]:
    return {"x-age-seconds": f"{max(time.time_ns() - sample.stamp_ns, 0) / 1e9:.3f}", "x-type": sample.type}


def _readable(request: Request) -> dict[str, str]:
    """Return what lets the web page that sent this read the answer; pages that may not were refused before."""
    origin = request.headers.get("origin", "")
    return {"access-control-allow-origin": origin, "vary": "Origin"} if origin else {}
