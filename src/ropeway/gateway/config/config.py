"""Reads the configuration of a gateway strictly and brings it to one form.

Three spellings are accepted: the Gateway paper's list of remotes, one remote alone, and the full form
``{"gateway": {...}, "remotes": [...]}``, each as JSON or YAML. All become a ``Config``, whose ``routes()`` are the
tasks of the paper's Algorithm 1. Faults are collected and raised together as one ``ConfigError``. In every spelling
``remotes[0]`` names the first remote.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from ropeway.errors import ConfigError
from ropeway.gateway.config.address import is_iort
from ropeway.gateway.config.check import check, route_key
from ropeway.gateway.config.document import read_file
from ropeway.gateway.config.model import Document, GatewayConfig, RemoteConfig
from ropeway.gateway.config.route_model import OPERATIONS, BridgedName, TopicItem
from ropeway.gateway.config.route_options import AS_IT_COMES, RouteOptions
from ropeway.gateway.config.safety_model import SafetyItem

__all__ = ["Config", "GatewayConfig", "RemoteConfig", "Route", "load", "parse"]


@dataclass(frozen=True, slots=True)
class Route:
    """A task: a name on the local graph joined with a name at a remote.

    ``path`` is where the configuration says so; ``key`` stays the same while class, address, name and type do.
    """

    remote: RemoteConfig
    operation: str
    kind: str  # "topic", "service" or "action"
    name: str
    remote_name: str
    type: str
    path: str
    key: str
    graph: str
    options: RouteOptions = AS_IT_COMES


@dataclass(frozen=True)
class Config:
    """A whole configuration, valid. ``source`` names the file it came from, ``part`` its name in one of many."""

    gateway: GatewayConfig
    remotes: tuple[RemoteConfig, ...] = ()
    source: str = field(default="", compare=False)
    part: str = field(default="", compare=False)

    def routes(self, *, active: bool = True) -> list[Route]:
        """Return the tasks of all active remotes, in order; or those of them that are paused."""
        return [
            self._route(index, remote, operation, number, item)
            for index, remote in enumerate(self.remotes)
            if remote.active
            for operation, number, item in remote.items()
            if item.active is active
        ]

    def _route(self, index: int, remote: RemoteConfig, operation: str, number: int, item: BridgedName) -> Route:
        name, remote_name = remote.names(item)
        graph = remote.graph or self.gateway.graphs[0]
        kind = OPERATIONS[operation]
        return Route(
            remote=remote,
            operation=operation,
            kind=kind,
            name=name,
            remote_name=remote_name,
            type=item.type,
            path=f"remotes[{index}].{operation}[{number}]",
            key=route_key(operation, remote.address, graph, name, remote_name, item.type),
            graph=graph,
            options=item.options(),
        )

    def safeties(self) -> list[tuple[str, SafetyItem]]:
        """Return the topics of commands that are guarded, each with its path."""
        found = [(f"gateway.safety[{number}]", item) for number, item in enumerate(self.gateway.safety)]
        for index, remote in enumerate(self.remotes):
            for operation, number, item in remote.items() if remote.active else ():
                if isinstance(item, TopicItem) and item.safety is not None:
                    given = item.safety.model_dump()
                    made = SafetyItem(topic=remote.names(item)[0], type=item.type, graph=remote.graph, **given)
                    found.append((f"remotes[{index}].{operation}[{number}].safety", made))
        return found

    @property
    def stores(self) -> bool:
        """Whether last values are kept."""
        return (
            self.gateway.store is not None
            or any(map(is_iort, self.gateway.listen))
            or any(route.options.store for route in self.routes())
        )

    def slice(self, remotes: Iterable[int], *, listen: bool = True) -> Config:
        """Return the part of this configuration for a worker: only the remotes with these indexes stay active.

        The others stay in their places, so that every path and key is that of the whole. ``listen=False`` takes
        the listeners away.
        """
        wanted = set(remotes)
        kept = tuple(
            remote if index in wanted else remote.model_copy(update={"active": False})
            for index, remote in enumerate(self.remotes)
        )
        gateway = self.gateway if listen else self.gateway.model_copy(update={"listen": ()})
        return replace(self, gateway=gateway, remotes=kept)

    def beside_another(self) -> Config:
        """Return the same without what one worker does for all: posts to web servers, and records graphs."""
        gateway = self.gateway
        if not (gateway.http or gateway.record):
            return self
        record = tuple(one.model_copy(update={"topics": ()}) for one in gateway.record if one.routes or one.link_state)
        return replace(self, gateway=gateway.model_copy(update={"http": (), "record": record}))

    def to_json(self) -> dict[str, Any]:
        """Return the full form, for ``parse`` in another process: paths are absolute and all defaults are
        written out.
        """
        whole = Document.model_construct(gateway=self.gateway, remotes=self.remotes)  # the one model that is built
        dumped: dict[str, Any] = whole.model_dump(
            mode="json", by_alias=True, exclude_none=True, exclude={"schema_", "anycast"}
        )
        return dumped

    @cached_property
    def etag(self) -> str:
        """A digest of the configuration, which two of the same sense share."""
        text = json.dumps(self.to_json(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    @staticmethod
    def schema() -> dict[str, Any]:
        """Return a JSON Schema of everything that ``parse`` accepts, for editors."""
        from ropeway.gateway.config.schema import build  # a tenth of a second that only this needs

        return build()


def load(path: str | Path) -> Config:
    """Read a JSON or YAML file. Raises ``ConfigError`` with every fault; relative paths start at the file."""
    return parse(read_file(path), str(path), directory=Path(path).parent)


def parse(obj: object, source: str = "", *, directory: str | Path = ".", part: str = "") -> Config:
    """Make a ``Config`` of a parsed JSON value. Raises ``ConfigError`` with every fault.

    ``source`` stands before each of them; relative paths in ``obj`` start at ``directory``. ``part`` is the name in a
    document of many.
    """
    document, problems = check(obj, Path(directory))
    if document is None or problems:
        raise ConfigError(problems, source)
    gateway = document.gateway
    if "listen" not in gateway.model_fields_set and any(remote.active for remote in document.remotes):
        gateway = gateway.model_copy(update={"listen": ()})  # it only dials: no port is opened that nobody asked for
    return Config(gateway, document.remotes, source, part)
