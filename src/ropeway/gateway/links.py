"""A remote that is reached over several links at once, each by a network interface of its own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ropeway.gateway.config.model import RemoteConfig
from ropeway.gateway.credentials import Credentials
from ropeway.gateway.remote import Remote, link_state, link_status, shown_address
from ropeway.group.links import LinkGroup
from ropeway.networks.rosbridge.client.by_interface import InterfaceGraph
from ropeway.types import TypeRegistry

__all__ = ["LinksRemote"]


class LinksRemote(Remote):
    """A gateway at an address that several links lead to; they are called by their interfaces."""

    def __init__(
        self,
        config: RemoteConfig,
        links: Mapping[str, InterfaceGraph],
        registry: TypeRegistry,
        credentials: Credentials,
    ) -> None:
        super().__init__(config, credentials)
        self.links = dict(links)
        name = config.title or shown_address(config)
        self.graph: LinkGroup = LinkGroup(links, name=name, duplicate=config.links == "duplicate", registry=registry)

    def begin_watch(self) -> None:
        """See ``Remote.begin_watch``."""
        for link in self.links.values():
            link.begin_watch()

    def _renew(self, credentials: Credentials, anew: bool) -> None:
        for link in self.links.values():
            link.renew(credentials.context, credentials.headers, anew=anew)

    @property
    def state(self) -> str:
        """The state in one word; ``connected`` while a link is up."""
        states = [link_state(link) for link in self.links.values()]
        return "connected" if "connected" in states else states[0]

    def status(self) -> dict[str, Any]:
        """Return the state of the links, for people and programs."""
        errors = (f"{name}: {link.last_error}" for name, link in self.links.items() if link.last_error)
        return {
            "address": shown_address(self.config),
            "title": self.config.title,
            "state": self.state,
            "error": "; ".join(errors),
            "links": self.graph.status(),
            "members": [{"interface": name, **link_status(link)} for name, link in self.links.items()],
        }
