"""IoRT nodes: robots of any make that publish and read values as text packets over TCP.

This one file is all that a robot needs: it runs on Python 3.8 and later without any other package, so it can be
copied. Everything goes on without the server: values are published and read locally and merged when it is back::

    from ropeway.iort import Node

    with Node("TURTLESIM", "iort://cloud.example:7410", directory="values") as node:
        node.publish("pose", "1.0,2.0,0.5")
        node.subscribe("cmd_vel", lambda value: print(value.text))
        print(node.read("battery", system="PEPPER").text, node.mode)

``AsyncNode`` is the same for asyncio. ``python3 iort.py --help`` publishes and reads from a shell. Any node can be the
server of its network while the cloud is away: ``python3 iort.py --serve`` (or ``LocalServer``) needs nothing else.

The packets (Cuadros Zegarra et al. 2024, section 4) begin and end with a percent sign and have fields between slashes.
Plain ones are those of the paper, and are never escaped::

    %01/SYSTEM/TOPIC/p/DATA%        publish; the server says nothing
    %01/SYSTEM/TOPIC/s%             read; answered by %ORIGIN/SYSTEM/TOPIC/p/DATA% or %00/SYSTEM/TOPIC/e/why not%
    %01/SYSTEM/KIND/TOPIC/p/DATA%   with the kind of system, as the paper's Alice has it; it is no part of the name
    %01/SYSTEM/-/d%                 disconnect: the server closes the connection

ORIGIN is the two-digit identifier of the node that wrote the value, ``00`` where no node did or its identifier is none.

Those of the upgrade have an operation that begins with a plus, a head of ``key=value`` pairs between commas, and are
escaped: ``~0`` is a tilde, ``~1`` a slash, ``~2`` a percent sign, ``~3`` a comma and ``~4`` an equals sign::

    %01/NAME/-/+hello/n=1,v=1,token=…%      who I am; answered by +ok with t, the server's time; kind=robot or kind=pc
    %01/SYSTEM/TOPIC/+pub/n=2,t=…,v=…/DATA% answered by +ok once the value is kept, with its version v
    %01/SYSTEM/TOPIC/+get/n=3%              answered by +val with t, v, o (origin), k (ROS type)
    %01/SYSTEM/TOPIC/+sub/n=4,last=1%       every later value comes as +val without n; patterns are allowed
    %01/SYSTEM/TOPIC/+unsub/n=5%            also +adv, +unadv, +watch, +list, +del, +ping

Every request with a number ``n`` is answered exactly once, by an answer with that number: ``+ok``, ``+val``, or
``+err`` with a ``code`` and a text. ``t`` is in nanoseconds since 1970, ``v`` grows with every value of a topic.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import hashlib
import hmac
import json
import os
import re
import socket
import ssl
import struct
import sys
import threading
import time
from collections import OrderedDict, deque
from concurrent.futures import TimeoutError as FutureTimeout
from typing import Any, Awaitable, Callable, Deque, Dict, Iterable, List, Mapping, Optional, Tuple, TypeVar, Union, cast
from urllib.parse import quote, urlsplit

__all__ = [
    "DEFAULT_PORT",
    "KINDS",
    "NOT_HTTP",
    "AsyncNode",
    "Fault",
    "LocalServer",
    "Node",
    "NodeError",
    "Packet",
    "Parser",
    "Value",
    "escape",
    "identifier_of",
    "is_http",
    "kind_of",
    "origin_of",
    "pack",
    "text_of",
    "unescape",
]

DEFAULT_PORT = 7410
MAX_PACKET_BYTES = 1 << 20
"""One packet, where no configuration says otherwise."""

HEAD_VALUES = 64
"""Values in the head of a packet. The longest has nine."""

KINDS = ("robot", "pc")
"""The kinds that a node may name: the paper's Robot Node or PC Node."""

_VERSION_AHEAD_US = 86_400 * 1_000_000
_SANE_CLOCK_US = 1_767_225_600 * 1_000_000  # the year 2026: a clock before that was never set
_UNSET_CLOCK_US = 2_398_377_600 * 1_000_000  # the year 2046: what is taken for possible without a clock

_PERCENT = b"%"
_LONGEST_FILE_NAME = 200  # without what is added; most systems take 255 bytes
_PING_S = 2.0
_SILENCE_S = 7.0
_CONNECT_S = 3.0
_PAUSE_S = (0.1, 2.0)
_WAITING_LIMIT = 4096
"""Topics whose newest value waits for a peer that reads slowly. Above, the oldest goes."""

_WAITING_BYTES = 16 << 20
"""The same in bytes, all values of one connection together."""

_HIGH_BYTES = 1 << 20

DISCOVERY_PORT = 7411
"""UDP port at which local servers are found."""

_GROUP = "239.255.74.11"  # of addresses that stay within an organization
_SIOCGIFBRDADDR = 0x8919  # of Linux: the broadcast address of an interface
_ASKED_S = 0.4  # how long answers are waited for
_ANSWERS = 16  # of one search
_ANSWERS_PER_S = 20
"""Answers of a local server to those who look for one, whoever asks."""

_DATAGRAM_BYTES = 512
"""A question or an answer of those who look for a server; a longer one is not read."""

_AHEAD_US = 5000000  # a live version further in the future than this is a wrong clock's
_LOGIN_S = 10.0
"""Time in which a node has to show the token of a local server."""

_STRANGERS_BYTES = 4096
"""A packet of a node that has not shown the token of a local server yet."""

_SERVED_NODES = 256
"""Nodes of a local server at a time."""

_SERVED_VALUES = 10000
"""Values that a local server keeps."""

_SERVED_BYTES = 64 << 20
"""The same in bytes, all together."""

_SERVED_SUBSCRIPTIONS = 256
"""Subscriptions of one node of a local server."""


# ── packets ────────────────────────────────────────────────────────────────────────────────────────────────────────


class NodeError(Exception):
    """A request that was refused or not answered. ``code`` is a word for programs.

    ``timeout``, ``lost``, ``malformed``, ``unknown-system``, ``unknown-topic``, ``denied``, ``login``, ``too-big``,
    ``full``, ``stale``, ``not-kept``, ``conversion``, ``name``, ``busy`` or ``closed``.
    """

    def __init__(self, code: str, text: str) -> None:
        self.code, self.text = code, text
        super().__init__(text or code)


class Fault:
    """Bytes that are no packet: ``code`` is ``malformed``, ``stray``, ``empty`` or ``too-big``."""

    __slots__ = ("code", "text")

    def __init__(self, code: str, text: str) -> None:
        self.code, self.text = code, text

    def __repr__(self) -> str:
        return "Fault({!r}, {!r})".format(self.code, self.text)


class Packet:
    """A packet. ``op`` is ``p``, ``s``, ``e``, ``d``, or begins with a plus; ``system_type`` is Alice's segment."""

    __slots__ = ("data", "head", "id", "op", "system", "system_type", "topic")

    def __init__(
        self,
        id: str,
        system: str,
        topic: str,
        op: str,
        head: Optional[Dict[str, str]] = None,
        data: bytes = b"",
        system_type: str = "",
    ) -> None:
        self.id, self.system, self.topic, self.op = id, system, topic, op
        self.head: Dict[str, str] = head if head is not None else {}
        self.data, self.system_type = data, system_type

    def encode(self) -> bytes:
        """Return the bytes on the wire."""
        return pack(self.id, self.system, self.topic, self.op, self.head, self.data, self.system_type)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Packet) and all(getattr(self, k) == getattr(other, k) for k in Packet.__slots__)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        where = "/".join(part for part in (self.id, self.system, self.system_type, self.topic, self.op) if part)
        return "<Packet {} {} {} B>".format(where, self.head or "", len(self.data))


def escape(text: str) -> str:
    """Return a name or a value of a head as it stands in a packet of the upgrade."""
    if text.isalnum():
        return text
    if "~" in text:
        text = text.replace("~", "~0")
    for plain, escaped in (("/", "~1"), ("%", "~2"), (",", "~3"), ("=", "~4")):
        if plain in text:
            text = text.replace(plain, escaped)
    return text


def unescape(text: str) -> str:
    """Undo ``escape``."""
    for escaped, plain in (("~4", "="), ("~3", ","), ("~2", "%"), ("~1", "/"), ("~0", "~")):
        text = text.replace(escaped, plain)
    return text


def pack(
    id: str,
    system: str,
    topic: str,
    op: str,
    head: Optional[Mapping[str, object]] = None,
    data: bytes = b"",
    system_type: str = "",
) -> bytes:
    """Return the bytes of a packet. Raises ``ValueError`` for what a plain packet cannot hold."""
    if op[0] == "+":
        fields = [escape(id), escape(system), escape(topic), op]
        if head or data:
            fields.append(",".join(["{}={}".format(key, escape(str(value))) for key, value in (head or {}).items()]))
        text = "/".join(fields).encode()
        if data:
            if b"~" in data:
                data = data.replace(b"~", b"~0")
            if _PERCENT in data:
                data = data.replace(_PERCENT, b"~2")
            return b"".join((_PERCENT, text, b"/", data, _PERCENT))
        return b"".join((_PERCENT, text, _PERCENT))
    names = [id, system, system_type, topic] if system_type else [id, system, topic]
    for name in names:
        if not name or "/" in name or "%" in name:
            raise ValueError("a plain packet cannot hold the name {!r}".format(name))
    if _PERCENT in data:
        raise ValueError("a plain packet cannot hold data with a percent sign")
    text = "/".join([*names, op]).encode()
    return b"".join((_PERCENT, text, _PERCENT) if op in ("s", "d") else (_PERCENT, text, b"/", data, _PERCENT))


def origin_of(ident: str, where: str, kind: str = "") -> str:
    """Name the writer of a value: ``01@robot:where``, or ``01@where`` where its kind is not known."""
    return "{}@{}:{}".format(ident, kind, where) if kind else "{}@{}".format(ident, where)


def identifier_of(origin: str) -> str:
    """Return the two digits of the node that wrote a value; ``00`` where no node did."""
    ident = origin[:2]
    return ident if origin[2:3] == "@" and ident.isascii() and ident.isdigit() else "00"


