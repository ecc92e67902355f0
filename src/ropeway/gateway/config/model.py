"""The parts of a configuration as frozen pydantic models: what each key may hold and how it is brought to one form."""

from __future__ import annotations

import re
import socket
from collections.abc import Iterable
from typing import Annotated, Final, Literal, TypeVar

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
)

from ropeway.budget import ACCOUNT_BYTES, PROCESS_BYTES, Budget
from ropeway.gateway.config.address import default_graph, parse_graph, parse_listen
from ropeway.gateway.config.audit_model import AuditItem
from ropeway.gateway.config.auth_model import AuthConfig, GlobsConfig, Secret
from ropeway.gateway.config.control_model import ControlItem
from ropeway.gateway.config.expected_model import ExpectedLink
from ropeway.gateway.config.fields import ExistingPath, Many, Model, Switch
from ropeway.gateway.config.foxglove_model import FoxgloveConfig
from ropeway.gateway.config.graph_model import Distro, GraphConfig, GraphItem
from ropeway.gateway.config.group_model import Addresses, AnycastConfig
from ropeway.gateway.config.http_model import HttpRule
from ropeway.gateway.config.iort_model import IortConfig, MapList, StoreConfig
from ropeway.gateway.config.mqtt_model import MqttTopicItem
from ropeway.gateway.config.overlay_model import (
    AutomaticConfig,
    OverlayConfig,
)
from ropeway.gateway.config.record_model import RecordItems
from ropeway.gateway.config.route_fields import Namespace, Seconds
from ropeway.gateway.config.route_model import (
    OPERATIONS,
    ActionItem,
    BridgedName,
    RenamedTopicItem,
    ServiceItem,
    TopicItem,
)
from ropeway.gateway.config.safety_model import SafetyItem
from ropeway.gateway.config.suggest import show
from ropeway.gateway.config.tls_model import ListenTls, RemoteTls
from ropeway.graph.base import resolve_name

__all__ = [
    "ClientsConfig",
    "Document",
    "GatewayConfig",
    "RemoteConfig",
]

_MIB: Final = 1 << 20
_MAX_WORKERS: Final = 256
_PART: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_INTERFACE: Final = re.compile(r"[A-Za-z0-9._:-]{1,45}")
T = TypeVar("T")


def _node_part(value: str) -> str:
    if not _PART.fullmatch(value):
        raise ValueError(f"expected letters, digits and _, not starting with a digit, got {show(value)}")
    return value


def _interface(value: str) -> str:
    if not _INTERFACE.fullmatch(value):
        raise ValueError(f"expected the name of a network interface such as wlan0, or its address, got {show(value)}")
    return value


def _url_path(value: str) -> str:
    if not value.startswith("/") or any(c in value for c in "?# "):
        raise ValueError(f"expected a path such as / or /ros, got {show(value)}")
    return value


def _workers(value: object) -> object:
    number = isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= _MAX_WORKERS
    if not number and value != "per-remote":
        wanted = f'0 (one process), up to {_MAX_WORKERS} processes or "per-remote"'
        raise ValueError(f"expected {wanted}, got {show(value)}")
    return value


def _not_empty(value: tuple[T, ...]) -> tuple[T, ...]:
    if not value:
        raise ValueError("expected at least one")
    return value


def _default_graphs() -> tuple[GraphConfig, ...]:
    try:
        address = default_graph()
    except ValueError:
        address = "dds:0"  # ``check`` tells what is wrong
    return (GraphConfig.model_validate({"address": address}),)


def _hostname() -> str:
    name = re.sub(r"[^A-Za-z0-9_]", "_", socket.gethostname().partition(".")[0])
    return name if _PART.fullmatch(name) else f"gateway_{name}".rstrip("_")


# ---------------------------------------------------------------------------------------------------- models


