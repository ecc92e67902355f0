"""Reads untrusted JSON and CBOR within bounds of memory and time; the only error it raises is ``InvalidFrame``."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from typing import Any, Final, NoReturn

import cbor2
import orjson

from ropeway.errors import InvalidFrame
from ropeway.limits import NESTED_CONTAINERS
from ropeway.types.weight import check_cbor, is_heavy_json

__all__ = ["cbor_loads", "json_loads", "json_value"]


def json_loads(data: bytes | bytearray | memoryview | str, max_depth: int = NESTED_CONTAINERS) -> Any:
    """Parse one JSON value. Takes ``NaN`` and ``Infinity``; raises ``InvalidFrame``."""
    if _is_heavy(data):
        value = _lenient(data)
    else:
        try:
            value = orjson.loads(data)
        except orjson.JSONDecodeError:
            value = _lenient(data)
    _check_depth(data, value, max_depth)
    return value


def _is_heavy(data: bytes | bytearray | memoryview | str) -> bool:
    try:
        return is_heavy_json(data)
    except InvalidFrame as error:
        raise InvalidFrame(error.reason, error.size_bytes, message=_about(data)) from None


def _about(data: bytes | bytearray | memoryview | str) -> dict[Any, Any] | None:
    """Return what the beginning and the end of an operation say it is, so that it can be refused by its id."""
    edges = (data[:_EDGE_BYTES], data[-_EDGE_BYTES:])
    text = b"\n".join(edge.encode(errors="replace") if isinstance(edge, str) else bytes(edge) for edge in edges)
    found = {key.decode(): orjson.loads(value) for key, value in reversed(_ABOUT.findall(text))}  # the first counts
    return found or None


_EDGE_BYTES: Final = 4096
_ABOUT: Final = re.compile(
    rb'"(op|id|service|action|topic)"\s{0,8}:\s{0,8}("[^"\\\x00-\x1f\x80-\xff]{0,256}"|-?[1-9][0-9]{0,15}(?=[\s,}]))'
)


def json_value(data: bytes | str) -> Any:
    """Return the value of a JSON text that is no frame: what stands in a certificate, a file, a parameter.

    Raises ``ValueError`` for everything that is not to be used, also where it is nested too deeply.
    """
    try:
        is_heavy_json(data)
        value = _lenient(data)  # keeps whole numbers of any size
        _check_depth(data, value, NESTED_CONTAINERS)
    except InvalidFrame as error:
        raise ValueError(error.reason) from None
    return value


def _lenient(data: bytes | bytearray | memoryview | str) -> Any:
    """Parse what orjson refuses: NaN and infinity, and numbers beyond a double."""
    try:
        text = data if isinstance(data, str) else str(data, "utf-8")
        value = json.loads(text)
        if _HALF_PAIR.search(text) and not _is_text(value):
            raise InvalidFrame("half a surrogate pair is not text", len(data), message=_object_in(value))
    except UnicodeError as error:
        raise InvalidFrame(f"not a text: {_short(error)}", len(data)) from None
    except (ValueError, RecursionError) as error:
        raise InvalidFrame(f"not JSON: {_short(error)}", len(data)) from None
    return value


def _is_text(value: Any) -> bool:
    try:
        json.dumps(value, ensure_ascii=False).encode()
    except UnicodeError:
        return False
    return True


def _object_in(value: Any) -> dict[Any, Any] | None:
    return value if isinstance(value, dict) else None


_HALF_PAIR: Final = re.compile(r"\\u[dD][89a-fA-F]")
_NO_MARK: Final = bytes(set(range(256)) - set(b'{}[]"'))
_ONE_KIND: Final = bytes.maketrans(b"{}", b"[]")
_TEXT: Final = re.compile(rb'"[^"]*"')


def _check_depth(data: bytes | bytearray | memoryview | str, value: Any, limit: int) -> None:
    """Raise ``InvalidFrame`` if ``value``, which ``data`` says, is nested deeper than ``limit``.

    What is deep is found by its brackets, so that ordinary messages are not walked through.
    """
    raw = data.encode() if isinstance(data, str) else bytes(data)
    count = 0
    for bracket in (b"{", b"["):
        at = raw.find(bracket)
        while at >= 0 and count <= limit:
            count += 1
            at = raw.find(bracket, at + 1)
    if count > limit and _is_deeper(_brackets(raw), limit):
        raise InvalidFrame(f"containers are nested more than {limit} deep", len(raw), message=_object_in(value))


def _brackets(raw: bytes) -> bytes:
    """Return the brackets of a JSON text, those in its texts left out, all of one kind."""
    if b"\\" in raw:
        raw = raw.replace(rb"\\", b"").replace(rb"\"", b"")
    marks = raw.translate(_ONE_KIND, _NO_MARK).replace(b'""', b"")  # texts without brackets
    return _TEXT.sub(b"", marks) if b'"' in marks else marks


def _is_deeper(brackets: bytes, limit: int) -> bool:
    """Return whether brackets are nested deeper than ``limit``; the innermost level goes first."""
    for _ in range(limit):
        brackets = brackets.replace(b"[]", b"")
    return bool(brackets)


def _short(error: Exception) -> str:
    return str(error)[:200]


def _refuse(*value: object) -> NoReturn:
    raise cbor2.CBORDecodeError("dates, big numbers, references and such are not part of ROS messages")


# Every tag that cbor2 would turn into something else than a CBORTag: costly, cyclic or without use here.
_NO_TAGS: Final[Mapping[int, Callable[..., Any]]] = dict.fromkeys(
    (0, 1, 2, 3, 4, 5, 25, 28, 29, 30, 35, 36, 37, 100, 256, 258, 260, 261, 1004, 43000, 43001, 55799), _refuse
)


def cbor_loads(data: bytes | bytearray | memoryview, max_depth: int = NESTED_CONTAINERS) -> Any:
    """Parse one CBOR value; arrays by RFC 8746 stay ``cbor2.CBORTag``. Raises ``InvalidFrame``."""
    check_cbor(data)
    try:
        return cbor2.loads(data, semantic_decoders=_NO_TAGS, max_depth=max_depth)
    except (cbor2.CBORError, ValueError, TypeError, RecursionError) as error:
        raise InvalidFrame(f"not CBOR: {_short(error)}", len(data), message=_salvaged(data)) from None


def _salvaged(data: bytes | bytearray | memoryview) -> dict[Any, Any] | None:
    """Recover the rest of a CBOR map with values that are not part of ROS messages, so that it can be refused by its
    id.
    """
    try:
        value = cbor2.loads(data, semantic_decoders=_EMPTY_TAGS, max_depth=NESTED_CONTAINERS, str_errors="replace")
    except (cbor2.CBORError, ValueError, TypeError, RecursionError):
        return None
    return _object_in(value)


_EMPTY_TAGS: Final[Mapping[int, Callable[..., Any]]] = dict.fromkeys(_NO_TAGS, lambda *value: None)
