"""WebSocket frames to operations: JSON in text and binary frames, CBOR maps in binary ones.

``loads`` takes one frame by itself; ``JsonAssembler`` also puts together an object that a client spread over
several frames, and finds the objects between what is not JSON. Whatever a peer sends, they raise only
``InvalidFrame``, and what they keep and compute is bounded by the size of the frames.
"""

from __future__ import annotations

import re
from typing import Any, Final

from ropeway.errors import InvalidFrame
from ropeway.limits import NESTED_CONTAINERS
from ropeway.patterns import compile_possessive
from ropeway.types.untrusted import cbor_loads, json_loads

__all__ = ["JsonAssembler", "loads"]

_PENDING_LIMIT_BYTES: Final = 16 << 20


def loads(
    data: bytes | bytearray | memoryview | str, *, text: bool, max_depth: int = NESTED_CONTAINERS
) -> list[dict[Any, Any]]:
    """Parse the objects of one frame, in order: JSON, several of them one after the other, or (binary) one CBOR map.

    ``NaN`` and ``Infinity`` are taken as numbers. Raises ``InvalidFrame``, also if anything else than objects is
    in the frame or the last one is not complete.
    """
    assembler = JsonAssembler(limit_bytes=len(data) * 4, max_depth=max_depth)
    objects = assembler.feed(data, text=text)
    if assembler.refused:
        raise assembler.refused[0]
    if not objects and not assembler.pending_bytes:
        raise InvalidFrame("a JSON object was expected, not white space", len(data))
    if assembler.pending_bytes:
        raise InvalidFrame("a JSON object is cut off", len(data))
    if assembler.garbage_bytes:
        raise InvalidFrame(f"{assembler.garbage_bytes} bytes between the JSON objects are not JSON", len(data))
    return objects


# --- JSON over several frames -----------------------------------------------------------------------------------

_QUOTE: Final = ord('"')
_WS: Final = rb"[ \t\r\n]*+"
_TEXT: Final = rb'(?:[^"\\]++|\\.)*+'  # up to the quote that ends it
_SCALAR: Final = rb"(?:-?+(?:[0-9][-+.0-9eE]*+|Infinity)|NaN|true|false|null)"
_FLAT: Final = rb'[\[{](?:[^{}\[\]"]++|"%b")*+[\]}]' % _TEXT
_NESTED: Final = rb'[\[{](?:[^{}\[\]"]++|"%b"|%b)*+[\]}]' % (_TEXT, _FLAT)
_DEEPER: Final = rb'[\[{](?:[^{}\[\]"]++|"%b"|%b)*+[\]}]' % (_TEXT, _NESTED)
_ITEM: Final = rb'(?:"%b"|%b|%b)' % (_TEXT, _SCALAR, _DEEPER)
_STRING: Final = compile_possessive(_TEXT, re.DOTALL)
_TOKEN: Final = compile_possessive(rb'%b(?:([{}\[\]:,"])|(%b))' % (_WS, _SCALAR))
# Many items with their commas in one step, as deep as the poses of a path; whether they are right JSON is seen when
# the object is read.
_ITEMS: Final = compile_possessive(rb"(?:%b%b%b,)++" % (_WS, _ITEM, _WS), re.DOTALL)
_MEMBERS: Final = compile_possessive(rb'(?:%b"%b"%b:%b%b%b,)++' % (_WS, _TEXT, _WS, _WS, _ITEM, _WS), re.DOTALL)
_SPACE: Final = compile_possessive(_WS)
_LITERALS: Final = (b"-Infinity", b"Infinity", b"NaN", b"true", b"false", b"null")
_LONGEST_NUMBER: Final = 1024
_MAX_ERRORS: Final = 64  # in one frame; what has more is not worth the search
_MAX_STEPS: Final = 50_000  # taken one by one up to the end of one object: about 50 ms

# what may come next
_VALUE, _FIRST_VALUE, _KEY, _FIRST_KEY, _COLON, _NEXT = range(6)
_VALUES: Final = frozenset((_VALUE, _FIRST_VALUE))
_KEYS: Final = frozenset((_KEY, _FIRST_KEY))