def kind_of(origin: str) -> str:
    """Return what the node that wrote a value is, one of ``KINDS``; an empty text where that is not known."""
    kind = origin.partition("@")[2].partition(":")[0]
    return kind if kind in KINDS else ""


def _parse(body: bytes) -> Union[Packet, Fault]:
    parts = body.split(b"/", 5)
    count = len(parts)
    if count < 4:
        return Fault("malformed", "a packet has at least ID/SYSTEM/TOPIC/p or s, with slashes between")
    op = parts[3]
    data = b""
    try:
        if op == b"p" and count > 4:
            data = parts[4] if count == 5 else parts[4] + b"/" + parts[5]
            packet = Packet(parts[0].decode(), parts[1].decode(), parts[2].decode(), "p", None, data)
        elif op == b"e" and count > 4:
            data = parts[4] if count == 5 else parts[4] + b"/" + parts[5]
            packet = Packet(parts[0].decode(), parts[1].decode(), parts[2].decode(), "e", None, data)
        elif op == b"s" and (count == 4 or (count == 5 and not parts[4])):
            packet = Packet(parts[0].decode(), parts[1].decode(), parts[2].decode(), "s")
        elif op == b"d" and count == 4 and parts[2] == b"-":
            packet = Packet(parts[0].decode(), parts[1].decode(), "-", "d")
        elif op[:1] == b"+":
            return _parse_upgrade(parts, count)
        elif count > 4 and ((parts[4] == b"p" and count == 6) or (parts[4] == b"s" and (count == 5 or not parts[5]))):
            packet = Packet(
                parts[0].decode(),
                parts[1].decode(),
                op.decode(),
                parts[4].decode(),
                None,
                parts[5] if count == 6 else b"",
                parts[2].decode(),
            )
        elif op == b"p" or (count == 5 and parts[4] == b"p"):
            return Fault("malformed", "a publication has data behind its p/")
        else:
            return Fault("malformed", "the message identifier is neither p nor s")
    except UnicodeDecodeError:
        return Fault("malformed", "names are text in UTF-8")
    if not packet.id or not packet.system or not packet.topic:
        return Fault("malformed", "identifier, system and topic may not be empty")
    return packet


def _parse_upgrade(parts: List[bytes], count: int) -> Union[Packet, Fault]:
    id, system, topic = parts[0].decode(), parts[1].decode(), parts[2].decode()
    if "~" in id or "~" in system or "~" in topic:
        id, system, topic = unescape(id), unescape(system), unescape(topic)
    if not id or not system or not topic:
        return Fault("malformed", "identifier, system and topic may not be empty; a dash stands for none")
    head: Dict[str, str] = {}
    if count > 4 and parts[4]:
        items = parts[4].decode().split(",", HEAD_VALUES)
        if len(items) > HEAD_VALUES:
            return Fault("malformed", "a head has {} values at most".format(HEAD_VALUES))
        for item in items:
            key, equals, value = item.partition("=")
            if not equals or not key:
                return Fault("malformed", "a head is key=value,key=value")
            head[key] = unescape(value) if "~" in value else value
    data = b""
    if count > 5:
        data = parts[5]
        if b"~" in data:
            data = data.replace(b"~2", _PERCENT).replace(b"~1", b"/").replace(b"~0", b"~")
    return Packet(id, system, topic, parts[3].decode(), head, data)


_HTTP = re.compile(rb"(?:GET|HEAD|POST|PUT|DELETE|CONNECT|OPTIONS|TRACE|PATCH) ")

NOT_HTTP = (
    b"HTTP/1.1 400 Bad Request\r\nContent-Type: text/plain\r\nConnection: close\r\n\r\nthis port speaks iort://\n"
)
"""The answer to a browser. A page could put packets into the body of a request, and so speak as a node."""


def is_http(first: bytes) -> bool:
    """Return whether a connection begins with these bytes as a browser's does."""
    return _HTTP.match(first) is not None


class Parser:
    """Packets of a stream, however it is cut: feed it what comes.

    A percent sign may end one packet, begin the next, or be a stray one, so that what stands between any two of them
    is a packet if it reads as one: a percent sign too many or too few costs no other packet. A packet of more than
    ``max_bytes`` is let go as it comes and reported once it ends. Memory is bounded by that.
    """

    def __init__(self, max_bytes: int = MAX_PACKET_BYTES) -> None:
        self.max_bytes = max_bytes
        self._begun = False  # a percent sign has come; what stands before the first one is no packet
        self._inside = False  # the last percent sign begins a packet, as far as can be told
        self._chunks: List[bytes] = []
        self._size = 0
        self._too_big = False

    @property
    def unfinished(self) -> bool:
        """Whether a packet has begun and not ended."""
        return self._begun and (self._size > 0 or self._too_big)

    def feed(self, data: bytes) -> List[Union[Packet, Fault]]:
        """Return the packets that ``data`` completes; empty if there are none."""
        pieces = data.split(_PERCENT)
        found: List[Union[Packet, Fault]] = []
        last = pieces.pop()
        for piece in pieces:
            if not self._begun:
                piece = piece.strip()[:1]  # only that something was there
            if self._size or self._too_big:
                self._keep(piece)
                piece = b"".join(self._chunks)
                self._chunks.clear()
                self._size = 0
            if self._too_big or len(piece) > self.max_bytes:
                self._too_big = self._inside = False
                found.append(Fault("too-big", "a packet has {} bytes at most".format(self.max_bytes)))
            elif piece and not piece.isspace():
                item: Union[Packet, Fault, None] = _parse(piece) if self._begun else None
                if item is None or (isinstance(item, Fault) and not self._inside):
                    item = Fault("stray", "bytes between packets")
                self._inside = False
                found.append(item)
            else:
                if self._inside:
                    found.append(Fault("empty", "a packet without content"))
                self._inside = not self._inside
            self._begun = True
        if last:
            self._keep(last)
        return found

    def _keep(self, piece: bytes) -> None:
        if not self._begun:
            piece = piece.strip()[:1]  # only that something was there
        if not self._too_big and self._size + len(piece) <= self.max_bytes:
            if piece and (self._begun or not self._size):
                self._chunks.append(piece)
                self._size += len(piece)
                if len(self._chunks) > 4096:  # a byte at a time
                    self._chunks = [b"".join(self._chunks)]
        else:
            self._too_big = True
            self._chunks.clear()
            self._size = 0


def latest_version(now_ns: int) -> int:
    """Return the latest version that can be right at ``now_ns``: a day ahead, since clocks differ.

    A version is the time in microseconds. One that is far ahead would outrank all that are written for years; the
    highest possible would leave none for those that follow. Without a clock that was set, more is possible.
    """
    now_us = now_ns // 1000
    return now_us + _VERSION_AHEAD_US if now_us >= _SANE_CLOCK_US else _UNSET_CLOCK_US


# ── values ─────────────────────────────────────────────────────────────────────────────────────────────────────────


class Value:
    """A value as it was read.

    ``stamp_ns``: when it was published, by the clock of the server (nanoseconds since 1970). ``version`` grows with
    every value of a topic; ``origin`` names who published it; ``type`` is its ROS type, where it has one.
    ``mode`` says where it was read: ``remote``, ``local-server`` or ``local``. ``latest`` marks one that was there
    before the subscription.
    """

    __slots__ = ("_offset_ns", "data", "latest", "mode", "origin", "stamp_ns", "system", "topic", "type", "version")

    def __init__(
        self,
        system: str,
        topic: str,
        data: bytes,
        version: int,
        stamp_ns: int,
        origin: str = "",
        type: str = "",
        mode: str = "remote",
        latest: bool = False,
        offset_ns: int = 0,
    ) -> None:
        self.system, self.topic, self.data = system, topic, data
        self.version, self.stamp_ns, self.origin, self.type = version, stamp_ns, origin, type
        self.mode, self.latest = mode, latest
        self._offset_ns = offset_ns

    @property
    def text(self) -> str:
        """The data as text; bytes that are no UTF-8 are shown as question marks."""
        return self.data.decode(errors="replace")

    @property
    def floats(self) -> List[float]:
        """Comma-separated numbers. Raises ``ValueError``."""
        return [float(part) for part in self.text.split(",")]

    @property
    def json(self) -> Any:
        """The parsed JSON text. Raises ``ValueError``."""
        return json.loads(self.text)

    @property
    def age_s(self) -> float:
        """Seconds since it was published."""
        return max(time.time_ns() + self._offset_ns - self.stamp_ns, 0) / 1e9

    @property
    def order(self) -> Tuple[int, str]:
        """The greater one is the last."""
        return self.version, self.origin

    def __repr__(self) -> str:
        return "<Value {}/{} {!r} v={} {}>".format(self.system, self.topic, self.text[:40], self.version, self.mode)


Content = Union[str, bytes, int, float, Iterable[float], Mapping[str, Any]]
"""The values that can be published: text, bytes, a number, numbers (joined with commas), or an object (as JSON)."""


def text_of(content: Content) -> bytes:
    """Return the bytes that are published for a content."""
    if isinstance(content, bytes):
        return content
    if isinstance(content, str):
        return content.encode()
    if isinstance(content, Mapping):
        return json.dumps(content).encode()
    if isinstance(content, (int, float)):
        return repr(content).encode()
    return ",".join([repr(float(part)) for part in content]).encode()


