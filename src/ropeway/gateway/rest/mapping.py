"""Makes the body of a request of a message, and a message of an answer, as a rule for a web server says."""

from __future__ import annotations

import base64
import binascii
import os
import re
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import orjson

from ropeway.errors import ConfigError, ConversionError
from ropeway.gateway.config.field_path import FieldPath, parse_field_path
from ropeway.types.untrusted import json_loads

if TYPE_CHECKING:
    from ropeway.gateway.config.http_model import AnswerTopic, HttpRule, PostedField, PostedFile
    from ropeway.types import TypeRegistry

__all__ = ["AnswerMapping", "Posted", "RequestMapping", "with_variables"]

_COMPRESSED: Final = "sensor_msgs/msg/CompressedImage"
_IMAGE: Final = "sensor_msgs/msg/Image"
_VARIABLE: Final = re.compile(r"\$\{(\w+)\}")
_EXTENSION: Final = {"jpeg": "jpg"}


class Posted(NamedTuple):
    """The body of a request, as ``httpx`` takes it: ``content`` of a media type, or the parts of a form."""

    arguments: dict[str, Any]
    message: bytes
    """The message as JSON, for answers that take something of it."""


class _Step(NamedTuple):
    source: FieldPath | None
    value: Any
    to: FieldPath
    of_message: bool = False

    def taken(self, found: Any) -> Any:
        """Return what this step takes of ``found``. Raises ``LookupError``."""
        return self.value if self.source is None else self.source.read(found)


class RequestMapping:
    """Makes requests of messages. Raises ``ConfigError`` where a variable is not set."""

    def __init__(self, rule: HttpRule, type: str, registry: TypeRegistry, path: str) -> None:
        self._codec, self._type = registry.codec(type), type
        self._steps = _steps(rule.fields, f"{path}.fields")
        self._files = [(parse_field_path(file.source), file) for file in rule.files]

    def make(self, payload: bytes) -> Posted:
        """Return what is posted of a message. Raises ``ConversionError`` where it has not what the rule wants."""
        text = self._codec.json(payload)
        if not self._steps and not self._files:
            return Posted({"content": text, "headers": {"content-type": "application/json"}}, text)
        message = json_loads(text)
        try:
            body: Any = None
            for step in self._steps:
                body = step.to.write(self._shown(step, message), body)
            if not self._files:
                return Posted({"content": orjson.dumps(body), "headers": {"content-type": "application/json"}}, text)
            files = [(file.name, self._file(path, file, message, payload)) for path, file in self._files]
        except LookupError as error:
            raise ConversionError(f"{self._type}: {error.args[0]}") from None
        return Posted({"data": _form(body), "files": files}, text)

    def _shown(self, step: _Step, message: Any) -> Any:
        """Return what a step takes: of a picture that goes to a field, the bytes in base64."""
        whole = step.source is not None and not step.source.steps
        return message["data"] if whole and step.to.steps and self._type == _COMPRESSED else step.taken(message)

    def _file(self, path: FieldPath, file: PostedFile, message: Any, payload: bytes) -> tuple[str, bytes, str]:
        if path.steps and (self._type not in (_COMPRESSED, _IMAGE) or path.text != "data"):
            return f"{file.name}.bin", _decoded(path.read(message), path.text), "application/octet-stream"
        if self._type == _COMPRESSED:
            kind = _picture_kind(message["format"])
            return f"{file.name}.{_EXTENSION.get(kind, kind)}", _decoded(message["data"], "data"), f"image/{kind}"
        from ropeway.gateway.thumbnail import thumbnail

        picture = thumbnail(self._codec.decode(payload), reduced=False) if self._type == _IMAGE else None
        if picture is None:
            raise ConversionError(f"{self._type}: it is no picture that can be posted; name a field of bytes in from")
        return f"{file.name}.png", picture[1], picture[0]


class AnswerMapping:
    """Makes messages of answers. Raises ``ConfigError`` where a variable is not set."""

    def __init__(self, answer: AnswerTopic, type: str, registry: TypeRegistry, path: str) -> None:
        self._codec, self._type = registry.codec(type), type
        self._steps = _steps(answer.fields, f"{path}.fields")
        self.needs_message = any(step.of_message for step in self._steps)

    def make(self, answer: bytes, media_type: str, posted: bytes) -> bytes:
        """Return the message as CDR. Raises ``RopewayError`` where the answer does not fit."""
        if media_type.startswith("image/"):
            if self._type != _COMPRESSED:
                raise ConversionError(f"the answer is a picture, which a {_COMPRESSED} could take, not a {self._type}")
            format = media_type.partition(";")[0].removeprefix("image/").strip()
            return self._codec.from_json({"format": format, "data": base64.b64encode(answer).decode()})
        found = json_loads(answer)
        if not self._steps:
            return self._codec.from_json(found)
        message: Any = None
        sent = json_loads(posted) if self.needs_message else None
        try:
            for step in self._steps:
                message = step.to.write(step.taken(sent if step.of_message else found), message)
        except LookupError as error:
            raise ConversionError(f"the answer does not fit: {error.args[0]}") from None
        return self._codec.from_json(message)


def with_variables(text: str, path: str) -> str:
    """Return a text with the values of variables of the environment, ``${NAME}``. Raises ``ConfigError``."""

    def value(found: re.Match[str]) -> str:
        text = os.environ.get(found[1])
        if text is None:
            raise ConfigError([(path, f"the environment variable {found[1]} is not set")])
        return text

    return _VARIABLE.sub(value, text)


def _steps(fields: Iterable[PostedField], path: str) -> list[_Step]:
    steps = []
    for number, field in enumerate(fields):
        value = field.value
        if isinstance(value, str):
            value = with_variables(value, f"{path}[{number}].value")
        source = None if field.source is None else parse_field_path(field.source)
        steps.append(_Step(source, value, parse_field_path(field.to), getattr(field, "of", "answer") == "message"))
    return steps


def _picture_kind(format: str) -> str:
    """Return the kind in ``jpeg``, or in ``rgb8; jpeg compressed bgr8`` as image_transport has it."""
    words = format.lower().replace("jpg", "jpeg").split()
    return next(
        (word for word in words if word in ("jpeg", "png")), words[0] if words and words[0].isalnum() else "jpeg"
    )


def _form(body: Any) -> dict[str, str]:
    """Return the fields of a form: texts as they are, all else as JSON."""
    if body is None:
        return {}
    if not isinstance(body, Mapping):
        raise ConversionError("a form has fields; give each a name in to")
    return {name: value if isinstance(value, str) else orjson.dumps(value).decode() for name, value in body.items()}


def _decoded(value: Any, name: str) -> bytes:
    try:
        return bytes(value) if isinstance(value, list) else base64.b64decode(value, validate=True)
    except (TypeError, ValueError, binascii.Error):
        raise ConversionError(f"{name} is no field of bytes") from None
