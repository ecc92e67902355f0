"""Says what is wrong with the shape of a document: every fault of its pydantic model with its path, in one line."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from typing import Final, get_args, get_origin

from pydantic import AliasChoices, BaseModel, ValidationError
from pydantic_core import ErrorDetails

from ropeway.errors import TOP_LEVEL
from ropeway.gateway.config.suggest import one_of, show, unknown_key

__all__ = ["inner_model", "json_path", "keys_of", "shape_problems", "spellings"]

_EXPECTED: Final = {
    "string_type": "a text",
    "bool_type": "true or false",
    "int_type": "a whole number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "tuple_type": "a list",
    "model_type": "an object",
    "dict_type": "an object",
    "recursion_loop": "a value that does not contain itself",
}
_QUOTED: Final = re.compile(r"'([^']*)'")  # the words of a Literal, as pydantic lists them
_BOUNDS: Final = {
    "greater_than": ("a number above", "gt"),
    "greater_than_equal": ("a number from", "ge"),
    "less_than_equal": ("a number up to", "le"),
}


def shape_problems(error: ValidationError, root: type[BaseModel]) -> list[tuple[str, str]]:
    """Return the path and a sentence for each fault that pydantic found in a document of the model ``root``."""
    return [_say(fault, root) for fault in error.errors(include_url=False)]


def json_path(parts: Iterable[str | int]) -> str:
    """Write a path as text: ``("remotes", 0, "publish")`` becomes ``remotes[0].publish``."""
    out = ""
    for part in parts:
        if isinstance(part, int):
            out += f"[{part}]"
        elif re.fullmatch(r"[A-Za-z_][\w-]*", part):
            out += f".{part}" if out else part
        else:
            out += f"[{json.dumps(part)}]"
    return out or TOP_LEVEL


def _say(fault: ErrorDetails, root: type[BaseModel]) -> tuple[str, str]:
    loc, kind, value = fault["loc"], fault["type"], fault["input"]
    context = fault.get("ctx", {})
    if kind == "extra_forbidden":
        return json_path(loc), _unknown(loc, root)
    if kind == "missing":
        field = _field(loc, root)
        return json_path(loc), f"this key is missing; expected {field}" if field else "this key is missing"
    if kind == "invalid_key":
        return json_path(loc[:-1]), f"the key {loc[-1]} is not a text"
    if kind == "below":
        return json_path((*loc, *context["at"])), context["text"]
    if kind == "value_error":
        return json_path(loc), str(context["error"])
    if kind in _BOUNDS:
        words, limit = _BOUNDS[kind]
        return json_path(loc), f"expected {words} {context[limit]:g}, got {show(value)}"
    if kind == "literal_error":
        return json_path(loc), one_of(value, _QUOTED.findall(context["expected"]))
    expected = _EXPECTED.get(kind) or fault["msg"].removeprefix("Input should be ")
    return json_path(loc), f"expected {expected}, got {show(value)}"


def _unknown(loc: tuple[str | int, ...], root: type[BaseModel]) -> str:
    model = _model_at(loc[:-1], root)
    word = loc[-1]
    names = spellings(model)
    if word in names:
        return f'another spelling of "{names[str(word)]}", which is there too; keep one'
    return unknown_key(word, keys_of(model))


def _field(loc: tuple[str | int, ...], root: type[BaseModel]) -> str:
    for name, info in _model_at(loc[:-1], root).model_fields.items():
        if loc[-1] in (name, info.alias, *_aliases(info.validation_alias)):
            return info.description or ""
    return ""


def _model_at(loc: Iterable[str | int], root: type[BaseModel]) -> type[BaseModel]:
    """Return the model at a location."""
    model = root
    parts = iter(loc)
    for part in parts:
        if isinstance(part, int):
            continue
        fields = model.model_fields.items()
        info = next((i for n, i in fields if part in (n, i.alias, *_aliases(i.validation_alias))), None)
        if info is None:
            break
        model = inner_model(info.annotation) or model
        if get_origin(info.annotation) is dict:
            next(parts, None)  # the name of an entry, which is no field
    return model


def inner_model(annotation: object) -> type[BaseModel] | None:
    """Return the model in an annotation such as ``tuple[Model, ...] | None``, ``None`` if there is none."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for argument in get_args(annotation):
        found = inner_model(argument)
        if found is not None:
            return found
    return None


def _aliases(alias: object) -> list[str]:
    if isinstance(alias, AliasChoices):
        return [str(choice) for choice in alias.choices]
    return [alias] if isinstance(alias, str) else []


def keys_of(model: type[BaseModel]) -> list[str]:
    """Return the keys of a model, each in its first spelling."""
    return [(_aliases(info.validation_alias) or [info.alias or name])[0] for name, info in model.model_fields.items()]


def spellings(model: type[BaseModel]) -> dict[str, str]:
    """Return every spelling of every key, with its first spelling."""
    out: dict[str, str] = {}
    for key, (name, info) in zip(keys_of(model), model.model_fields.items(), strict=True):
        for spelling in _aliases(info.validation_alias) or [info.alias or name]:
            out[spelling] = key
    return out
