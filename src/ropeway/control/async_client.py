"""A client of control APIs for programs with an event loop, which takes no more than it can hold of any answer."""

from __future__ import annotations

import contextlib
import json
from collections.abc import AsyncGenerator, Mapping
from typing import Any, Final
from urllib.parse import quote

import httpx

from ropeway.control.client import ControlTarget, read_answer, unavailable
from ropeway.errors import ControlRefused
from ropeway.limits import CONTROL_ANSWER_BYTES, CONTROL_STREAM_LINE_BYTES

__all__ = ["AsyncControlClient", "path_of"]

_TIMEOUT_S: Final = 10.0
_APPLY_S: Final = 120.0
_BAD_GATEWAY: Final = 502  # of HTTP: what stands behind gave no usable answer
_DATA: Final = b"data: "


def path_of(*parts: object) -> str:
    """Return a path of the control API; each part is quoted, whatever it holds."""
    return "/v1/" + "/".join(quote(str(part), safe="") for part in parts)


class AsyncControlClient:
    """Asks a control API, and turns its errors into ours: ``ControlUnavailable``, ``ControlRefused``, ``ConfigError``.

    Answers longer than ``CONTROL_ANSWER_BYTES`` are refused as they come; compressed ones are not asked for.
    """

    def __init__(self, target: ControlTarget, *, timeout_s: float = _TIMEOUT_S) -> None:
        self.target = target
        self._client = target.async_client(timeout_s)
        self._client.headers["accept-encoding"] = "identity"
        self._timeout_s = timeout_s

    async def close(self) -> None:
        """Close the connections."""
        await self._client.aclose()

    async def get(self, path: str, **query: Any) -> Any:
        """Return what is at a path."""
        return await self.request("GET", path, query=query)

    async def post(self, path: str, body: Any = None) -> Any:
        """Have something done."""
        return await self.request("POST", path, body={} if body is None else body)

    async def delete(self, path: str) -> Any:
        """Remove something."""
        return await self.request("DELETE", path, body={})

    async def request(
        self,
        method: str,
        path: str,
        *,
        query: Mapping[str, Any] | None = None,
        body: Any = None,
        headers: Mapping[str, str] | None = None,
    ) -> Any:
        """Send a request and return the answer as JSON, or as text where it is none."""
        content = None if body is None else json.dumps(body).encode()
        sent = dict(headers or {}) | ({} if content is None else {"content-type": "application/json"})
        wait_s = self._timeout_s if method == "GET" else _APPLY_S
        try:
            async with self._client.stream(
                method, path, params=dict(query or {}), content=content, headers=sent, timeout=wait_s
            ) as answer:
                return read_answer(await _whole(answer))
        except httpx.HTTPError as error:
            raise unavailable(self.target, error) from None

    async def stream(self, path: str, **query: Any) -> AsyncGenerator[Any, None]:
        """Yield what a stream of server-sent events tells, until either side ends it."""
        try:
            async with self._client.stream("GET", path, params=query, timeout=self._timeout_s) as answer:
                if answer.status_code != httpx.codes.OK:
                    read_answer(await _whole(answer))
                async with contextlib.aclosing(_lines(answer)) as lines:
                    async for line in lines:
                        if line.startswith(_DATA):
                            yield _value(line[len(_DATA) :])
        except httpx.HTTPError as error:
            raise unavailable(self.target, error) from None


async def _whole(answer: httpx.Response) -> httpx.Response:
    """Return an answer with its body. Raises ``ControlRefused`` for one that is too long."""
    parts, size = [], 0
    async for part in answer.aiter_raw():
        size += len(part)
        if size > CONTROL_ANSWER_BYTES:
            raise ControlRefused(_BAD_GATEWAY, f"the answer is longer than {CONTROL_ANSWER_BYTES} bytes")
        parts.append(part)
    headers = {"content-type": answer.headers.get("content-type", "")}
    if "etag" in answer.headers:
        headers["etag"] = answer.headers["etag"]
    return httpx.Response(answer.status_code, headers=headers, content=b"".join(parts))


async def _lines(answer: httpx.Response) -> AsyncGenerator[bytes, None]:
    waiting = b""
    async for part in answer.aiter_raw():
        *whole, waiting = (waiting + part).split(b"\n")
        if len(waiting) > CONTROL_STREAM_LINE_BYTES:
            raise ControlRefused(_BAD_GATEWAY, f"an event is longer than {CONTROL_STREAM_LINE_BYTES} bytes")
        for line in whole:
            yield line


def _value(text: bytes) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        raise ControlRefused(_BAD_GATEWAY, "an event is not JSON; is this the control API of a gateway?") from None