class RemoteConfig(Model):
    """Configures another gateway (or rosbridge server) and what crosses to and from it."""

    addresses: Addresses = Field(
        alias="address",
        description="ws://host:port or wss://host:port, overlay: everybody in the overlay, iort://host:port: a server "
        "of IoRT nodes, or mqtt://host:port or mqtts://host:port: an MQTT broker; a list of ws:// or wss:// addresses "
        "that offer the same is a group",
    )
    title: str = Field("", description="for people")
    active: Switch = Field(True, description="false: parsed and checked, but not started")
    graph: Annotated[str, AfterValidator(parse_graph)] | None = Field(
        None, description="which of gateway.graphs; default: the first"
    )
    ros: Literal[1, 2] | None = Field(
        None, description="ws, wss: which ROS a rosbridge server there belongs to; default: detected"
    )
    distro: Distro | None = Field(
        None,
        description="ws, wss: the distribution of ROS 2 whose layouts of types are used there; default: the local one. "
        "Gateways need none",
    )
    types: Many[ExistingPath] = Field(
        (), description="ws, wss: files and directories with definitions that count for this remote alone"
    )
    local_namespace: Namespace = Field("/", description="put before every local name")
    remote_namespace: Namespace = Field("/", description="put before every remote name")
    tls: RemoteTls | None = None
    unique: str | None = Field(
        None, description="overlay: makes other global names of the same names, for a deployment that stands apart"
    )
    readers: Many[str] | None = Field(
        None, description="overlay: patterns of the members that may read what is published; default: all"
    )
    callers: Many[str] | None = Field(
        None, description="overlay: patterns of the members that may call what is exposed; default: all"
    )
    maps: MapList = Field((), description="iort: how topics of nodes map to ROS topics, as in gateway.iort.maps")
    topics: Many[MqttTopicItem] = Field(
        (), description="mqtt: types, forms and names of topics of the broker; the first that matches counts"
    )
    user: str | None = Field(None, min_length=1, description="mqtt: the user, as the broker knows it")
    password: Secret | None = Field(None, description='mqtt: of the user: {"env": "NAME"} or {"file": "PATH"}')
    automatic: AutomaticConfig | None = Field(
        None, description="overlay: topics are offered and fetched as the local graph needs"
    )
    anycast: AnycastConfig | None = Field(
        None, description="of a group: which address gets a request; overlay: the members that offer the same are one"
    )
    interfaces: Many[Annotated[str, AfterValidator(_interface)]] = Field(
        (),
        description="ws, wss: network interfaces (wlan0), or addresses that they have, to dial by; several are used at "
        "once",
    )
    links: Literal["best", "duplicate"] | None = Field(
        None,
        description="of several interfaces: best (default), the one that is quick and steady; duplicate: all at once, "
        "and the first copy counts",
    )
    link: ExpectedLink | None = Field(
        None, description="what the link carries, for ropeway predict and for a warning where topics do not fit"
    )
    token: Secret | None = Field(None, description='shown to the remote: {"env": "NAME"} or {"file": "PATH"}')
    publish: Many[TopicItem] = Field((), description="topics sent to the remote")
    subscribe: Many[TopicItem] = Field((), description="topics fetched from the remote")
    trans_publish: Many[RenamedTopicItem] = Field(
        (), alias="trans-publish", description="topics sent to the remote under another name"
    )
    expose_service: Many[ServiceItem] = Field((), alias="expose-service", description="local services offered there")
    reserve_service: Many[ServiceItem] = Field((), alias="reserve-service", description="remote services offered here")
    expose_action: Many[ActionItem] = Field((), alias="expose-action", description="local actions offered there")
    reserve_action: Many[ActionItem] = Field((), alias="reserve-action", description="remote actions offered here")

    @property
    def address(self) -> str:
        """The address; of a group all of them, with commas between."""
        return ",".join(self.addresses)

    def items(self) -> Iterable[tuple[str, int, BridgedName]]:
        """Yield every ``(operation, index, item)``, in the order of ``OPERATIONS``."""
        for operation in OPERATIONS:
            for index, item in enumerate(getattr(self, operation.replace("-", "_"))):
                yield operation, index, item

    @property
    def lasts(self) -> bool:
        """Whether it stays up while all its routes are paused: a group, which would have to find its best anew."""
        group = self.anycast is not None or len(self.addresses) > 1
        return self.automatic is not None or (group and any(True for _ in self.items()))

    def names(self, item: BridgedName) -> tuple[str, str]:
        """Return the absolute local and remote names of an item.

        Namespaces stand before ``name``, with or without its leading slash; a ``remote_name`` with a leading slash
        is taken as it is.
        """
        shared = item.name.lstrip("/")
        remote = item.remote_name or shared
        return resolve_name(shared, self.local_namespace), resolve_name(remote, self.remote_namespace)


class ClientsConfig(Model):
    """Says how the listeners treat rosbridge clients."""

    path: Annotated[str, AfterValidator(_url_path)] = Field("/", description="the path of the WebSocket")
    max_clients: int = Field(1000, ge=1, description="how many may be connected at a time, per worker")
    unregister_timeout_s: float = Field(
        10.0, ge=0, allow_inf_nan=False, description="how long a topic stays advertised after its last client"
    )
    call_timeout_s: float = Field(
        5.0, ge=0, allow_inf_nan=False, description="for service calls that give no timeout; 0: no limit"
    )
    params_timeout_s: float = Field(5.0, gt=0, allow_inf_nan=False, description="how long rosapi waits for a node")
    ping_interval_s: Seconds = Field(5.0, description="how often a client is pinged; gateways are every second")
    silence_s: Seconds = Field(30.0, description="a client that has been silent for this long is disconnected")
    cancel_goals: bool = Field(True, description="the goals of a client that leaves are cancelled; false: they go on")
    publish_clients: bool = Field(True, description="/client_count and /connected_clients are published")
    publish_rosout: bool = Field(True, description="warnings and errors of the gateway are published on /rosout")


