"""Messages as peers of ROS 1 write them, while ours stay CDR of ROS 2.

ROS 1's rosbridge names types in two parts (``std_msgs/String``), spells a time ``secs`` and ``nsecs``, gives a header
its ``seq``, keeps the names of its own definitions (``CameraInfo.K``), and has a signed ``byte``; its raw bytes are
those that its nodes send.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

from ropeway.errors import DecodeError, ValueMismatch
from ropeway.types.check import explain
from ropeway.types.codec import MessageCodec
from ropeway.types.definition import HEADER, ROS1_HEADER, ROS1_TIMES, TIMES, Definition, Field, FieldType, short_name
from ropeway.types.layout import Planner
from ropeway.types.now import replace_now, stamp_header
from ropeway.types.reader import make_reader
from ropeway.types.ros1_types import Ros1Types
from ropeway.types.typedef import typedefs
from ropeway.types.writer import FAILURES, make_writer

__all__ = ["Ros1Codec", "Ros1Spelling"]

_OWN: Final = {
    ROS1_TIMES[0]: (("uint32", "secs"), ("uint32", "nsecs")),
    ROS1_TIMES[1]: (("int32", "secs"), ("int32", "nsecs")),
    ROS1_HEADER: (("uint32", "seq"), (ROS1_TIMES[0], "stamp"), ("string", "frame_id")),
}
_NAMED: Final = {HEADER: ROS1_HEADER, TIMES[0]: ROS1_TIMES[0], TIMES[1]: ROS1_TIMES[1], "byte": "int8"}


class Ros1Spelling:
    """Writes the types of ``types`` for ROS 1 peers."""

    def __init__(self, types: Ros1Types) -> None:
        self._types = types
        self._lock = threading.Lock()
        self._codecs: dict[str, tuple[MessageCodec, Ros1Codec]] = {}

    def codec(self, type: str) -> MessageCodec:
        """Return the codec of a message or of one part of a service whose JSON, CBOR and raw bytes are those of ROS 1.

        Raises as that of the registry does.
        """
        full = self._types.registry.canonical(type)
        with self._lock:
            self._types.teach(full)
            plain = self._types.registry.codec(full)
            known = self._codecs.get(full)
            if known is None or known[0] is not plain:  # the definition has changed
                known = self._codecs[full] = (plain, Ros1Codec(plain, self._types, self.definition))
            return known[1]

    def definition(self, name: str, *, needed_by: str = "") -> Definition:
        """Return the definition of the values of ``name``. Raises ``UnknownType``."""
        if name in _OWN:
            return Definition(name, tuple(Field(field, FieldType(type)) for type, field in _OWN[name]))
        found = self._types.definition(name, needed_by=needed_by)
        return replace(found, fields=tuple(replace(each, type=_named(each.type)) for each in found.fields), source="")

    def typedefs(self, type: str) -> list[dict[str, Any]]:
        """Return the ``TypeDef`` objects with which ROS 1's rosapi describes a message. Raises ``UnknownType``."""
        names = dict.fromkeys([self._types.registry.canonical(type)])
        waiting = list(names)
        while waiting:
            for field in self._types.definition(waiting.pop(0)).fields:
                if field.type.is_message and field.type.base not in names and field.type.base not in TIMES:
                    names[field.type.base] = None
                    waiting.append(field.type.base)
        return typedefs(names, self._types.definition, ros1=True)

    def text(self, type: str) -> str:
        """Return the definition with all its dependencies, as ROS 1's bags and rosapi have it.

        Raises ``UnknownType``.
        """
        return self._types.message(type).text

    @staticmethod
    def name(type: str) -> str:
        """Return the name of a type in two parts; anything else is returned unchanged."""
        return short_name(type) if type.count("/") == 2 else type


def _named(type: FieldType) -> FieldType:
    return replace(type, base=_NAMED.get(type.base, type.base))


class Ros1Codec(MessageCodec):
    """The codec of one type for peers of ROS 1: objects, JSON and CBOR in their spelling, their bytes as raw.

    Values in the spelling of ROS 2 are taken, too: a gateway or a newer client may send them.
    """

    variant = "ros1"

    def __init__(self, plain: MessageCodec, types: Ros1Types, definition: Callable[..., Definition]) -> None:
        super().__init__(plain.type, types.registry)
        self._plain = plain
        self._converter = types.converter(plain.type)
        self._values_of = definition
        self._root = _NAMED.get(plain.type, plain.type)
        self._plan = Planner(definition, "ros1").plan(self._root)
        self.fields = tuple(field.name for field in definition(self._root).wire_fields)

    def raw(self, cdr: bytes) -> bytes:
        """Return the bytes that ROS 1 sends. Raises ``DecodeError``."""
        return self._converter.to_ros1(cdr)

    def from_raw(self, raw: bytes) -> bytes:
        """Convert bytes of ROS 1 to CDR. Raises ``DecodeError``."""
        return self._converter.from_ros1(raw)

    def from_json(self, value: Any, *, now_ns: Callable[[], int] = time.time_ns) -> bytes:
        """Encode a parsed JSON value as CDR. Raises ``ValueMismatch``."""
        return self._encode(stamp_header(value, now_ns) if self.has_header else value, now_ns)

    from_cbor = from_json

    def _read(self, flavour: str, cdr: bytes, *, alone: bool = False) -> Any:
        raw = self._converter.to_ros1(cdr)
        read = self._readers.get(flavour)
        if read is None:
            read = self._readers[flavour] = make_reader(self._plan, flavour)
        value, _ = read(raw, 0, len(raw))
        return value

    def _encode(self, value: Any, now_ns: Callable[[], int] | None = None) -> bytes:
        write = self._write
        if write is None:
            write = self._write = make_writer(self._plan)
        out: list[bytes] = []
        try:
            write(value, out, 0)
        except FAILURES:
            return self._otherwise(value, now_ns)
        try:
            return self._converter.from_ros1(b"".join(out))
        except DecodeError as error:
            raise ValueMismatch(self.type, "", error.reason) from None

    def _otherwise(self, value: Any, now_ns: Callable[[], int] | None) -> bytes:
        if now_ns is not None:
            timed = replace_now(self._root, value, self._values_of, now_ns())
            if timed is not value:
                return self._encode(timed)
        try:
            return self._plain.from_json(value)
        except ValueMismatch:
            raise explain(self._root, value, self._values_of) from None
