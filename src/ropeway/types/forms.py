"""Converts between what robots and devices say and ROS messages: the forms that a map may name.

A form turns a text into the messages to publish (several if a command ends by itself, each with a delay), and a message
into the text to publish, or into nothing if it says nothing new. The forms ``raw`` and ``cdr`` do the same with bytes.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Protocol

import orjson

from ropeway.errors import ConversionError, InvalidFrame, TypesError
from ropeway.types import TypeRegistry
from ropeway.types.codec import MessageCodec
from ropeway.types.untrusted import json_loads

__all__ = [
    "FAILURES",
    "FORMS",
    "RAW_TYPES",
    "TWIST",
    "AngleForm",
    "CdrForm",
    "CodesForm",
    "FloatsForm",
    "Form",
    "JsonForm",
    "RawForm",
    "TextForm",
    "Timed",
    "default_form",
    "make_form",
]

TWIST: Final = ("linear.x", "linear.y", "linear.z", "angular.x", "angular.y", "angular.z")
"""The six numbers of ``cmd_vel``: linear x, y, z, angular a, b, c (IoRT paper, section 5.2)."""

FORMS: Final = ("text", "floats", "json", "codes", "angle", "raw", "cdr")

RAW_TYPES: Final = ("std_msgs/msg/UInt8MultiArray", "std_msgs/msg/ByteMultiArray")
"""The types whose ``data`` is the bytes of the form ``raw``."""

Timed = tuple[float, bytes]
"""Seconds from now, and the CDR to publish then."""

_STRING: Final = "std_msgs/msg/String"


class Form(Protocol):
    """A way to write messages of one type as text."""

    def messages(self, data: bytes) -> list[Timed]:
        """Return the messages to publish for a text. Raises ``ConversionError`` or another ``TypesError``."""

    def text(self, cdr: bytes) -> bytes | None:
        """Return the text of a message, ``None`` for nothing to say.

        Raises ``ConversionError`` or another ``TypesError``.
        """


class TextForm:
    """The text of the only field: of a ``std_msgs/msg/String``, a number, a bool."""

    def __init__(self, codec: MessageCodec) -> None:
        self._codec = codec
        if len(codec.fields) != 1:
            raise ConversionError(f"{codec.type} has {len(codec.fields)} fields; the form text is for types with one")
        self._field = codec.fields[0]
        default = codec.default()[self._field]
        self._kind: type = type(default)
        if not isinstance(default, (str, bool, int, float)):
            raise ConversionError(f"{codec.type}.{self._field} is neither text nor number; use the form json")

    def messages(self, data: bytes) -> list[Timed]:
        """Return one message."""
        value: Any = _decoded(data)
        if self._kind is not str:
            value = _number(value) if self._kind is float else self._whole(value)
        return [(0.0, self._codec.encode({self._field: value}))]

    def _whole(self, text: str) -> int | bool:
        if self._kind is bool:
            lowered = text.strip().lower()
            if lowered not in ("true", "false", "1", "0"):
                raise ConversionError(f"expected true or false, got {text[:40]!r}")
            return lowered in ("true", "1")
        try:
            return int(text)
        except ValueError:
            raise ConversionError(f"expected a whole number, got {text[:40]!r}") from None

    def text(self, cdr: bytes) -> bytes:
        """Return the text of the field."""
        value = self._codec.decode(cdr)[self._field]
        if isinstance(value, bool):
            return b"true" if value else b"false"
        return str(value).encode()


class FloatsForm:
    """Numbers between commas, each for the field at a path such as ``linear.x``."""

    def __init__(self, codec: MessageCodec, fields: Sequence[str]) -> None:
        self._codec, self._fields = codec, [tuple(path.split(".")) for path in fields]
        for path in self._fields:
            _check_path(codec, path)

    def messages(self, data: bytes) -> list[Timed]:
        """Return one message. There must be as many numbers as fields."""
        parts = _decoded(data).split(",")
        if len(parts) != len(self._fields):
            raise ConversionError(f"expected {len(self._fields)} numbers between commas, got {len(parts)}")
        message: dict[str, Any] = {}
        for path, part in zip(self._fields, parts, strict=True):
            _set(message, path, _number(part))
        return [(0.0, self._codec.encode(message))]

    def text(self, cdr: bytes) -> bytes:
        """Return the numbers, as short as they can be read back."""
        message = self._codec.decode(cdr)
        return ",".join([repr(float(_get(message, path))) for path in self._fields]).encode()


class JsonForm:
    """A JSON text: the whole message as rosbridge has it, or with ``fields`` only some, by their paths on both sides.

    ``fields`` maps the path of a field of the message to a path in the JSON value, such as ``pose.position.x`` to
    ``robot.x``.
    """

    def __init__(self, codec: MessageCodec, fields: Mapping[str, str] | None = None) -> None:
        self._codec = codec
        self._fields = [(tuple(ros.split(".")), tuple(json.split("."))) for ros, json in (fields or {}).items()]
        for path, _ in self._fields:
            _check_path(codec, path)

    def messages(self, data: bytes) -> list[Timed]:
        """Return one message; fields that the text leaves out get their defaults."""
        try:
            value = json_loads(data)
        except InvalidFrame as error:
            raise ConversionError(f"it is not JSON: {error.reason}") from None
        if self._fields:
            message: dict[str, Any] = {}
            for ros, json in self._fields:
                found = _find(value, json)
                if found is not None:
                    _set(message, ros, found)
            value = message
        return [(0.0, self._codec.from_json(value))]

    def text(self, cdr: bytes) -> bytes:
        """Return the message as JSON."""
        if not self._fields:
            return self._codec.json(cdr)
        message = orjson.loads(self._codec.json(cdr))
        value: dict[str, Any] = {}
        for ros, json in self._fields:
            _set(value, json, _get(message, ros))
        return orjson.dumps(value)


class CodesForm:
    """A single word out of a few, each with the fields that it stands for; fields left out are zero.

    A message becomes the code whose fields point the same way (the greatest cosine); one whose fields are all within
    ``deadband`` of zero becomes the code without fields. ``send`` limits the codes that are sent. A message that
    is nothing but what the other codes stand for (a rotation where only linear ones are sent) says nothing.
    """

    def __init__(
        self,
        codec: MessageCodec,
        codes: Mapping[str, Mapping[str, float]],
        *,
        send: Sequence[str] | None = None,
        deadband: float = 1e-3,
    ) -> None:
        self._codec, self._deadband = codec, deadband
        self._codes = {code: {tuple(p.split(".")): float(v) for p, v in f.items()} for code, f in codes.items()}
        self._paths = list(dict.fromkeys(path for fields in self._codes.values() for path in fields))
        for path in self._paths:
            _check_path(codec, path)
        self._send = [code for code in (self._codes if send is None else send) if code in self._codes]
        self._last: str | None = None

    def messages(self, data: bytes) -> list[Timed]:
        """Return one message."""
        code = _decoded(data).strip()
        fields = self._codes.get(code)
        if fields is None:
            raise ConversionError(f"expected one of {', '.join(self._codes)}, got {code[:40]!r}")
        message: dict[str, Any] = {}
        for path, value in fields.items():
            _set(message, path, value)
        return [(0.0, self._codec.encode(message))]

    def text(self, cdr: bytes) -> bytes | None:
        """Return the nearest code."""
        message = self._codec.decode(cdr)
        values = {path: float(_get(message, path)) for path in self._paths}
        length = math.sqrt(sum(v * v for v in values.values()))
        if all(abs(v) <= self._deadband for v in values.values()):
            code = next((c for c in self._send if not self._codes[c]), None)
            return None if code is None else code.encode()
        best, best_cosine = None, 1e-9
        for code in self._send:
            fields = self._codes[code]
            size = math.sqrt(sum(v * v for v in fields.values()))
            if not size:
                continue
            cosine = sum(values[path] * v for path, v in fields.items()) / (size * length)
            if cosine > best_cosine:
                best, best_cosine = code, cosine
        return None if best is None else best.encode()


class AngleForm:
    """An angle to turn by, in degrees, for a rate in ``field``, in radians per second; positive is to the left.

    A text becomes the rate ``rate_rad_s`` and, once the angle is done, a stop. Messages become the angles that they
    add up to: each rate holds until the next message, for ``hold_s`` at most; an angle is sent when it has grown to
    ``step_deg``, and what is left of it when the rate becomes zero.
    """

    def __init__(
        self,
        codec: MessageCodec,
        field: str = "angular.z",
        *,
        rate_rad_s: float = 0.5,
        hold_s: float = 1.0,
        step_deg: float = 5.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._codec, self._field = codec, tuple(field.split("."))
        _check_path(codec, self._field)
        self._rate, self._hold_s, self._step = rate_rad_s, hold_s, step_deg
        self._clock = clock
        self._angle = 0.0
        self._last: tuple[float, float] | None = None  # when, and the rate then

    def messages(self, data: bytes) -> list[Timed]:
        """Return a rate, and the stop that ends it."""
        angle = math.radians(_number(_decoded(data)))
        turn: dict[str, Any] = {}
        _set(turn, self._field, math.copysign(self._rate, angle) if angle else 0.0)
        stop = self._codec.encode({})
        return [(0.0, self._codec.encode(turn)), (abs(angle) / self._rate, stop)] if angle else [(0.0, stop)]

    def text(self, cdr: bytes) -> bytes | None:
        """Return the angle since the last one that was sent, if it is time to send it."""
        rate = float(_get(self._codec.decode(cdr), self._field))
        now = self._clock()
        if self._last is not None:
            self._angle += math.degrees(self._last[1]) * min(now - self._last[0], self._hold_s)
        ended = rate == 0.0
        self._last = None if ended else (now, rate)
        if abs(self._angle) >= self._step or (ended and abs(self._angle) >= 0.5):
            angle, self._angle = round(self._angle, 1), 0.0
            return repr(angle).encode()
        if ended:
            self._angle = 0.0
        return None


class RawForm:
    """Bytes as they are, in the field ``data`` of a ``std_msgs/msg/UInt8MultiArray`` or ``ByteMultiArray``."""

    def __init__(self, codec: MessageCodec) -> None:
        self._codec = codec
        if codec.type not in RAW_TYPES:
            raise ConversionError(f"the form raw is for {' and '.join(RAW_TYPES)}, not for {codec.type}")

    def messages(self, data: bytes) -> list[Timed]:
        """Return one message."""
        return [(0.0, self._codec.encode({"data": bytes(data)}))]

    def text(self, cdr: bytes) -> bytes:
        """Return the bytes."""
        return bytes(self._codec.decode(cdr)["data"])


class CdrForm:
    """The message as ROS 2 sends it: CDR behind its header of 4 bytes."""

    def __init__(self, codec: MessageCodec) -> None:
        self._codec = codec

    def messages(self, data: bytes) -> list[Timed]:
        """Return the message; what is none of the type is refused."""
        data = bytes(data)
        self._codec.decode(data)
        return [(0.0, data)]

    def text(self, cdr: bytes) -> bytes:
        """Return the message as it is."""
        return bytes(cdr)


def make_form(
    form: str, type: str, registry: TypeRegistry, options: Mapping[str, Any], *, clock: Callable[[], float]
) -> Form:
    """Make a form by its name. Raises ``ConversionError`` for options that do not fit the type, or ``UnknownType``."""
    codec = registry.codec(type)
    if form == "text":
        return TextForm(codec)
    if form == "floats":
        return FloatsForm(codec, options.get("fields") or TWIST)
    if form == "json":
        return JsonForm(codec, options.get("fields"))
    if form == "raw":
        return RawForm(codec)
    if form == "cdr":
        return CdrForm(codec)
    if form == "codes":
        return CodesForm(codec, options["codes"], send=options.get("send"), deadband=options.get("deadband", 1e-3))
    extra = {key: options[key] for key in ("rate_rad_s", "hold_s", "step_deg") if key in options}
    return AngleForm(codec, options.get("field", "angular.z"), clock=clock, **extra)


def default_form(type: str, registry: TypeRegistry) -> Form:
    """Return the form of topics that no map names: text for a String, JSON for all others."""
    codec = registry.codec(type)
    return TextForm(codec) if type == _STRING else JsonForm(codec)


def _decoded(data: bytes) -> str:
    try:
        return bytes(data).decode()
    except UnicodeDecodeError:
        raise ConversionError("it is not UTF-8 text") from None


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ConversionError(f"expected a number, got {text[:40]!r}") from None
    if not math.isfinite(value):
        raise ConversionError(f"expected a finite number, got {text[:40]!r}")
    return value


def _check_path(codec: MessageCodec, path: tuple[str, ...]) -> None:
    value: Any = codec.default()
    for part in path:
        if not isinstance(value, Mapping) or part not in value:
            raise ConversionError(f"{codec.type} has no field {'.'.join(path)}")
        value = value[part]


def _get(message: Any, path: tuple[str, ...]) -> Any:
    for part in path:
        message = message[part]
    return message


def _find(value: Any, path: tuple[str, ...]) -> Any:
    for part in path:
        if isinstance(value, Mapping):
            value = value.get(part)
        elif isinstance(value, list) and part.isdigit() and int(part) < len(value):
            value = value[int(part)]
        else:
            return None
    return value


def _set(message: dict[str, Any], path: tuple[str, ...], value: Any) -> None:
    for part in path[:-1]:
        message = message.setdefault(part, {})
    message[path[-1]] = value


FAILURES: Final = (TypesError, KeyError, TypeError, ValueError, OverflowError)
"""The errors that a form may raise on values of others."""
