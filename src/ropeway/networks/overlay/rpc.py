"""Requests from one gateway to another, sealed between the two.

The first request opens a pairwise channel (``crypto.channel``); it serves ten minutes and is made again when
either side has forgotten it. A request is a CBOR map with ``op``; whoever serves that word answers with any CBOR value,
or raises a ``RopewayError``, which arrives as a word and a text.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter, OrderedDict
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from typing import Any, Final, TypeVar

import cbor2

from ropeway import aio
from ropeway.errors import CallTimeout, ProviderLost, RopewayError, SealError
from ropeway.limits import (
    OVERLAY_CHANNELS,
    OVERLAY_CHANNELS_PER_MEMBER,
    OVERLAY_REQUEST_ITEMS,
    OVERLAY_REQUESTS,
    OVERLAY_REQUESTS_BYTES,
)
from ropeway.networks.overlay.asked import Asked
from ropeway.networks.overlay.crypto.cbor import loads
from ropeway.networks.overlay.crypto.certificate import Certificate
from ropeway.networks.overlay.crypto.channel import Initiator, SecureChannel, peek_channel, respond
from ropeway.networks.overlay.crypto.identity import Identity
from ropeway.networks.overlay.crypto.trust import Trust
from ropeway.networks.overlay.data_plane import DataPlane, Handle
from ropeway.networks.overlay.refusal import Refusal
from ropeway.tasks import Chores, describe, end

__all__ = ["Answer", "RemoteError", "Rpc", "key_of", "part"]

log = logging.getLogger("ropeway.overlay")

_HELLO: Final = b"\x01"
_SEALED: Final = b"\x02"
_REFUSED: Final = b"\x00"
_HELLO_S: Final = 3.0
_LARGE_BYTES: Final = 1 << 16  # more is sent from a thread
_ABOUT_BYTES: Final = 24  # of a request: its channel and its number, which its answer is bound to

T = TypeVar("T")

Answer = Callable[[Certificate, Mapping[str, Any]], Awaitable[Any]]
"""Answers a request of the owner of a certificate."""


def part(request: Mapping[str, Any], key: str, kind: type[T]) -> T:
    """Return one value of a request. Raises ``SealError`` where it is of another kind."""
    value = request.get(key)
    if type(value) is not kind:
        raise SealError(Refusal.MALFORMED, f"a request, whose {key!r} is not a {kind.__name__}")
    return value


def key_of(gateway: bytes) -> str:
    """Return the key at which a gateway takes requests."""
    return f"rw/g/{gateway.hex()}"


class Rpc:
    """Asks other gateways, and answers them."""

    def __init__(
        self,
        fabric: DataPlane,
        identity: Identity,
        trust: Trust,
        refused: Callable[[str, SealError], None],
    ) -> None:
        self._fabric, self._identity, self._trust = fabric, identity, trust
        self._refused = refused
        self._answers: dict[str, Answer] = {}
        self._opening: dict[bytes, asyncio.Task[SecureChannel]] = {}
        self._channels: dict[bytes, SecureChannel] = {}
        self._inbound: OrderedDict[bytes, SecureChannel] = OrderedDict()
        self._tasks = Chores()
        self._under_way_bytes = 0
        self._ends: list[Handle] = []
        self.counts: Counter[str] = Counter()

    def open(self) -> None:
        """Take requests from now on."""
        key = key_of(self._fabric.gateway)
        self._ends.append(self._fabric.serve(key, self._take, limit_bytes=OVERLAY_REQUESTS_BYTES))

    async def close(self) -> None:
        """Stop answering."""
        for handle in self._ends:
            handle()
        self._ends.clear()
        await end(*self._opening.values())
        await self._tasks.close()

    def answers(self, op: str, answer: Answer) -> None:
        """Register the handler of requests with this word."""
        self._answers[op] = answer

    def forget(self, gateway: bytes) -> None:
        """Forget a gateway that has gone."""
        self._channels.pop(gateway, None)

    def recheck(self) -> None:
        """Drop the channels of those whose certificates are good no longer."""
        for channels in (self._channels, self._inbound):
            for key, channel in list(channels.items()):
                if not self._good(channel):
                    del channels[key]

    def _good(self, channel: SecureChannel) -> bool:
        try:
            self._trust.check(channel.peer.der)
        except SealError:
            return False
        return True

    # ── asking ─────────────────────────────────────────────────────────────────────────────────────────────────

    async def ask(self, gateway: bytes, request: Mapping[str, Any], timeout_s: float, *, lane: int = 1) -> Any:
        """Send a request to a gateway and return its answer.

        Raises ``ProviderLost`` where it is not there or goes meanwhile, ``CallTimeout``, ``SealError`` where it is not
        who it claims to be, or what the other side raised (as ``RemoteError``).
        """
        deadline = time.monotonic() + timeout_s
        text = cbor2.dumps(request)
        name = str(request.get("op"))
        for last in (False, True):
            channel = await self._channel(gateway, max(deadline - time.monotonic(), 0.001))
            packet = channel.seal(text)
            left_s = max(deadline - time.monotonic(), 0.001)
            replies = await self._fabric.ask(key_of(gateway), _SEALED + packet, left_s, lane=lane, first=True)
            self.counts[name] += 1
            if not replies:
                if time.monotonic() >= deadline - 0.001:
                    raise CallTimeout(name, timeout_s)
                raise ProviderLost(name, "its gateway has gone")
            reply = replies[0]
            if reply[:1] == _SEALED:
                return self._read(channel.open(reply[1:], packet[:_ABOUT_BYTES]))
            self._channels.pop(gateway, None)  # it has forgotten the channel
            if last:
                raise ProviderLost(name, "its gateway does not take the request")
        raise AssertionError

    @staticmethod
    def _read(raw: bytes) -> Any:
        answer = loads(raw, "an answer", items=OVERLAY_REQUEST_ITEMS)
        if not isinstance(answer, dict):
            raise SealError(Refusal.MALFORMED, "an answer")
        if "error" in answer:
            text = str(answer.get("text", ""))
            raise RemoteError(str(answer["error"]), text, str(answer.get("reason", text)))
        return answer.get("ok")

    async def _channel(self, gateway: bytes, timeout_s: float) -> SecureChannel:
        channel = self._channels.get(gateway)
        if channel is not None and channel.usable():
            return channel
        opening = self._opening.get(gateway)
        if opening is None:
            opening = asyncio.create_task(self._open_channel(gateway), name=f"channel to {gateway.hex()[:8]}")
            self._opening[gateway] = opening
            opening.add_done_callback(partial(self._opened, gateway))
        try:
            async with aio.timeout(timeout_s):
                return await asyncio.shield(opening)
        except TimeoutError:
            raise CallTimeout("hello", timeout_s) from None

    def _opened(self, gateway: bytes, opening: asyncio.Task[SecureChannel]) -> None:
        self._opening.pop(gateway, None)
        if not opening.cancelled():
            opening.exception()  # seen, also where whoever asked has stopped waiting

    async def _open_channel(self, gateway: bytes) -> SecureChannel:
        began = Initiator(self._identity, gateway)
        replies = await self._fabric.ask(key_of(gateway), _HELLO + began.hello, _HELLO_S, first=True)
        if not replies:
            raise ProviderLost("hello", "the gateway is not there")
        if replies[0][:1] != _HELLO:
            raise ProviderLost("hello", f"the gateway refuses us: {replies[0][1:].decode(errors='replace')}")
        try:
            channel = began.finish(replies[0][1:], self._trust)
        except SealError as error:
            self._refused(f"gateway {gateway.hex()[:8]}", error)
            raise
        self._channels[gateway] = channel
        return channel

    # ── answering ──────────────────────────────────────────────────────────────────────────────────────────────

    def _take(self, asked: Asked) -> None:
        kind, rest = asked.payload[:1], asked.payload[1:]
        if kind == _HELLO:
            self._greet(asked, rest)
        elif kind == _SEALED:
            self._serve(asked, rest)
        else:
            self._refused("a request", SealError(Refusal.MALFORMED))
            asked.done()

    def _greet(self, asked: Asked, hello: bytes) -> None:
        try:
            reply, channel = respond(self._identity, self._fabric.gateway, hello, self._trust)
        except SealError as error:
            self._refused("a gateway that greets", error)
            asked.answer(_REFUSED + str(error).encode())
            return
        self._keep(channel)
        asked.answer(_HELLO + reply)

    def _keep(self, channel: SecureChannel) -> None:
        """Keep a channel that another gateway opened; above the limits, the one goes that was not used for longest."""
        self._inbound[channel.id] = channel
        owner = channel.peer.fingerprint
        same = [id for id, other in self._inbound.items() if other.peer.fingerprint == owner]
        if len(same) > OVERLAY_CHANNELS_PER_MEMBER:
            del self._inbound[same[0]]
        while len(self._inbound) > OVERLAY_CHANNELS:
            self._inbound.popitem(last=False)

    def _serve(self, asked: Asked, packet: bytes) -> None:
        try:
            channel = self._inbound.get(peek_channel(packet))
            if channel is None or not channel.usable():
                asked.answer(_REFUSED)
                return
            request = loads(channel.open(packet), "a request", items=OVERLAY_REQUEST_ITEMS)
            self._trust.check(channel.peer.der)
        except SealError as error:
            self._refused("a request", error)
            asked.answer(_REFUSED)
            return
        self._inbound.move_to_end(channel.id)
        if len(self._tasks.tasks) >= OVERLAY_REQUESTS or self._under_way_bytes + len(packet) > OVERLAY_REQUESTS_BYTES:
            busy = {"error": "CallFailed", "text": f"busy with {len(self._tasks.tasks)} requests"}
            asked.answer(self._sealed(channel, busy, packet[:_ABOUT_BYTES]))
            return
        self._under_way_bytes += len(packet)
        task = self._tasks.start(self._answer(asked, channel, request, packet[:_ABOUT_BYTES]), "overlay request")
        task.add_done_callback(partial(self._answered, len(packet)))

    def _answered(self, size: int, _: object) -> None:
        self._under_way_bytes -= size

    async def _answer(self, asked: Asked, channel: SecureChannel, request: Any, about: bytes) -> None:
        reply: dict[str, Any] | None = None
        try:
            answer = self._answers.get(str(request.get("op"))) if isinstance(request, dict) else None
            if answer is None:
                reply = {"error": "CallFailed", "text": "nobody here knows this request"}
            else:
                reply = {"ok": await answer(channel.peer, request)}
        except SealError as error:
            self._refused(channel.peer.name, error)
            reply = {"error": "SealError", "text": str(error)}
        except RopewayError as error:
            reply = {"error": type(error).__name__, "text": str(error)}
            if isinstance(error, ProviderLost):
                reply["reason"] = error.reason
        except (KeyError, TypeError, ValueError) as error:  # of a member, but not in the form that we expect
            log.debug("overlay: a request of %s cannot be used", channel.peer.name, exc_info=error)
            self._refused(channel.peer.name, SealError(Refusal.MALFORMED))
            reply = {"error": "SealError", "text": Refusal.MALFORMED.value}
        except Exception as error:  # a handler is somebody else's code; its failure is this request's
            log.exception("overlay: a request of %s failed", channel.peer.name)
            reply = {"error": "CallFailed", "text": describe(error)}
        finally:
            if reply is None:
                asked.done()
        packet = self._sealed(channel, reply, about)
        if len(packet) > _LARGE_BYTES:
            await asyncio.to_thread(asked.answer, packet)
        else:
            asked.answer(packet)

    @staticmethod
    def _sealed(channel: SecureChannel, reply: Mapping[str, Any], about: bytes) -> bytes:
        return _SEALED + channel.seal(cbor2.dumps(reply), about)


class RemoteError(RopewayError):
    """Raised for an error that the other side raised: ``word`` is its name, ``reason`` that of ``ProviderLost``."""

    def __init__(self, word: str, text: str, reason: str) -> None:
        self.word, self.text, self.reason = word, text, reason
        super().__init__(text)
