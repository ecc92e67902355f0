"""``MessageCodec``: one message type between CDR and everything else."""

from __future__ import annotations

import copy
import re
import struct
import time
from collections.abc import Callable, Mapping
from typing import Any, Final, Protocol

import orjson

from ropeway.errors import DecodeError, ValueMismatch
from ropeway.types.check import explain
from ropeway.types.definition import HEADER, Definition
from ropeway.types.layout import Plan, Planner
from ropeway.types.now import replace_now, stamp_header
from ropeway.types.reader import Reader, make_reader
from ropeway.types.swap import to_little_endian
from ropeway.types.values import Short
from ropeway.types.writer import FAILURES, Writer, make_writer

__all__ = ["MessageCodec"]

_CDR_HEADER: Final = b"\0\1\0\0"
_LITTLE: Final = b"\0\1"
_BIG: Final = b"\0\0"
_PADDING_BYTES: Final = 7
_JSON: Final = orjson.OPT_SERIALIZE_NUMPY
_STAMP_LITTLE: Final = struct.Struct("<iI").unpack_from
_STAMP_BIG: Final = struct.Struct(">iI").unpack_from
_BEYOND_ASCII: Final = re.compile(r"[^\x00-\x7f]")


class Adapting(Protocol):
    """Whatever recognizes messages that another distribution has written."""

    def adapted(self, type: str, raw: bytes) -> bytes | None:
        """Return the message in our layout, ``None`` where no distribution would write it."""
        ...


class Definitions(Protocol):
    """A registry, as its codecs see it."""

    @property
    def others(self) -> Adapting | None:
        """The layouts of other distributions."""
        ...

    def definition(self, name: str) -> Definition:
        """Return the definition of a message. Raises ``UnknownType``."""
        ...

    def hash(self, name: str) -> str:
        """Return the hash of a message."""
        ...


