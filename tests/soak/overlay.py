"""A megabyte from other members of an overlay to a gateway, and to a router from them and from strangers."""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any, Final

import cbor2

from ropeway.networks.overlay.advert import Advertisement, advert_key, make_advert
from ropeway.networks.overlay.announcement import NoteKey
from ropeway.networks.overlay.crypto.channel import Initiator
from ropeway.networks.overlay.crypto.identity import Identity, write_private
from ropeway.networks.overlay.data_plane import CRL_KEY, DataPlane, Handle
from ropeway.networks.overlay.fleet import Fleet
from ropeway.networks.overlay.graph import OverlayGraph
from ropeway.networks.overlay.graph.publisher import OverlayPublisher
from ropeway.networks.overlay.names import Metadata, global_name
from ropeway.networks.overlay.node import OverlayNode
from ropeway.networks.overlay.packet_item import RAW, ZSTD, PacketItem
from ropeway.networks.overlay.packet_mark import Mark
from ropeway.networks.overlay.router import Router
from ropeway.networks.overlay.rpc import key_of
from ropeway.qos import QoS
from tests.networks.overlay.hostile import bomb
from tests.support.ports import free_endpoint
from tests.support.until import until

__all__ = ["MEMBERS", "TO_ROUTERS", "Attack", "Overlay", "a_gateway", "a_router", "attacked"]

_FEW_BYTES: Final = 2_000
_TOPIC: Final = "/soak"
_STRING: Final = "std_msgs/msg/String"
_DECLARED_BYTES: Final = 500  # as which a declaration counts: Zenoh takes minutes for what fits into a megabyte
_AT_ONCE: Final = 64  # questions that wait for their answer


