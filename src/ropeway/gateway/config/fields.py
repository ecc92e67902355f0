"""Defines what all models of a configuration share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationInfo
from pydantic_core import PydanticCustomError

__all__ = ["ExistingPath", "Many", "Model", "below"]

T = TypeVar("T")
Many = Annotated[tuple[T, ...], Field(strict=False)]


def _existing(value: str, info: ValidationInfo) -> str:
    base = Path((info.context or {}).get("directory", "."))
    path = base / Path(value).expanduser()
    if not path.exists():
        raise ValueError(f'expected an existing file or directory, "{path}" does not exist')
    return str(path.resolve())


ExistingPath = Annotated[str, AfterValidator(_existing)]


class Model(BaseModel):
    """Strict: no key that is not known, no value of another type."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid")


def below(path: tuple[str | int, ...], text: str) -> PydanticCustomError:
    """Return the fault ``text`` of what stands at ``path`` below the value that is validated."""
    return PydanticCustomError("below", "{text}", {"at": path, "text": text})