class _NotJson(Exception):  # a signal within this module
    def __init__(self, at: int) -> None:
        self.at = at  # what comes before is no use


class JsonAssembler:
    """Takes the frames of one connection and gives their objects.

    ``limit_bytes`` bounds what is kept of an object that is not complete yet; ``garbage_bytes`` counts what was
    thrown away because it is no JSON, ``pending_bytes`` what waits for the next frame. ``refused`` has the errors of
    objects that are whole but of no use; whoever feeds frames takes them from there. A frame that is an operation
    by itself ends an object that was never finished.
    """

    def __init__(self, *, limit_bytes: int = _PENDING_LIMIT_BYTES, max_depth: int = NESTED_CONTAINERS) -> None:
        self.limit_bytes = limit_bytes
        self.max_depth = max_depth
        self.garbage_bytes = 0
        self.refused: list[InvalidFrame] = []
        self._buffer = bytearray()  # begins with the object that is not complete
        self._open = bytearray()  # its containers
        self._expect = _VALUE
        self._string = False
        self._at = 0  # as far as it was looked at
        self._steps = 0

    @property
    def pending_bytes(self) -> int:
        """The bytes kept of an incomplete object."""
        return len(self._buffer)

    def clear(self) -> None:
        """Forget what is kept of an incomplete object."""
        self._buffer = bytearray()
        self._open.clear()

    def feed(self, data: bytes | bytearray | memoryview | str, *, text: bool) -> list[dict[Any, Any]]:
        """Return the objects that this frame completes; none while the first one is incomplete.

        Raises ``InvalidFrame`` if the frame has nothing of use. What is between objects is only counted.
        """
        if isinstance(data, str):
            try:
                data = data.encode()
            except UnicodeError:
                raise InvalidFrame("half a surrogate pair is not text", len(data)) from None
        if not len(data):
            raise InvalidFrame("an empty frame")
        if not text and data[0] >= 0x80 and (value := self._binary(data)) is not None:
            return [value]
        try:
            whole = json_loads(data, self.max_depth)
        except InvalidFrame as error:
            if error.message is None or self._buffer:
                return self._search(data, error)
            self.refused.append(error)
            return []
        if self._buffer:
            if not isinstance(whole, dict) or "op" not in whole:
                return self._search(data, None)
            self._discard(len(self._buffer))
        if not isinstance(whole, dict):
            raise InvalidFrame(f"a JSON object was expected, not {_kind(whole)}", len(data))
        return [whole]

    def _binary(self, data: bytes | bytearray | memoryview) -> dict[Any, Any] | None:
        """Parse a frame as a CBOR map; ``None`` if it may continue a JSON text."""
        try:
            if not 0xA0 <= data[0] <= 0xBF:
                raise InvalidFrame("a binary frame that is neither JSON nor a CBOR map", len(data))
            value = cbor_loads(data, self.max_depth)
        except InvalidFrame:
            if self._buffer:
                return None
            raise
        assert isinstance(value, dict)
        return value

    def _search(self, data: bytes | bytearray | memoryview, error: InvalidFrame | None) -> list[dict[Any, Any]]:
        waiting = len(self._buffer)
        if waiting + len(data) > self.limit_bytes:
            self._discard(waiting)
            raise InvalidFrame(f"a JSON object is not complete after {self.limit_bytes} bytes", waiting + len(data))
        self._buffer += data
        objects: list[dict[Any, Any]] = []
        before = self.garbage_bytes
        errors = 0
        while self._begin():
            try:
                end = self._end()
            except _NotJson as wrong:
                errors += 1
                self._discard(wrong.at if errors < _MAX_ERRORS else len(self._buffer))
                continue
            if end is None:
                break
            try:
                objects.append(json_loads(bytes(self._buffer[:end]), self.max_depth))
            except InvalidFrame as inner:
                if inner.message is not None:
                    self.refused.append(inner)
                else:
                    error = error or inner
                    self.garbage_bytes += end
            del self._buffer[:end]
        if not objects and not self._buffer and self.garbage_bytes > before:
            raise error or InvalidFrame("not a JSON object", len(data))
        return objects

    def _discard(self, size: int) -> None:
        self.garbage_bytes += size
        del self._buffer[:size]
        self._open.clear()

    def _begin(self) -> bool:
        """Skip to where an object begins; return false if there is none."""
        if self._open:
            return True
        at = self._buffer.find(b"{")
        before = len(self._buffer) if at < 0 else at
        space = _SPACE.match(self._buffer, 0, before)
        if space is not None and space.end() < before:
            self.garbage_bytes += before
        del self._buffer[:before]
        if at < 0:
            return False
        self._open += b"{"
        self._expect = _FIRST_KEY
        self._string = False
        self._at = 1
        self._steps = 0
        return True

    def _end(self) -> int | None:
        """Return where the object ends that the buffer begins with; ``None`` if its end has not arrived.

        Continues where it stopped before. Raises ``_NotJson`` at what cannot be a part of an object.
        """
        buffer, open_, at = self._buffer, self._open, self._at
        while True:
            if self._string:
                at = _matched(_STRING, buffer, at).end()
                if at >= len(buffer) or buffer[at] != _QUOTE:
                    self._at = at
                    return None
                self._string = False
                at += 1
            self._steps += 1
            if self._steps > _MAX_STEPS:
                raise _NotJson(len(buffer))
            if self._expect in _VALUES and open_.endswith(b"["):
                items = _ITEMS.match(buffer, at)
            else:
                items = _MEMBERS.match(buffer, at) if self._expect in _KEYS else None
            if items is not None:
                at = items.end()
                self._expect = _VALUE if self._expect in _VALUES else _KEY
            token = _TOKEN.match(buffer, at)
            if token is None or (token.end() == len(buffer) and token.lastindex == 2):
                self._at = self._unfinished(at)
                return None
            mark = token.group(1)
            start, at = token.start(token.lastindex or 0), token.end()
            expect = self._expect
            if mark is None and expect in _VALUES:
                self._expect = _NEXT
            elif mark == b'"' and expect in _VALUES:
                self._string, self._expect = True, _NEXT
            elif mark == b'"' and expect in _KEYS:
                self._string, self._expect = True, _COLON
            elif mark == b":" and expect == _COLON:
                self._expect = _VALUE
            elif mark == b"," and expect == _NEXT:
                self._expect = _KEY if open_.endswith(b"{") else _VALUE
            elif (mark == b"}" and open_.endswith(b"{") and expect in (_FIRST_KEY, _NEXT)) or (
                mark == b"]" and open_.endswith(b"[") and expect in (_FIRST_VALUE, _NEXT)
            ):
                open_.pop()
                self._expect = _NEXT
                if not open_:
                    return at
            elif mark in (b"{", b"[") and expect in _VALUES:
                if len(open_) >= self.max_depth:
                    raise _NotJson(len(buffer))
                open_ += mark
                self._expect = _FIRST_KEY if mark == b"{" else _FIRST_VALUE
            else:
                raise _NotJson(start)

    def _unfinished(self, at: int) -> int:
        """Return where, after white space, an unfinished number or word begins."""
        start = _matched(_SPACE, self._buffer, at).end()
        rest = bytes(self._buffer[start : start + _LONGEST_NUMBER])
        number = rest[:1].isdigit() or (rest[:1] == b"-" and rest[1:2].isdigit())
        if len(rest) == _LONGEST_NUMBER or not (number or any(word.startswith(rest) for word in _LITERALS)):
            raise _NotJson(start)
        return start


def _matched(pattern: re.Pattern[bytes], buffer: bytearray, at: int) -> re.Match[bytes]:
    found = pattern.match(buffer, at)
    assert found is not None  # these patterns match the empty text
    return found


def _kind(value: object) -> str:
    return {list: "an array", str: "a text", bool: "a truth value", type(None): "null"}.get(type(value), "a number")