class MessageCodec:
    """Turns messages of one type from CDR into objects, JSON, CBOR and ROS 1, and back.

    ``type`` is the full name, ``hash`` the RIHS01 hash, ``fields`` the names of the fields, ``has_header`` tells of a
    field ``header`` of type ``std_msgs/Header``. Functions are generated at their first use; all methods may be
    called from any thread.

    CDR is taken in both byte orders, with up to 7 bytes of padding behind, and given little-endian with the header
    ``00 01 00 00``. What reads bytes raises ``DecodeError`` and nothing else, what takes values ``ValueMismatch`` and
    nothing else; its ``reason`` is the text rosbridge gives.
    """

    def __init__(self, name: str, registry: Definitions) -> None:
        self.type = name
        self._registry = registry
        self._definition: Definition = registry.definition(name)
        self.fields = tuple(field.name for field in self._definition.wire_fields)
        first = self._definition.wire_fields[:1]
        self.has_header = any(
            field.name == "header" and field.type.base == HEADER and field.type.kind == "scalar"
            for field in self._definition.wire_fields
        )
        self._stamped = bool(first) and first[0].type.base == HEADER and first[0].type.kind == "scalar"
        self.plan: Plan = Planner(registry.definition).plan(name)
        self._json = "json"
        self._readers: dict[str, Reader] = {}
        self._write: Writer | None = None
        self._ros1: tuple[Reader, Writer] | None = None

    variant = "ros2"
    """The spelling of the JSON and CBOR; encodings of one message are cached by it."""

    @property
    def hash(self) -> str:
        """The type hash ``RIHS01_…``."""
        return self._registry.hash(self.type)

    def decode(self, cdr: bytes) -> dict[str, Any]:
        """Decode CDR to nested dicts.

        Arrays of uint8, char and byte are ``bytes``, other arrays of numbers read-only numpy arrays over ``cdr``,
        arrays of bool and string lists. Raises ``DecodeError``.
        """
        return self._read("object", cdr)  # type: ignore[no-any-return]

    def encode(self, message: Mapping[str, Any]) -> bytes:
        """Encode nested dicts as CDR; fields left out get their defaults. Raises ``ValueMismatch``."""
        return self._encode(message)

    def default(self) -> dict[str, Any]:
        """Return a new message as nested dicts, with every field at its default."""
        return self.decode(self._encode({}))

    def json(self, cdr: bytes) -> bytes:
        """Return the JSON text that rosbridge sends for this message, in ASCII. Raises ``DecodeError``."""
        text = orjson.dumps(self._read(self._json, cdr), option=_JSON)
        return text if text.isascii() else _BEYOND_ASCII.sub(_escape, text.decode()).encode()

    @property
    def long_texts(self) -> bool:
        """Whether this codec was made by ``with_long_texts``."""
        return self._json == "json64"

    def with_long_texts(self) -> MessageCodec:
        """Return a copy whose JSON writes 64-bit integers as texts, so that JavaScript does not round them."""
        codec = copy.copy(self)
        codec._json = "json64"
        return codec

    def from_json(self, value: Any, *, now_ns: Callable[[], int] = time.time_ns) -> bytes:
        """Encode a parsed JSON value as CDR, by rosbridge's rules.

        A header without stamp gets the time ``now_ns()``, as does the Time ``"now"``. Raises ``ValueMismatch``.
        """
        return self._encode(stamp_header(value, now_ns) if self.has_header else value, now_ns)

    def cbor(self, cdr: bytes) -> dict[str, Any]:
        """Return the object that rosbridge sends as CBOR: typed arrays carry the tags of RFC 8746.

        Raises ``DecodeError``.

        ``ropeway.types.cbor.dumps`` writes it; ``cbor2.dumps`` does too, but gives NaN as a half float.
        """
        return self._read("cbor", cdr)  # type: ignore[no-any-return]

    def from_cbor(self, value: Any, *, now_ns: Callable[[], int] = time.time_ns) -> bytes:
        """Encode a parsed CBOR value as CDR: arrays may be tagged, plain or bytes. Raises ``ValueMismatch``."""
        return self._encode(stamp_header(value, now_ns) if self.has_header else value, now_ns)

    def raw(self, cdr: bytes) -> bytes:
        """Return the bytes that ``cbor-raw`` carries: the CDR unchanged."""
        return cdr

    def from_raw(self, raw: bytes) -> bytes:
        """Return the CDR that a peer sent as ``cbor-raw``, after checking that it is of this type.

        Raises ``DecodeError``.
        """
        return self.fitting(raw)

    def rosgw(self, cdr: bytes) -> dict[str, Any]:
        """Return the object that rosgw writes as CBOR: every array of numbers is a plain byte string.

        Raises ``DecodeError``.
        """
        return self._read("rosgw", cdr)  # type: ignore[no-any-return]

    def ros1(self, cdr: bytes) -> bytes:
        """Serialise the message as ROS 1 does; headers get the ``seq`` 0. Raises ``DecodeError``."""
        message = self._read("object", cdr)
        out: list[bytes] = []
        try:
            self._ros1_functions()[1](message, out, 0)
        except FAILURES:
            raise DecodeError(self.type, "CDR", explain(self.type, message, self._registry.definition).reason) from None
        return b"".join(out)

    def from_ros1(self, raw: bytes) -> bytes:
        """Convert a message that ROS 1 serialised to CDR. Raises ``DecodeError``."""
        data = raw if raw.__class__ is bytes else bytes(raw)
        try:
            value, end = self._ros1_functions()[0](data, 0, len(data))
        except (Short, struct.error, ValueError) as error:
            raise DecodeError(self.type, "ROS 1", str(error) or "the bytes end too early") from None
        if end != len(data):
            raise DecodeError(self.type, "ROS 1", f"{len(data) - end} bytes are left over")
        try:
            return self._encode(value)
        except ValueMismatch as error:
            raise DecodeError(self.type, "ROS 1", error.reason) from None

    def header_stamp_ns(self, cdr: bytes) -> int | None:
        """Return the stamp of the header that the message begins with, in nanoseconds, or ``None`` without one."""
        if not self._stamped:
            return None
        try:
            sec, nanosec = (_STAMP_LITTLE if cdr[1] else _STAMP_BIG)(cdr, 4)
        except (struct.error, IndexError):
            return None
        return sec * 1_000_000_000 + nanosec  # type: ignore[no-any-return]

    def _read(self, flavour: str, cdr: bytes, *, alone: bool = False) -> Any:
        read = self._readers.get(flavour)
        if read is None:
            read = self._readers[flavour] = make_reader(self.plan, flavour)
        raw = cdr if cdr.__class__ is bytes else bytes(cdr)
        try:
            if raw[:2] != _LITTLE:
                raw = self._swapped(raw)
            value, end = read(raw, 4, len(raw))
        except (Short, struct.error, ValueError) as error:
            return self._read_other(flavour, cdr, str(error) or "the bytes end too early", alone)
        if end + _PADDING_BYTES < len(raw):
            return self._read_other(flavour, cdr, f"{len(raw) - end} bytes are left over", alone)
        return value

    def _read_other(self, flavour: str, cdr: bytes, reason: str, alone: bool) -> Any:
        """Read a message that does not fit: another distribution may have written it. Raises ``DecodeError``."""
        adapted = None if alone else self._adapted(cdr)
        if adapted is None:
            raise DecodeError(self.type, "CDR", reason)
        return self._read(flavour, adapted)

    def _adapted(self, cdr: bytes) -> bytes | None:
        others = self._registry.others
        return None if others is None else others.adapted(self.type, bytes(cdr))

    def fitting(self, cdr: bytes) -> bytes:
        """Return the message in our layout, even if another distribution wrote it. Raises ``DecodeError``."""
        read = self._readers.get("object")
        if read is not None and self.fields and cdr.__class__ is bytes and cdr[:2] == _LITTLE:
            try:  # what fits is all there is to see, mostly
                _, end = read(cdr, 4, len(cdr))
                if end <= len(cdr) <= end + _PADDING_BYTES:
                    return cdr
            except (Short, struct.error, ValueError):
                pass
        if not self.fields and len(cdr) == len(_CDR_HEADER):
            cdr = bytes(cdr) + b"\0"  # the byte of a message without fields, which some leave out
        try:
            self._read("object", cdr, alone=True)
        except DecodeError:
            adapted = self._adapted(cdr)
            if adapted is None:
                raise
            return adapted
        return cdr

    def _swapped(self, raw: bytes) -> bytes:
        if raw[:2] != _BIG or len(raw) < 4:
            raise DecodeError(
                self.type, "CDR", f"it begins with {raw[:4].hex(' ') or 'nothing'}, not with 00 01 or 00 00"
            )
        return to_little_endian(self.plan, raw)

    def _encode(self, value: Any, now_ns: Callable[[], int] | None = None) -> bytes:
        write = self._write
        if write is None:
            write = self._write = make_writer(self.plan)
        out = [_CDR_HEADER]
        try:
            write(value, out, 0)
        except FAILURES:
            definition = self._registry.definition
            if now_ns is not None:
                timed = replace_now(self.type, value, definition, now_ns())
                if timed is not value:
                    return self._encode(timed)
            raise explain(self.type, value, definition) from None
        return b"".join(out)

    def _ros1_functions(self) -> tuple[Reader, Writer]:
        if self._ros1 is None:
            plan = Planner(self._registry.definition, "ros1").plan(self.type)
            self._ros1 = make_reader(plan, "object"), make_writer(plan)
        return self._ros1


def _escape(found: re.Match[str]) -> str:
    point = ord(found[0])
    if point < 0x10000:
        return f"\\u{point:04x}"
    point -= 0x10000
    return f"\\u{0xD800 + (point >> 10):04x}\\u{0xDC00 + (point & 0x3FF):04x}"
