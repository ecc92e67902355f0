"""Reads one document for many gateways: ``gateways`` with a configuration for each, checked one by one and across.

``{"gateways": {"robot": {"host": "10.0.0.7", "gateway": {...}, "remotes": [...]}, "cloud": {...}}}``. A gateway has the
name under which it stands, unless it says another. ``host`` is where others reach it, for the checks across.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple
from urllib.parse import urlsplit

from ropeway.errors import TOP_LEVEL, ConfigError
from ropeway.gateway.config.address import is_loopback
from ropeway.gateway.config.config import Config, Route, parse
from ropeway.gateway.config.document import read_file
from ropeway.gateway.config.overlay_model import OVERLAY
from ropeway.gateway.config.suggest import one_of, show, unknown_key

__all__ = ["KEY", "FleetFinding", "GatewayFleet", "is_fleet", "load_one", "read_fleet", "select"]

KEY: Final = "gateways"
_HOST: Final = "host"
_OUTWARD: Final[Mapping[str, str]] = {"subscribe": "publish", "reserve-service": "expose-service"} | {
    "reserve-action": "expose-action"
}
"""Operations that fetch a name, and those that send it."""
_ANYWHERE: Final = ("0.0.0.0", "::")  # noqa: S104 - compared, not bound


class FleetFinding(NamedTuple):
    """A fault or, where it may be meant, a warning of what does not fit together."""

    path: str
    text: str
    fault: bool = False


@dataclass(frozen=True)
class GatewayFleet:
    """The gateways of a document, by their names in it; ``hosts`` has those that were given."""

    members: Mapping[str, Config]
    hosts: Mapping[str, str]

    def findings(self) -> list[FleetFinding]:
        """Return what does not fit together."""
        return [*self._names(), *self._ports(), *self._dialled(), *self._unsent()]

    # ── who is called how, and listens where ───────────────────────────────────────────────────────────────────

    def _names(self) -> Iterator[FleetFinding]:
        seen: dict[str, str] = {}
        for name, config in self.members.items():
            called = config.gateway.name
            if called in seen:
                text = f"{seen[called]} is called {called}, too; others could not tell them apart"
                yield FleetFinding(f"{KEY}.{name}.gateway.name", text, fault=True)
            seen.setdefault(called, name)

    def _ports(self) -> Iterator[FleetFinding]:
        seen: dict[tuple[str, int], tuple[str, str]] = {}
        for name, config in self.members.items():
            host = self.hosts.get(name, f"({name})")
            for path, url in _sockets(config):
                port = urlsplit(url).port
                if not port:
                    continue
                path = f"{KEY}.{name}.{path}"
                other = seen.setdefault((host, port), (path, url))
                if other[0] != path and _collide(url, other[1]):
                    yield FleetFinding(
                        path, f"{url} and {other[1]} of {other[0]} are the same port of {host}", fault=True
                    )

    # ── who dials whom ─────────────────────────────────────────────────────────────────────────────────────────

    def _dialled(self) -> Iterator[FleetFinding]:
        for name, config in self.members.items():
            for index, remote in enumerate(config.remotes):
                for address in remote.addresses if remote.active else ():
                    yield from self._dials(name, f"{KEY}.{name}.remotes[{index}].address", address)

    def _dials(self, name: str, path: str, address: str) -> Iterator[FleetFinding]:
        """Check that somebody listens where a gateway of the document is dialled."""
        if "://" not in address:
            return
        parts = urlsplit(address)
        there = self._on_host(name, address)
        if not there:
            return
        listeners = [(other, url) for other in there for url in self.members[other].gateway.listen]
        fitting = [(other, url) for other, url in listeners if urlsplit(url).port == parts.port]
        if not fitting:
            said = ", ".join(f"{other} at {url}" for other, url in listeners) or "none of them listens anywhere"
            if there != [name]:
                yield FleetFinding(
                    path, f"nobody listens at {address}; on this host: {said}", fault=not is_loopback(address)
                )
            return
        other, url = fitting[0]
        if not is_loopback(address) and is_loopback(url):
            yield FleetFinding(path, f"{other} listens at {url}, which only its own machine reaches", fault=True)
        elif urlsplit(url).scheme != parts.scheme:
            yield FleetFinding(path, f"{other} listens at {url}; write {urlsplit(url).scheme}:// here", fault=True)
        elif other == name:
            yield FleetFinding(path, "this is the gateway itself", fault=True)

    def member_at(self, name: str, address: str) -> str:
        """Return the gateway that ``name`` reaches at an address, ``""`` where that is none of the document."""
        if "://" not in address:
            return ""
        there = self._on_host(name, address)
        port = urlsplit(address).port
        found = (one for one in there if any(urlsplit(url).port == port for url in self.members[one].gateway.listen))
        return next(found, "")

    def _on_host(self, name: str, address: str) -> list[str]:
        """Return the gateways on the host of an address that ``name`` dials, as far as the document says."""
        if is_loopback(address):
            return [other for other in self.members if self._together(name, other)]
        host = urlsplit(address).hostname or ""
        return [other for other, known in self.hosts.items() if known == host]

    def _together(self, name: str, other: str) -> bool:
        """Return whether two gateways are on one machine, as far as the document says."""
        mine = self.hosts.get(name)
        return name == other or (mine is not None and mine == self.hosts.get(other))

    # ── who reads what nobody sends ────────────────────────────────────────────────────────────────────────────

    def _unsent(self) -> Iterator[FleetFinding]:
        """Compare what crosses the overlay: what one fetches, another has to send, with the same type."""
        routes = [(name, route) for name, config in self.members.items() for route in _overlay_routes(config)]
        for name, route in routes:
            if any(other != name and _shares(self.members[other]) for other in self.members):
                continue  # what is shared automatically may be anything
            path = f"{KEY}.{name}.{route.path}"
            others = [(other, one) for other, one in routes if other != name and one.remote_name == route.remote_name]
            wanted = _OUTWARD.get(route.operation)
            if wanted is None:
                continue
            senders = [(other, one) for other, one in others if one.operation.removeprefix("trans-") == wanted]
            if not senders:
                yield FleetFinding(
                    path, f"no gateway of this document has {wanted} for {route.remote_name} in the overlay"
                )
            elif all(one.type != route.type for _, one in senders):
                other, one = senders[0]
                text = f"{other} has {route.remote_name} with the type {one.type}, and this is {route.type}"
                yield FleetFinding(path, text, fault=True)


def _shares(config: Config) -> bool:
    """Return whether a gateway offers to the overlay whatever its network has."""
    return any(remote.active and remote.automatic is not None for remote in config.remotes)


def is_fleet(document: object) -> bool:
    """Return whether a document is for many gateways."""
    return isinstance(document, Mapping) and KEY in document


def load_one(path: str | Path, name: str = "") -> Config:
    """Read the configuration of one gateway from a file that may have many. Raises ``ConfigError``."""
    return parse(select(read_file(path), name), str(path), directory=Path(path).parent, part=name)


def select(document: Any, name: str) -> Any:
    """Return the configuration of the gateway ``name``, or the document itself where it is for one.

    Raises ``ConfigError`` where a name is missing, not known, or given for a document that has none.
    """
    if not is_fleet(document):
        if name:
            raise ConfigError([(TOP_LEVEL, f'there is no "{KEY}" in this document; leave --as {name} out')])
        return document
    members = _members(document)
    if not name:
        raise ConfigError([(KEY, f"several gateways are described here; choose with --as: {', '.join(members)}")])
    if name not in members:
        raise ConfigError([(KEY, one_of(name, list(members)))])
    return _own(name, members[name])


def read_fleet(document: Any, source: str = "", *, directory: str | Path = ".") -> GatewayFleet:
    """Read all gateways of a document. Raises ``ConfigError`` with the faults of all of them, and those across."""
    members = _members(document)
    configs: dict[str, Config] = {}
    hosts: dict[str, str] = {}
    problems: list[tuple[str, str]] = []
    for name, member in members.items():
        host = member.get(_HOST)
        if isinstance(host, str) and host:
            hosts[name] = host.lower()
        elif host is not None:
            problems.append((f"{KEY}.{name}.{_HOST}", f"expected a name or an address, got {show(host)}"))
        try:
            configs[name] = parse(_own(name, member), source, directory=directory, part=name)
        except ConfigError as error:
            problems += [(f"{KEY}.{name}.{path}", text) for path, text in error.problems]
    fleet = GatewayFleet(configs, hosts)
    problems += [(found.path, found.text) for found in fleet.findings() if found.fault]
    if problems:
        raise ConfigError(problems, source)
    return fleet


def _members(document: Any) -> Mapping[str, Mapping[str, Any]]:
    problems = [(str(key), unknown_key(key, (KEY, "$schema"))) for key in document if key not in (KEY, "$schema")]
    members = document[KEY]
    if not isinstance(members, Mapping) or not members:
        problems.append((KEY, f"expected an object of configurations by name, got {show(members)}"))
    else:
        problems += [
            (f"{KEY}.{name}", f"expected a configuration, got {show(member)}")
            for name, member in members.items()
            if not isinstance(member, Mapping)
        ]
    if problems:
        raise ConfigError(problems)
    return {str(name): member for name, member in members.items()}


def _own(name: str, member: Mapping[str, Any]) -> dict[str, Any]:
    """Return the full form of a gateway, which has the name in the document unless it says another."""
    own = {key: value for key, value in member.items() if key != _HOST}
    gateway = own.setdefault("gateway", {})
    if isinstance(gateway, Mapping):
        own["gateway"] = {"name": name, **gateway}
    return own


def _sockets(config: Config) -> Iterator[tuple[str, str]]:
    for key, urls in (("listen", config.gateway.listen), ("control.listen", config.gateway.control.listen)):
        for number, url in enumerate(urls):
            yield f"gateway.{key}[{number}]", url


def _collide(one: str, other: str) -> bool:
    """Return whether two listeners of one port cannot both be on a machine."""
    hosts = [urlsplit(url).hostname for url in (one, other)]
    return hosts[0] == hosts[1] or any(host in _ANYWHERE for host in hosts)


def _overlay_routes(config: Config) -> Iterable[Route]:
    return (route for route in config.routes() if route.remote.addresses[0] == OVERLAY)
