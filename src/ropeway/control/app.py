"""The ASGI application of the control API: admits, reads bodies, calls the handler of a resource, answers in JSON."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import logging
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, cast

import orjson
from pydantic import ValidationError
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ropeway import aio
from ropeway.control.openapi import document
from ropeway.control.request_audit import audited
from ropeway.control.resource import Answer, ControlRequest, Resource, collect
from ropeway.errors import ConfigError, ControlRefused, JournalError, RopewayError
from ropeway.gateway.config.shape import json_path
from ropeway.limits import CONTROL_BODIES_BYTES, CONTROL_BODY_BYTES, CONTROL_READER_S, CONTROL_REQUEST_S
from ropeway.tasks import describe

if TYPE_CHECKING:
    from ropeway.control.admission import AnyAdmission
    from ropeway.control.manager import Manager

__all__ = ["ABORT", "PEER", "make_app"]

log = logging.getLogger("ropeway.control")

PEER: Final = "ropeway.peer"
"""The key under which a connection's ``ControlPeer`` stands in the scope of a request."""

ABORT: Final = "ropeway.abort"
"""The key of what ends the connection at once."""

_JSON: Final = "application/json"
_OPTIONS: Final = orjson.OPT_NON_STR_KEYS | orjson.OPT_PASSTHROUGH_DATACLASS
_ALWAYS: Final = {"cache-control": "no-store", "x-content-type-options": "nosniff"}
_OPENAPI_PATH: Final = "/openapi.json"


class _Room:
    """The bytes of bodies that are held at a time."""

    def __init__(self, room_bytes: int) -> None:
        self._free = room_bytes

    @contextlib.contextmanager
    def take(self, size_bytes: int) -> Iterator[None]:
        """Take room for one body. Raises ``ControlRefused`` where there is none."""
        if size_bytes > self._free:
            raise ControlRefused(503, "other requests take all the room; try again", headers={"retry-after": "1"})
        self._free -= size_bytes
        try:
            yield
        finally:
            self._free += size_bytes


def make_app(manager: Manager, admission: AnyAdmission, *, only: Sequence[Resource] | None = None) -> ASGIApp:
    """Make the application that answers for ``manager``: for everything, or for ``only`` some resources."""
    resources = collect() if only is None else only
    room = _Room(CONTROL_BODIES_BYTES)
    by_path: dict[str, list[Resource]] = {}
    for resource in resources:
        by_path.setdefault(resource.path, []).append(resource)
    routes = [Route(path, _Endpoint(listed, manager, room)) for path, listed in _specific_first(by_path)]
    if only is None:
        routes.append(Route(_OPENAPI_PATH, _openapi(resources)))
    handlers: Mapping[Any, Any] = {HTTPException: _no_such}
    return _Admitting(Starlette(routes=routes, exception_handlers=handlers), admission)


def _specific_first(by_path: Mapping[str, list[Resource]]) -> list[tuple[str, list[Resource]]]:
    """Return paths without braces before those whose parts would match them, too."""
    return sorted(by_path.items(), key=lambda item: (item[0].count("{"), item[0]))


class _Admitting:
    """Lets nobody through to the application whom ``admission`` does not know."""

    def __init__(self, app: ASGIApp, admission: AnyAdmission) -> None:
        self._app, self._admission = app, admission

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            return
        try:
            headers = _headers(scope)
            query = scope["query_string"].decode("latin-1")
            target = scope["path"] + (f"?{query}" if query else "")
            caller = await self._admission.admit(scope[PEER], scope["method"], target, headers)
            if scope["method"] not in ("GET", "HEAD"):
                _demand_json(headers)
        except ControlRefused as error:
            await _refusal(error, close=True)(scope, receive, send)
            return
        scope["state"]["caller"] = caller
        await self._app(scope, receive, send)


def _headers(scope: Scope) -> dict[str, str]:
    """Return the headers by their names in lower case. Raises ``ControlRefused`` for one that must not be repeated."""
    found: dict[str, str] = {}
    for raw_name, raw_value in scope["headers"]:
        name, value = raw_name.decode("latin-1"), raw_value.decode("latin-1")
        if name in found and name in ("host", "origin", "authorization", "content-type"):
            raise ControlRefused(400, f"the header {name} stands twice")
        found[name] = f"{found[name]}, {value}" if name in found else value
    return found


def _demand_json(headers: Mapping[str, str]) -> None:
    """Refuse what a form of a web page could send."""
    if headers.get("content-type", "").partition(";")[0].strip().lower() != _JSON:
        raise ControlRefused(415, f"requests that change something need the header content-type: {_JSON}")


