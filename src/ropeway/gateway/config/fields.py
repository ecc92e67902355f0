"""Defines what all models of a configuration share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo, WithJsonSchema
from pydantic_core import PydanticCustomError

__all__ = ["ExistingPath", "Many", "Model", "Switch", "below"]

T = TypeVar("T")
Many = Annotated[tuple[T, ...], Field(strict=False)]


def _existing(value: str, info: ValidationInfo) -> str:
    base = Path((info.context or {}).get("directory", "."))
    path = base / Path(value).expanduser()
    if not path.exists():
        raise ValueError(f'expected an existing file or directory, "{path}" does not exist')
    return str(path.resolve())


ExistingPath = Annotated[str, AfterValidator(_existing)]


def _switch(value: object) -> object:
    if isinstance(value, str) and value.lower() in ("true", "false"):
        return value.lower() == "true"
    return value


Switch = Annotated[
    bool,
    BeforeValidator(_switch),
    WithJsonSchema({"anyOf": [{"type": "boolean"}, {"type": "string", "pattern": "^([Tt]rue|[Ff]alse|TRUE|FALSE)$"}]}),
]
"""A truth value, which may be written as a text."""


class Model(BaseModel):
    """Strict: no key that is not known, no value of another type."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", defer_build=True)  # only what is used is built


def below(path: tuple[str | int, ...], text: str) -> PydanticCustomError:
    """Return the fault ``text`` of what stands at ``path`` below the value that is validated."""
    return PydanticCustomError("below", "{text}", {"at": path, "text": text})
