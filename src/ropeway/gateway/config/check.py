"""Finds every fault of a configuration in one pass and says each in one line.

First the shape (unknown keys, wrong types, bad names), by the models; then the sense (duplicate tasks, open listeners,
graphs that are not there), on whatever parts are well-formed, so that one run reports all.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Final, TypeVar

from pydantic import ValidationError

from ropeway.errors import TOP_LEVEL
from ropeway.gateway.config.address import (
    default_graph,
    is_iort,
    is_loopback,
    is_mqtt,
    is_secure,
    parse_graph,
    parse_link,
    parse_listen,
)
from ropeway.gateway.config.auth_model import ALL
from ropeway.gateway.config.model import Document, RemoteConfig
from ropeway.gateway.config.overlay_model import METADATA, OVERLAY
from ropeway.gateway.config.policy import policy_problems, with_default_policy, with_policy_files
from ropeway.gateway.config.route_model import OPERATIONS, BridgedName
from ropeway.gateway.config.safety_check import safety_problems
from ropeway.gateway.config.shape import inner_model, keys_of, shape_problems, spellings
from ropeway.gateway.config.suggest import did_you_mean, nearest, one_of
from ropeway.gateway.config.web_rules import with_web_rules
from ropeway.limits import OVERLAY_WAYS

__all__ = ["check", "route_key"]

Problem = tuple[str, str]
T = TypeVar("T")

_WHY_NOT: Final = {
    "ros2": "ros2 has the types of the ROS 2 that is sourced",
    "auto": "write dds:0 instead of auto, which may be ros2",
    "ros1": "ROS 1 has its own types",
    "mqtt": "a broker knows no types; topics says which its topics have",
    "mqtts": "a broker knows no types; topics says which its topics have",
    "memory": "a network in memory has the types of the gateway",
}


def check(obj: object, directory: Path) -> tuple[Document | None, list[Problem]]:
    """Check a configuration; return the document, ``None`` if its shape is wrong, and every problem, those of shape
    first.
    """
    obj, faults = with_web_rules(obj)
    full, problem = _full_form(obj)
    if problem:
        return None, [problem]
    full, problems = with_policy_files(full, directory)
    problems = [*faults, *problems]
    document: Document | None = None
    try:
        document = with_default_policy(Document.model_validate(full, context={"directory": directory}))
    except ValidationError as error:
        problems += shape_problems(error, Document)
    problems += _sense(full, document)
    problems += [] if document is None else policy_problems(document)
    return document, problems


def route_key(operation: str, address: str, graph: str, name: str, remote_name: str, type: str) -> str:
    """Return a stable hash of a task: its class and direction, address, names and type.

    Direction, graph and remote name are part of it because a topic may go both ways, from two networks, or to two
    names. ``publish`` and ``trans-publish`` are one direction.
    """
    digest = hashlib.sha256()
    direction = operation.removeprefix("trans-")
    for text in (OPERATIONS[operation], direction, address, graph, name, remote_name, type):
        raw = text.encode()
        digest.update(len(raw).to_bytes(4, "big") + raw)
    return digest.hexdigest()[:32]


# ------------------------------------------------------------------------------------------------------ shape


def _full_form(obj: object) -> tuple[Mapping[str, Any], Problem | None]:
    """Bring the three spellings of a configuration to the full form."""
    if isinstance(obj, list):
        return {"remotes": obj}, None
    if not isinstance(obj, Mapping):
        what = "the file is empty; " if obj is None else ""
        return {}, (TOP_LEVEL, f"{what}expected a list of remotes, or an object with gateway and remotes")
    if "gateways" in obj:
        return {}, ("gateways", "several gateways are described here; choose one of them with --as")
    if not obj.keys() & {"gateway", "remotes"}:
        keys = keys_of(RemoteConfig)
        meant = any(nearest(key, ("gateway", "remotes")) for key in obj if key not in keys)
        if not meant and any(nearest(key, keys) for key in obj):
            return {"remotes": [obj]}, None
    return obj, None


# ------------------------------------------------------------------------------------------------------ sense


def _attempt(make: Callable[[Any], T], value: object) -> T | None:
    """Return ``make(value)``, or ``None`` if its shape is wrong, which is reported elsewhere."""
    try:
        return make(value)
    except (ValueError, TypeError, AttributeError):
        return None


def _objects(value: object) -> Iterable[tuple[int, Mapping[str, Any]]]:
    if isinstance(value, list):
        yield from ((i, item) for i, item in enumerate(value) if isinstance(item, Mapping))


def _sense(full: Mapping[str, Any], document: Document | None) -> list[Problem]:
    gateway = full.get("gateway")
    gateway = gateway if isinstance(gateway, Mapping) else {}
    problems = [*_listeners(gateway), *_auth(gateway), *_control(gateway), *_store(gateway, full.get("remotes"))]
    problems += _overlay_links(gateway.get("overlay"))
    graphs = gateway.get("graphs")
    if graphs is None:
        try:
            graphs = [default_graph()]
        except ValueError as error:
            problems.append(("gateway.graphs", str(error)))
    graphs = [graph.get("address") if isinstance(graph, Mapping) else graph for graph in _list(graphs)]
    problems += _graphs(gateway, graphs)
    problems += _recorders(gateway, graphs)
    problems += safety_problems(full, graphs) if graphs else []
    first_seen: dict[str, str] = {}
    for index, remote in _objects(full.get("remotes")):
        path = f"remotes[{index}]"
        problems += _remote(remote, path, graphs)
        problems += _overlay(remote, path, gateway)
        problems += _iort(remote, path)
        problems += _mqtt(remote, path)
        if _inactive(remote):
            continue
        read = None if document is None else document.remotes[index]
        for key, where, said in _tasks(remote, read, path, graphs):
            if key in first_seen:
                problems.append((where, f"the same task as {first_seen[key]} ({said}); keep one"))
            else:
                first_seen[key] = where
    return problems


def _control(gateway: Mapping[str, Any]) -> Iterable[Problem]:
    """Check that nobody without credentials changes the gateway over TCP."""
    control, auth = gateway.get("control"), gateway.get("auth")
    if not isinstance(control, Mapping):
        return
    for key in ("listen", "metrics"):
        addresses, where = control.get(key), f"gateway.control.{key}"
        if not addresses:
            continue
        if not isinstance(auth, Mapping) or not (auth.get("tokens") or auth.get("certificates")):
            yield (
                where,
                "needs gateway.auth with tokens or certificates; without, the API is on the UNIX socket of its user "
                "only",
            )
        if gateway.get("tls") is None and any(str(url).startswith("https:") for url in _list(addresses)):
            yield where, "https:// needs gateway.tls with a certificate and its key"


def _graphs(gateway: Mapping[str, Any], addresses: list[Any]) -> Iterable[Problem]:
    for number, graph in _objects(gateway.get("graphs")):
        where, address = f"gateway.graphs[{number}]", _attempt(parse_graph, graph.get("address"))
        for key in ("distro", "types"):
            if address is not None and graph.get(key) is not None and not address.startswith(("dds:", "zenoh")):
                why = _WHY_NOT[address.partition(":")[0]]
                yield f"{where}.{key}", f"only dds and zenoh graphs have this key; {why}"
        if graph.get("topics") and address is not None and not is_mqtt(address):
            yield f"{where}.topics", "only mqtt and mqtts graphs have this key"
        if graph.get("distro") is not None and address is not None and "distro=" in address:
            yield f"{where}.distro", f"{address} says it, too; keep one"
    for number, address in enumerate(addresses):
        first = addresses.index(address)
        if first != number:
            yield f"gateway.graphs[{number}]", f"the same network as gateway.graphs[{first}]; keep one"


def _recorders(gateway: Mapping[str, Any], addresses: list[Any]) -> Iterable[Problem]:
    """Check that what recorders read is there."""
    record = gateway.get("record")
    several = isinstance(record, list)
    for number, one in _objects(record if several else [record]):
        graph = _attempt(parse_graph, one.get("graph"))
        if graph is not None and graph not in addresses:
            where = f"gateway.record[{number}].graph" if several else "gateway.record.graph"
            yield where, one_of(graph, [str(address) for address in addresses])


def _list(value: object) -> list[Any]:
    return list(value) if isinstance(value, list | tuple) else []


def _listeners(gateway: Mapping[str, Any]) -> Iterable[Problem]:
    listen, tls, auth = gateway.get("listen"), gateway.get("tls"), gateway.get("auth")
    tls = tls if isinstance(tls, Mapping) else {}
    certified = tls.get("ca") is not None and tls.get("client_certificates") != "optional"
    identified = isinstance(auth, Mapping) and bool(auth.get("tokens") or auth.get("certificates"))
    if identified and isinstance(auth, Mapping) and auth.get("default_role") == ALL:
        identified = False
    for number, text in enumerate(listen if isinstance(listen, list) else []):
        address = _attempt(parse_listen, text)
        if address is None:
            continue
        where = f"gateway.listen[{number}]"
        if is_secure(address) and not tls:
            scheme = address.partition(":")[0]
            yield where, f'a {scheme}:// listener needs gateway.tls with "certificate" and "key"'
        guarded = is_loopback(address) or identified or (is_secure(address) and certified)
        if not guarded and gateway.get("insecure") is not True:
            yield (
                where,
                f"{address} lets every machine that reaches it read and publish without authentication; listen on "
                '127.0.0.1, name tokens under gateway.auth, or write "insecure": true under gateway if that is meant',
            )


def _auth(gateway: Mapping[str, Any]) -> Iterable[Problem]:
    auth, tls = gateway.get("auth"), gateway.get("tls")
    if not isinstance(auth, Mapping):
        return
    roles = auth.get("roles")
    known = [*(roles if isinstance(roles, Mapping) else ()), ALL]
    named = [
        (f"gateway.auth.{key}[{i}].role", item.get("role"))
        for key in ("tokens", "certificates")
        for i, item in _objects(auth.get(key))
    ]
    for where, role in (*named, ("gateway.auth.default_role", auth.get("default_role"))):
        if isinstance(role, str) and role not in known:
            yield where, one_of(role, known)
    if auth.get("certificates") and (not isinstance(tls, Mapping) or tls.get("ca") is None):
        yield "gateway.auth.certificates", "needs gateway.tls with ca: only so are clients asked for certificates"


def _first_address(remote: Mapping[str, Any]) -> object:
    """Return the address; of a group the first, which says what kind all are."""
    address = remote.get("address")
    return address[0] if isinstance(address, list) and address else address


def _remote(remote: Mapping[str, Any], path: str, graphs: list[Any]) -> Iterable[Problem]:
    address = _attempt(parse_link, _first_address(remote))
    tls = remote.get("tls")
    if isinstance(tls, Mapping):
        if address is not None and not is_secure(address):
            secure = "mqtts" if is_mqtt(address) else "wss"
            yield f"{path}.tls", f"needs a {secure}:// address, and {path}.address is {address}"
        for one, other in (("certificate", "key"), ("key", "certificate")):
            if tls.get(one) is not None and tls.get(other) is None:
                yield f"{path}.tls.{other}", f"this key is missing; {one} is of no use without it"
    for key in ("distro", "types"):
        if not remote.get(key):
            continue
        if not isinstance(address, str) or not address.startswith("ws"):
            if address is not None or _first_address(remote) == OVERLAY:
                yield f"{path}.{key}", f"only ws:// and wss:// remotes have this key, and this is {remote['address']}"
        elif remote.get("ros") == 1:
            yield f"{path}.{key}", 'a remote of ROS 1 has no layouts of ROS 2; leave this or "ros": 1 out'
    yield from _anycast(remote, path)
    yield from _interfaces(remote, path, address)
    graph = _attempt(parse_graph, remote.get("graph"))
    if graph is not None and graphs and graph not in graphs:
        near = did_you_mean(graph, [g for g in graphs if isinstance(g, str)])
        yield f"{path}.graph", f"expected one of gateway.graphs ({', '.join(map(str, graphs))}), got {graph}{near}"


def _interfaces(remote: Mapping[str, Any], path: str, address: str | None) -> Iterable[Problem]:
    """Check that several links are those of one address."""
    named = remote.get("interfaces")
    count = len(named) if isinstance(named, list | tuple) else bool(named)
    if named and (not isinstance(address, str) or not address.startswith("ws")):
        yield (
            f"{path}.interfaces",
            "only ws:// and wss:// remotes have this key; the overlay has its own in gateway.overlay, and for others "
            "the system decides",
        )
    if isinstance(named, list | tuple) and len(set(map(str, named))) < len(named):
        yield f"{path}.interfaces", "the same interface twice; keep one"
    if count > 1 and isinstance(remote.get("address"), list) and len(remote["address"]) > 1:
        yield f"{path}.interfaces", "several links lead to one address; name one interface, or one address"
    if remote.get("links") is not None and count < 2:
        yield f"{path}.links", "needs several interfaces"


def _overlay_links(overlay: object) -> Iterable[Problem]:
    """Check that links used at once have an interface each."""
    if not isinstance(overlay, Mapping):
        return
    named, path = _list(overlay.get("interfaces")), "gateway.overlay"
    if len(set(map(str, named))) < len(named):
        yield f"{path}.interfaces", "the same interface twice; keep one"
    if overlay.get("links") is not None and len(named) < 2:
        yield f"{path}.links", "needs several interfaces; name them in gateway.overlay.interfaces"
    elif overlay.get("links") is not None and len(named) > OVERLAY_WAYS:
        yield f"{path}.interfaces", f"at most {OVERLAY_WAYS} are used at once"


def _anycast(remote: Mapping[str, Any], path: str) -> Iterable[Problem]:
    """Check that a group has several members, and only keys that it can have."""
    anycast, listed = remote.get("anycast"), remote.get("address")
    if anycast is None:
        return
    if listed == OVERLAY:
        if remote.get("automatic") is not None:
            text = "what is shared automatically goes to everybody; write a remote of its own for it"
            yield f"{path}.automatic", text
        return
    if not (isinstance(listed, list) and len(listed) > 1):
        yield f"{path}.anycast", f'needs several addresses, or "overlay"; {path}.address is one'
    if isinstance(anycast, Mapping) and anycast.get("members") is not None:
        yield f"{path}.anycast.members", 'needs "address": "overlay"; here the addresses say who the members are'


def _overlay(remote: Mapping[str, Any], path: str, gateway: Mapping[str, Any]) -> Iterable[Problem]:
    """Check the keys that only a remote in the overlay has, and those that it does not have."""
    there = _first_address(remote) == OVERLAY
    if there and gateway.get("overlay") is None and not _inactive(remote):
        yield f"{path}.address", 'the overlay needs gateway.overlay with an "identity"; ropeway keys issue writes one'
    for key in ("tls", "token") if there else ("unique", "readers", "callers", "automatic"):
        if remote.get(key) is not None:
            what = (
                "is not for the overlay, where certificates say who is who" if there else 'needs "address": "overlay"'
            )
            yield f"{path}.{key}", what
    if there:
        return
    for operation in OPERATIONS:
        items = remote.get(operation)
        for index, item in enumerate(items if isinstance(items, list | tuple) else ()):
            for key in METADATA:
                if isinstance(item, Mapping) and item.get(key) is not None:
                    yield f"{path}.{operation}[{index}].{key}", 'needs "address": "overlay"'


def _iort(remote: Mapping[str, Any], path: str) -> Iterable[Problem]:
    """Check the keys that only a server of nodes has, and those that it does not have."""
    address = _attempt(parse_link, _first_address(remote))
    if address is None or not is_iort(address):
        if remote.get("maps"):
            yield f"{path}.maps", "needs an iort:// address; maps of listeners stand under gateway.iort"
        return
    for operation, kind in OPERATIONS.items():
        if kind != "topic" and remote.get(operation):
            yield f"{path}.{operation}", "IoRT nodes know neither services nor actions"


def _mqtt(remote: Mapping[str, Any], path: str) -> Iterable[Problem]:
    """Check the keys that only a broker has, and those that it does not have."""
    address = _attempt(parse_link, _first_address(remote))
    if address is None or not is_mqtt(address):
        for key in ("topics", "user", "password"):
            if remote.get(key):
                yield f"{path}.{key}", "needs an mqtt:// or mqtts:// address"
        return
    if remote.get("password") is not None and remote.get("user") is None:
        yield f"{path}.user", "this key is missing; a password is that of a user"
    if remote.get("token") is not None:
        yield f"{path}.token", 'a broker asks for a user and a password; write "user" and "password"'
    for operation, kind in OPERATIONS.items():
        if kind != "topic" and remote.get(operation):
            yield f"{path}.{operation}", "MQTT knows neither services nor actions"


def _store(gateway: Mapping[str, Any], remotes: object) -> Iterable[Problem]:
    """Check that only one process keeps last values."""
    if gateway.get("workers", 0) in (0, None):
        return
    listen = gateway.get("listen")
    nodes = any(
        (address := _attempt(parse_listen, text)) is not None and is_iort(address)
        for text in (listen if isinstance(listen, list) else [])
    )
    stored = any(
        item.get("store") is True
        for _, remote in _objects(remotes)
        for operation, kind in OPERATIONS.items()
        if kind == "topic"
        for _, item in _objects(remote.get(operation))
    )
    if nodes or stored or gateway.get("store") is not None:
        yield (
            "gateway.workers",
            "last values and IoRT nodes need one process; write 0, or run a second gateway for them",
        )


def _inactive(remote: Mapping[str, Any]) -> bool:
    active = remote.get("active", True)
    return active is False or (isinstance(active, str) and active.lower() == "false")


def _tasks(
    remote: Mapping[str, Any], read: RemoteConfig | None, path: str, graphs: list[Any]
) -> Iterable[tuple[str, str, str]]:
    """Yield ``(key, path, words)`` for every well-formed task of a remote; ``read`` is the whole, where all is well."""
    shell = read or _shell(remote)
    if shell is None:
        return
    default = graphs[0] if graphs else ""
    for operation in OPERATIONS:
        field = operation.replace("-", "_")
        items = enumerate(getattr(read, field)) if read is not None else _well_formed(field, remote.get(operation))
        for number, item in items:
            name, remote_name = shell.names(item)
            key = route_key(operation, shell.address, shell.graph or str(default), name, remote_name, item.type)
            said = f"{OPERATIONS[operation]} {name}, {item.type}, {shell.address}"
            yield key, f"{path}.{operation}[{number}]", said


def _shell(remote: Mapping[str, Any]) -> RemoteConfig | None:
    frame = {k: remote[k] for k in ("address", "graph", "local_namespace", "remote_namespace") if k in remote}
    return _attempt(RemoteConfig.model_validate, frame)


def _well_formed(field: str, items: object) -> Iterable[tuple[int, BridgedName]]:
    model = inner_model(RemoteConfig.model_fields[field].annotation)
    assert model is not None
    known = spellings(model)
    for number, raw in _objects(items):
        item = _attempt(model.model_validate, {k: v for k, v in raw.items() if k in known})
        if isinstance(item, BridgedName):
            yield number, item
