"""Models a remote that is a group: several addresses that offer the same."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, Field, PlainSerializer, PlainValidator, WithJsonSchema, model_validator

from ropeway.errors import InvalidName
from ropeway.gateway.config.address import parse_link
from ropeway.gateway.config.fields import Many, Model, below
from ropeway.gateway.config.overlay_model import OVERLAY
from ropeway.gateway.config.policy_model import ROBOT, SERVICE, Parameters, States, lift
from ropeway.gateway.config.suggest import did_you_mean, show
from ropeway.graph.base import resolve_name
from ropeway.group.bound import STATISTICS, LatencyBound
from ropeway.group.latency import WINDOW_S
from ropeway.group.options import PAUSE_S, PROFILE_S

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
            raise below((at,), str(error)) from None
        if len(value) > 1 and not address.startswith(("ws:", "wss:")):
            raise below((at,), f"only ws:// and wss:// addresses can be a group, and this is {address}")
        if address in found:
            raise below((at,), f"the same address as {found.index(address)}; keep one")
        if found and address.partition(":")[0] != found[0].partition(":")[0]:
            raise below((at,), f"all addresses of a group are ws://, or all are wss://; the first is {found[0]}")
        found.append(address)
    return tuple(found)


def _bound(value: object) -> LatencyBound:
    if isinstance(value, LatencyBound):
        return value
    if not isinstance(value, Mapping):
        raise ValueError('expected an object such as {"median": 0.3}, in seconds')
    for name, limit in value.items():
        if isinstance(limit, bool) or not isinstance(limit, int | float) or not 0 < limit < float("inf"):
            raise below((str(name),), f"expected a number of seconds above 0, got {show(limit)}")
        try:
            LatencyBound.of({str(name): limit})
        except ValueError as error:
            raise below((str(name),), f"{error}{did_you_mean(str(name), STATISTICS)}") from None
    return LatencyBound.of({str(name): float(limit) for name, limit in value.items()})


def _names(value: dict[str, str]) -> dict[str, str]:
    for request, response in value.items():
        for name in (request, response):
            try:
                resolve_name(name)
            except InvalidName as error:
                raise below((request,), f"expected names of topics: {error}") from None
    return value


def _topic(value: str | None) -> str | None:
    if value is not None:
        try:
            resolve_name(value)
        except InvalidName as error:
            raise ValueError(f"expected the name of a topic: {error.reason}") from None
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
    """Chooses which of several addresses, or members of the overlay, gets a request."""

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
    latency_topic: Annotated[str | None, AfterValidator(_topic)] = Field(
        None,
        description="a topic (std_msgs/Float64) of the local graph that tells latencies of the member in use, in "
        "seconds",
    )

    action_latency: Literal["accepted", "result"] = Field(
        "accepted", description="what the latency of an action is: the time until a goal is accepted, or has succeeded"
    )
    profile_s: float = Field(
        PROFILE_S, gt=0, le=10, allow_inf_nan=False, description="how long each address is asked at the start"
    )
    pause_s: float = Field(
        PAUSE_S, ge=0, le=60, allow_inf_nan=False, description="how long nothing is judged after that"
    )
    state_definition: States = Field(
        {}, description="FogROS2-LS: topics (pub or sub) and params of robot, service, standby and states of one's own"
    )
    params: Parameters = Field({}, description="FogROS2-LS: parameters that the robot sets")
    initial_policy: dict[str, str] = Field(
        {},
        description="FogROS2-LS: the state in which each machine begins, the robot and the addresses",
    )
    machines: dict[str, str] = Field(
        {}, description="which address a machine of initial_policy has; default: in the order of address"
    )

    @model_validator(mode="before")
    @classmethod
    def _listing(cls, value: object) -> object:
        return lift(value)

    @model_validator(mode="after")
    def _consistent(self) -> AnycastConfig:
        if self.policy != "one" and not self.stateless:
            why = f'"{self.policy}" asks several members, so a request may be carried out more than once'
            raise below(("policy",), f'{why}; write "stateless": true if that does no harm')
        return self

    @property
    def pairs(self) -> dict[str, str]:
        """The topics that are asked on and answered on: as ``responses`` says, else as the states do.

        They say it where the robot publishes one topic that the service reads, and reads one that it publishes.
        """
        if self.responses:
            return dict(self.responses)
        robot, service = (self.state_definition.get(name) for name in (ROBOT, SERVICE))
        if robot is None or service is None:
            return {}
        asked = [t for t, way in robot.topics.items() if way == "pub" and service.topics.get(t) == "sub"]
        answered = [t for t, way in robot.topics.items() if way == "sub" and service.topics.get(t) == "pub"]
        return {asked[0]: answered[0]} if len(asked) == len(answered) == 1 else {}

    def group_options(self) -> dict[str, Any]:
        """Return what ``Group`` takes of it."""
        from ropeway.group.graph import Policy
        from ropeway.group.scheduler import Options

        return {
            "policy": Policy(self.policy),
            "bound": self.latency_bound,
            "stateless": self.stateless,
            "options": Options(
                window_s=self.latency_window_s,
                profile_s=self.profile_s,
                pause_s=self.pause_s,
                judge_results=self.action_latency == "result",
            ),
        }
