"""Says what a gateway records of what crosses it, and around what: ``gateway.record``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo, WithJsonSchema, model_validator

from ropeway.gateway.config.address import parse_graph
from ropeway.gateway.config.auth_model import Pattern
from ropeway.gateway.config.fields import Many, Model, Switch
from ropeway.gateway.config.route_fields import Seconds
from ropeway.gateway.config.suggest import one_of, show
from ropeway.recording.condition import Condition
from ropeway.recording.mcap_writer import COMPRESSIONS

__all__ = ["RecordConfig", "RecordItems"]

_MIB: Final = 1 << 20
_GIB: Final = 1 << 30
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,62}")
_FILES_KEPT: Final = 8  # files that the room is divided into, where nobody says how large they are
_LARGEST_FILE_BYTES: Final = 512 * _MIB


def _name(value: str) -> str:
    if not _NAME.fullmatch(value):
        raise ValueError(f"expected letters, digits, _, - and ., as it names a directory, got {show(value)}")
    return value


def _place(value: str, info: ValidationInfo) -> str:
    base = Path((info.context or {}).get("directory", "."))
    return str((base / Path(value).expanduser()).resolve())


def _compression(value: str) -> str:
    if value not in COMPRESSIONS:
        raise ValueError(one_of(value, COMPRESSIONS))
    return value


def _condition(value: str) -> str:
    Condition(value)
    return value


class RecordConfig(Model):
    """A recorder: what it takes, where it writes, and when."""

    name: Annotated[str, AfterValidator(_name)] = Field(
        "recording", description="tells recorders apart; its files are in a directory of this name"
    )
    directory: Annotated[str, AfterValidator(_place)] | None = Field(
        None, description="where the directories of recorders are; default: in the user's state directory"
    )
    active: Switch = Field(True, description="false: it waits for an order to start (ropeway record --start)")
    routes: Many[Pattern] = Field(
        ("*",), description="patterns of the local names of topics that cross; what crosses is recorded"
    )
    topics: Many[Pattern] = Field(
        (), description="patterns of topics that a local network has, whether they cross or not"
    )
    graph: Annotated[str, AfterValidator(parse_graph)] | None = Field(
        None, description="which of gateway.graphs topics and when are on; default: the first"
    )
    exclude: Many[Pattern] = Field((), description="patterns of names that are left out of both")
    link_state: bool = Field(
        True, description="the states, round trips and paces of links and what routes drop are recorded, too, as JSON"
    )
    compression: Annotated[str, AfterValidator(_compression), WithJsonSchema({"enum": list(COMPRESSIONS)})] = Field(
        "none", description="of the files: none, lz4 or zstd"
    )
    split_bytes: int | None = Field(
        None, ge=_MIB, description="a file that has so much is followed by another; default: 512 MiB at most"
    )
    split_s: Seconds | None = Field(None, description="a file is also followed by another after so many seconds")
    keep_bytes: int = Field(
        10 * _GIB, ge=4 * _MIB, description="all files of the recorder together; the oldest are removed for new ones"
    )
    ring_s: Seconds | None = Field(
        None, description="keep the last seconds in memory, and write them when something happens; default: write all"
    )
    ring_bytes: int = Field(256 * _MIB, ge=_MIB, description="what the ring takes in memory at most")
    after_s: float = Field(10.0, ge=0, le=600, allow_inf_nan=False, description="seconds of a clip after what happened")
    when: Many[Annotated[str, AfterValidator(_condition)]] = Field(
        (), description='conditions that trigger a clip, such as "/battery.percentage < 0.2"'
    )
    link_loss: bool = Field(False, description="true: the loss of a link triggers a clip")

    @model_validator(mode="after")
    def _fits(self) -> RecordConfig:
        if self.ring_s is None and (self.when or self.link_loss):
            raise ValueError("when and link_loss trigger clips, which need ring_s: how many seconds before it?")
        if self.split_bytes is not None and 2 * self.split_bytes > self.keep_bytes:
            raise ValueError("keep_bytes has to have room for two files of split_bytes at least")
        if not (self.routes or self.topics or self.link_state):
            raise ValueError("nothing to record: name routes or topics")
        return self

    @property
    def file_bytes(self) -> int:
        """The size of a file that is followed by another."""
        return self.split_bytes or min(self.keep_bytes // _FILES_KEPT, _LARGEST_FILE_BYTES)


def _listed(value: object) -> Any:
    return [value] if isinstance(value, Mapping | RecordConfig) else value


def _different(value: tuple[RecordConfig, ...]) -> tuple[RecordConfig, ...]:
    names = [one.name for one in value]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f'two recorders are called "{name}"; give one of them another name')
    return value


RecordItems = Annotated[
    Many[RecordConfig],
    BeforeValidator(_listed),
    AfterValidator(_different),
    WithJsonSchema(
        {"anyOf": [{"$ref": "#/$defs/RecordConfig"}, {"type": "array", "items": {"$ref": "#/$defs/RecordConfig"}}]}
    ),
]
"""One recorder, or several."""