class _Endpoint:
    """The resources of one path, by method. An ASGI application, to which Starlette leaves all methods."""

    def __init__(self, listed: Sequence[Resource], manager: Manager, room: _Room) -> None:
        self._by_method: dict[str, Resource] = {resource.method: resource for resource in listed}
        self._manager, self._room = manager, room

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        response = await self._response(Request(scope, receive, send))
        await response(scope, receive, send)

    async def _response(self, request: Request) -> Response:
        resource = self._by_method.get("GET" if request.method == "HEAD" else request.method)
        if resource is None:
            allow = ", ".join(sorted(self._by_method))
            return _refusal(ControlRefused(405, f"{request.url.path} knows {allow}", headers={"allow": allow}))
        asked = ControlRequest(
            self._manager,
            request.state.caller,
            path=dict(request.path_params),
            query=dict(request.query_params),
            headers=dict(request.headers),
        )
        try:
            with audited(resource, asked):
                asked.caller.demand(resource.right)
                return await _handled(resource, request, asked, self._room)
        except RopewayError as error:
            return _refusal(error)
        except ClientDisconnect:
            return Response(status_code=400)  # nobody reads it
        except Exception as error:  # whoever asks is told, and the gateway goes on
            log.error("%s %s failed: %s", request.method, request.url.path, describe(error), exc_info=error)
            return _refusal(ControlRefused(500, f"this failed for a reason that is in the log: {describe(error)}"))


async def _handled(resource: Resource, request: Request, asked: ControlRequest, room: _Room) -> Response:
    with room.take(_announced_bytes(request)):
        body = _checked(resource, await _body(request))
        found = await resource.handler(replace(asked, body=body))
    return _answer(found if isinstance(found, Answer) else Answer(found))


def _announced_bytes(request: Request) -> int:
    """Return how long the body may be. Raises ``ControlRefused`` for one that is too long."""
    if "transfer-encoding" in request.headers:
        return CONTROL_BODY_BYTES
    announced = request.headers.get("content-length", "0")
    size = int(announced) if announced.isascii() and announced.isdigit() else 0
    if size > CONTROL_BODY_BYTES:
        raise _too_long()
    return size


async def _body(request: Request) -> bytes:
    parts: list[bytes] = []
    size = 0
    try:
        async with aio.timeout(CONTROL_REQUEST_S):
            async for part in request.stream():
                size += len(part)
                if size > CONTROL_BODY_BYTES:
                    raise _too_long()
                parts.append(part)
    except TimeoutError:
        raise ControlRefused(408, f"the body did not come within {CONTROL_REQUEST_S:g} s") from None
    return b"".join(parts)


def _too_long() -> ControlRefused:
    return ControlRefused(413, f"the body is longer than {CONTROL_BODY_BYTES} bytes")


def _checked(resource: Resource, body: bytes) -> Any:
    """Return the body as the model that the resource takes. Raises ``ControlRefused`` with every fault."""
    if resource.takes is None:
        return None
    try:
        return resource.takes.model_validate_json(body or b"{}")
    except ValidationError as error:
        faults = [
            {"path": json_path(fault["loc"]), "problem": fault["msg"]} for fault in error.errors(include_url=False)
        ]
        said = "; ".join(f"{fault['path']}: {fault['problem']}" for fault in faults[:3])
        raise ControlRefused(422, f"the body is not what is expected here: {said}", {"problems": faults}) from None


def _answer(found: Answer) -> Response:
    headers = {**_ALWAYS, **found.headers}
    if found.stream is not None:
        return _Stream(found.stream, found.status, headers, found.media_type)
    body = found.value if isinstance(found.value, bytes) else orjson.dumps(found.value, default=_plain, option=_OPTIONS)
    return Response(body, found.status, headers, found.media_type)


class _Stream(StreamingResponse):
    """A stream whose reader is dropped when it takes nothing for too long."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def timely(message: Message) -> None:
            try:
                async with aio.timeout(CONTROL_READER_S):
                    await send(message)
            except TimeoutError:
                scope[ABORT]()

        try:
            await super().__call__(scope, receive, timely)
        finally:
            await cast("Any", self.body_iterator).aclose()


def _plain(value: Any) -> Any:
    if hasattr(value, "to_json"):
        return value.to_json()
    if hasattr(value, "tolist"):  # of numpy, which orjson would load to look for its types
        return value.tolist()
    if hasattr(value, "model_dump"):
        return value.model_dump(mode="json")
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    raise TypeError(type(value).__name__)


def _refusal(error: RopewayError, *, close: bool = False) -> Response:
    """Return an error as an answer: its text, and what programs need of it."""
    status, details, headers = 500, {}, dict(_ALWAYS)
    if isinstance(error, ConfigError):
        status = 422
        details = {"problems": [{"path": path, "problem": text} for path, text in error.problems]}
    elif isinstance(error, JournalError):
        status = 507
    elif isinstance(error, ControlRefused):
        status, details = error.status, error.details
        headers |= {name.lower(): text for name, text in error.headers.items() if name.lower() != "content-type"}
    if close:
        headers["connection"] = "close"
    body = orjson.dumps({"error": str(error), **details}, default=_plain, option=_OPTIONS)
    return Response(body, status, headers, _JSON)


async def _no_such(request: Request, error: Exception) -> Response:
    status = error.status_code if isinstance(error, HTTPException) else 404
    path = request.url.path[:200]
    return _refusal(ControlRefused(status, f"there is no {path} here; GET {_OPENAPI_PATH} describes what there is"))


def _openapi(resources: Sequence[Resource]) -> Callable[[Request], Awaitable[Response]]:
    made: list[bytes] = []  # a tenth of a second that only who asks for it should wait

    async def openapi(request: Request) -> Response:
        if not made:
            made.append(await asyncio.to_thread(lambda: orjson.dumps(document(resources))))
        return Response(made[0], 200, dict(_ALWAYS), _JSON)

    return openapi
