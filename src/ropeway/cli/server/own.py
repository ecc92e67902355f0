"""The options of ``ropeway server`` as the parameters of its node, by rosbridge's names."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any, Final

import yaml

from ropeway.cli.server.parameters import WITHOUT_EFFECT
from ropeway.networks.rosbridge.server.own_parameters import OwnParameter, OwnParameters

if TYPE_CHECKING:
    from ropeway.gateway.config.foxglove_model import FoxgloveConfig
    from ropeway.gateway.gateway import Gateway

__all__ = ["declared", "declared_to_viewers", "parameters_served"]

_OPTIONS: Final = (
    *("port", "address", "url_path", "certfile", "keyfile", "retry_startup_delay", "websocket_ping_interval"),
    *("websocket_ping_timeout", "unregister_timeout", "default_call_service_timeout", "topics_glob"),
    *("topics_pub_glob", "topics_sub_glob", "services_glob", "actions_glob", "params_glob", "params_timeout"),
)
_RETRY_S: Final = 2.0  # rosbridge's, which tries again for ever
_GRAPHS: Final = ("dds", "ros2", "zenoh", "memory")  # where nodes have parameter services
_ADDRESS: Final = "127.0.0.1"


def declared(given: Mapping[str, Any], actual_port: int) -> list[OwnParameter]:
    """Return the parameters for the options ``given``, in rosbridge's types; those left out have its defaults."""
    defaults: dict[str, Any] = {"retry_startup_delay": _RETRY_S, "address": _ADDRESS}
    found = [
        OwnParameter(
            name,
            given[name] or defaults.get(name, given[name]),
            f"As --{name.replace('_', '-')} of ropeway server",
            f"start the server with --{name.replace('_', '-')}",
        )
        for name in _OPTIONS
    ]
    for name, (usual, reason) in WITHOUT_EFFECT.items():
        value = yaml.safe_load(given[name] if given.get(name) is not None else usual[0])
        found.append(OwnParameter(name, value, f"Without effect here: {reason}", "it has no effect"))
    found.append(OwnParameter("actual_port", actual_port, "The port that is listened on", "it follows from port"))
    found.append(OwnParameter("use_sim_time", False, "The server needs no clock", "the server needs no clock"))
    return sorted(found, key=lambda parameter: parameter.name)


def declared_to_viewers(settings: FoxgloveConfig, given: Mapping[str, Any], actual_port: int) -> list[OwnParameter]:
    """Return the parameters in the place of foxglove_bridge's, which tells the port that was taken as ``port``."""
    values: dict[str, Any] = {
        name: getattr(settings, name) for name in type(settings).model_fields if name != "enabled"
    }
    values |= {"port": actual_port, "address": given["address"] or _ADDRESS}
    values |= {name: given[name] for name in ("tls", "certfile", "keyfile")}
    change = "start the server with another value"
    return [
        OwnParameter(name, list(value) if isinstance(value, tuple) else value, "As in foxglove_bridge", change)
        for name, value in sorted(values.items())
    ]


@asynccontextmanager
async def parameters_served(gateway: Gateway, given: Mapping[str, Any]) -> AsyncIterator[None]:
    """Serve the parameters while the gateway runs, on a network whose nodes have such services."""
    (hub,) = gateway.hubs.values()
    if hub.graph.kind not in _GRAPHS:
        yield
        return
    view = hub.view("parameters of the server", alone=True)
    port = gateway.listening[0].listeners[0].port
    settings = gateway.config.gateway
    shown = declared_to_viewers(settings.foxglove, given, port) if given["foxglove"] else declared(given, port)
    own = OwnParameters(view, gateway.registry, f"/{settings.name}", shown)
    try:
        await own.open()
        yield
    finally:
        await own.close()
        await view.close()
