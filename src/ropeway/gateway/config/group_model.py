"""Models a remote that is a group: several addresses that offer the same."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, Field, PlainSerializer, PlainValidator, WithJsonSchema, model_validator
from pydantic_core import PydanticCustomError

from ropeway.errors import InvalidName
from ropeway.gateway.config.address import parse_link
from ropeway.gateway.config.fields import Many, Model
from ropeway.gateway.config.overlay_model import OVERLAY
from ropeway.gateway.config.suggest import did_you_mean, show
from ropeway.graph.base import resolve_name
from ropeway.group.bound import STATISTICS, LatencyBound
from ropeway.group.latency import WINDOW_S

__all__ = ["Addresses", "AnycastConfig"]

MOST_MEMBERS: Final = 64


def _parse(value: object) -> str:
    if not isinstance(value, str):
        raise ValueError(f"expected a text, got {show(value)}")
    return OVERLAY if value == OVERLAY else parse_link(value)


def _addresses(value: object) -> tuple[str, ...]:
    if not isinstance(value, list | tuple):
        return (_parse(value),)
    if not 1 <= len(value) <= MOST_MEMBERS:
        raise ValueError(f"expected one address, or a list of up to {MOST_MEMBERS} that offer the same")
    found: list[str] = []
    for at, text in enumerate(value):
        try:
            address = _parse(text)
        except ValueError as error:
            raise _below(at, str(error)) from None
        if len(value) > 1 and not address.startswith(("ws:", "wss:")):
            raise _below(at, f"only ws:// and wss:// addresses can be a group, and this is {address}")
        if address in found:
            raise _below(at, f"the same address as {found.index(address)}; keep one")
        if found and address.partition(":")[0] != found[0].partition(":")[0]:
            raise _below(at, f"all addresses of a group are ws://, or all are wss://; the first is {found[0]}")
        found.append(address)
    return tuple(found)


def _below(at: object, text: str) -> PydanticCustomError:
    return PydanticCustomError("below", "{text}", {"at": at, "text": text})


def _bound(value: object) -> LatencyBound:
    if isinstance(value, LatencyBound):
        return value
    if not isinstance(value, Mapping):
        raise ValueError('expected an object such as {"median": 0.3}, in seconds')
    for name, limit in value.items():
        if isinstance(limit, bool) or not isinstance(limit, int | float) or not 0 < limit < float("inf"):
            raise _below(str(name), f"expected a number of seconds above 0, got {show(limit)}")
        try:
            LatencyBound.of({str(name): limit})
        except ValueError as error:
            raise _below(str(name), f"{error}{did_you_mean(str(name), STATISTICS)}") from None
    return LatencyBound.of({str(name): float(limit) for name, limit in value.items()})


def _names(value: dict[str, str]) -> dict[str, str]:
    for request, response in value.items():
        for name in (request, response):
            try:
                resolve_name(name)
            except InvalidName as error:
                raise _below(request, f"expected names of topics: {error}") from None
    return value


Addresses = Annotated[
    tuple[str, ...],
    PlainValidator(_addresses),
    PlainSerializer(lambda found: found[0] if len(found) == 1 else list(found)),
    WithJsonSchema(
        {"anyOf": [{"type": "string"}, {"type": "array", "minItems": 1, "items": {"type": "string"}}]},
    ),
]
"""One address, or several that offer the same."""

_Bound = Annotated[
    LatencyBound,
    PlainValidator(_bound),
    PlainSerializer(lambda bound: dict(bound.limits)),
    WithJsonSchema(
        {
            "type": "object",
            "additionalProperties": False,
            "properties": {name: {"type": "number", "exclusiveMinimum": 0} for name in STATISTICS},
            "patternProperties": {r"^p\d{1,2}(\.\d+)?$": {"type": "number", "exclusiveMinimum": 0}},
        }
    ),
]


class AnycastConfig(Model):
    """Which of several addresses, or members of the overlay, gets a request."""

    policy: Literal["one", "hedge", "all"] = Field(
        "one",
        description="one: the member that meets the bound; hedge: a second one, too, if the first is late; all: every "
        "one, and the first answer wins",
    )
    stateless: bool = Field(
        False, description="true: a request may be carried out more than once; hedge and all need it"
    )
    latency_bound: _Bound = Field(
        LatencyBound(),
        description="upper bounds in seconds on max, mean, median, min, stddev or percentiles (p99) of the latency; "
        "default: the first member that is there is used",
    )
    latency_window_s: float = Field(
        WINDOW_S, gt=0, le=3600, allow_inf_nan=False, description="how far back latencies are looked at"
    )
    responses: Annotated[dict[str, str], AfterValidator(_names)] = Field(
        {},
        description="topics that are asked on one and answered on the other: "
        '{"/yolo/input": "/yolo/output"}; the latency of topics is known from these',
    )
    members: Many[str] | None = Field(
        None, description="overlay: patterns of the names of the members that may be used; default: all"
    )
    latency_topic: str | None = Field(
        None,
        description="a topic (std_msgs/Float64) of the local graph that tells latencies of the member in use, in "
        "seconds",
    )

    @model_validator(mode="after")
    def _consistent(self) -> AnycastConfig:
        if self.policy != "one" and not self.stateless:
            why = f'"{self.policy}" asks several members, so a request may be carried out more than once'
            raise _below("policy", f'{why}; write "stateless": true if that does no harm')
        return self

    def group_options(self) -> dict[str, Any]:
        """Return what ``Group`` takes of it."""
        from ropeway.group.graph import Policy
        from ropeway.group.scheduler import Options

        return {
            "policy": Policy(self.policy),
            "bound": self.latency_bound,
            "stateless": self.stateless,
            "options": Options(window_s=self.latency_window_s),
        }