class _Copy:
    """The node's own copy of what it published and read; ``SYSTEM/TOPIC.json`` under a directory, where one is given.

    ``unsent`` has what the server does not have yet, oldest first, ``depth`` values of each topic at most.
    """

    def __init__(self, directory: Optional[str], depth: int) -> None:
        self.directory = os.path.expanduser(directory) if directory else None
        self.depth = depth
        self.values: Dict[Tuple[str, str], Value] = {}
        self.unsent: "OrderedDict[Tuple[str, str], List[Value]]" = OrderedDict()
        self.fault = ""
        if self.directory is not None:
            os.makedirs(self.directory, exist_ok=True)
            self._load(self.directory)

    def publish(self, value: Value) -> None:
        """Keep a value that the node published and the server does not have yet."""
        key = (value.system, value.topic)
        self.values[key] = value
        waiting = self.unsent.setdefault(key, [])
        waiting.append(value)
        del waiting[: -self.depth]
        self.unsent.move_to_end(key)
        self._write(key)

    def learn(self, value: Value) -> None:
        """Keep a value that a server sent."""
        key = (value.system, value.topic)
        self.values[key] = value
        self._write(key)

    def settle(self, value: Value) -> None:
        """Note that the server has the value now, or will never take it."""
        key = (value.system, value.topic)
        waiting = self.unsent.get(key)
        if waiting is None or value not in waiting:
            return
        waiting.remove(value)
        if not waiting:
            del self.unsent[key]
        self._write(key)

    def everything(self) -> Iterable[Value]:
        """Return all values, those included that no server has yet."""
        yield from self.values.values()
        for waiting in self.unsent.values():
            yield from waiting

    def newest_unsent(self, key: Tuple[str, str]) -> Optional[Value]:
        """Return the last value that this node wrote and the server does not have."""
        waiting = self.unsent.get(key)
        return waiting[-1] if waiting else None

    def _load(self, directory: str) -> None:
        for root, _, names in os.walk(directory):
            for name in sorted(names):
                if not name.endswith(".json"):
                    continue
                try:
                    with open(os.path.join(root, name), encoding="utf-8") as file:
                        told = json.load(file)
                    value = _value_of(told, told["system"], told["topic"])
                    waiting = [_value_of(one, value.system, value.topic) for one in told.get("unsent", ())]
                except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
                    continue  # not ours, or half of one
                key = (value.system, value.topic)
                self.values[key] = value
                if waiting:
                    if waiting[-1].order == value.order:
                        waiting[-1] = value
                    self.unsent[key] = waiting

    def _write(self, key: Tuple[str, str]) -> None:
        value = self.values.get(key)
        if self.directory is None or value is None:
            return
        told: Dict[str, Any] = {"system": value.system, "topic": value.topic}
        told.update(_told(value), form="")
        if key in self.unsent:
            told["unsent"] = [_told(one) for one in self.unsent[key]]
        folder = os.path.join(self.directory, _file_name(value.system))
        path = os.path.join(folder, _file_name(value.topic) + ".json")
        try:
            os.makedirs(folder, exist_ok=True)
            with open(path + ".tmp", "w", encoding="utf-8") as file:
                json.dump(told, file)
            os.replace(path + ".tmp", path)
            self.fault = ""
        except OSError as error:  # a full disk: the value is still in memory
            self.fault = str(error)


def _told(value: Value) -> Dict[str, Any]:
    told: Dict[str, Any] = {}
    try:
        told["data"] = value.data.decode()
    except UnicodeDecodeError:
        told["base64"] = base64.b64encode(value.data).decode()
    told.update(type=value.type, version=value.version, stamp_ns=value.stamp_ns, origin=value.origin)
    return told


def _value_of(told: Mapping[str, Any], system: str, topic: str) -> Value:
    raw = told.get("base64")
    data = told["data"].encode() if raw is None else base64.b64decode(raw)
    return Value(
        system,
        topic,
        data,
        int(told["version"]),
        int(told["stamp_ns"]),
        told.get("origin", ""),
        told.get("type", ""),
        "local",
    )


def _file_name(name: str) -> str:
    encoded = quote(name, safe=" ()+,=@[]{}")
    if encoded.startswith("."):
        encoded = encoded.replace(".", "%2E")
    if len(encoded) > _LONGEST_FILE_NAME:
        digest = hashlib.sha256(name.encode()).hexdigest()
        return "{}~{}".format(encoded[:150], digest[:32])
    return encoded


class _Newest:
    """The newest thing of each topic that waits, bounded in number and in bytes; what waited for longest goes first."""

    def __init__(self) -> None:
        self._things: "OrderedDict[Tuple[str, str], Tuple[Any, int]]" = OrderedDict()
        self.bytes = 0

    def __len__(self) -> int:
        return len(self._things)

    def put(self, key: Tuple[str, str], thing: Any, size: int) -> List[Any]:
        """Have a thing wait, of a topic of which none does; return those that gave way for it."""
        self._things[key] = thing, size
        self.bytes += size
        gone = []
        while len(self._things) > 1 and (len(self._things) > _WAITING_LIMIT or self.bytes > _WAITING_BYTES):
            gone.append(self.next())
        return gone

    def pop(self, key: Tuple[str, str]) -> Any:
        """Take what waits of a topic, ``None`` where nothing does."""
        thing, size = self._things.pop(key, (None, 0))
        self.bytes -= size
        return thing

    def next(self) -> Any:
        """Take what has waited for longest."""
        _, (thing, size) = self._things.popitem(last=False)
        self.bytes -= size
        return thing

    def clear(self) -> List[Any]:
        """Let go of all; return it."""
        return [self.next() for _ in range(len(self._things))]


# ── the node ───────────────────────────────────────────────────────────────────────────────────────────────────────


class _Connection(asyncio.Protocol):
    """A connection to a server."""

    def __init__(self, node: "AsyncNode", url: str, mode: str, max_bytes: int) -> None:
        self.node, self.url, self.mode = node, url, mode
        self.parser = Parser(max_bytes)
        self.transport: Optional[asyncio.Transport] = None
        self.lost: "asyncio.Future[None]" = asyncio.get_event_loop().create_future()
        self.requests: Dict[str, "asyncio.Future[Packet]"] = {}
        self.last_heard = time.monotonic()
        self.paused = False
        self.number = 0
        self.max_bytes = 0  # of a packet, as the server told; 0 until then

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = transport  # type: ignore[assignment]
        assert self.transport is not None
        self.transport.set_write_buffer_limits(high=_HIGH_BYTES)

    def pause_writing(self) -> None:
        self.paused = True

    def resume_writing(self) -> None:
        self.paused = False
        self.node._drain(self)

    def data_received(self, data: bytes) -> None:
        self.last_heard = time.monotonic()
        for item in self.parser.feed(data):
            if isinstance(item, Packet):
                number = item.head.get("n")
                waiting = self.requests.pop(number, None) if number is not None else None
                if waiting is not None:
                    if not waiting.done():
                        waiting.set_result(item)
                elif item.op in ("+val", "+evt"):
                    self.node._pushed(self, item)
            else:
                self.node.faults += 1

    def connection_lost(self, exc: Optional[Exception]) -> None:
        for waiting in self.requests.values():
            if not waiting.done():
                waiting.set_exception(NodeError("lost", "the connection to {} was lost".format(self.url)))
                waiting.exception()  # whoever waits gets it; nobody else need hear of it
        self.requests.clear()
        if not self.lost.done():
            self.lost.set_result(None)

    def send(self, raw: bytes) -> None:
        if self.transport is not None and not self.transport.is_closing():
            self.transport.write(raw)

    def request(self, system: str, topic: str, op: str, head: Dict[str, object], data: bytes = b"") -> Any:
        """Send, and a future of the answer."""
        self.number += 1
        number = str(self.number)
        future: "asyncio.Future[Packet]" = asyncio.get_event_loop().create_future()
        if self.transport is None or self.transport.is_closing():
            future.set_exception(NodeError("lost", "the connection to {} was lost".format(self.url)))
            return future
        raw = pack(self.node.ident, system, topic, op, {"n": number, **head}, data)
        if self.max_bytes and len(raw) - 2 > self.max_bytes:  # it would be let go there, number and all
            text = "a packet of {} bytes; {} takes {} at most".format(len(raw), self.url, self.max_bytes)
            future.set_exception(NodeError("too-big", text))
            future.exception()  # whoever waits gets it; nobody else need hear of it
            return future
        self.requests[number] = future
        self.transport.write(raw)
        return future

    async def ask(
        self, system: str, topic: str, op: str, head: Dict[str, object], data: bytes = b"", timeout_s: float = 5.0
    ) -> Packet:
        """Send, and the answer. Raises ``NodeError``."""
        future = self.request(system, topic, op, head, data)
        try:
            answer: Packet = await asyncio.wait_for(future, timeout_s)
        except asyncio.TimeoutError:
            raise NodeError("timeout", "{} did not answer within {:g} s".format(self.url, timeout_s)) from None
        return _checked(answer)

    def close(self) -> None:
        if self.transport is not None:
            self.transport.close()


def _number(packet: Packet, key: str) -> int:
    """Return a whole number of up to 63 bits in the head of a packet; 0 if there is none. Raises ``NodeError``."""
    text = packet.head.get(key, "0")
    if not (text.isascii() and text.isdigit() and len(text) < 20 and int(text) < 1 << 63):
        raise NodeError("malformed", "{}={} is not a whole number of up to 63 bits".format(key, text[:40]))
    return int(text)


def _checked(answer: Packet) -> Packet:
    if answer.op == "+err":
        raise NodeError(answer.head.get("code", "refused"), answer.data.decode(errors="replace"))
    return answer


class _Subscription:
    __slots__ = ("callback", "head", "latest", "seen", "system", "topic")

    def __init__(
        self, system: str, topic: str, callback: Callable[[Value], Any], latest: bool, head: Mapping[str, object]
    ) -> None:
        self.system, self.topic, self.callback, self.latest, self.head = system, topic, callback, latest, head
        self.seen: Dict[Tuple[str, str], Tuple[int, str]] = {}


