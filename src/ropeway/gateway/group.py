"""A remote that is a group: several gateways or rosbridge servers that offer the same."""

from __future__ import annotations

import logging
import struct
from collections.abc import Mapping, Sequence
from typing import Any, Final

from ropeway.gateway.config.config import Route
from ropeway.gateway.config.group_model import AnycastConfig
from ropeway.gateway.config.model import RemoteConfig
from ropeway.gateway.credentials import Credentials
from ropeway.gateway.remote import Remote, link_state, link_status, shown_address
from ropeway.graph.base import Graph, Sample, Subscription
from ropeway.group.graph import Group
from ropeway.networks.rosbridge.client import RosbridgeGraph
from ropeway.types import TypeRegistry

__all__ = ["GroupRemote"]

log = logging.getLogger("ropeway.group")

_LATENCY_TYPE: Final = "std_msgs/msg/Float64"
_LATENCY: Final = struct.Struct("<d")
_LATENCY_AT: Final = 4  # behind the header of CDR


class GroupRemote(Remote):
    """Several addresses as one graph; its members are called by their addresses."""

    def __init__(
        self,
        config: RemoteConfig,
        links: Mapping[str, RosbridgeGraph],
        routes: Sequence[Route],
        registry: TypeRegistry,
        credentials: Credentials,
    ) -> None:
        super().__init__(config, credentials)
        self.links = dict(links)
        anycast = config.anycast or AnycastConfig.model_validate({})
        self.graph: Group = Group(
            links,
            name=config.title or shown_address(config),
            exchanges=_exchanges(anycast.responses, routes),
            registry=registry,
            **anycast.group_options(),
        )
        self._latency_topic = anycast.latency_topic
        self._latencies: Subscription | None = None

    async def listen(self, view: Graph) -> None:
        """Read the topic of the local graph that tells latencies, where the configuration names one."""
        if self._latency_topic is not None:
            self._latencies = await view.create_subscription(self._latency_topic, _LATENCY_TYPE, None, self._measured)

    async def close(self) -> None:
        """Read it no longer."""
        if self._latencies is not None:
            await self._latencies.close()

    def _measured(self, batch: Sequence[Sample]) -> None:
        scheduler = self.graph.scheduler
        for sample in batch:
            if scheduler.current and len(sample.payload) >= _LATENCY_AT + _LATENCY.size:
                (latency_s,) = _LATENCY.unpack_from(sample.payload, _LATENCY_AT)
                if latency_s >= 0:  # no latency is negative, and NaN is none
                    scheduler.measured(scheduler.current, latency_s, self.graph.now())

    def _renew(self, credentials: Credentials, anew: bool) -> None:
        for link in self.links.values():
            link.renew(credentials.context, credentials.headers, anew=anew)

    @property
    def state(self) -> str:
        """The state in one word; ``connected`` while a member is reached."""
        states = [link_state(link) for link in self.links.values()]
        return "connected" if "connected" in states else states[0]

    def status(self) -> dict[str, Any]:
        """Return the state of the group and its links, for people and programs."""
        return {
            "address": shown_address(self.config),
            "title": self.config.title,
            "state": self.state,
            "error": "; ".join(f"{name}: {link.last_error}" for name, link in self.links.items() if link.last_error),
            "group": self.graph.status(),
            "members": [{"address": name, **link_status(link)} for name, link in self.links.items()],
        }


def _exchanges(responses: Mapping[str, str], routes: Sequence[Route]) -> dict[str, str]:
    """Return the pairs of topics by the names that they have at the members.

    Whoever writes a configuration names topics as the local graph has them, with or without the leading slash.
    """
    remote = {route.name: route.remote_name for route in routes if route.kind == "topic"}

    def there(name: str) -> str:
        full = name if name.startswith("/") else f"/{name}"
        return remote.get(full, full)

    return {there(request): there(response) for request, response in responses.items()}
