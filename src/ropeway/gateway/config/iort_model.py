"""Models the configuration of robots of other makes, and of the store of last values."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WithJsonSchema,
    WrapValidator,
    model_validator,
)

from ropeway.errors import InvalidName, InvalidTypeName
from ropeway.gateway.config.document import read_file
from ropeway.gateway.config.fields import Many, Model
from ropeway.gateway.config.suggest import did_you_mean, one_of, show
from ropeway.graph.base import resolve_name
from ropeway.types.definition import canonical_name
from ropeway.types.forms import FORMS, RAW_TYPES

if TYPE_CHECKING:
    from ropeway.networks.iort.maps import TopicMap
    from ropeway.store import StoreLimits

__all__ = ["DIRECTIONS", "FormItem", "IortConfig", "MapItem", "MapList", "StoreConfig", "robots"]

DIRECTIONS: Final = ("both", "in", "out")
_MIB: Final = 1 << 20


def robots() -> dict[str, Any]:
    """Return the maps that come with Ropeway, by name: those of the IoRT paper's five robots."""
    from importlib import resources

    folder = resources.files("ropeway.networks.iort") / "robots"
    return {entry.name.removesuffix(".yaml"): entry for entry in folder.iterdir() if entry.name.endswith(".yaml")}


def _read_maps(text: str, directory: Path) -> list[object]:
    known = robots()
    if text in known:
        from importlib import resources

        with resources.as_file(known[text]) as path:
            found = read_file(path)
    else:
        path = directory / Path(text).expanduser()
        if not path.is_file():
            near = did_you_mean(text, known)
            raise ValueError(
                f"expected a map, the name of one that comes with Ropeway ({', '.join(sorted(known))}) or a file, "
                f"got {show(text)}{near}"
            )
        found = read_file(path)
    if isinstance(found, Mapping):
        found = found.get("maps", found)
    if not isinstance(found, list):
        raise ValueError(f"expected a list of maps in {text}")
    return found


def _type(value: str) -> str:
    try:
        return canonical_name(value, "msg")
    except InvalidTypeName:
        raise ValueError(f"expected the type of a topic, pkg/msg/Name, got {show(value)}") from None


def _name(value: str) -> str:
    try:
        return resolve_name(value)
    except InvalidName as error:
        raise ValueError(f"expected a ROS name such as /robot/cmd_vel, got {show(value)}: {error.reason}") from error


def _one_of(choices: tuple[str, ...]) -> AfterValidator:
    def check(value: str) -> str:
        if value not in choices:
            raise ValueError(one_of(value, [choice for choice in choices if choice]))
        return value

    return AfterValidator(check)


def _identifier(value: str) -> str:
    if len(value) != 2 or not (value.isascii() and value.isdigit()):
        raise ValueError(f'expected the two digits that packets of a node begin with, such as "01", got {show(value)}')
    return value


def _kind(value: str) -> str:
    from ropeway.iort import KINDS  # the library of nodes, for those who have some

    if value not in KINDS:
        raise ValueError(one_of(value, KINDS))
    return value


def _kinds(schema: dict[str, Any]) -> None:
    from ropeway.iort import KINDS

    schema["additionalProperties"] = {"enum": list(KINDS)}


def _codes(value: object) -> object:
    """Convert codes to text: YAML reads the code 0 as a number."""
    if isinstance(value, Mapping):
        return {str(code): {} if fields is None else fields for code, fields in value.items()}
    return value


def _send(value: object) -> object:
    return [str(code) for code in value] if isinstance(value, list | tuple) else value


Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class FormItem(Model):
    """Says how values of others become messages of a ROS topic: what maps of nodes and of brokers share."""

    type: Annotated[str, AfterValidator(_type)] = Field("std_msgs/msg/String", description="the type in ROS")
    form: Annotated[str, _one_of(("", *FORMS)), WithJsonSchema({"enum": ["", *FORMS]})] = Field(
        "", description=f"how it is written: {', '.join(FORMS)}; default: text for a String, else json"
    )
    name: Annotated[str, AfterValidator(_name)] | None = Field(
        None, description="the name in ROS; default: that of the topic"
    )
    direction: Annotated[str, _one_of(DIRECTIONS), WithJsonSchema({"enum": list(DIRECTIONS)})] = Field(
        "both", description="in: others publish; out: ROS does"
    )
    latched: bool = Field(False, description="true: late joiners in ROS get the last value, too")
    fields: Many[str] | dict[str, str] | None = Field(
        None, description="floats: paths of the fields in order; json: paths in ROS to paths in JSON"
    )
    codes: Annotated[dict[str, dict[str, float]], BeforeValidator(_codes)] | None = Field(
        None, description="codes: each with the fields it stands for"
    )
    send: Annotated[Many[str], BeforeValidator(_send)] | None = Field(
        None, description="codes: those that are sent; default: all"
    )
    deadband: Positive | None = Field(None, description="codes: values this close to zero are zero")
    field: str | None = Field(None, description="angle: path of the rate; default: angular.z")
    rate_rad_s: Positive | None = Field(None, description="angle: how fast to turn (rad/s); default: 0.5")
    hold_s: Positive | None = Field(None, description="angle: how long a rate holds (s) without another; default: 1")
    step_deg: Positive | None = Field(None, description="angle: the smallest angle sent (degrees); default: 5")

    @model_validator(mode="after")
    def _fits(self) -> FormItem:
        if self.form == "codes" and not self.codes:
            raise ValueError('the form codes needs "codes", such as {"0": {"linear.x": 0.2}, "4": {}}')
        if self.form == "floats" and isinstance(self.fields, dict):
            raise ValueError("the form floats has a list of fields")
        if self.form == "json" and isinstance(self.fields, tuple):
            raise ValueError('the form json has fields such as {"linear.x": "speed"}')
        if self.form == "raw" and self.type not in RAW_TYPES:
            raise ValueError(f"the form raw is for {' and '.join(RAW_TYPES)}")
        return self

    def _options(self) -> dict[str, Any]:
        """Return what is said of the form."""
        keys = ("fields", "codes", "send", "deadband", "field", "rate_rad_s", "hold_s", "step_deg")
        return {key: value for key in keys if (value := getattr(self, key)) is not None}