class AsyncNode:
    """A robot (or a program) with a name, that publishes and reads values; for asyncio. ``Node`` is without.

    ``system``: its name, and the system of topics where none is given. ``server``: ``iort://host:port`` (``iorts://``
    with TLS). ``local_server``: one on the robot's own network, used while the server is away. ``directory``: where
    its own copy is kept (``None``: in memory). ``offline_depth``: how many values of a topic that were written without
    the server are brought to it (the ones before the last become history there, where it keeps one). ``token``: shown to the servers. ``kind``: what
    it is, ``robot``, ``pc``, or empty for neither; ``ident``: its identifier, two digits, which plain nodes see. ``tls``: an ``ssl.SSLContext``, or the
    path of the authorities to trust. ``discover`` looks for a local server on the network while neither server can be
    reached (see ``LocalServer``); a text ``host:port`` asks only there. ``on_mode`` is called with ``remote``, ``local-server`` or ``local``.
    """

    def __init__(
        self,
        system: str,
        server: str,
        *,
        local_server: Optional[str] = None,
        directory: Optional[str] = None,
        offline_depth: int = 1,
        token: Optional[str] = None,
        tls: Union[None, str, ssl.SSLContext] = None,
        ident: str = "01",
        kind: str = "robot",
        discover: Union[bool, str] = False,
        max_packet_bytes: int = MAX_PACKET_BYTES,
        on_mode: Optional[Callable[[str], None]] = None,
        on_event: Optional[Callable[[Packet], None]] = None,
        clock_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self.system, self.server, self.local_server, self.ident = system, server, local_server, ident
        if kind and kind not in KINDS:
            raise NodeError("malformed", "a node is one of {}, not {!r}".format(", ".join(KINDS), kind))
        self.kind = kind
        self.origin = origin_of(ident, "{}.{}".format(system, os.urandom(4).hex()), kind)
        self.on_mode, self.on_event = on_mode, on_event
        self.last_error = ""
        self.faults = 0  # bytes and packets of servers that could not be read
        self.refused: Dict[str, int] = {}  # values that a server did not take, by the code of its reason
        self.superseded = 0  # values that a newer one of their topic replaced while the connection was slow
        self.note = ""  # what the server had to say about this node, such as a second one of its name
        self._token, self._tls = token, tls
        self._discover = discover
        self._max_bytes = max_packet_bytes
        self._clock_ns = clock_ns
        self._copy = _Copy(directory, max(offline_depth, 1))
        self._offset_ns = 0
        for value in self._copy.everything():
            value.version = self._possible(value.version)
        self._version = max([value.version for value in self._copy.values.values()] + [0])
        self._connection: Optional[_Connection] = None
        self._mode = "local"
        self._subscriptions: List[_Subscription] = []
        self._standing: Dict[Tuple[str, str, str], Dict[str, object]] = {}  # adverts and watches, told again
        self._waiting = _Newest()  # values, each with the future of who waits for it
        self._task: Optional["asyncio.Task[None]"] = None
        self._changed: Optional[asyncio.Event] = None
        self._closed = False

    # ── life ───────────────────────────────────────────────────────────────────────────────────────────────────

    @property
    def mode(self) -> str:
        """``remote`` (the server answers), ``local-server``, or ``local`` (neither does)."""
        return self._mode

    @property
    def pending(self) -> int:
        """The number of topics with a value that the server does not have yet."""
        return len(self._copy.unsent)

    async def open(self, wait_s: float = 0.0) -> "AsyncNode":
        """Begin to connect, and wait up to ``wait_s`` seconds for it; without a server everything is local."""
        if self._task is None:
            self._changed = asyncio.Event()
            self._task = asyncio.get_event_loop().create_task(self._keep_connected())
        if wait_s:
            await self.wait_mode("remote", wait_s)
        return self

    def renew(self, token: Optional[str], tls: Any, anew: bool = False) -> None:
        """Show another token, and use other TLS, from the next connection on; with ``anew`` that is made at once."""
        self._token, self._tls = token, tls
        if anew and self._connection is not None:
            self._connection.close()

    async def wait_mode(self, mode: str, timeout_s: float) -> bool:
        """Wait for a mode; false when the time is over."""
        deadline = time.monotonic() + timeout_s
        while self._mode != mode:
            left = deadline - time.monotonic()
            if left <= 0 or self._changed is None:
                return False
            changed = self._changed
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(changed.wait(), left)
        return True

    async def close(self) -> None:
        """Leave; what the server does not have yet is kept in the directory, where there is one."""
        self._closed = True
        task, self._task = self._task, None
        while task is not None and not task.done():
            task.cancel()  # again, because wait_for before Python 3.12 may swallow one
            await asyncio.wait([task], timeout=0.2)
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()
            await asyncio.wait([connection.lost], timeout=1.0)
        for _, future in self._waiting.clear():
            if future is not None and not future.done():
                future.set_exception(NodeError("closed", "the node was closed"))
                future.exception()

    async def __aenter__(self) -> "AsyncNode":
        return await self.open(_CONNECT_S)

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    # ── values ─────────────────────────────────────────────────────────────────────────────────────────────────

    async def publish(
        self, topic: str, content: Content, *, system: Optional[str] = None, type: str = "", timeout_s: float = 5.0
    ) -> Value:
        """Publish, and wait until a server keeps it; without one it is kept here, and merged later.

        The value that is returned says by its ``mode`` where it is. Raises ``NodeError`` if the server refuses it.
        """
        value = self._made(topic, content, system, type)
        connection = self._connection
        if connection is None:
            value.mode = "local"
            return value
        future = self._send(connection, value, wanted=True)
        try:
            answer = _checked(await asyncio.wait_for(future, timeout_s))
        except asyncio.TimeoutError:
            raise NodeError("timeout", "{} did not answer within {:g} s".format(connection.url, timeout_s)) from None
        except NodeError as error:
            if error.code == "lost":
                value.mode = "local"
                return value
            self._refused(value, error)
            raise
        if answer.op == "+ok":
            self._acknowledged(connection, value, answer)
        value.mode = connection.mode
        return value

    def publish_nowait(
        self,
        topic: str,
        content: Content,
        *,
        system: Optional[str] = None,
        type: str = "",
        stamp_ns: int = 0,
        origin: str = "",
    ) -> Value:
        """Publish without waiting. While the connection is slow a newer value of a topic replaces the one that waits.

        ``stamp_ns`` and ``origin`` are those of who published it first, where this node only passes it on.
        """
        value = self._made(topic, content, system, type, stamp_ns, origin)
        connection = self._connection
        if connection is not None:
            self._send(connection, value, wanted=False)
        return value

    def known(self, system: str, topic: str) -> Optional[Value]:
        """Return the node's own copy of a value."""
        return self._copy.values.get((system, topic))

    def all_known(self) -> List[Value]:
        """Return the node's own copies of all values, by their names."""
        return [value for _, value in sorted(self._copy.values.items())]

    def take(self, value: Value, merge: bool) -> Value:
        """Keep a value that another node wrote, and bring it to the server.

        Its version counts if it is later than the last one and, unless it is of a ``merge``, not far in the future.
        Raises ``NodeError``: ``stale`` for an older one of a merge, ``not-kept`` where the disk refuses it.
        """
        known = self.known(value.system, value.topic)
        now_ns = self._clock_ns() + self._offset_ns
        if merge and value.version:
            if value.version > latest_version(now_ns):
                raise NodeError("malformed", "version {} is too far in the future".format(value.version))
            if known is not None and known.order >= value.order:
                if known.order == value.order:
                    return known
                raise NodeError("stale", "version {} is there, which is later".format(known.version))
        else:
            last = known.version if known is not None else 0
            now_us = now_ns // 1000
            if not last < value.version <= now_us + _AHEAD_US:
                self._version = value.version = max(now_us, self._version + 1, last + 1)
        self._copy.publish(value)
        if self._copy.fault:
            raise NodeError("not-kept", "the value is served but not kept: " + self._copy.fault)
        if self._connection is not None:
            self._send(self._connection, value, wanted=False)
        return value

    async def read(self, topic: str, *, system: Optional[str] = None, timeout_s: float = 5.0) -> Value:
        """Return the last value; without a reachable server, the node's own copy.

        Raises ``NodeError``: ``unknown-system``, ``unknown-topic``, ``denied``, ``timeout``.
        """
        where = system or self.system
        connection = self._connection
        if connection is not None:
            try:
                answer = await connection.ask(where, topic, "+get", {}, timeout_s=timeout_s)
            except NodeError as error:
                own = self._copy.newest_unsent((where, topic))
                if error.code in ("unknown-system", "unknown-topic") and own is not None:
                    return own
                if error.code != "lost":
                    raise
            else:
                value = self._value(connection, answer)
                self._learned(value)
                return self._newest(value)
        known = self._copy.values.get((where, topic))
        if known is None:
            code = "unknown-topic" if any(key[0] == where for key in self._copy.values) else "unknown-system"
            raise NodeError(code, "no value of {}/{} is known here, and no server can be reached".format(where, topic))
        return Value(
            known.system,
            known.topic,
            known.data,
            known.version,
            known.stamp_ns,
            known.origin,
            known.type,
            "local",
            offset_ns=self._offset_ns,
        )

    async def subscribe(
        self,
        topic: str,
        callback: Callable[[Value], Any],
        *,
        system: Optional[str] = None,
        latest: bool = True,
        head: Optional[Mapping[str, object]] = None,
    ) -> Callable[[], Awaitable[None]]:
        """Call ``callback`` with every value that others publish; patterns such as ``*`` are allowed.

        ``latest`` begins with the value that is there. After a cut the newest value comes, once. Returns a function
        that ends it. Raises ``NodeError`` if the server refuses. ``head`` is told to the server besides.
        """
        subscription = _Subscription(system or self.system, topic, callback, latest, head or {})
        self._subscriptions.append(subscription)
        connection = self._connection
        if connection is not None:
            try:
                await self._subscribe(connection, subscription)
            except NodeError as error:
                if error.code != "lost":
                    self._subscriptions.remove(subscription)
                    raise

        async def end() -> None:
            if subscription not in self._subscriptions:
                return
            self._subscriptions.remove(subscription)
            name = (subscription.system, subscription.topic)
            connection = self._connection
            if connection is not None and all((s.system, s.topic) != name for s in self._subscriptions):
                with contextlib.suppress(NodeError):
                    await connection.ask(name[0], name[1], "+unsub", {})

        return end

    async def list(self, pattern_system: str = "*", pattern_topic: str = "*") -> List[Dict[str, Any]]:
        """Return the last values whose names match, as JSON objects. Raises ``NodeError``."""
        answer = await self.request(pattern_system, pattern_topic, "+list", {})
        try:
            found: List[Dict[str, Any]] = json.loads(answer.data.decode())
        except (ValueError, RecursionError):
            raise NodeError("malformed", "the server's list is not JSON") from None
        return found

    async def request(
        self, system: str, topic: str, op: str, head: Dict[str, object], timeout_s: float = 5.0
    ) -> Packet:
        """Send any request of the protocol, and return its answer. Raises ``NodeError``."""
        connection = self._connection
        if connection is None:
            raise NodeError("lost", self.last_error or "no server can be reached")
        return await connection.ask(system, topic, op, head, timeout_s=timeout_s)

    async def stand(self, system: str, topic: str, op: str, head: Optional[Dict[str, object]]) -> None:
        """Tell every server this again after a reconnect (``+adv``, ``+watch``); with ``None``, no longer."""
        key = (system, topic, op)
        if head is None:
            self._standing.pop(key, None)
            return
        self._standing[key] = head
        if self._connection is not None:
            try:
                await self._connection.ask(system, topic, op, head)
            except NodeError as error:
                if error.code != "lost":
                    self._standing.pop(key, None)
                    raise

    # ── inside ─────────────────────────────────────────────────────────────────────────────────────────────────

    def _made(
        self,
        topic: str,
        content: Content,
        system: Optional[str],
        type: str,
        stamp_ns: int = 0,
        origin: str = "",
    ) -> Value:
        key = (system or self.system, topic)
        for name in key:
            if not name or not name.isprintable() or len(name.encode()) > 200:
                raise NodeError("name", "a system and a topic have a name of up to 200 bytes that can be printed")
        known = self._copy.values.get(key)
        now_ns = self._clock_ns() + self._offset_ns
        self._version = max(now_ns // 1000, self._version + 1, known.version + 1 if known is not None else 0)
        value = Value(
            key[0],
            topic,
            text_of(content),
            self._version,
            stamp_ns or now_ns,
            origin or self.origin,
            type,
            "local",
            offset_ns=self._offset_ns,
        )
        self._copy.publish(value)
        return value

    def _send(self, connection: _Connection, value: Value, wanted: bool, merge: bool = False) -> Any:
        key = (value.system, value.topic)
        if connection.paused and not merge:
            future = asyncio.get_event_loop().create_future() if wanted else None
            before = self._waiting.pop(key)
            if before is not None:
                self.superseded += 1
                self._copy.settle(before[0])
                if before[1] is not None and not before[1].done():
                    before[1].set_result(Packet("00", key[0], key[1], "+superseded"))
            for _, oldest in self._waiting.put(key, (value, future), len(value.data)):
                self.superseded += 1
                if oldest is not None and not oldest.done():
                    oldest.set_exception(NodeError("busy", "the connection is too slow for so many topics"))
            return future
        head: Dict[str, object] = {"t": value.stamp_ns, "v": value.version, "o": value.origin}
        if value.type:
            head["k"] = value.type
        if merge:
            head["m"] = 1
        future = connection.request(value.system, value.topic, "+pub", head, value.data)
        if not wanted:
            future.add_done_callback(lambda done: self._acknowledge(connection, value, done))
        return future

    def _acknowledge(self, connection: _Connection, value: Value, done: Any) -> None:
        if done.cancelled():
            return
        error = done.exception()
        if error is not None:
            if error.code != "lost":  # else the value is brought to the server later
                self._refused(value, error)
            return
        answer = done.result()
        if answer.op == "+err":
            self._refused(value, NodeError(answer.head.get("code", ""), answer.data.decode(errors="replace")))
        else:
            self._acknowledged(connection, value, answer)

    def _acknowledged(self, connection: _Connection, value: Value, answer: Packet) -> None:
        try:
            version = self._possible(_number(answer, "v"))
        except NodeError:
            self.faults += 1
            version = 0
        if version:
            value.version = version
            self._version = max(self._version, version)
        if connection.mode == "remote":
            self._copy.settle(value)

    def _refused(self, value: Value, error: NodeError) -> None:
        """Drop a value that the server refuses, unless it was only not kept (yet)."""
        self.last_error = str(error)
        self.refused[error.code] = self.refused.get(error.code, 0) + 1
        if error.code not in ("not-kept", "timeout"):
            self._copy.settle(value)

    def _drain(self, connection: _Connection) -> None:
        while self._waiting and not connection.paused:
            value, future = self._waiting.next()
            sent = self._send(connection, value, wanted=True)
            if future is None:
                sent.add_done_callback(lambda done, value=value: self._acknowledge(connection, value, done))
            else:
                sent.add_done_callback(lambda done, future=future: _pass_on(done, future))

    def _value(self, connection: _Connection, packet: Packet) -> Value:
        head = packet.head
        return Value(
            packet.system,
            packet.topic,
            packet.data,
            self._possible(_number(packet, "v")),
            _number(packet, "t"),
            head.get("o", ""),
            head.get("k", ""),
            connection.mode,
            head.get("last") == "1",
            self._offset_ns,
        )

    def _possible(self, version: int) -> int:
        """Return a version, or now for one that nobody can have written yet: those that follow must outrank it."""
        now_ns = self._clock_ns() + self._offset_ns
        return version if version <= latest_version(now_ns) else now_ns // 1000

    def _learned(self, value: Value) -> None:
        key = (value.system, value.topic)
        known = self._copy.values.get(key)
        if known is None or known.order < value.order:
            self._copy.learn(value)

    def _newest(self, value: Value) -> Value:
        """Return a server's value, unless this node wrote something later that the server does not have yet."""
        own = self._copy.newest_unsent((value.system, value.topic))
        return own if own is not None and own.order > value.order else value

    def _pushed(self, connection: _Connection, packet: Packet) -> None:
        if packet.op == "+evt":
            if self.on_event is not None:
                self.on_event(packet)
            return
        try:
            value = self._value(connection, packet)
        except NodeError:
            self.faults += 1
            return
        self._learned(value)
        key = (value.system, value.topic)
        for subscription in list(self._subscriptions):
            if not (_fits(key[0], subscription.system) and _fits(key[1], subscription.topic)):
                continue
            if value.latest and not subscription.latest and key not in subscription.seen:
                continue
            if subscription.seen.get(key, (-1, "")) >= value.order:
                continue
            subscription.seen[key] = value.order
            try:
                result = subscription.callback(value)
            except Exception as error:  # the callback is somebody else's
                self.last_error = "a callback for {}/{} failed: {!r}".format(key[0], key[1], error)
                asyncio.get_event_loop().call_exception_handler({"message": self.last_error, "exception": error})
                continue
            if asyncio.iscoroutine(result):
                self._spawn(result)

    def _spawn(self, work: Any) -> None:
        task = asyncio.get_event_loop().create_task(work)
        _running.add(task)
        task.add_done_callback(self._spawned)

    def _spawned(self, task: "asyncio.Task[Any]") -> None:
        _running.discard(task)
        error = None if task.cancelled() else task.exception()
        if error is not None:
            self.last_error = "work of a callback failed: {!r}".format(error)
            asyncio.get_event_loop().call_exception_handler({"message": self.last_error, "exception": error})

    async def _subscribe(self, connection: _Connection, subscription: _Subscription) -> None:
        # after a cut the newest is asked for, whatever was asked first: nothing of the meantime is missed
        again = bool(subscription.seen)
        head: Dict[str, object] = {"last": 1 if subscription.latest or again else 0, **subscription.head}
        await connection.ask(subscription.system, subscription.topic, "+sub", head)

    def _set_mode(self, mode: str) -> None:
        if mode == self._mode:
            return
        self._mode = mode
        changed, self._changed = self._changed, asyncio.Event()
        if changed is not None:
            changed.set()
        if self.on_mode is not None:
            try:
                self.on_mode(mode)
            except Exception as error:  # the callback is somebody else's
                self.last_error = "a callback for the mode failed: {!r}".format(error)
                asyncio.get_event_loop().call_exception_handler({"message": self.last_error, "exception": error})

    async def _keep_connected(self) -> None:
        while not self._closed:
            try:
                await self._connect_again_and_again()
            except Exception as error:  # whatever a server or a callback does, the node goes on
                self.last_error = "the connection failed: {!r}".format(error)
                asyncio.get_event_loop().call_exception_handler({"message": self.last_error, "exception": error})
                if self._connection is not None:
                    self._connection.close()
                    self._connection = None
                await asyncio.sleep(_PAUSE_S[1])

    async def _connect_again_and_again(self) -> None:
        pause = _PAUSE_S[0]
        while not self._closed:
            connection = await self._dial(self.server, "remote")
            if connection is None and self.local_server is not None:
                connection = await self._dial(self.local_server, "local-server")
            if connection is None and self._discover:
                for url in await _search(self._discover, self._token):
                    connection = await self._dial(url, "local-server")
                    if connection is not None:
                        break
            if connection is None:
                self._set_mode("local")
                await asyncio.sleep(pause)
                pause = min(2 * pause, _PAUSE_S[1])
                continue
            pause = _PAUSE_S[0]
            while connection is not None:
                connection = await self._live(connection)

    async def _live(self, connection: _Connection) -> Optional[_Connection]:
        """Stay with a connection until it is lost; the one to the server, if that came back meanwhile."""
        self._connection = connection
        self._set_mode(connection.mode)
        try:
            await self._take_up(connection)
            while not connection.lost.done():
                await asyncio.wait([connection.lost], timeout=_PING_S)
                if connection.lost.done():
                    break
                if time.monotonic() - connection.last_heard > _SILENCE_S:
                    self.last_error = "{} has been silent for {:g} s".format(connection.url, _SILENCE_S)
                    break
                if connection.transport is not None:
                    connection.send(pack(self.ident, "-", "-", "+ping"))
                if connection.mode != "remote":
                    better = await self._dial(self.server, "remote")
                    if better is not None:
                        return better
        finally:
            if self._connection is connection:
                self._connection = None
            if connection.transport is not None:
                connection.transport.abort()
        if not self._closed and self._mode == connection.mode:
            self._set_mode("local")
        return None

    async def _dial(self, url: str, mode: str) -> Optional[_Connection]:
        try:
            parts = urlsplit(url)
            if parts.scheme not in ("iort", "iorts") or not parts.hostname:
                raise NodeError("malformed", "{!r} is not an address; write iort://host:7410".format(url))
            connection = _Connection(self, url, mode, self._max_bytes + 4096)
            loop = asyncio.get_event_loop()
            await asyncio.wait_for(
                loop.create_connection(
                    lambda: connection, parts.hostname, parts.port or DEFAULT_PORT, ssl=self._context(parts.scheme)
                ),
                _CONNECT_S,
            )
        except asyncio.TimeoutError:
            self.last_error = "{} did not answer within {:g} s".format(url, _CONNECT_S)
            return None
        except (OSError, NodeError) as error:
            self.last_error = "{}: {}".format(url, error)
            return None
        head: Dict[str, object] = {"v": 1, "o": self.origin}
        if self.kind:
            head["kind"] = self.kind
        if self._token is not None:
            head["token"] = self._token
        before = time.time_ns()
        try:
            answer = await connection.ask(self.system, "-", "+hello", head, timeout_s=_CONNECT_S)
            if answer.op != "+ok":
                raise NodeError("malformed", "the peer that answers there is not a server of nodes")
            now = _number(answer, "t")
            if now:
                self._offset_ns = now - (before + time.time_ns()) // 2
            self.note = answer.data.decode(errors="replace")
            connection.max_bytes = _number(answer, "max")
        except NodeError as error:
            self.last_error = "{}: {}".format(url, error)
            connection.close()
            return None
        return connection

    def _context(self, scheme: str) -> Optional[ssl.SSLContext]:
        if scheme == "iort":
            return None
        if isinstance(self._tls, ssl.SSLContext):
            return self._tls
        context = ssl.create_default_context(cafile=self._tls)
        if self._tls:  # Python 3.13 demands more of certificates than authorities of one's own put in
            context.verify_flags &= ~ssl.VERIFY_X509_STRICT
        return context

    async def _take_up(self, connection: _Connection) -> None:
        """Tell a server that was reached what stands, what is subscribed, and what it does not have yet."""
        try:
            for (system, topic, op), head in list(self._standing.items()):
                await connection.ask(system, topic, op, head)
            for subscription in list(self._subscriptions):
                try:
                    await self._subscribe(connection, subscription)
                except NodeError as error:
                    if error.code in ("lost", "timeout"):
                        raise
                    self.last_error = str(error)
            waiting = [(key, value) for key, values in self._copy.unsent.items() for value in values]
            for start in range(0, len(waiting), 64):
                group = waiting[start : start + 64]
                sent = [(key, value, self._send(connection, value, True, merge=True)) for key, value in group]
                for key, value, future in sent:
                    try:
                        answer = _checked(await asyncio.wait_for(future, 10.0))
                    except NodeError as error:
                        if error.code == "lost":
                            raise
                        self._refused(value, error)
                        if error.code == "stale":
                            self._learned(self._value(connection, await connection.ask(key[0], key[1], "+get", {})))
                    else:
                        self._acknowledged(connection, value, answer)
        except (NodeError, asyncio.TimeoutError) as error:
            self.last_error = "{}: {}".format(connection.url, error)
            connection.close()


_running: "set[asyncio.Task[Any]]" = set()


def _pass_on(done: Any, future: Any) -> None:
    if future.done():
        return
    if done.cancelled():
        future.cancel()
    elif done.exception() is not None:
        future.set_exception(done.exception())
    else:
        future.set_result(done.result())


def _fits(name: str, pattern: str) -> bool:
    if pattern in ("*", name):
        return True
    if "*" not in pattern and "?" not in pattern and "[" not in pattern:
        return False
    from fnmatch import fnmatchcase

    return fnmatchcase(name, pattern)


# ── finding a local server ─────────────────────────────────────────────────────────────────────────────────────────


def _proof(token: Optional[str], *parts: str) -> str:
    """Prove that the token of the fleet is known, without telling it; an empty text where there is none."""
    return "" if token is None else hmac.new(token.encode(), "\n".join(parts).encode(), hashlib.sha256).hexdigest()


class _Searcher(asyncio.DatagramProtocol):
    """Asks who serves, and collects the answers of servers that know the token, where this node has one."""

    def __init__(self, token: Optional[str]) -> None:
        self.token, self.nonce = token, os.urandom(16).hex()
        self.found: Dict[str, str] = {}  # names by URL

    def question(self) -> bytes:
        proof = _proof(self.token, "who serves", self.nonce)
        return json.dumps({"iort": 1, "nonce": self.nonce, "proof": proof}).encode()

    def datagram_received(self, data: bytes, addr: Tuple[Any, ...]) -> None:
        told = _datagram(data)
        port, name = told.get("port"), told.get("name")
        if (
            told.get("nonce") != self.nonce
            or type(port) is not int
            or not 0 < port < 65536
            or not isinstance(name, str)
        ):
            return
        proof = _proof(self.token, "I serve", self.nonce, str(addr[0]), str(port), name)
        if hmac.compare_digest(proof.encode(), str(told.get("proof", "")).encode()) and len(self.found) < _ANSWERS:
            self.found["iort://{}:{}".format(addr[0], port)] = name

    def error_received(self, exc: Exception) -> None:
        """Ignore the error: nobody is there."""


class _Answerer(asyncio.DatagramProtocol):
    """Answers who asks for a server, and knows the token where the server has one."""

    def __init__(self, name: str, port: int, token: Optional[str]) -> None:
        self.name, self.port, self.token = name, port, token
        self.transport: Any = None
        self._second, self._answered = 0.0, 0

    def connection_made(self, transport: Any) -> None:
        self.transport = transport

    def datagram_received(self, data: bytes, addr: Tuple[Any, ...]) -> None:
        told = _datagram(data)
        nonce, proof = told.get("nonce"), _proof(self.token, "who serves", str(told.get("nonce")))
        if told.get("iort") != 1 or not isinstance(nonce, str) or len(nonce) > 64:
            return
        if self.token is not None and not hmac.compare_digest(proof.encode(), str(told.get("proof", "")).encode()):
            return
        now = time.monotonic()
        if now - self._second > 1.0:
            self._second, self._answered = now, 0
        self._answered += 1
        if self._answered <= _ANSWERS_PER_S:
            proof = _proof(self.token, "I serve", nonce, _own_address(str(addr[0])), str(self.port), self.name)
            answer = {"nonce": nonce, "port": self.port, "name": self.name, "proof": proof}
            self.transport.sendto(json.dumps(answer).encode(), addr)


def _own_address(toward: str) -> str:
    """Return the address of this machine that another one sees; whoever passes an answer on has another."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        try:
            sock.connect((toward, DISCOVERY_PORT))
        except OSError:
            return ""
        return str(sock.getsockname()[0])


def _datagram(data: bytes) -> Dict[str, Any]:
    """Return what a datagram says, nothing for what is none of ours."""
    try:
        told = json.loads(data.decode()) if len(data) <= _DATAGRAM_BYTES else None
    except (ValueError, RecursionError):
        return {}
    return told if isinstance(told, dict) else {}


async def _search(where: Union[bool, str], token: Optional[str]) -> List[str]:
    """Return the addresses of local servers, in an order that is the same for all nodes."""
    searcher = _Searcher(token)
    if isinstance(where, str):
        host, _, port = where.rpartition(":")
        targets = [(host, int(port))]
    else:
        targets = [(host, DISCOVERY_PORT) for host in (_GROUP, "255.255.255.255", "127.0.0.1")]
    loop = asyncio.get_event_loop()
    try:
        transport, _ = await loop.create_datagram_endpoint(
            lambda: searcher,
            local_addr=("0.0.0.0", 0),  # noqa: S104 - it asks on every network, and hears answers only
            allow_broadcast=True,
        )
    except OSError:  # there is no network at all
        return []
    try:
        for target in targets:
            with contextlib.suppress(OSError):
                transport.sendto(searcher.question(), target)
        if not isinstance(where, str):
            _ask_everywhere(transport, searcher.question())
        await asyncio.sleep(_ASKED_S)
    finally:
        transport.close()
    return [url for name, url in sorted((name, url) for url, name in searcher.found.items())]


def _ask_everywhere(transport: Any, question: bytes) -> None:
    """Ask on each interface by itself: without a default route, as on a robot's own network, nothing else goes out."""
    sock = transport.get_extra_info("socket")
    for index, broadcast in _interfaces(sock):
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, bytes(8) + struct.pack("@i", index))
            transport.sendto(question, (_GROUP, DISCOVERY_PORT))
        if broadcast != "0.0.0.0":  # noqa: S104 - which stands for none
            with contextlib.suppress(OSError):
                transport.sendto(question, (broadcast, DISCOVERY_PORT))


def _interfaces(sock: Any) -> List[Tuple[int, str]]:
    """Return index and broadcast address of each interface with an IPv4 address, where the system is Linux."""
    if not sys.platform.startswith("linux"):
        return []
    import fcntl

    found = []
    for index, name in socket.if_nameindex():
        with contextlib.suppress(OSError):  # it has no address
            told = fcntl.ioctl(sock.fileno(), _SIOCGIFBRDADDR, struct.pack("256s", name.encode()[:15]))
            found.append((index, socket.inet_ntoa(told[20:24])))
    return found


# ── the local server ───────────────────────────────────────────────────────────────────────────────────────────────


class _Served(asyncio.Protocol):
    """A node at a local server."""

    def __init__(self, server: "LocalServer") -> None:
        self.server = server
        self.allowed = server.token is None
        self.parser = Parser(server.max_packet_bytes if self.allowed else _STRANGERS_BYTES)
        self.transport: Any = None
        self.peer, self.origin, self.kind = "", "", ""
        self.upgraded = False
        self.subscriptions: Dict[Tuple[str, str], Callable[[], Awaitable[None]]] = {}
        self.waiting = _Newest()  # packets with values
        self.items: Deque[Union[Packet, Fault]] = deque()
        self.busy = self.paused = False
        self.heard = False
        self.login: Optional[asyncio.TimerHandle] = None  # who has not said who it is by then has to leave

    def connection_made(self, transport: Any) -> None:
        self.transport = transport
        transport.set_write_buffer_limits(high=_HIGH_BYTES)
        self.peer = "{}:{}".format(*(transport.get_extra_info("peername") or ("?", 0))[:2])
        if len(self.server.nodes) >= _SERVED_NODES:
            transport.close()
            return
        self.server.nodes.append(self)
        if not self.allowed:
            self.login = asyncio.get_event_loop().call_later(_LOGIN_S, transport.close)

    def connection_lost(self, exc: Optional[Exception]) -> None:
        self.items.clear()
        self.waiting.clear()
        if self.login is not None:
            self.login.cancel()
        if self in self.server.nodes:
            self.server.nodes.remove(self)
        for end in self.subscriptions.values():
            self.server.spawn(end())
        self.subscriptions.clear()

    def pause_writing(self) -> None:
        self.paused = True
        self.transport.pause_reading()

    def resume_writing(self) -> None:
        self.paused = False
        while self.waiting and not self.paused:
            self.transport.write(self.waiting.next())
        self.go_on()

    def data_received(self, data: bytes) -> None:
        if not self.heard and is_http(data):
            self.server.faults += 1
            self.transport.write(NOT_HTTP)
            self.transport.close()
            return
        self.heard = True
        self.items += self.parser.feed(data)
        self.go_on()

    def go_on(self) -> None:
        """Handle what came, one after the other; while one of them waits for the cloud, no more is read."""
        while self.items and not self.busy and not self.paused:
            item = self.items.popleft()
            if isinstance(item, Packet):
                work = self._handle(item)
                if work is not None:
                    self.busy = True
                    self.server.spawn(self._finish(item, work))
            else:
                self.server.faults += 1
                if self.upgraded:
                    self._send("-", "-", "+err", {"code": item.code}, item.text.encode())
        if self.busy:
            self.transport.pause_reading()
        elif not self.paused:
            self.transport.resume_reading()

    async def _finish(self, packet: Packet, work: Awaitable[None]) -> None:
        try:
            await work
        except NodeError as error:
            self._refuse(packet, error)
        finally:
            self.busy = False
            if not self.transport.is_closing():
                self.go_on()

    def _handle(self, packet: Packet) -> Optional[Awaitable[None]]:
        op = packet.op
        if op[0] == "+":
            self.upgraded = True
        try:
            if op == "d" or op == "+bye":
                self._ok(packet)
                self.items.clear()
                self.transport.close()
            elif op == "+hello":
                self._hello(packet)
            elif op == "+ping":
                self._ok(packet, t=time.time_ns())
            elif not self.allowed:
                raise NodeError("login", "who are you? +hello with the token of the fleet is needed here")
            elif op in ("p", "+pub"):
                self._publish(packet)
            elif op in ("s", "+get"):
                return self._read(packet)
            elif op == "+sub":
                return self._subscribe(packet)
            elif op == "+unsub":
                end = self.subscriptions.pop((packet.system, packet.topic), None)
                if end is not None:
                    self.server.spawn(end())
                self._ok(packet)
            elif op == "+list":
                self._list(packet)
            elif op in ("+adv", "+unadv", "+watch"):
                self._ok(packet)  # who publishes what is not told here
            else:
                raise NodeError("malformed", "{} is not known here".format(op[:20]))
        except NodeError as error:
            self._refuse(packet, error)
        return None

    def push(self, value: Value) -> None:
        """Send a value that was subscribed to; while the node reads slowly, the newest of each topic waits."""
        raw = pack("00", value.system, value.topic, "+val", _head(value), value.data)
        if not self.paused:
            self._write(raw)
            return
        key = (value.system, value.topic)
        self.waiting.pop(key)
        self.server.superseded += len(self.waiting.put(key, raw, len(raw)))

    def _write(self, raw: bytes) -> None:
        if not self.transport.is_closing():
            self.transport.write(raw)

    def _send(self, system: str, topic: str, op: str, head: Dict[str, object], data: bytes = b"") -> None:
        self._write(pack("00", system, topic, op, head, data))

    def _ok(self, packet: Packet, **head: object) -> None:
        if "n" in packet.head:
            self._send("-", "-", "+ok", {"n": packet.head["n"], **head})

    def _refuse(self, packet: Packet, error: NodeError) -> None:
        self.server.refused[error.code] = self.server.refused.get(error.code, 0) + 1
        text = error.text.replace("%", "").encode()
        if packet.op == "s":
            self._write(pack("00", packet.system, packet.topic, "e", None, text, packet.system_type))
        elif self.upgraded:
            head = {"n": packet.head["n"]} if "n" in packet.head else {}
            self._send("-", "-", "+err", {**head, "code": error.code}, text)

    def _hello(self, packet: Packet) -> None:
        token = self.server.token
        if token is not None and not hmac.compare_digest(packet.head.get("token", "").encode(), token.encode()):
            self._refuse(packet, NodeError("login", "the token of the fleet is needed here"))
            self.transport.close()
            return
        self.allowed = True
        self.parser.max_bytes = self.server.max_packet_bytes
        if self.login is not None:
            self.login.cancel()
        kind = packet.head.get("kind", "")
        self.kind = kind if kind in KINDS else ""
        self.origin = packet.head.get("o", "")[:200]
        self._ok(packet, t=time.time_ns(), max=self.server.max_packet_bytes)

    def _publish(self, packet: Packet) -> None:
        origin = packet.head.get("o", "")[:200] or self.origin or origin_of(packet.id, self.peer, self.kind)
        version, stamp_ns = _number(packet, "v"), _number(packet, "t") or time.time_ns()
        value = Value(
            packet.system, packet.topic, packet.data, version, stamp_ns, origin, packet.head.get("k", "")[:200], "local"
        )
        kept = self.server.publish(value, packet.head.get("m") == "1", self)
        self._ok(packet, v=kept.version)

    async def _read(self, packet: Packet) -> None:
        value = await self.server.read(packet.system, packet.topic)
        if packet.op == "+get":
            if "n" in packet.head:
                head = {"n": packet.head["n"], **_head(value)}
                self._send(value.system, value.topic, "+val", head, value.data)
            return
        id = identifier_of(value.origin)
        try:
            self._write(pack(id, packet.system, packet.topic, "p", None, value.data, packet.system_type))
        except ValueError as error:
            raise NodeError("conversion", str(error)) from None

    async def _subscribe(self, packet: Packet) -> None:
        key = (packet.system, packet.topic)
        if key not in self.subscriptions:
            if len(self.subscriptions) >= _SERVED_SUBSCRIPTIONS:
                raise NodeError("full", "a node has {} subscriptions at most".format(_SERVED_SUBSCRIPTIONS))
            self.subscriptions[key] = await self.server.follow(key, self)
        self._ok(packet)
        if packet.head.get("last", "1") == "1":
            for value in self.server.values(*key):
                raw = pack("00", value.system, value.topic, "+val", {**_head(value), "last": 1}, value.data)
                self._write(raw)

    def _list(self, packet: Packet) -> None:
        found = [
            {"system": value.system, "topic": value.topic, **_told(value), "kind": kind_of(value.origin)}
            for value in self.server.values(packet.system, packet.topic)
        ]
        if "n" in packet.head:
            self._send("-", "-", "+val", {"n": packet.head["n"]}, json.dumps(found).encode())


def _head(value: Value) -> Dict[str, object]:
    head: Dict[str, object] = {"t": value.stamp_ns, "v": value.version, "o": value.origin}
    if value.type:
        head["k"] = value.type
    return head


class LocalServer:
    """The server of nodes on one network, on any machine of it: it keeps values, and brings them to the cloud.

    ``cloud`` is the server whose place it takes while that is away (``None``: none). ``directory``: where values are
    kept over restarts. ``token``: of the fleet; nodes show it, plain ones cannot and are refused, and the cloud gets
    it. Beyond loopback a token or ``insecure`` is needed. ``announce`` lets nodes with ``discover`` find it, at UDP
    port ``discovery_port``. ``offline_depth`` values of each topic are brought to the cloud.
    """

    def __init__(
        self,
        name: str,
        *,
        cloud: Optional[str] = None,
        directory: Optional[str] = None,
        token: Optional[str] = None,
        tls: Union[None, str, ssl.SSLContext] = None,
        insecure: bool = False,
        announce: bool = False,
        discovery_port: int = DISCOVERY_PORT,
        offline_depth: int = 1,
        max_packet_bytes: int = MAX_PACKET_BYTES,
    ) -> None:
        self.name, self.cloud, self.token, self.insecure = name, cloud, token, insecure
        self.announce, self.discovery_port, self.max_packet_bytes = announce, discovery_port, max_packet_bytes
        self.nodes: List[_Served] = []
        self.faults = self.superseded = 0
        self.refused: Dict[str, int] = {}
        self.node = AsyncNode(
            name,
            cloud or "",
            directory=directory,
            offline_depth=offline_depth,
            token=token,
            tls=tls,
            kind="",
            max_packet_bytes=max_packet_bytes,
        )
        self._bytes = sum(len(value.data) for value in self.node.all_known())
        self._server: Any = None
        self._answerer: Any = None

    async def listen(self, host: str = "127.0.0.1", port: int = DEFAULT_PORT) -> int:
        """Listen for nodes, and return the port. Raises ``NodeError`` where that cannot be, or is not safe."""
        if self.token is None and not self.insecure and not (host == "localhost" or host.startswith("127.")):
            raise NodeError("login", "beyond loopback the token of the fleet is needed, or insecure")
        loop = asyncio.get_event_loop()
        try:
            self._server = await loop.create_server(lambda: _Served(self), host, port)
            port = self._server.sockets[0].getsockname()[1]
            if self.announce:
                sock = _discovery_socket(self.discovery_port)
                answerer = _Answerer(self.name, port, self.token)
                self._answerer, _ = await loop.create_datagram_endpoint(lambda: answerer, sock=sock)
        except OSError as error:
            await self.close()
            raise NodeError("busy", "{}:{} cannot be listened on: {}".format(host, port, error)) from None
        if self.cloud is not None:
            await self.node.open()
        return port

    async def close(self) -> None:
        """Stop; what the cloud does not have yet stays in the directory."""
        if self._answerer is not None:
            self._answerer.close()
        if self._server is not None:
            self._server.close()
        for node in list(self.nodes):
            node.transport.close()
        await self.node.close()

    # ── what nodes ask for ─────────────────────────────────────────────────────────────────────────────────────

    def publish(self, value: Value, merge: bool, sender: Optional[_Served]) -> Value:
        """Keep a value of a node, and tell the others. Raises ``NodeError``."""
        for name in (value.system, value.topic):
            if not name.isprintable() or len(name.encode()) > 200:
                raise NodeError("name", "a system and a topic have a name of up to 200 bytes that can be printed")
        before = self.node.known(value.system, value.topic)
        grown = len(value.data) - (len(before.data) if before is not None else 0)
        if before is None and len(self.node._copy.values) >= _SERVED_VALUES:
            raise NodeError("full", "{} values are kept here, and no more".format(_SERVED_VALUES))
        if self._bytes + grown > _SERVED_BYTES:
            raise NodeError("full", "all values together have {} bytes at most".format(_SERVED_BYTES))
        kept = self.node.take(value, merge)
        if kept is value:
            self._bytes += grown
            self._tell(value, sender)
        return kept

    async def read(self, system: str, topic: str) -> Value:
        """Return the last value; what is not here is asked for in the cloud. Raises ``NodeError``."""
        known = self.node.known(system, topic)
        return known if known is not None else await self.node.read(topic, system=system)

    def values(self, system: str, topic: str) -> List[Value]:
        """Return the values whose names fit."""
        return [v for v in self.node.all_known() if _fits(v.system, system) and _fits(v.topic, topic)]

    async def follow(self, key: Tuple[str, str], reader: _Served) -> Callable[[], Awaitable[None]]:
        """Send a node what the cloud says on a topic, too; returns what ends it. Raises ``NodeError``."""
        return await self.node.subscribe(key[1], reader.push, system=key[0], latest=False)

    def _tell(self, value: Value, sender: Optional[_Served]) -> None:
        for node in self.nodes:
            if node is not sender and any(
                _fits(value.system, system) and _fits(value.topic, topic) for system, topic in node.subscriptions
            ):
                node.push(value)

    def spawn(self, work: Awaitable[None]) -> None:
        """Run something for a node."""
        self.node._spawn(work)


def _discovery_socket(port: int) -> socket.socket:
    """Return a socket that hears who looks for a server, by multicast, broadcast or directly."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind(("", port))
        for index in [0] + [index for index, _ in _interfaces(sock)]:  # 0: that of the default route
            with contextlib.suppress(OSError):  # a machine without multicast is found by broadcast
                group = socket.inet_aton(_GROUP) + bytes(4) + (struct.pack("@i", index) if index else b"")
                sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
        sock.setblocking(False)
    except OSError:
        sock.close()
        raise
    return sock


# ── without asyncio ────────────────────────────────────────────────────────────────────────────────────────────────

T = TypeVar("T")


class Node:
    """``AsyncNode`` for programs without asyncio: it lives in a thread of its own. Arguments are those of ``AsyncNode``.

    Callbacks of subscriptions run in that thread, one after the other: keep them short.
    """

    def __init__(self, system: str, server: str, **options: Any) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="iort {}".format(system), daemon=True)
        self._thread.start()

        async def make() -> AsyncNode:
            return AsyncNode(system, server, **options)

        try:
            self._node = self._run(make(), 5.0)
        except BaseException:
            self._stop()
            raise
        self._open = True
        self._run(self._node.open(), 5.0)

    @property
    def mode(self) -> str:
        """``remote`` (the server answers), ``local-server``, or ``local`` (neither does)."""
        return self._node.mode

    @property
    def pending(self) -> int:
        """The number of topics with a value that the server does not have yet."""
        return self._node.pending

    @property
    def last_error(self) -> str:
        """The reason why the server is not reached, or what it refused last."""
        return self._node.last_error

    def wait_mode(self, mode: str, timeout_s: float) -> bool:
        """Wait for a mode; false when the time is over."""
        return self._run(self._node.wait_mode(mode, timeout_s), timeout_s + 5.0)

    def publish(
        self,
        topic: str,
        content: Content,
        *,
        system: Optional[str] = None,
        type: str = "",
        wait: bool = True,
        timeout_s: float = 5.0,
    ) -> Value:
        """Publish; with ``wait`` until a server keeps it, where one is reached. Raises ``NodeError``."""
        if wait:
            work = self._node.publish(topic, content, system=system, type=type, timeout_s=timeout_s)
            return self._run(work, timeout_s + 5.0)

        async def publish() -> Value:
            return self._node.publish_nowait(topic, content, system=system, type=type)

        return self._run(publish(), timeout_s)

    def read(self, topic: str, *, system: Optional[str] = None, timeout_s: float = 5.0) -> Value:
        """Return the last value; without a reachable server, the node's own copy. Raises ``NodeError``."""
        return self._run(self._node.read(topic, system=system, timeout_s=timeout_s), timeout_s + 5.0)

    def subscribe(
        self,
        topic: str,
        callback: Callable[[Value], Any],
        *,
        system: Optional[str] = None,
        latest: bool = True,
    ) -> Callable[[], None]:
        """Call ``callback`` with every value that others publish. Returns a function that ends it."""
        end = self._run(self._node.subscribe(topic, callback, system=system, latest=latest), 10.0)
        return lambda: self._run(end(), 10.0)

    def list(self, system: str = "*", topic: str = "*") -> List[Dict[str, Any]]:
        """Return the last values whose names match, as JSON objects. Raises ``NodeError``."""
        return self._run(self._node.list(system, topic), 10.0)

    def request(self, system: str, topic: str, op: str, head: Dict[str, object]) -> Packet:
        """Send any request of the protocol, and return its answer. Raises ``NodeError``."""
        return self._run(self._node.request(system, topic, op, head), 10.0)

    def close(self) -> None:
        """Leave; harmless twice."""
        if self._open:
            self._open = False
            self._run(self._node.close(), 5.0)
            self._stop()

    def __enter__(self) -> "Node":
        self.wait_mode("remote", _CONNECT_S)
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self, work: Awaitable[T], timeout_s: float) -> T:
        if not self._thread.is_alive():
            cast(Any, work).close()
            raise NodeError("closed", "the node was closed")
        future = asyncio.run_coroutine_threadsafe(cast(Any, work), self._loop)
        try:
            return cast(T, future.result(timeout_s))
        except FutureTimeout:
            future.cancel()
            raise NodeError("timeout", "no answer within {:g} s".format(timeout_s)) from None

    def _stop(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(5.0)
        if not self._thread.is_alive():
            self._loop.close()


async def _serve(told: Any) -> None:
    """Run the local server until the process is ended."""
    host, _, port = told.serve.rpartition(":")
    if not host or not port.isdigit() or "/" in host:
        raise NodeError("malformed", "--serve takes HOST:PORT, such as 0.0.0.0:7410; the cloud comes with --cloud")
    server = LocalServer(
        told.called or socket.gethostname(),
        cloud=told.cloud or told.server,
        directory=told.directory,
        token=told.token,
        tls=told.ca,
        insecure=told.insecure,
        announce=told.announce,
        discovery_port=told.discovery_port,
        offline_depth=told.offline_depth,
    )
    bound = await server.listen(host, int(port))
    print("serving nodes on iort://{}:{}".format(host, bound), flush=True)
    try:
        await asyncio.Event().wait()
    finally:
        await server.close()


def _main(arguments: List[str]) -> int:
    """Run ``iort.py SERVER publish|read|watch|list`` and ``iort.py --serve``, for shells on robots."""
    import argparse

    parser = argparse.ArgumentParser(prog="iort.py", description="publish and read values of robots, or serve them")
    parser.add_argument("server", nargs="?", help="iort://host:7410")
    parser.add_argument("verb", nargs="?", choices=["publish", "read", "watch", "list"])
    parser.add_argument("name", nargs="?", default="", help="SYSTEM/TOPIC")
    parser.add_argument("data", nargs="?", help="what to publish")
    parser.add_argument("--token", default=os.environ.get("ROPEWAY_TOKEN"), help="or ROPEWAY_TOKEN")
    parser.add_argument("--ca", help="file of the authorities to trust, for iorts://")
    parser.add_argument(
        "--serve",
        nargs="?",
        const="127.0.0.1:{}".format(DEFAULT_PORT),
        metavar="HOST:PORT",
        help="act as the server of this network (default %(const)s; 0.0.0.0:7410 for others, with --token)",
    )
    parser.add_argument("--cloud", help="with --serve: the server that gets what is kept here, and may be away")
    parser.add_argument("--called", help="with --serve: its name (default: that of this machine)")
    parser.add_argument("--directory", help="with --serve: keep values here over restarts")
    parser.add_argument("--announce", action="store_true", help="with --serve: let nodes on this network find it")
    parser.add_argument("--discovery-port", type=int, default=DISCOVERY_PORT, help="UDP port (default %(default)s)")
    parser.add_argument("--offline-depth", type=int, default=1, help="values of a topic that the cloud gets later")
    parser.add_argument("--insecure", action="store_true", help="with --serve: let everybody in without a token")
    told = parser.parse_args(arguments)
    if told.serve is not None:
        try:
            asyncio.run(_serve(told))
        except NodeError as error:
            print(error, file=sys.stderr)
            return 1
        except KeyboardInterrupt:
            pass
        return 0
    if told.server is None or told.verb is None:
        parser.error("a server and one of publish, read, watch, list is needed, or --serve")
    system, _, topic = (told.name or "*/*").partition("/")
    with Node("shell", told.server, token=told.token, tls=told.ca, kind="pc") as node:
        if node.mode != "remote":
            print(node.last_error, file=sys.stderr)
            return 1
        try:
            if told.verb == "publish":
                node.publish(topic, told.data or "", system=system)
            elif told.verb == "read":
                print(node.read(topic, system=system).text)
            elif told.verb == "list":
                print(json.dumps(node.list(system, topic), indent=1))
            else:
                node.subscribe(topic, lambda v: print(v.system, v.topic, v.text, flush=True), system=system)
                threading.Event().wait()
        except NodeError as error:
            print(error, file=sys.stderr)
            return 1
        except KeyboardInterrupt:
            return 0
    return 0


if __name__ == "__main__":
    sys.exit(_main(sys.argv[1:]))
