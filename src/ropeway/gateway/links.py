"""A remote that is reached over several links at once, each by a network interface of its own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ropeway.gateway.config.model import RemoteConfig
from ropeway.gateway.credentials import Credentials
from ropeway.gateway.remote import SeveralLinks, shown_address
from ropeway.group.links import LinkGroup
from ropeway.networks.rosbridge.client.by_interface import InterfaceGraph
from ropeway.types import TypeRegistry

__all__ = ["LinksRemote"]


class LinksRemote(SeveralLinks):
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

    def status(self) -> dict[str, Any]:
        """Return the state of the links, for people and programs."""
        return {
            "address": shown_address(self.config),
            "title": self.config.title,
            "state": self.state,
            "error": self.error,
            "links": self.graph.status(),
            "members": self.members("interface"),
        }