class MapItem(FormItem):
    """Maps a topic of IoRT nodes to a ROS topic."""

    system: str = Field(min_length=1, description="the system, or a pattern such as *")
    topic: str = Field(min_length=1, description="the topic, or a pattern")

    @model_validator(mode="after")
    def _one_topic(self) -> MapItem:
        if self.name and any(c in self.system + self.topic for c in "*?["):
            raise ValueError("a map of several topics cannot have one name")
        return self

    def as_map(self) -> TopicMap:
        """Return the map in the form that the graph uses."""
        from ropeway.networks.iort.maps import TopicMap

        name, options = self.name or "", self._options()
        return TopicMap(self.system, self.topic, self.type, self.form, name, self.direction, self.latched, options)


def _expanded(value: object, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> tuple[MapItem, ...]:
    """Expand one item of a list: to itself, or to the maps in the file, or of the name, that it gives."""
    if not isinstance(value, str):
        return (handler(value),)
    made: list[MapItem] = []
    for number, raw in enumerate(_read_maps(value, Path((info.context or {}).get("directory", ".")))):
        try:
            made.append(MapItem.model_validate(raw))
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(str(part) for part in first["loc"])
            raise ValueError(f"{value}: map {number}: {where}: {first['msg'].removeprefix('Value error, ')}") from None
    return tuple(made)


def _flat(value: tuple[object, ...]) -> tuple[object, ...]:
    return tuple(map for maps in value for map in (maps if isinstance(maps, tuple) else (maps,)))


def _or_text(schema: dict[str, Any]) -> None:
    schema["items"] = {"anyOf": [schema["items"], {"type": "string"}]}


MapList = Annotated[
    Many[Annotated[MapItem, WrapValidator(_expanded)]], AfterValidator(_flat), Field(json_schema_extra=_or_text)
]
"""Maps, names of robots and files, as one list of maps."""


class IortConfig(Model):
    """Configures robots of any make, at listeners such as iort://127.0.0.1:7410."""

    maps: MapList = Field(
        (), description="topics that are shared with ROS: maps, files of them, or names of robots such as alice"
    )
    kinds: dict[Annotated[str, AfterValidator(_identifier)], Annotated[str, AfterValidator(_kind)]] = Field(
        default_factory=dict,
        description="what plain nodes are, robot or pc, by their identifiers; those of the node library tell it",
        json_schema_extra=_kinds,
    )
    max_packet_bytes: int = Field(_MIB, ge=1024, description="a longer packet is refused")
    max_nodes: int = Field(10_000, ge=1, description="how many may be connected at a time")


class StoreConfig(Model):
    """Configures last values: of nodes, and of topics with "store": true."""

    path: str | None = Field(
        None,
        description="an SQLite file, or a directory (with a slash at its end) for JSON files; default: "
        "~/.local/state/ropeway/NAME.sqlite; memory: keeps nothing",
    )
    mongodb: str | None = Field(
        None, description="mongodb://host/database that gets all values, too; it may come and go"
    )
    max_value_bytes: int = Field(_MIB, ge=1, description="a bigger value is refused")
    max_values: int = Field(100_000, ge=1, description="how many topics have a value")
    max_bytes: int = Field(1 << 30, ge=1, description="of all values together")
    max_age_s: Positive | None = Field(None, description="older values (s) are forgotten; default: never")
    history: int = Field(0, ge=0, le=10_000, description="how many values before the last are kept of each topic")

    def limits(self) -> StoreLimits:
        """Return the limits in the form that the store uses."""
        from ropeway.store import StoreLimits

        return StoreLimits(self.max_value_bytes, self.max_values, self.max_bytes, self.max_age_s, self.history)
