"""The answers of control APIs as pages use them. What a gateway sends is checked here, once, and nowhere else.

A key that is missing has a default, for gateways of other versions; one of another type is a ``ControlRefused``.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError

from ropeway.errors import ControlRefused

__all__ = [
    "AuditPageAnswer",
    "AuditRow",
    "CallerRow",
    "ConfigAnswer",
    "EventRow",
    "ExplanationRow",
    "FindingRow",
    "FleetMemberRow",
    "GraphRow",
    "GroupRow",
    "HistoryRow",
    "LatencyRow",
    "LinkRow",
    "MemberRow",
    "PictureAnswer",
    "PlanAnswer",
    "RouteRow",
    "SessionRow",
    "SessionTopicRow",
    "StatusAnswer",
    "StepRow",
    "StoreRow",
    "TopicRow",
    "ValueAnswer",
    "read",
]

_SHOWN_CHARACTERS: Final = 500
_BAD_GATEWAY: Final = 502  # of HTTP: what stands behind gave no usable answer

T = TypeVar("T")


def _clipped(value: Any) -> Any:
    """Return a text that can be shown and sent to a browser."""
    if not isinstance(value, str):
        return value
    whole = value.encode("utf-8", "replace").decode()  # JSON may hold halves of characters
    return whole if len(whole) <= _SHOWN_CHARACTERS else whole[:_SHOWN_CHARACTERS] + "…"


Text = Annotated[str, BeforeValidator(_clipped)]
Counts = dict[Text, float]


class _Row(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)


class CallerRow(_Row):
    """The name and the rights that a gateway gives us."""

    name: Text = ""
    rights: frozenset[str] = frozenset()


class GraphRow(_Row):
    """A network that a gateway has joined."""

    graph: Text
    topics: int = 0
    nodes: int = 0


class FleetMemberRow(_Row):
    """A gateway of the overlay, as another one sees it."""

    name: Text = ""
    gateway: Text = ""
    path: Text = ""
    names: int = 0


class OverlayRow(_Row):
    """The overlay that a remote stands for: its fleet, its other members and the routers that are linked."""

    fleet: Text = ""
    expires: Text = ""
    trouble: Text | None = None
    routers: list[Text] = Field(default_factory=list)
    gateways: list[FleetMemberRow] = Field(default_factory=list)


class LinkRow(_Row):
    """A remote of a gateway. ``gateway`` is the name by which the other end calls itself."""

    address: Text
    title: Text = ""
    state: Text = ""
    error: Text = ""
    gateway: Text | None = None
    rtt_ms: float | None = None
    pace_bps: float | None = None
    bytes_in: float | None = None
    bytes_out: float | None = None
    overlay: OverlayRow | None = None


class RouteRow(_Row):
    """A route of a gateway."""

    key: Text = ""
    operation: Text = ""
    name: Text
    remote_name: Text = ""
    address: Text = ""
    type: Text = ""
    state: Text = ""
    error: Text = ""
    reason: Text = ""
    encoding: Text = ""
    publishers: int | None = None
    readers: int | None = None
    rate_hz: float | None = None
    bandwidth_bps: float | None = None
    delay_ms: float | None = None
    took_ms: float | None = None
    drops: Counts = Field(default_factory=dict)

    @property
    def why(self) -> str:
        """The error, or else the reason for which nothing crosses."""
        return self.error or self.reason

    @property
    def inward(self) -> bool:
        """Whether messages come from the remote."""
        return self.operation in ("subscribe", "reserve-service", "reserve-action")


class SessionTopicRow(_Row):
    """A topic of a client."""

    name: Text
    direction: Text = ""
    rate_hz: float | None = None


class SessionRow(_Row):
    """A client of a gateway."""

    peer: Text
    since: float = 0.0
    agent: Text = ""
    gateway: Text = ""
    dialect: Text = ""
    role: Text = ""
    bytes_in: float = 0
    bytes_out: float = 0
    denied: Counts = Field(default_factory=dict)
    topics: list[SessionTopicRow] = Field(default_factory=list)


class StatusAnswer(_Row):
    """The state of a gateway."""

    name: Text
    graphs: list[GraphRow] = Field(default_factory=list)
    remotes: list[LinkRow] = Field(default_factory=list)
    routes: list[RouteRow] = Field(default_factory=list)
    sessions: list[SessionRow] = Field(default_factory=list)
    safety: list[dict[str, Any]] = Field(default_factory=list)
    store: dict[str, Any] | None = None
    nodes: dict[str, Any] | None = None
    failed: list[Any] = Field(default_factory=list)


class EventRow(_Row):
    """An event in a gateway."""

    number: int
    time: float
    kind: Text = ""
    name: Text = ""
    state: Text = ""
    before: Text = ""
    why: Text = ""
    action: Text = ""
    who: Text = ""


class FindingRow(_Row):
    """A step of an explanation; ``ok`` is ``None`` where it decides nothing."""

    subject: Text = ""
    ok: bool | None = None
    text: Text = ""


class ExplanationRow(_Row):
    """The reasons for which a name crosses or does not."""

    name: Text = ""
    source: Text = ""
    target: Text = ""
    crosses: bool | None = None
    findings: list[FindingRow] = Field(default_factory=list)


class StepRow(_Row):
    """A step of a plan."""

    action: Text = ""
    what: Text = ""
    name: Text = ""
    details: list[Text] = Field(default_factory=list)
    interrupts: Text = ""


class PlanAnswer(_Row):
    """The steps of a change of the configuration."""

    steps: list[StepRow] = Field(default_factory=list)
    unchanged_routes: int = 0
    restart: list[Text] = Field(default_factory=list)


class ConfigAnswer(_Row):
    """The configuration that runs."""

    etag: str = ""
    source: Text = ""
    config: dict[str, Any]


class LatencyRow(_Row):
    """The latencies of a member of a group, in seconds."""

    answered: int = 0
    pending: int = 0
    min: float = 0.0
    median: float = 0.0
    mean: float = 0.0
    max: float = 0.0
    p99: float = 0.0


class MemberRow(_Row):
    """A member of a group."""

    here: bool = False
    standing: Text = ""
    latency_s: LatencyRow | None = None
    in_flight: int = 0


class GroupRow(_Row):
    """A group, as its scheduler sees it."""

    group: Text
    policy: Text = ""
    phase: Text = ""
    held: bool = False
    current: Text | None = None
    members: dict[Text, MemberRow] = Field(default_factory=dict)
    decisions: list[Text] = Field(default_factory=list)


class StoreRow(_Row):
    """A value of the store."""

    system: Text
    topic: Text
    type: Text = ""
    origin: Text = ""
    age_s: float = 0.0
    bytes: int = 0
    text: Text = ""


class HistoryRow(_Row):
    """A change of a configuration."""

    number: int
    time: float = 0.0
    who: Text = ""
    where: Text = Field("", alias="from")
    action: Text = ""
    note: Text = ""
    state: Text = ""
    steps: list[StepRow] = Field(default_factory=list)


class TopicRow(_Row):
    """A topic on the networks of a gateway."""

    name: Text
    type: Text = ""
    graph: Text = ""
    publishers: int = 0
    readers: int = 0


class PictureAnswer(_Row):
    """A picture of an image."""

    media_type: Literal["image/png", "image/jpeg"]
    base64: Annotated[str, Field(pattern=r"^[A-Za-z0-9+/=]*$")]


class ValueAnswer(_Row):
    """The newest message of a topic; ``value`` only where it is a new one."""

    type: Text = ""
    count: int = 0
    rate_hz: float = 0.0
    bandwidth_bps: float = 0.0
    bytes: int = 0
    value: Any = None
    picture: PictureAnswer | None = None
    error: Text = ""


class AuditRow(_Row):
    """An entry of the audit log."""

    number: int = 0
    time: float = 0.0
    kind: Text = ""
    operation: Text = ""
    name: Text = ""
    who: Text = ""
    where: Text = ""
    outcome: Text = ""
    why: Text = ""
    times: int = 1


class AuditPageAnswer(_Row):
    """Entries of the audit log, the oldest first."""

    entries: list[AuditRow] = Field(default_factory=list)
    lost: int = 0
    error: Text = ""


def read(shape: type[T], value: Any) -> T:
    """Return an answer in a shape. Raises ``ControlRefused`` for what has another."""
    try:
        return TypeAdapter(shape).validate_python(value)
    except (ValidationError, RecursionError) as error:
        said = ""
        if isinstance(error, ValidationError):
            fault = error.errors(include_url=False, include_input=False)[0]
            said = f": {'.'.join(map(str, fault['loc']))[:100]}: {fault['msg']}"
        raise ControlRefused(
            _BAD_GATEWAY, f"this is not the answer of a gateway that this dashboard knows{said}"
        ) from None
