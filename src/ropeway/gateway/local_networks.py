"""Opens the local networks of a gateway."""

from __future__ import annotations

import asyncio
import logging
from typing import Any, Final

from ropeway.errors import GraphUnavailable
from ropeway.extras import require
from ropeway.gateway.config.address import is_mqtt
from ropeway.gateway.config.graph_model import GraphConfig
from ropeway.graph.base import Graph
from ropeway.networks.factory import open_graph
from ropeway.types import TypeRegistry

__all__ = ["open_network"]

log = logging.getLogger("ropeway.gateway")

_MASTER_S: Final = 30.0
_MASTER_PAUSE_S: Final = 0.5


async def open_network(network: GraphConfig, *, registry: TypeRegistry, name: str, gateway_id: str) -> Graph:
    """Open a network, waiting for a ROS 1 master that starts a little later than its robot's gateway."""
    loop, url = asyncio.get_running_loop(), network.address
    deadline = loop.time() + (_MASTER_S if url.partition(":")[0] == "ros1" else 0.0)
    waits = False
    options = _broker_options(network) if is_mqtt(url) else {}
    while True:
        try:
            return await open_graph(
                url,
                registry=registry,
                name=name,
                gateway_id=gateway_id,
                distro=network.distro,
                types=network.types,
                **options,
            )
        except GraphUnavailable as error:
            if loop.time() >= deadline:
                raise
            if not waits:
                log.warning("%s; waiting for it, %g s at most", error, _MASTER_S)
                waits = True
        await asyncio.sleep(_MASTER_PAUSE_S)


def _broker_options(network: GraphConfig) -> dict[str, Any]:
    """Return what the graph of a broker is told: it may come later, and its topics have these maps."""
    require("mqtt", "an MQTT broker")
    from ropeway.networks.mqtt.maps import MqttMaps

    return {"wait_s": 0.0, "maps": MqttMaps(item.as_map() for item in network.topics)}