class Overlay:
    """A fleet with a router, and a member that is hostile."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.fleet = Fleet.create("soak", directory / "fleet")
        self.endpoint = free_endpoint()

    def bundle(self, name: str, **options: Any) -> str:
        """Return the file of a new member."""
        path = self.directory / f"{name}.ropeway"
        write_private(path, self.fleet.issue(name, **options).to_text())
        return str(path)


class Hostile:
    """The member, as far as it needs to know who is attacked."""

    def __init__(self, graph: OverlayGraph, publisher: OverlayPublisher, target: bytes) -> None:
        self.graph, self.publisher, self.target = graph, publisher, target
        self.ends: list[Handle] = []  # of what was declared
        self.identity: Identity = graph.node.identity
        self.fabric: DataPlane = graph.node.fabric
        self.me = graph.node.gateway
        assert self.identity.name_secret is not None
        self.secret = self.identity.name_secret
        self.notes = NoteKey(self.secret)
        self.key = advert_key(self.secret)

    def end(self) -> None:
        """Take back what was declared."""
        for end in self.ends:
            end()

    async def put(self, key: str, raw: bytes, mark: bytes | None = None) -> int:
        """Put something."""
        await asyncio.to_thread(self.fabric.put, 4, key, raw, mark)
        return len(raw) + len(key)

    def note(self, kind: str, body: object) -> bytes:
        """Seal a note as the gateway that we are."""
        return self.notes.seal(self.me, kind, body, self.identity.sign)

    def advert(self, number: int, kind: str = "publisher") -> bytes:
        """Make a sealed advertisement."""
        return make_advert(self.endpoint(number, kind), self.identity, self.key)

    def endpoint(self, number: int, kind: str = "publisher") -> Advertisement:
        """Make up an endpoint."""
        name, about = f"/t{number}", Metadata()
        secret = global_name(self.secret, "topic" if kind == "publisher" else "service", name, _STRING, about)
        since = time.time_ns()
        return Advertisement(
            kind, secret, os.urandom(16), self.me, name, _STRING, QoS(), "cdr", about, since, since + 10**18
        )


Attack = Callable[[Hostile, int], Awaitable[int]]
"""Sends one thing, by its number; returns how many bytes that were."""


async def _adverts(evil: Hostile, number: int) -> int:
    adverts = [evil.endpoint(100 * number + n) for n in range(100)]
    raws = [make_advert(advert, evil.identity, evil.key) for advert in adverts]
    for advert, raw in zip(adverts, raws, strict=True):
        evil.graph.node.membership.advertise(advert, raw)
    await asyncio.sleep(0.05)
    return sum(map(len, raws))


async def _deltas(evil: Hostile, number: int) -> int:
    body = {"v": number, "add": [os.urandom(40) for _ in range(2000)], "del": [os.urandom(16)] * 2000}
    return await evil.put(f"rw/a/{evil.me.hex()}", evil.note("delta", body))


async def _beats(evil: Hostile, number: int) -> int:
    body = {"t": time.time_ns(), "v": 0, "w": {os.urandom(16): n for n in range(4000)}, "r": 0}
    return await evil.put(f"rw/h/{evil.me.hex()}", evil.note("heartbeat", body))


async def _newer_lists(evil: Hostile, number: int) -> int:
    body = {"t": time.time_ns(), "v": 10**9 + number, "w": {}, "r": 10**9}
    return await evil.put(f"rw/h/{evil.me.hex()}", evil.note("heartbeat", body))


async def _strange_beats(evil: Hostile, number: int) -> int:
    return await evil.put(f"rw/h/{os.urandom(16).hex()}", os.urandom(200))


async def _nested_notes(evil: Hostile, number: int) -> int:
    return await evil.put(f"rw/a/{evil.me.hex()}", evil.note("delta", {"v": 1, "add": [[]] * 8000, "del": []}))


async def _large_notes(evil: Hostile, number: int) -> int:
    return await evil.put(f"rw/h/{evil.me.hex()}", os.urandom(1 << 20))


async def _tokens(evil: Hostile, number: int) -> int:
    key = f"rw/l/{os.urandom(16).hex()}"
    evil.ends.append(evil.fabric.token(key))
    return _DECLARED_BYTES


async def _revocation_lists(evil: Hostile, number: int) -> int:
    return await evil.put(CRL_KEY, b"\x30\x82" + os.urandom(10_000))


async def _packets(evil: Hostile, number: int) -> int:
    items = [PacketItem(100 * number + n, 0, 1, b"o" * 16, 0, RAW, b"") for n in range(4000)]
    return await evil.put(evil.publisher.key, evil.publisher.source.seal(items))


async def _bombs(evil: Hostile, number: int) -> int:
    items = [PacketItem(number * 4 + n, 0, 1, b"o" * 16, 0, ZSTD, bomb(1 << 29)) for n in range(4)]
    return await evil.put(evil.publisher.key, evil.publisher.source.seal(items)) * 20


async def _unknown_keys(evil: Hostile, number: int) -> int:
    junk = bytearray(evil.publisher.source.seal([PacketItem(1, 0, 1, b"o" * 16, 0, RAW, bytes(10))]))
    junk[4:8] = b"\xff\xff\xff\xff"
    return await evil.put(evil.publisher.key, bytes(junk))


async def _parts(evil: Hostile, number: int) -> int:
    mark = Mark(number % 7, number, 0, 60 << 20).to_bytes()
    return await evil.put(evil.publisher.key, os.urandom(100), mark)


async def _ask(evil: Hostile, key: str, payload: bytes) -> int:
    await evil.fabric.ask(key, payload, 2.0)
    return len(key) + len(payload)


async def _hellos(evil: Hostile, number: int) -> int:
    made = [b"\x01" + Initiator(evil.identity, evil.target).hello for _ in range(_AT_ONCE)]
    return sum(await asyncio.gather(*(_ask(evil, key_of(evil.target), hello) for hello in made)))


async def _junk_questions(evil: Hostile, number: int) -> int:
    keys = (key_of(evil.target), f"rw/m/{evil.target.hex()}", CRL_KEY, f"rw/k/{evil.target.hex()}")
    asked = (_ask(evil, keys[n % 4], bytes([n % 4]) + os.urandom(500)) for n in range(_AT_ONCE))
    return sum(await asyncio.gather(*asked))


async def _requests(evil: Hostile, number: int) -> int:
    ops = ("key", "history", "call", "ping", "list", "receipts", "nothing")

    async def one(n: int) -> int:
        request = {"op": ops[n % len(ops)], "of": os.urandom(16), "by": evil.me, "id": os.urandom(16), "x": [0] * 1000}
        request |= {"key": os.urandom(32), "after": -1, "for": [os.urandom(16)] * 30, "name": "x" * 1000}
        with contextlib.suppress(Exception):  # refused, which is as good
            await evil.graph.node.rpc.ask(evil.target, request, 2.0)
        return len(cbor2.dumps(request))

    return sum(await asyncio.gather(*map(one, range(_AT_ONCE))))


async def _readers(evil: Hostile, number: int) -> int:
    key = f"rw/d/{os.urandom(32).hex()}/*"
    evil.ends.append(evil.fabric.subscribe(key, lambda *_: None))
    return _DECLARED_BYTES


async def _answerers(evil: Hostile, number: int) -> int:
    key = f"rw/g/{os.urandom(16).hex()}"
    evil.ends.append(evil.fabric.serve(key, lambda _: None))
    return _DECLARED_BYTES


async def _names(evil: Hostile, number: int) -> int:
    key = f"rw/d/{os.urandom(32).hex()}/{os.urandom(16).hex()}"
    made = evil.fabric.short(key)
    evil.ends.append(lambda: evil.fabric.forget(made))
    return _DECLARED_BYTES


MEMBERS: Final[dict[str, Attack]] = {
    "adverts": _adverts,
    "deltas": _deltas,
    "beats": _beats,
    "newer-lists": _newer_lists,
    "strange-beats": _strange_beats,
    "nested-notes": _nested_notes,
    "large-notes": _large_notes,
    "tokens": _tokens,
    "revocation-lists": _revocation_lists,
    "packets": _packets,
    "bombs": _bombs,
    "unknown-keys": _unknown_keys,
    "parts": _parts,
    "hellos": _hellos,
    "junk-questions": _junk_questions,
    "requests": _requests,
}
"""By their names: what a member does to a gateway."""

TO_ROUTERS: Final[dict[str, Attack]] = {
    name: MEMBERS[name] for name in ("large-notes", "tokens", "revocation-lists", "parts", "junk-questions")
} | {"readers": _readers, "answerers": _answerers, "names": _names}
"""The same to a router."""


async def a_gateway(overlay: Overlay, stack: AsyncExitStack) -> dict[str, Any]:
    """Start a router, and return the configuration of a gateway that is a member, and reads a topic."""
    identity = overlay.fleet.issue("router", role="router")
    await stack.enter_async_context(Router(identity, listen=[overlay.endpoint]))
    membership = {"identity": overlay.bundle("gateway"), "routers": [overlay.endpoint], "listen": []}
    reads = [{"name": _TOPIC, "type": _STRING}]
    return {
        "gateway": {
            "name": "gateway",
            "graphs": ["memory:soak"],
            "listen": ["ws://127.0.0.1:0"],
            "overlay": membership,
        },
        "remotes": [{"address": "overlay", "subscribe": reads}],
    }


async def a_router(overlay: Overlay, stack: AsyncExitStack) -> dict[str, Any]:
    """Return the configuration of a router."""
    return {"router": {"identity": overlay.bundle("router", role="router"), "listen": overlay.endpoint}}


async def attacked(overlay: Overlay, attack: Attack, stack: AsyncExitStack, size: int, *, gateway: bool) -> None:
    """Join as a member that does something until it has sent so many bytes; the stack leaves."""
    node = OverlayNode(overlay.fleet.issue(f"m{os.urandom(4).hex()}"), routers=[overlay.endpoint], listen=())
    graph = OverlayGraph(node)
    await graph.open()
    stack.push_async_callback(graph.close)
    target = os.urandom(16)
    publisher = await graph.create_publisher(_TOPIC, _STRING)
    if gateway:
        await until(lambda: node.membership.gateways())
        target = next(iter(node.membership.gateways()))
        await until(lambda: publisher.subscribers)
    evil = Hostile(graph, publisher, target)
    stack.callback(evil.end)
    sent = 0
    number = 1
    while sent < size:
        sent += await attack(evil, number)
        number += 1