class GatewayConfig(Model):
    """The gateway itself."""

    name: Annotated[str, AfterValidator(_node_part)] = Field(
        default_factory=_hostname, description="the name that others see; default: from the host name"
    )
    networks: Annotated[Many[GraphItem], AfterValidator(_not_empty)] = Field(
        default_factory=_default_graphs,
        alias="graphs",
        description="the local networks: dds:<domain> (without ROS), ros2 or ros2:<domain> (through the sourced ROS 2, "
        "any RMW), auto (ros2 where ROS 2 is sourced, else dds), ros1 or ros1:http://host:11311 (a ROS 1 master), "
        "zenoh or zenoh:tcp/host:7447 (nodes on rmw_zenoh, without ROS), mqtt://host:port or mqtts://host:port (the "
        "topics of a broker); left out: dds with ROS_DOMAIN_ID. An object with address, distro, types and topics says "
        "more of a network",
    )
    listen: Many[Annotated[str, AfterValidator(parse_listen)]] = Field(
        ("ws://127.0.0.1:9090",),
        description="where other gateways, rosbridge clients and Foxglove viewers connect (ws, wss), viewers alone "
        "(foxglove, foxgloves) and IoRT nodes (iort, iorts); "
        "[] for nowhere, which is the default where active remotes are named",
    )
    insecure: bool = Field(False, description="true allows listeners that other machines reach without authentication")
    tls: ListenTls | None = Field(None, description="for wss:// and other secure listeners")
    auth: AuthConfig = Field(default_factory=dict, validate_default=True, description="who may connect, and do what")
    globs: GlobsConfig = Field(
        default_factory=dict, validate_default=True, description="rosbridge's globs, for all clients"
    )
    overlay: OverlayConfig | None = Field(None, description="membership of the overlay, for remotes with that address")
    iort: IortConfig = Field(default_factory=dict, validate_default=True, description="robots of other makes")
    store: StoreConfig | None = Field(
        None,
        description='last values; there also without this where a listener is iort:// or a topic has "store": true',
    )
    http: Many[HttpRule] = Field(
        (), description="topics that are posted to URLs, and URLs that are offered as services"
    )
    rest: bool = Field(
        False, description="true: topics and services are also REST resources at ws and wss listeners, below /ros"
    )
    safety: Many[SafetyItem] = Field(
        (), description="topics of commands, whoever publishes them through the gateway: lease, limits, drivers"
    )
    diagnostics: bool = Field(
        False, description="how links and routes are is published on /diagnostics of the local networks (REP 107)"
    )
    clients: ClientsConfig = Field(
        default_factory=dict, validate_default=True, description="how rosbridge clients are served"
    )
    foxglove: FoxgloveConfig = Field(
        default_factory=dict, validate_default=True, description="what Foxglove viewers are shown"
    )
    control: ControlItem = Field(
        default_factory=dict,
        validate_default=True,
        description="how the running gateway is seen and changed; false: not at all",
    )
    audit: AuditItem = Field(
        default_factory=dict,
        validate_default=True,
        description="the log of who changed, commanded, was denied or disconnected; false: none",
    )
    record: RecordItems = Field(
        (),
        description="recorders of what crosses, of links and networks, all the time or around what happens",
    )
    workers: Annotated[
        Annotated[int, Field(ge=0, le=_MAX_WORKERS)] | Literal["per-remote"], BeforeValidator(_workers)
    ] = Field(0, description='0: one process; a number of processes; or "per-remote"')
    types: Many[ExistingPath] = Field((), description="files and directories with .msg, .srv and .action definitions")
    max_message_bytes: int = Field(64 * _MIB, ge=1024, description="a longer message closes its connection")
    max_connection_bytes: int | None = Field(
        None,
        ge=1 << 20,
        description="what one connection may have the gateway hold in memory (128 MiB, or twice the longest message); "
        "more closes it",
    )
    max_held_bytes: int | None = Field(
        None,
        ge=1 << 20,
        description="what all connections of a process may have it hold in memory (512 MiB, or eight times the longest "
        "message): then nobody else may connect, and who holds the most is closed",
    )

    @property
    def graphs(self) -> tuple[str, ...]:
        """The addresses of the local networks."""
        return tuple(network.address for network in self.networks)

    def budget(self) -> Budget:
        """Return the bounds on what connections may have a process hold."""
        largest = self.max_message_bytes
        return Budget(
            limit_bytes=self.max_held_bytes or max(PROCESS_BYTES, 8 * largest),
            account_limit_bytes=self.max_connection_bytes or max(ACCOUNT_BYTES, 2 * largest),
        )


class Document(Model):
    """The full form."""

    schema_: str = Field("", alias="$schema", description="for editors; ignored")
    gateway: GatewayConfig = Field(default_factory=dict, validate_default=True, description="the gateway itself")
    anycast: AnycastConfig | None = Field(None, description="for every remote that is a group and says nothing else")
    remotes: Many[RemoteConfig] = Field((), description="the other gateways and what crosses to them")
