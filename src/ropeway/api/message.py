"""Messages as programs have them: mappings that are decoded when somebody looks, objects, or the bytes themselves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import SimpleNamespace
from typing import Any, Final

from ropeway.errors import RopewayError, TypeConflict, ValueMismatch
from ropeway.graph.base import Sample
from ropeway.types import MessageCodec, TypeRegistry

__all__ = ["MessageType", "TypedMessage"]

_SHOWN_CHARACTERS: Final = 200  # of a message's fields in its ``repr``
_PLAIN: Final = (str, bytes, bytearray, memoryview, bool, int, float, type(None))


class MessageType:
    """A type of message: encodes what a program gives, and decodes what a graph gives."""

    def __init__(self, registry: TypeRegistry, name: str) -> None:
        self.codec: MessageCodec = registry.codec(name)
        self.name = self.codec.type

    def encode(self, value: object) -> bytes:
        """Return the CDR of a message.

        ``value`` is a mapping or an object with the fields as attributes (fields left out get their defaults, a header
        without stamp and the time ``"now"`` get the present time), ``None`` for a message with defaults alone, a
        ``TypedMessage``, or bytes, which are CDR with its header of 4 bytes. Raises ``ValueMismatch`` for values and
        ``DecodeError`` for bytes that do not fit, ``TypeConflict`` for a message of another type.
        """
        if isinstance(value, TypedMessage):
            if value.type != self.name:
                raise TypeConflict("the message", self.name, value.type)
            return value.raw
        if isinstance(value, (bytes, bytearray, memoryview)):
            return self.codec.fitting(bytes(value))
        try:
            fields = {} if value is None else _fields_of(value)
        except RecursionError:
            raise ValueMismatch(self.name, "", "the object contains itself, or is nested too deeply") from None
        if fields is None:
            reason = (
                f"{type(value).__name__} is not a message; give a mapping, an object with these fields, or CDR bytes"
            )
            raise ValueMismatch(self.name, "", reason)
        return self.codec.from_json(fields)

    def message(self, raw: bytes, *, topic: str = "", sample: Sample | None = None) -> TypedMessage:
        """Return the message in ``raw``, which is not looked at yet."""
        return TypedMessage(self.codec, raw, topic=topic, sample=sample)


class TypedMessage(Mapping[str, Any]):
    """A message that was received: a mapping of its fields, which are decoded when first looked at.

    ``raw`` is its CDR, ``type`` its type, ``topic`` where it came from (``""`` for requests, responses and the parts
    of actions), ``received_ns`` when it came (``time.time_ns``). Looking at a field raises ``DecodeError`` if the bytes
    are no such message.

    Nested messages are dicts, arrays of ``uint8``, ``char`` and ``byte`` are ``bytes``, other arrays of numbers are
    read-only numpy arrays, arrays of texts and truth values are lists. Two messages are equal if type and bytes are.
    """

    __slots__ = ("_codec", "_fields", "raw", "sample", "topic")

    def __init__(self, codec: MessageCodec, raw: bytes, *, topic: str = "", sample: Sample | None = None) -> None:
        self.raw, self.topic, self.sample = raw, topic, sample
        self._codec = codec
        self._fields: dict[str, Any] | None = None

    @property
    def type(self) -> str:
        """Return the name of its type, such as ``std_msgs/msg/String``."""
        return self._codec.type

    @property
    def received_ns(self) -> int:
        """Return when it was received, in nanoseconds since 1970; 0 for what is no message of a topic."""
        return 0 if self.sample is None else self.sample.stamp_ns

    def to_dict(self) -> dict[str, Any]:
        """Return a new dict of its fields. Raises ``DecodeError``."""
        return self._codec.decode(self.raw)

    def to_object(self) -> Any:
        """Return an object with its fields as attributes: ``message.to_object().pose.position.x``."""
        return _as_object(self._read())

    def to_json(self) -> str:
        """Return it as rosbridge writes it: arrays of bytes in base64, infinity and NaN as null."""
        return self._codec.json(self.raw).decode()

    def __getitem__(self, field: str) -> Any:
        return self._read()[field]

    def __iter__(self) -> Iterator[str]:
        return iter(self._codec.fields)

    def __len__(self) -> int:
        return len(self._codec.fields)

    def __eq__(self, other: object) -> bool:
        if isinstance(other, TypedMessage):
            return self.type == other.type and self.raw == other.raw
        return super().__eq__(other)

    def __hash__(self) -> int:
        return hash((self.type, self.raw))

    def __repr__(self) -> str:
        try:
            fields = repr(self._read())
        except RopewayError as error:
            fields = str(error)
        if len(fields) > _SHOWN_CHARACTERS:
            fields = f"{fields[:_SHOWN_CHARACTERS]}…"
        return f"<{self.type} {fields}>"

    def _read(self) -> dict[str, Any]:
        if self._fields is None:
            self._fields = self._codec.decode(self.raw)
        return self._fields


def _as_object(value: Any) -> Any:
    if isinstance(value, dict):
        return SimpleNamespace(**{key: _as_object(part) for key, part in value.items()})
    return [_as_object(part) for part in value] if isinstance(value, list) else value


def _fields_of(value: object) -> Mapping[str, Any] | None:
    """Return the fields of a mapping or an object, with those of the objects within it; ``None`` if it has none."""
    if isinstance(value, Mapping):
        fields = value
    elif hasattr(value, "get_fields_and_field_types"):  # a message of rclpy keeps its fields behind properties
        fields = {name: getattr(value, name) for name in value.get_fields_and_field_types()}
    elif isinstance(value, (*_PLAIN, list, tuple, set, type)):
        return None
    elif hasattr(value, "__dict__"):
        fields = vars(value)
    elif hasattr(value, "__slots__"):
        fields = {name: getattr(value, name) for name in value.__slots__}
    else:
        return None
    return {name: _part_of(part) for name, part in fields.items()}


def _part_of(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        if not value or isinstance(value[0], (str, bool, int, float)):  # long arrays are not looked through
            return value
        return [_part_of(part) for part in value]
    if isinstance(value, _PLAIN) or hasattr(value, "dtype") or hasattr(value, "tag"):  # numpy's, and typed CBOR
        return value
    fields = _fields_of(value)
    return value if fields is None else fields
