"""Renames coordinate frames in messages of any type: the strings called ``frame_id`` and ``child_frame_id``.

Where the definition begins with its only header, as those of images, clouds and scans do, the name is exchanged in the
bytes; all other messages are read and written again.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Any, Final

from ropeway.errors import DecodeError
from ropeway.types.codec import MessageCodec
from ropeway.types.definition import HEADER, PRIMITIVES, Definition, FieldType
from ropeway.types.frame_names import FrameNames
from ropeway.types.registry import TypeRegistry

__all__ = ["frame_renamer"]

_FRAME_FIELDS: Final = frozenset({"frame_id", "child_frame_id"})
_LENGTH_AT: Final = 12  # behind the four bytes of the encapsulation, and the stamp
_NAME_AT: Final = 16
_CDR_AT: Final = 4
_NUMBERS: Final = {b"\0\1": struct.Struct("<I"), b"\0\0": struct.Struct(">I")}

Paths = dict[str, "Paths | None"]
"""The fields of a message that have frames below them; ``None`` stands for the name of a frame itself."""


def frame_renamer(registry: TypeRegistry, type: str, names: FrameNames) -> Callable[[bytes], bytes]:
    """Make the function that renames the frames in CDR messages of ``type``. Raises ``UnknownType``.

    It returns a message without frames, or whose frames keep their names, as it is, and raises ``DecodeError`` for one
    that is not of the type.
    """
    definition = registry.definition(type)
    paths = _paths(registry, definition)
    if not paths:
        return lambda payload: payload
    codec = registry.codec(type)
    if paths == {"header": {"frame_id": None}} and (align := _splices(registry, definition)):
        return _splicer(codec, names, align)
    return _rewriter(codec, names, paths)


def _paths(registry: TypeRegistry, definition: Definition) -> Paths:
    found: Paths = {}
    for field in definition.wire_fields:
        type = field.type
        if type.base == "string" and field.name in _FRAME_FIELDS and type.kind == "scalar":
            found[field.name] = None
        elif type.is_message and (below := _paths(registry, registry.definition(type.base))):
            found[field.name] = below
    return found


# ── in the bytes ───────────────────────────────────────────────────────────────────────────────────────────────────


def _splices(registry: TypeRegistry, definition: Definition) -> int:
    """Return the alignment of what follows the header, where no shift by a multiple of it changes a padding; else 0.

    That is so where the first value behind the header needs the greatest alignment of all that follow.
    """
    first, *others = definition.wire_fields
    if first.type != FieldType(HEADER) or first.name != "header":
        return 0
    aligns = [align for field in others for align in _alignments(registry, field.type)]
    if not aligns:
        return 1
    return aligns[0] if aligns[0] == max(aligns) else 0


def _alignments(registry: TypeRegistry, type: FieldType) -> list[int]:
    """Return the alignments of the values of a field, in order."""
    found = [4] if type.kind != "scalar" and type.kind != "array" else []  # the length of a sequence
    if not type.is_message:
        return [*found, PRIMITIVES[type.base] or 4]
    below = registry.definition(type.base).wire_fields
    return found + ([align for field in below for align in _alignments(registry, field.type)] if below else [1])


def _splicer(codec: MessageCodec, names: FrameNames, align: int) -> Callable[[bytes], bytes]:
    known: dict[bytes, bytes | None] = {}

    def spliced(payload: bytes) -> bytes:
        number = _NUMBERS.get(bytes(payload[:2]))
        if number is None or len(payload) < _NAME_AT:
            raise DecodeError(codec.type, "CDR", "it ends within its header, or is no plain CDR")
        (length,) = number.unpack_from(payload, _LENGTH_AT)
        end = _NAME_AT + length
        if not length:
            return payload
        if end > len(payload) or payload[end - 1]:
            raise DecodeError(codec.type, "CDR", "the name of its frame is none")
        name = bytes(payload[_NAME_AT : end - 1])
        try:
            new = known[name]
        except KeyError:
            if len(known) >= _KNOWN_NAMES:
                known.clear()
            new = known[name] = _renamed(codec, names, name)
        if new is None:
            return payload
        begin = b"".join((payload[:_LENGTH_AT], number.pack(len(new) + 1), new, b"\0"))
        rest = payload[end + _padding(end, align) :]
        return b"".join((begin, bytes(_padding(len(begin), align)), rest)) if rest else begin

    return spliced


_KNOWN_NAMES: Final = 64
"""How many names of frames are remembered with what becomes of them: messages of a topic have one, or few."""


def _padding(end: int, align: int) -> int:
    return -(end - _CDR_AT) % align


def _renamed(codec: MessageCodec, names: FrameNames, name: bytes) -> bytes | None:
    """Return the new name, ``None`` where it stays."""
    try:
        old = name.decode()
    except UnicodeDecodeError:
        raise DecodeError(codec.type, "CDR", "the name of its frame is not UTF-8") from None
    new = names.renamed(old)
    return None if new == old else new.encode()


# ── read and written again ─────────────────────────────────────────────────────────────────────────────────────────


def _rewriter(codec: MessageCodec, names: FrameNames, paths: Paths) -> Callable[[bytes], bytes]:
    def rewritten(payload: bytes) -> bytes:
        message = codec.decode(payload)
        return codec.encode(message) if _rename(message, paths, names) else payload

    return rewritten


def _rename(message: Any, paths: Paths, names: FrameNames) -> bool:
    """Rename the frames in a message, or in each of a list of them; return whether any has a new name."""
    if not isinstance(message, Mapping):
        return sum(_rename(one, paths, names) for one in message) > 0  # any() would leave the rest as it is
    changed = False
    for field, below in paths.items():
        if below is not None:
            changed |= _rename(message[field], below, names)
        elif (new := names.renamed(message[field])) != message[field]:
            message[field] = new  # type: ignore[index]
            changed = True
    return changed
