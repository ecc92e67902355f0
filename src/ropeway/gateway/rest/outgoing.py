"""Posts topics to web servers, and offers their URLs as services; bodies are the JSON of rosbridge."""

from __future__ import annotations

import asyncio
import ssl
import time
from collections import Counter
from contextlib import AsyncExitStack
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import httpx

from ropeway import aio
from ropeway.errors import CallFailed, RopewayError
from ropeway.fault_log import FaultLog
from ropeway.gateway.auth import read_secret
from ropeway.gateway.rest.mapping import AnswerMapping, Posted, RequestMapping, with_variables
from ropeway.graph.base import SEQ_NONE, Sample, new_origin
from ropeway.limits import REST_BODY_BYTES
from ropeway.tasks import Supervised
from ropeway.types.untrusted import json_loads

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ropeway.gateway.config.http_model import HttpRule
    from ropeway.graph.base import Publisher
    from ropeway.graph.calls import Request
    from ropeway.hub.hub import Hub, View
    from ropeway.types import TypeRegistry

__all__ = ["WebRule", "open_rules"]

_PAUSE_S: Final = 0.5  # before the second attempt; each further one waits twice as long
_AGAIN: Final = frozenset((408, 425, 429, 500, 502, 503, 504))


class _NoAnswer(Exception):
    """A server that gave no good answer. ``again``: another attempt may help."""

    def __init__(self, reason: str, *, again: bool) -> None:
        super().__init__(reason)
        self.again = again


class _Answer(NamedTuple):
    body: bytes
    media_type: str


class WebRule:
    """A rule that is carried out."""

    def __init__(self, rule: HttpRule, path: str, view: View, registry: TypeRegistry, *, pause_s: float) -> None:
        self.rule, self._view, self._registry, self._pause_s = rule, view, registry, pause_s
        self.counts: Counter[str] = Counter()
        kind = "msg" if rule.topic is not None else "srv"
        self._type = registry.canonical(rule.type, kind)
        headers = {name: with_variables(text, f"{path}.headers.{name}") for name, text in rule.headers.items()}
        if rule.token is not None:
            headers["authorization"] = f"Bearer {read_secret(rule.token, f'{path}.token')}"
        verify = ssl.create_default_context(cafile=rule.ca) if rule.ca is not None else True
        self._client = httpx.AsyncClient(headers=headers, verify=verify, timeout=rule.timeout_s, trust_env=False)
        self._fault_log = FaultLog(rule.url)
        self._newest: Sample | None = None
        self._came = asyncio.Event()
        self._answers: Publisher | None = None
        self._answer: AnswerMapping | None = None
        self._request = RequestMapping(rule, self._type, registry, path) if rule.topic is not None else None
        if rule.answer is not None:
            answered = registry.canonical(rule.answer.type)
            self._answer = AnswerMapping(rule.answer, answered, registry, f"{path}.answer")
        self._origin = new_origin()

    async def open(self, stack: AsyncExitStack) -> None:
        """Begin. Raises ``RopewayError``."""
        stack.push_async_callback(self._client.aclose)
        rule, view = self.rule, self._view
        if rule.service is not None:
            await view.create_service(rule.service, self._type, self._serve)
            return
        assert rule.topic is not None
        if rule.answer is not None:
            self._answers = await view.create_publisher(rule.answer.topic, self._registry.canonical(rule.answer.type))
        await view.create_subscription(rule.topic, self._type, None, self._arrived)
        stack.push_async_callback(Supervised(self._post_all, f"posts to {rule.url}").start().close)

    def status(self) -> dict[str, Any]:
        """Return what was done, as JSON."""
        return {"url": self.rule.url, "name": self.rule.topic or self.rule.service, "counts": dict(self.counts)}

    # ── topics ─────────────────────────────────────────────────────────────────────────────────────────────────

    def _arrived(self, batch: Sequence[Sample]) -> None:
        self.counts["replaced by newer"] += len(batch) - (1 if self._newest is None else 0)
        self._newest = batch[-1]
        self._came.set()

    async def _post_all(self) -> None:
        request = self._request
        assert request is not None
        while True:
            await self._came.wait()
            self._came.clear()
            sample, self._newest = self._newest, None
            if sample is None:
                continue
            try:
                posted = request.make(sample.payload)
                self._publish(await self._with_attempts(posted), posted)
            except (_NoAnswer, RopewayError) as error:
                self.counts["failed"] += 1
                self._fault_log.note("answer", self.rule.topic or "", error)
            else:
                self.counts["posted"] += 1

    async def _with_attempts(self, posted: Posted) -> _Answer:
        for number in range(1, self.rule.attempts + 1):
            try:
                return await self._post(posted.arguments, self.rule.timeout_s)
            except _NoAnswer as error:
                if not error.again or number == self.rule.attempts:
                    raise
                self.counts["tried again"] += 1
            await asyncio.sleep(self._pause_s * 2 ** (number - 1))
        raise AssertionError

    def _publish(self, answer: _Answer, posted: Posted) -> None:
        if self._answers is not None and self._answer is not None:
            payload = self._answer.make(answer.body, answer.media_type, posted.message)
            self._answers.publish(Sample(payload, self._answers.type, time.time_ns(), self._origin, SEQ_NONE))

    # ── services ───────────────────────────────────────────────────────────────────────────────────────────────

    async def _serve(self, request: Request) -> bytes:
        body = self._registry.codec(f"{self._type}_Request").json(request.payload)
        timeout_s = min(self.rule.timeout_s, request.timeout_s or self.rule.timeout_s)
        try:
            arguments = {"content": body, "headers": {"content-type": "application/json"}}
            answer = await self._post(arguments, timeout_s)  # once: a call may not be done twice
            response = self._registry.codec(f"{self._type}_Response").from_json(json_loads(answer.body))
        except (_NoAnswer, RopewayError) as error:
            self.counts["failed"] += 1
            raise CallFailed(self.rule.service or "", f"{self.rule.url}: {error}") from None
        self.counts["answered"] += 1
        return response

    async def _post(self, arguments: dict[str, Any], timeout_s: float) -> _Answer:
        """Return a good answer. Raises ``_NoAnswer``."""
        try:
            async with aio.timeout(timeout_s), self._client.stream("POST", self.rule.url, **arguments) as answer:
                if not answer.is_success:
                    raise _NoAnswer(f"the server answered {answer.status_code}", again=answer.status_code in _AGAIN)
                parts, size = [], 0
                async for part in answer.aiter_bytes():
                    size += len(part)
                    if size > REST_BODY_BYTES:
                        raise _NoAnswer(f"the answer is longer than {REST_BODY_BYTES} bytes", again=False)
                    parts.append(part)
                return _Answer(b"".join(parts), answer.headers.get("content-type", "").lower())
        except (TimeoutError, httpx.TimeoutException):
            raise _NoAnswer(f"no answer within {timeout_s:g} s", again=True) from None
        except httpx.HTTPError as error:
            raise _NoAnswer(f"no answer: {error or type(error).__name__}", again=True) from None


async def open_rules(
    rules: Sequence[HttpRule], hub: Hub, registry: TypeRegistry, stack: AsyncExitStack, *, pause_s: float = _PAUSE_S
) -> list[WebRule]:
    """Carry out rules on a graph, as long as ``stack`` is open. Raises ``RopewayError``."""
    view = hub.view("web servers")
    stack.push_async_callback(view.close)
    opened = []
    for number, rule in enumerate(rules):
        made = WebRule(rule, f"gateway.http[{number}]", view, registry, pause_s=pause_s)
        await made.open(stack)
        opened.append(made)
    return opened
