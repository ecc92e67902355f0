"""Names the modules that parts of a configuration need, and that a gateway without such parts has not loaded."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from ropeway.gateway.config.address import is_foxglove, is_iort, is_mqtt
from ropeway.gateway.config.config import Config
from ropeway.gateway.config.model import GatewayConfig, RemoteConfig
from ropeway.gateway.config.overlay_model import OVERLAY

__all__ = ["needed_modules"]

_OVERLAY: Final = ("ropeway.networks.overlay.node", "ropeway.networks.overlay.graph")
_MQTT: Final = ("ropeway.networks.mqtt.graph", "ropeway.networks.mqtt.maps")
_RECORDING: Final = (
    "ropeway.gateway.recording.recorder",
    "ropeway.gateway.recording.route_tap",
    "ropeway.gateway.recording.link_report",
)
_NETWORKS: Final[Mapping[str, Sequence[str]]] = {
    "auto": ("ropeway.networks.dds.graph", "ropeway.networks.ros2"),
    "dds": ("ropeway.networks.dds.graph",),
    "memory": ("ropeway.networks.memory.graph",),
    "mqtt": _MQTT,
    "mqtts": _MQTT,
    "overlay": _OVERLAY,
    "ros1": ("ropeway.networks.ros1",),
    "ros2": ("ropeway.networks.ros2",),
    "zenoh": ("ropeway.networks.zenoh.graph",),
}


def needed_modules(config: Config) -> Iterator[str]:
    """Yield the modules that the networks, listeners, remotes and routes of a configuration are made with.

    They are still imported where they are used; this is to have them loaded before that happens on a loop that carries
    messages.
    """
    yield from _of_gateway(config.gateway)
    if config.safeties():
        yield "ropeway.gateway.safety"
    if config.stores:
        yield from ("ropeway.store", "ropeway.listener.store_pages")
    for remote in config.remotes:
        if remote.active:
            yield from _of_remote(remote)
    for route in config.routes():
        if route.options.store:
            yield "ropeway.gateway.last_value"
        if route.options.audit:
            yield "ropeway.gateway.audit"


def _of_gateway(settings: GatewayConfig) -> Iterator[str]:
    for network in settings.networks:
        yield from _NETWORKS.get(network.address.partition(":")[0].partition("?")[0], ())
        if network.distro or network.types:
            yield "ropeway.types.variant"
    for url in settings.listen:
        if is_iort(url):
            yield "ropeway.gateway.nodes"
        elif is_foxglove(url):
            yield "ropeway.gateway.viewers"
        else:
            yield from ("ropeway.gateway.client_server", "ropeway.gateway.pages")
            if settings.foxglove.enabled:
                yield "ropeway.gateway.viewers"
            if settings.rest:
                yield "ropeway.gateway.rest.pages"
    if settings.http:
        yield "ropeway.gateway.rest.outgoing"
    if settings.diagnostics:
        yield "ropeway.gateway.diagnostics"
    if settings.record:
        yield from _RECORDING
    if settings.tls is not None:
        yield "cryptography.x509"


def _of_remote(remote: RemoteConfig) -> Iterator[str]:
    if remote.address == OVERLAY:
        yield from _OVERLAY
        if remote.anycast is not None:
            yield from ("ropeway.gateway.group", "ropeway.networks.overlay.graph.pool")
        if remote.automatic is not None:
            yield "ropeway.gateway.automatic"
    elif is_iort(remote.address):
        yield "ropeway.networks.iort.graph"
    elif is_mqtt(remote.address):
        yield from _MQTT
    elif len(remote.addresses) > 1:
        yield "ropeway.gateway.group"
    elif len(remote.interfaces) > 1:
        yield "ropeway.gateway.links"
